//! Who may attach.

use crate::messages::Team;
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

/// Who may attach to a group besides its owner.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AccessConfig {
    /// Users of this group of the system may read poses and send commands, through a socket that the
    /// process `gateway` offers; docs/attaching.md says how. Empty: only the owner may attach.
    pub group: String,
    /// So many of their programs at the same time; one user has at most half of the places, and gives up what it
    /// has more than others when all are taken.
    #[schemars(range(min = 2, max = 256))]
    pub clients: u32,
    /// Programs of the owner, by the names under which they join the group, whose messages are believed on every
    /// topic as if they were processes of the group: one that feeds frames into `frames`, say. On `commands`
    /// every program is believed. docs/attaching.md tells more.
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
    /// The group of users that may attach, if there is one.
    pub fn group(&self) -> Option<&str> {
        Some(self.group.as_str()).filter(|group| !group.is_empty())
    }
}
