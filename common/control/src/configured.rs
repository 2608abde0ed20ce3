//! The configurations of a group.

use crate::event::seconds_since_1970;
use serde::{Deserialize, Serialize};

/// Configurations that a group keeps as files, to go back to.
pub const KEPT_REVISIONS: u32 = 16;

/// A configuration that was accepted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Revised {
    /// Its revision.
    pub revision: u32,
    /// When, seconds since 1970.
    pub time_s: f64,
    /// What changed, or why it was taken back.
    pub what: String,
    /// Identifies the content: equal for configurations with equal keys.
    #[serde(default)]
    pub hash: String,
}

impl Revised {
    /// Accepted now. `hash` identifies the content.
    pub fn new(revision: u32, hash: String, what: String) -> Self {
        Self { revision, time_s: seconds_since_1970(), what, hash }
    }
}

/// The group's configuration, for the report.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Configured {
    /// Revision of the newest accepted configuration.
    pub revision: u32,
    /// Identifies its content: equal for configurations with equal keys.
    #[serde(default)]
    pub hash: String,
    /// Stages whose active process still runs with an earlier one, or has only just taken over.
    pub pending: Vec<String>,
    /// The last accepted configurations, oldest first.
    pub history: Vec<Revised>,
}
