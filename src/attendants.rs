//! The table of attendants: the processes that a group has besides its stages.
//!
//! A row says everything that the command line and the supervisor need to know of one. To add an attendant, write
//! it in a folder of its own, give it a number and a name in [`common::messages::Attendant`], a row here and a section in
//! the configuration.

use crate::gateway;
use common::config::Config;
use common::instance::{Instance, InstanceError};
use common::messages::Attendant;
use std::error::Error;

/// Whatever keeps an attendant from its work; its text is for the user.
pub type AttendantError = Box<dyn Error + Send + Sync>;

/// An attendant.
pub struct Row {
    /// Its name and its number in messages. The name is its subcommand, too.
    pub attendant: Attendant,
    /// What it does, for `touchline --help`.
    pub about: &'static str,
    /// Whether a group with this configuration has one. Makes what has to be there before it starts; what it would
    /// fail at is an error here, before the match begins.
    pub prepare: fn(&Instance, &Config) -> Result<bool, AttendantError>,
    /// The process: runs until it is told to end, or, `supervised`, until its group is gone.
    pub run: fn(&Instance, &Config, supervised: bool) -> Result<(), AttendantError>,
    /// Removes what it has made outside the group's directories, when the group has ended.
    pub remove: fn(&Instance) -> Result<(), InstanceError>,
}

/// All of them.
pub const TABLE: [Row; 1] = [gateway::ROW];

impl Row {
    /// Its name.
    pub fn name(&self) -> &'static str {
        self.attendant.name()
    }
}

/// The attendant of this name, if there is one.
pub fn named(name: &str) -> Option<&'static Row> {
    TABLE.iter().find(|row| row.name() == name)
}
