//! Access configuration: which users and programs may attach.

use messages::Team;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which users may command which team through the gateway.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TeamsAccess {
    /// Users, by name or number, that may command yellow robots. Empty: all users that may attach.
    pub yellow: Vec<String>,
    /// Users that may command blue robots.
    pub blue: Vec<String>,
}

impl TeamsAccess {
    /// The users named for a team.
    pub fn of(&self, team: Team) -> &[String] {
        match team {
            Team::Yellow => &self.yellow,
            Team::Blue => &self.blue,
        }
    }
}

/// Which users and programs may attach to a group besides its owner.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AccessConfig {
    /// System group whose users may read poses and send commands, through a socket of the process
    /// `gateway`; see docs/attaching.md. Empty: only the owner may attach.
    pub group: String,
    /// Most programs of these users at the same time. One user has at most half of the places, and
    /// loses what it has beyond the others' share when all are taken.
    #[schemars(range(min = 2, max = 256))]
    pub clients: u32,
    /// The owner's programs, by the names under which they join the group, whose messages are accepted
    /// on every topic like those of the group's processes: for example one that feeds frames into
    /// `frames`. On `commands` every program is accepted. See docs/attaching.md.
    pub publishers: Vec<String>,
    /// Which users may command which team.
    pub teams: TeamsAccess,
}

impl Default for AccessConfig {
    fn default() -> Self {
        Self {
            group: String::new(),
            clients: 32,
            publishers: Vec::new(),
            teams: TeamsAccess::default(),
        }
    }
}

impl AccessConfig {
    /// The system group that may attach, if there is one.
    pub fn group(&self) -> Option<&str> {
        Some(self.group.as_str()).filter(|group| !group.is_empty())
    }
}
