//! The group's configuration: accepts changes in the middle of a match, keeps the revisions before, and
//! goes back to the one before when a new one does not work.
//!
//! `config.toml` in the runtime directory is the newest accepted configuration, from which every process
//! starts; `revisions/N.toml` are the last ones by number, for a tracker that gets runs of another
//! revision, and for going back. Both are replaced atomically, so a supervisor that dies at any moment
//! leaves one accepted configuration.

use super::history::{self, KEPT_CHANGES};
use super::premises::make_private_directory;
use super::sys::{self, Call};
use client::instance::Instance;
use client::private;
use config::change::content_hash;
use config::change::{Change, Effect, changes};
use config::input;
use config::snapshot::{Snapshot, concerned};
use config::{Config, ConfigError, commented_toml};
use control::{KEPT_REVISIONS, Revised};
use messages::{ProcessKind, Revision};
use std::fs;
use std::io::{self, Write};
use std::path::Path;

/// File of the configuration that the supervisor was started with, beside the revisions.
const ORIGIN: &str = "origin.toml";
/// A configuration with which processes fail so often within its trial is given up.
const MOST_FAULTS: u32 = 2;
/// Length of a trial, from the acceptance of a configuration.
const TRIAL_NS: u64 = 20_000_000_000;

/// Pause after a failed attempt to take a configuration back.
const RETRY_NS: u64 = 1_000_000_000;

/// The configuration of a running group.
pub struct Configuration {
    instance: Instance,
    snapshot: Snapshot,
    trial: Option<Trial>,
    history: Vec<Revised>,
}

/// A new configuration is watched until it has proved itself.
struct Trial {
    ends_ns: u64,
    faults: u32,
    /// Time before which it is not taken back, because that has just failed.
    retry_ns: u64,
}

impl Configuration {
    /// The configuration that a group starts with or, if it `lives` already, goes on with.
    pub fn new(instance: &Instance, snapshot: Snapshot, lives: bool) -> Self {
        let what = match snapshot.revision {
            Revision::FIRST => "as the group was started",
            _ => "as the supervisor before has left it",
        };
        let number = snapshot.revision.number;
        let start = Revised::new(number, content_hash(&snapshot.config), what.into());
        let history = if lives { history::read(instance) } else { Vec::new() };
        let is_known = history.last().is_some_and(|last| last.revision == number);
        let mut it = Self { instance: instance.clone(), snapshot, trial: None, history };
        if !is_known {
            it.remember(start);
        }
        it
    }

    /// The newest accepted one.
    pub fn snapshot(&self) -> &Snapshot {
        &self.snapshot
    }

    /// Identifies the content of the newest accepted one.
    pub fn hash(&self) -> &str {
        self.history.last().map_or("", |last| &last.hash)
    }

    /// Changes so far, oldest first.
    pub fn history(&self) -> &[Revised] {
        &self.history
    }

    /// Accepts the configuration in a file, if this group can go over to it. Returns the kinds of stage
    /// to be replaced; `None` if nothing differs.
    ///
    /// A change that was made from another revision `base` than the newest one is refused: it would undo
    /// what was changed meanwhile.
    pub fn accept(
        &mut self,
        file: &Path,
        base: Option<u32>,
        now_ns: u64,
    ) -> Result<Option<Vec<ProcessKind>>, String> {
        let number = self.snapshot.revision.number;
        if let Some(base) = base
            && base != number
        {
            return Err(format!(
                "the configuration was changed meanwhile: it is revision {number}, and this change was made \
                 from revision {base}; look at it and try again"
            ));
        }
        let text = input::read_text(file, input::CONFIG).map_err(|error| error.to_string())?;
        let config = Config::parse(&text, "the new configuration");
        let config = config.map_err(|error| error.to_string())?;
        let changes = changes(&self.snapshot.config, &config);
        let refused: Vec<String> = changes.iter().filter_map(refusal).collect();
        if !refused.is_empty() {
            return Err(format!(
                "a running group cannot take this over; stop it and start it again:\n  {}",
                refused.join("\n  ")
            ));
        }
        if changes.is_empty() {
            return Ok(None);
        }
        let what = summary(&changes);
        self.replace(self.snapshot.next(config, Some(number)), what)?;
        self.trial = Some(Trial { ends_ns: now_ns + TRIAL_NS, faults: 0, retry_ns: 0 });
        Ok(Some(concerned(&changes)))
    }

    /// Goes back to the configuration before. Returns the kinds of stage to be replaced.
    pub fn roll_back(&mut self, reason: &str) -> Result<Vec<ProcessKind>, String> {
        let Some(number) = self.snapshot.before else {
            return Err("there is no configuration before this one".into());
        };
        let earlier = Snapshot::load(&self.instance.revision_path(number))
            .map_err(|error: ConfigError| format!("revision {number}: {error}"))?;
        let changes = changes(&self.snapshot.config, &earlier.config);
        let what = format!("back to revision {number}: {reason}");
        self.replace(self.snapshot.next(earlier.config, earlier.before), what)?;
        self.trial = None;
        Ok(concerned(&changes))
    }

    /// Counts a failure of a process of this kind that runs with this revision. True if the configuration
    /// is on trial, concerns this kind, and the failure counts against it.
    pub fn blame(&mut self, kind: ProcessKind, revision: u32, now_ns: u64) -> bool {
        let number = self.snapshot.revision.number;
        let is_new = revision == number && self.snapshot.needed(kind) == number;
        // A process that finds no file to start from says nothing about what is in it.
        let is_new = is_new && self.instance.config_path().exists();
        match &mut self.trial {
            Some(trial) if is_new && now_ns < trial.ends_ns => {
                trial.faults += 1;
                true
            }
            _ => false,
        }
    }

    /// Whether the configuration on trial has failed and is to be taken back now.
    pub fn has_failed(&self, now_ns: u64) -> bool {
        let is_due = |trial: &Trial| trial.faults >= MOST_FAULTS && now_ns >= trial.retry_ns;
        self.trial.as_ref().is_some_and(is_due)
    }

    /// It could not be taken back: it is tried again a little later.
    pub fn retry_later(&mut self, now_ns: u64) {
        if let Some(trial) = &mut self.trial {
            trial.retry_ns = now_ns + RETRY_NS;
        }
    }

    fn replace(&mut self, snapshot: Snapshot, what: String) -> Result<(), String> {
        let number = snapshot.revision.number;
        write(&self.instance, &snapshot)
            .map_err(|error| format!("the new configuration cannot be kept: {error}"))?;
        self.remember(Revised::new(number, content_hash(&snapshot.config), what));
        self.snapshot = snapshot;
        Ok(())
    }

    fn remember(&mut self, change: Revised) {
        self.history.push(change);
        let surplus = self.history.len().saturating_sub(KEPT_CHANGES);
        self.history.drain(..surplus);
        // Best effort: the configuration counts without its history, and the next change writes all of it.
        let _ = history::write(&self.instance, &self.history);
    }
}

/// Writes a snapshot as the newest one, and under its number.
pub fn write(instance: &Instance, snapshot: &Snapshot) -> io::Result<()> {
    let (number, text) = (snapshot.revision.number, snapshot.to_text());
    let directory = instance.revisions_directory();
    let numbered = instance.revision_path(number);
    let newest = instance.config_path();
    let new = newest.with_extension("new");
    sys::ask(Call::WriteConfig, || {
        make_private_directory(&directory)?;
        for path in [&numbered, &new] {
            private::create_file(path)?.write_all(text.as_bytes())?;
        }
        fs::rename(&new, &newest)
    })?;
    // Best effort: an old revision costs a few kilobytes.
    if let Some(old) = number.checked_sub(KEPT_REVISIONS) {
        let _ = fs::remove_file(instance.revision_path(old));
    }
    Ok(())
}

/// Keeps the configuration that the supervisor was started with, for [`left_behind`].
pub fn keep_origin(instance: &Instance, config: &Config) -> io::Result<()> {
    make_private_directory(&instance.revisions_directory())?;
    private::create_file(&instance.revisions_directory().join(ORIGIN))?
        .write_all(commented_toml(config).as_bytes())
}

/// The newest snapshot, if this configuration is one of the kept revisions, or the one that the earlier
/// supervisor was started with: a group that was reloaded goes on with its newest configuration, although
/// it is started again with an older one.
pub fn left_behind(instance: &Instance, config: &Config) -> Option<Snapshot> {
    let newest = Snapshot::load(&instance.config_path()).ok()?;
    let is_known = || {
        let entries = fs::read_dir(instance.revisions_directory()).into_iter().flatten().flatten();
        entries
            .filter_map(|entry| Snapshot::load(&entry.path()).ok())
            .any(|earlier| earlier.config == *config)
    };
    (newest.config == *config || is_known()).then_some(newest)
}

fn refusal(change: &Change) -> Option<String> {
    match change.effect() {
        Effect::NewGroup(reason) => Some(format!("{change} ({reason})")),
        Effect::Stages(_) | Effect::Supervisor => None,
    }
}

/// The changed keys in one line.
fn summary(changes: &[Change]) -> String {
    const SHOWN: usize = 3;
    let shown: Vec<String> = changes.iter().take(SHOWN).map(Change::to_string).collect();
    match changes.len().saturating_sub(SHOWN) {
        0 => shown.join(", "),
        more => format!("{}, and {more} more keys", shown.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn configuration(name: &str) -> (Configuration, std::path::PathBuf) {
        let base = std::env::temp_dir().join(format!("tl-{name}-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        let snapshot = Snapshot::first(Config::default());
        write(&instance, &snapshot).unwrap();
        (Configuration::new(&instance, snapshot, false), base)
    }

    fn file(base: &Path, config: &Config) -> std::path::PathBuf {
        let path = base.join("new.toml");
        fs::write(&path, commented_toml(config)).unwrap();
        path
    }

    #[test]
    fn a_change_is_accepted_and_taken_back() {
        let (mut it, base) = configuration("revisions");
        let mut config = Config::default();
        assert_eq!(it.accept(&file(&base, &config), None, 0), Ok(None), "nothing differs");
        config.filter.actuation_delay_ms = 33.0;
        assert_eq!(it.accept(&file(&base, &config), None, 0), Ok(Some(vec![ProcessKind::Filter])));
        assert_eq!(it.snapshot().revision.number, 2);
        let written = Snapshot::load(&it.instance.config_path()).unwrap();
        assert_eq!(&written, it.snapshot());
        assert_eq!(left_behind(&it.instance, &Config::default()), Some(written.clone()));
        let mut other = Config::default();
        other.filter.actuation_delay_ms = 34.0;
        assert_eq!(left_behind(&it.instance, &other), None);

        assert_eq!(it.roll_back("for a test"), Ok(vec![ProcessKind::Filter]));
        assert_eq!(it.snapshot().revision.number, 3, "revisions only rise");
        assert_eq!(it.snapshot().config, Config::default());
        assert!(it.roll_back("again").is_err());
        assert_eq!(it.history().len(), 3);
        assert_eq!(it.history()[0].hash, it.hash(), "the content of the first");
        assert_ne!(it.history()[1].hash, it.hash());

        let next = Configuration::new(&it.instance, it.snapshot().clone(), true);
        assert_eq!(next.history(), it.history(), "it outlives the supervisor");
        let anew = Configuration::new(&it.instance, Snapshot::first(Config::default()), false);
        assert_eq!(anew.history().len(), 1);
        it.instance.remove_directory().unwrap();
        fs::remove_dir_all(base).unwrap();
    }

    #[test]
    fn the_configuration_of_the_start_is_known_however_often_it_is_changed() {
        let (mut it, base) = configuration("origin");
        keep_origin(&it.instance, &Config::default()).unwrap();
        let mut config = Config::default();
        for change in 1..=KEPT_REVISIONS + 3 {
            config.filter.actuation_delay_ms = 20.0 + f64::from(change);
            it.accept(&file(&base, &config), None, 0).unwrap();
        }
        assert_eq!(left_behind(&it.instance, &Config::default()).as_ref(), Some(it.snapshot()));
        config.filter.actuation_delay_ms = 21.0;
        assert_eq!(left_behind(&it.instance, &config), None, "a revision that is not kept");
        assert!(fs::read_dir(it.instance.revisions_directory()).unwrap().count() < 20);
        it.instance.remove_directory().unwrap();
        fs::remove_dir_all(base).unwrap();
    }

    #[test]
    fn what_needs_a_new_group_or_is_invalid_is_refused_and_changes_nothing() {
        let (mut it, base) = configuration("refused");
        let before = fs::read(it.instance.config_path()).unwrap();
        let mut config = Config::default();
        config.camera.width = 320;
        config.camera.height = 240;
        config.geometry = config::GeometryConfig::above(&config.field, [320, 240], 2200.0);
        let refusal = it.accept(&file(&base, &config), None, 0).unwrap_err();
        assert!(refusal.contains("camera.width: 640 → 320"), "{refusal}");
        let broken = base.join("broken.toml");
        fs::write(&broken, "[filter]\nactuation_delay_ms = -1\n").unwrap();
        let refusal = it.accept(&broken, None, 0).unwrap_err();
        assert!(refusal.contains("actuation_delay_ms") && refusal.contains(":2"), "{refusal}");
        assert!(it.accept(&base.join("missing.toml"), None, 0).is_err());
        assert_eq!(fs::read(it.instance.config_path()).unwrap(), before);
        it.instance.remove_directory().unwrap();
        fs::remove_dir_all(base).unwrap();
    }

    #[test]
    fn a_change_of_an_outdated_configuration_is_refused() {
        let (mut it, base) = configuration("outdated");
        let mut config = Config::default();
        let mut accept = |delay_ms: f64, from: Option<u32>| {
            config.filter.actuation_delay_ms = delay_ms;
            it.accept(&file(&base, &config), from, 0)
        };
        assert!(accept(33.0, Some(1)).is_ok());
        for from in [0, 1, 3] {
            let refusal = accept(34.0, Some(from)).unwrap_err();
            assert!(refusal.contains("changed meanwhile: it is revision 2"), "{refusal}");
            assert!(refusal.contains(&format!("from revision {from};")), "{refusal}");
        }
        assert!(accept(34.0, Some(2)).is_ok());
        assert!(accept(35.0, None).is_ok(), "wanted whatever there is");
        assert_eq!(it.snapshot().revision.number, 4);
        it.instance.remove_directory().unwrap();
        fs::remove_dir_all(base).unwrap();
    }

    #[test]
    fn two_faults_within_the_trial_condemn_a_configuration() {
        let (mut it, base) = configuration("trial");
        const FILTER: ProcessKind = ProcessKind::Filter;
        assert!(!it.blame(FILTER, 1, 0), "the first configuration is not on trial");
        let mut config = Config::default();
        config.filter.actuation_delay_ms = 33.0;
        it.accept(&file(&base, &config), None, 0).unwrap();
        assert!(!it.blame(FILTER, 1, 1), "a process of the configuration before");
        assert!(!it.blame(ProcessKind::Tracker, 2, 1), "it does not concern the tracker");
        assert!(it.blame(FILTER, 2, 1) && !it.has_failed(1));
        assert!(!it.blame(FILTER, 2, TRIAL_NS), "the trial is over");
        assert!(it.blame(FILTER, 2, 2) && it.has_failed(2));
        it.retry_later(2);
        assert!(!it.has_failed(3) && it.has_failed(2 + RETRY_NS));
        it.roll_back("it kills").unwrap();
        assert!(!it.has_failed(TRIAL_NS / 2));
        it.instance.remove_directory().unwrap();
        fs::remove_dir_all(base).unwrap();
    }
}
