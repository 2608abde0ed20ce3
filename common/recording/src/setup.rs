//! The description of a recording: its first message, on the channel `setup`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Circumstances of a recording; written at its start, and again for each further configuration, before the
/// first output that was made with it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Setup {
    /// Version of the program that wrote the recording.
    pub touchline_version: String,
    /// Name of the recorded group.
    pub instance: String,
    /// Add this to a `t_*_ns` stamp in a message to get nanoseconds since 1970. It is already added to
    /// the log and publish times of the file.
    pub wall_minus_monotonic_ns: i64,
    /// The group's configuration, as TOML.
    pub config_toml: String,
    /// The configuration's revision, which outputs name; 0 if the group was started by hand.
    #[serde(default)]
    pub revision: u32,
    /// When the group accepted the configuration, nanoseconds since 1970; 0 if unknown.
    #[serde(default)]
    pub accepted_wall_ns: u64,
}

impl Setup {
    /// Encodes the message.
    pub fn encode(&self) -> Vec<u8> {
        serde_json::to_vec(self).unwrap_or_default()
    }

    /// Decodes the message; `None` if it is malformed.
    pub fn decode(data: &[u8]) -> Option<Self> {
        serde_json::from_slice(data).ok()
    }

    /// Converts a stamp in a message to the wall clock.
    pub fn wall_ns(&self, t_ns: u64) -> u64 {
        t_ns.saturating_add_signed(self.wall_minus_monotonic_ns)
    }
}
