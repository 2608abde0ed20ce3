//! The description of a recording: its first message, on the channel `setup`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Circumstances of a recording; written at its start and again when the configuration changes.
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
