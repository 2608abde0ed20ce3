//! The table of attendants: the processes that a group has besides its stages.
//!
//! A row holds everything that the command line and the supervisor need to know about one. To add an
//! attendant, write it in a folder of its own, and give it a number and a name in
//! [`messages::Attendant`], a row here and a section in the configuration.

use crate::{console, gateway, publisher};
use client::instance::{Instance, InstanceError};
use config::Config;
use config::change::Change;
use messages::Attendant;
use std::error::Error;

/// Reason for which an attendant cannot work; the text is for the user.
pub type AttendantError = Box<dyn Error + Send + Sync>;

/// An attendant.
pub struct Row {
    /// Its name and number in messages. The name is also its subcommand.
    pub attendant: Attendant,
    /// One line for `touchline --help`.
    pub about: &'static str,
    /// Whether a group with this configuration has it. Creates what it needs before it starts;
    /// anything it would fail at is an error here, before the match begins.
    pub prepare: fn(&Instance, &Config) -> Result<bool, AttendantError>,
    /// The process: runs until it is told to end, or, `supervised`, until its group is gone.
    pub run: fn(&Instance, &Config, supervised: bool) -> Result<(), AttendantError>,
    /// Keys of the configuration that it reads when it starts, or sections of them: it is restarted when one of
    /// them changes.
    pub reads: &'static [&'static str],
    /// Removes what it created outside the group's directories, when the group has ended.
    pub remove: fn(&Instance) -> Result<(), InstanceError>,
}

/// All attendants.
pub const TABLE: [Row; 3] = [gateway::ROW, publisher::ROW, console::ROW];

impl Row {
    /// Whether it has to be restarted for a change of the configuration to take effect.
    pub fn is_concerned(&self, change: &Change) -> bool {
        self.reads.iter().any(|key| change.is_below(key))
    }

    /// Its name.
    pub fn name(&self) -> &'static str {
        self.attendant.name()
    }
}

/// The attendant of this name, if there is one.
pub fn named(name: &str) -> Option<&'static Row> {
    TABLE.iter().find(|row| row.name() == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Preset;
    use config::change::values;

    #[test]
    fn every_key_that_an_attendant_reads_exists() {
        let keys: Vec<Change> = Preset::ALL
            .into_iter()
            .flat_map(|preset| values(&preset.config()).into_keys())
            .map(|key| Change { key, old: None, new: None })
            .collect();
        for row in &TABLE {
            for read in row.reads {
                assert!(keys.iter().any(|key| key.is_below(read)), "{}: {read}", row.name());
            }
        }
        let delay = Change { key: "filter.actuation_delay_ms".into(), old: None, new: None };
        assert!(TABLE.iter().all(|row| !row.is_concerned(&delay)));
    }
}
