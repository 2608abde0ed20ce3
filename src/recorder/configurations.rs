//! The configurations of a recorded group. Each accepted one is recorded once, and before the first output that
//! was made with it, so that a recording contains what its outputs were made with, however often the
//! configuration was changed.
//!
//! A configuration is known by its revision, which every output names. The supervisor writes its file before
//! it starts a process with it, so the file is there when the first output names it.

use client::instance::Instance;
use config::snapshot::Snapshot;
use messages::{DetectionFrame, ProcessKind, RunsHeader, WorldFrame};
use recording::Setup;
use std::collections::BTreeSet;
use std::path::Path;
use std::time::UNIX_EPOCH;

/// Revisions without a file that are remembered, so that invalid messages do not cost a look each.
const MOST_MISSING: usize = 1000;

/// Revisions that made an output, in the order of [`ProcessKind::ALL`]; 0 for none.
pub type Revisions = [u32; ProcessKind::ALL.len()];

/// An output that names the revisions it was made with.
pub trait Revised {
    /// These revisions.
    fn revisions(&self) -> Revisions;
}

impl Revised for RunsHeader {
    fn revisions(&self) -> Revisions {
        by_kind(self.revision, 0, 0)
    }
}

impl Revised for DetectionFrame {
    fn revisions(&self) -> Revisions {
        by_kind(self.classifier_revision, self.revision, 0)
    }
}

impl Revised for WorldFrame {
    fn revisions(&self) -> Revisions {
        by_kind(self.classifier_revision, self.tracker_revision, self.revision)
    }
}

fn by_kind(classifier: u32, tracker: u32, filter: u32) -> Revisions {
    ProcessKind::ALL.map(|kind| match kind {
        ProcessKind::Grabber => 0,
        ProcessKind::Classifier => classifier,
        ProcessKind::Tracker => tracker,
        ProcessKind::Filter => filter,
    })
}

/// A configuration to record.
#[derive(Debug, Clone)]
pub struct Configuration {
    /// As it is recorded.
    pub setup: Setup,
    /// Parsed, with its revision; the defaults if the group has none or it is invalid.
    pub snapshot: Snapshot,
}

/// Follows the configurations of a group.
pub struct Configurations {
    instance: Instance,
    wall_minus_monotonic_ns: i64,
    newest: Configuration,
    /// Revisions returned so far.
    known: BTreeSet<u32>,
    /// Revisions that outputs named and that have no file.
    missing: BTreeSet<u32>,
}

impl Configurations {
    /// Begins with the newest configuration.
    pub fn new(instance: &Instance, wall_minus_monotonic_ns: i64) -> Self {
        let newest = read(instance, &instance.config_path(), wall_minus_monotonic_ns);
        let newest = newest.unwrap_or_else(|| of_text(instance, "", 0, wall_minus_monotonic_ns));
        Self {
            instance: instance.clone(),
            wall_minus_monotonic_ns,
            known: [newest.snapshot.revision.number].into(),
            missing: BTreeSet::new(),
            newest,
        }
    }

    /// The newest one.
    pub fn newest(&self) -> &Configuration {
        &self.newest
    }

    /// Those accepted since the last call, oldest first.
    pub fn look(&mut self) -> Vec<Configuration> {
        let Some(now) = self.read(&self.instance.config_path()) else { return Vec::new() };
        if now.setup.config_toml == self.newest.setup.config_toml {
            return Vec::new();
        }
        let [before, number] = [&self.newest, &now].map(|it| it.snapshot.revision.number);
        // Some may have been accepted and replaced in between; only the last ones have a file.
        let between = if before == 0 { number..number } else { before + 1..number };
        let mut found: Vec<_> =
            between.rev().map_while(|it| self.read(&self.instance.revision_path(it))).collect();
        found.reverse();
        found.push(now.clone());
        self.known.extend(found.iter().map(|it| it.snapshot.revision.number));
        self.newest = now;
        found
    }

    /// Those that an output names and that were not returned before.
    pub fn of_output(&mut self, revisions: &Revisions) -> Vec<Configuration> {
        let mut found = Vec::new();
        for &number in revisions.iter().filter(|&&number| number > 0) {
            if self.known.contains(&number) || self.missing.contains(&number) {
                continue;
            }
            found.extend(self.look());
            if self.known.contains(&number) {
                continue;
            }
            match self.read(&self.instance.revision_path(number)) {
                Some(earlier) => {
                    self.known.insert(number);
                    found.push(earlier);
                }
                None if self.missing.len() < MOST_MISSING => _ = self.missing.insert(number),
                None => self.missing = [number].into(),
            }
        }
        found
    }

    fn read(&self, path: &Path) -> Option<Configuration> {
        read(&self.instance, path, self.wall_minus_monotonic_ns)
    }
}

/// Reads a file; `None` if there is none.
fn read(instance: &Instance, path: &Path, wall_minus_monotonic_ns: i64) -> Option<Configuration> {
    let text = std::fs::read_to_string(path).ok()?;
    // A file is written once, when its configuration is accepted.
    let written = path.metadata().and_then(|data| data.modified()).ok()?;
    let accepted_ns = written.duration_since(UNIX_EPOCH).map_or(0, |time| time.as_nanos() as u64);
    Some(of_text(instance, &text, accepted_ns, wall_minus_monotonic_ns))
}

fn of_text(
    instance: &Instance,
    text: &str,
    accepted_wall_ns: u64,
    wall_minus_monotonic_ns: i64,
) -> Configuration {
    // The group has validated it; only drawings and the choice of revisions depend on it here.
    let snapshot = Snapshot::parse(text, "the group's configuration")
        .unwrap_or_else(|_| Snapshot::of_user(config::Config::default()));
    let setup = Setup {
        touchline_version: env!("CARGO_PKG_VERSION").into(),
        instance: instance.name().into(),
        wall_minus_monotonic_ns,
        config_toml: text.into(),
        revision: snapshot.revision.number,
        accepted_wall_ns,
    };
    Configuration { setup, snapshot }
}

/// The configurations in one file.
#[derive(Debug, Default)]
pub struct Coverage {
    written: Vec<Snapshot>,
    /// The revisions last found to be covered: nearly always those of the next output too.
    last: [Revisions; LAST],
}

/// Kinds of output that name revisions: runs, detections, `world`.
const LAST: usize = 3;

impl Coverage {
    /// A configuration was written to the file.
    pub fn add(&mut self, snapshot: &Snapshot) {
        self.written.push(snapshot.clone());
    }

    /// Whether none is in it yet.
    pub fn is_empty(&self) -> bool {
        self.written.is_empty()
    }

    /// The revisions of an output that no configuration in the file stands for.
    pub fn lacks(&mut self, revisions: &Revisions) -> Vec<u32> {
        if self.last.contains(revisions) {
            return Vec::new();
        }
        let is_covered = |kind: ProcessKind, number: u32| {
            number == 0 || self.written.iter().any(|it| it.stands_for(number, kind))
        };
        let lacks: Vec<u32> = ProcessKind::ALL
            .into_iter()
            .zip(*revisions)
            .filter(|&(kind, number)| !is_covered(kind, number))
            .map(|(_, number)| number)
            .collect();
        if lacks.is_empty() {
            self.last.rotate_right(1);
            self.last[0] = *revisions;
        }
        lacks
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Config;
    use std::fs;

    fn group(name: &str) -> Instance {
        let base = std::env::temp_dir().join(format!("tl-{name}-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        fs::create_dir(instance.revisions_directory()).unwrap();
        instance
    }

    fn write(instance: &Instance, snapshot: &Snapshot) {
        for path in [instance.config_path(), instance.revision_path(snapshot.revision.number)] {
            fs::write(path, snapshot.to_text()).unwrap();
        }
    }

    /// Snapshots of which each has another delay than the one before.
    fn history(count: u32) -> Vec<Snapshot> {
        let mut config = Config::default();
        let mut history = vec![Snapshot::first(config.clone())];
        for number in 1..count {
            config.filter.actuation_delay_ms = 20.0 + f64::from(number);
            let next = history[history.len() - 1].next(config.clone(), Some(number));
            history.push(next);
        }
        history
    }

    fn numbers(found: Vec<Configuration>) -> Vec<u32> {
        found.into_iter().map(|it| it.setup.revision).collect()
    }

    #[test]
    fn every_accepted_configuration_is_found_once() {
        let instance = group("recorded");
        let history = history(6);
        write(&instance, &history[0]);
        let mut it = Configurations::new(&instance, 5);
        assert_eq!(it.newest().setup.revision, 1);
        assert!(it.newest().setup.accepted_wall_ns > 1_600_000_000_000_000_000);
        assert_eq!(numbers(it.look()), [0u32; 0]);
        for snapshot in &history[1..4] {
            write(&instance, snapshot);
        }
        assert_eq!(numbers(it.look()), [2, 3, 4], "accepted between two looks");
        assert_eq!(numbers(it.look()), [0u32; 0]);
        for snapshot in &history[4..] {
            write(&instance, snapshot);
        }
        assert_eq!(numbers(it.of_output(&[0, 1, 4, 5])), [5, 6], "an output comes first");
        assert_eq!(numbers(it.of_output(&[0, 1, 4, 6])), [0u32; 0]);
        assert_eq!(numbers(it.of_output(&[0, 99, 4, 6])), [0u32; 0], "there is no such revision");
        assert!(it.missing.contains(&99));
        instance.remove_directory().unwrap();
    }

    #[test]
    fn a_recorder_that_comes_late_finds_earlier_ones_and_does_without_removed_ones() {
        let instance = group("recorded-late");
        let history = history(4);
        history.iter().for_each(|snapshot| write(&instance, snapshot));
        fs::remove_file(instance.revision_path(2)).unwrap();
        let mut it = Configurations::new(&instance, 0);
        assert_eq!(numbers(it.of_output(&[0, 3, 2, 4])), [3]);
        instance.remove_directory().unwrap();
    }

    #[test]
    fn a_newer_configuration_stands_for_earlier_ones_that_stages_do_not_tell_apart() {
        let history = history(4);
        let mut coverage = Coverage::default();
        coverage.add(&history[2]);
        // Only the filter was concerned by all changes.
        assert_eq!(coverage.lacks(&[0, 1, 2, 3]), [0u32; 0]);
        assert_eq!(coverage.lacks(&[0, 1, 1, 2]), [2]);
        assert_eq!(coverage.lacks(&[0, 0, 0, 4]), [4]);
        coverage.add(&history[3]);
        assert_eq!(coverage.lacks(&[0, 0, 0, 4]), [0u32; 0]);
    }
}
