//! The configuration that a group runs with, as a file: every process of the group starts from it.
//!
//! Its first line says which revision it is, so that text and revision can never be taken from different
//! files:
//!
//! ```text
//! # revision 7:5, grabber 1, classifier 5, tracker 7, filter 2, before 6
//! ```
//!
//! Revision 7 has the colours of revision 5; a grabber of revision 1 or later does as this configuration
//! says, a tracker of an earlier one than 7 does not; a rollback returns to revision 6.

use super::{Config, ConfigError, commented_toml, input};
use crate::change::{Change, Effect, changes, have_same_classes};
use messages::{ProcessKind, Revision};
use std::path::Path;

/// A configuration with its revision.
#[derive(Debug, Clone, PartialEq)]
pub struct Snapshot {
    /// The configuration.
    pub config: Config,
    /// Its revision; 0 for a file that no supervisor has written.
    pub revision: Revision,
    /// For each kind of stage, in the order of [`ProcessKind::ALL`], the oldest revision of a process that
    /// does as this configuration says.
    needed: [u32; ProcessKind::ALL.len()],
    /// The revision to which a rollback returns.
    pub before: Option<u32>,
}

/// Beginning of the first line.
const MARK: &str = "# revision ";

impl Snapshot {
    /// The configuration that a group starts with.
    pub fn first(config: Config) -> Self {
        let needed = [Revision::FIRST.number; ProcessKind::ALL.len()];
        Self { config, revision: Revision::FIRST, needed, before: None }
    }

    /// A user's configuration, which no supervisor has accepted.
    pub fn of_user(config: Config) -> Self {
        Self { config, revision: Revision::default(), needed: Default::default(), before: None }
    }

    /// Another configuration in the place of this one. A rollback to it would lead `before`.
    pub fn next(&self, config: Config, before: Option<u32>) -> Self {
        let revision = self.revision.next(have_same_classes(&self.config, &config));
        let mut needed = self.needed;
        for kind in concerned(&changes(&self.config, &config)) {
            needed[kind as usize] = revision.number;
        }
        Self { config, revision, needed, before }
    }

    /// The oldest revision of a process of this kind that does as this configuration says.
    pub fn needed(&self, kind: ProcessKind) -> u32 {
        self.needed[kind as usize]
    }

    /// Whether a process of this kind does the same with this configuration as with revision `number`.
    pub fn stands_for(&self, number: u32, kind: ProcessKind) -> bool {
        let own = self.revision.number;
        number == own || (self.needed(kind)..own).contains(&number)
    }

    /// The file's text.
    pub fn to_text(&self) -> String {
        let mut line = format!("{MARK}{}", self.revision);
        for kind in ProcessKind::ALL {
            line += &format!(", {} {}", kind.name(), self.needed(kind));
        }
        if let Some(before) = self.before {
            line += &format!(", before {before}");
        }
        format!("{line}\n{}", commented_toml(&self.config))
    }

    /// Parses a file's text; any configuration file is a snapshot of revision 0.
    pub fn parse(text: &str, origin: &str) -> Result<Self, ConfigError> {
        Ok(Self::of_text(text, Config::parse(text, origin)?))
    }

    fn of_text(text: &str, config: Config) -> Self {
        let mut snapshot = Self::of_user(config);
        let first = text.lines().next().and_then(|line| line.strip_prefix(MARK));
        let mut entries = first.unwrap_or_default().split(", ");
        if let Some(Ok(revision)) = entries.next().map(str::parse) {
            snapshot.revision = revision;
        }
        for entry in entries {
            let Some((name, number)) = entry.split_once(' ') else { continue };
            let Ok(number) = number.parse() else { continue };
            match ProcessKind::from_name(name) {
                Some(kind) => snapshot.needed[kind as usize] = number,
                None if name == "before" => snapshot.before = Some(number),
                None => {}
            }
        }
        snapshot
    }

    /// Reads a file.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        Self::parse(&read(path)?, &path.display().to_string())
    }

    /// Reads a file that a supervisor has written and whose configuration it had checked. Not checking it
    /// again makes the start of a process shorter. Other files are checked.
    pub fn load_accepted(path: &Path) -> Result<Self, ConfigError> {
        let text = read(path)?;
        let accepted = Config::parse_unchecked(&text).map(|config| Self::of_text(&text, config));
        match accepted.filter(|snapshot| snapshot.revision.number > 0) {
            Some(snapshot) => Ok(snapshot),
            None => Self::parse(&text, &path.display().to_string()),
        }
    }
}

fn read(path: &Path) -> Result<String, ConfigError> {
    input::read_text(path, input::CONFIG)
        .map_err(|source| ConfigError::Read { path: path.into(), source })
}

/// The kinds of stage that have to be replaced for these changes, in the order of a frame's way.
pub fn concerned(changes: &[Change]) -> Vec<ProcessKind> {
    let reads = |kind: &ProcessKind| {
        changes.iter().any(|change| match change.effect() {
            Effect::Stages(kinds) => kinds.contains(kind),
            Effect::Supervisor | Effect::NewGroup(_) => false,
        })
    };
    ProcessKind::ALL.into_iter().filter(reads).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Preset;

    #[test]
    fn a_snapshot_is_read_back_and_only_concerned_stages_need_it() {
        let first = Snapshot::first(Config::default());
        assert_eq!(Snapshot::parse(&first.to_text(), "test").unwrap(), first);
        let mut config = first.config.clone();
        config.filter.actuation_delay_ms += 1.0;
        let second = first.next(config.clone(), Some(1));
        assert_eq!(second.revision, Revision { number: 2, classes_since: 1 });
        assert_eq!(ProcessKind::ALL.map(|kind| second.needed(kind)), [1, 1, 1, 2]);
        config.colors[0].red = [1, 2];
        let third = second.next(config, Some(2));
        assert_eq!(third.revision, Revision { number: 3, classes_since: 3 });
        assert_eq!(ProcessKind::ALL.map(|kind| third.needed(kind)), [1, 3, 3, 2]);
        assert_eq!(Snapshot::parse(&third.to_text(), "test").unwrap(), third);
        let stands_for = |number| third.stands_for(number, ProcessKind::Filter);
        assert_eq!([0, 1, 2, 3, 4].map(stands_for), [false, false, true, true, false]);
    }

    #[test]
    fn an_accepted_file_is_read_as_it_was_checked_and_others_are_checked() {
        let path = std::env::temp_dir().join(format!("tl-accepted-{}.toml", std::process::id()));
        for preset in Preset::ALL {
            let first = Snapshot::first(preset.config());
            let mut config = preset.config();
            config.geometry.camera_mm[0] += 10.0;
            config.light.pitch_rgb = None;
            config.robots.identities.pop();
            for snapshot in [&first, &first.next(config, Some(1))] {
                std::fs::write(&path, snapshot.to_text()).unwrap();
                assert_eq!(&Snapshot::load_accepted(&path).unwrap(), snapshot);
                assert_eq!(&Snapshot::load(&path).unwrap(), snapshot);
            }
        }
        for text in ["[filter]\nactuation_delay_ms = -1\n", "# revision 2:1\n[filter]\nx = 1\n"] {
            std::fs::write(&path, text).unwrap();
            assert!(Snapshot::load_accepted(&path).is_err(), "{text}");
        }
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn a_users_file_has_no_revision_whatever_its_first_line() {
        for line in ["", "# revision", "# revision x", "# revision 3:4, grabber", "# Revision 3:3"]
        {
            let text = format!("{line}\n{}", commented_toml(&Config::default()));
            let snapshot = Snapshot::parse(&text, "test").unwrap();
            assert_eq!(snapshot.revision, Revision::default(), "{line}");
        }
    }
}
