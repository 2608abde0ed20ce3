//! The configurations in a recording: when each was accepted, and what it changed.

use super::time_text;
use crate::commands::CommandError;
use config::Config;
use config::change::changes;
use recording::Setup;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Most changed keys shown of a configuration.
const SHOWN_KEYS: usize = 3;

/// A configuration in a recording.
#[derive(Debug, Serialize)]
pub struct Configuration {
    /// Its revision; 0 for a group that names none.
    pub revision: u32,
    /// When it was accepted, in seconds since the first message; 0 for the first one.
    pub after_s: f64,
    /// The same, nanoseconds since 1970.
    pub accepted_wall_ns: u64,
    /// The keys that differ from the configuration before, with both values.
    pub changes: Vec<String>,
}

/// The recorded configurations by revision and, for those without, by time.
#[derive(Default)]
pub struct Configurations(BTreeMap<(u32, u64), Setup>);

impl Configurations {
    /// Adds one that was recorded at a time, nanoseconds since 1970.
    pub fn add(&mut self, t_ns: u64, setup: Setup) {
        let is_numbered = setup.revision > 0;
        self.0.insert((setup.revision, if is_numbered { 0 } else { t_ns }), setup);
    }

    /// All of them, in order. `begin_ns`: time of the first message.
    pub fn list(&self, begin_ns: u64) -> Vec<Configuration> {
        let mut before: Option<Config> = None;
        let mut list = Vec::new();
        for (&(revision, t_ns), setup) in &self.0 {
            let config = Config::parse(&setup.config_toml, "recorded").ok();
            let pair = before.as_ref().zip(config.as_ref());
            let changes = pair.map(|(old, new)| changes(old, new)).unwrap_or_default();
            let accepted_wall_ns = setup.accepted_wall_ns.max(t_ns);
            list.push(Configuration {
                revision,
                after_s: accepted_wall_ns.saturating_sub(begin_ns) as f64 / 1e9,
                accepted_wall_ns,
                changes: changes.iter().map(ToString::to_string).collect(),
            });
            before = config;
        }
        list
    }

    /// The text of a revision, or of the newest one.
    pub fn text(&self, revision: Option<u32>) -> Result<&str, CommandError> {
        let is_it = |(number, _): &(u32, u64)| revision.is_none_or(|wanted| wanted == *number);
        let found = self.0.iter().rev().find(|(key, _)| is_it(key));
        let numbers = || {
            let numbers: Vec<String> =
                self.0.keys().map(|(number, _)| number.to_string()).collect();
            numbers.join(", ")
        };
        match (found, revision) {
            (Some((_, setup)), _) => Ok(&setup.config_toml),
            (None, Some(number)) => {
                Err(format!("revision {number} is not in it; these are: {}", numbers()).into())
            }
            (None, None) => Err("no configuration was recorded".into()),
        }
    }
}

/// A line for each configuration, if there are several.
pub fn text(list: &[Configuration]) -> String {
    let mut text = String::new();
    if list.len() < 2 {
        return text;
    }
    for it in list {
        let shown = it.changes.iter().take(SHOWN_KEYS).cloned().collect::<Vec<_>>().join(", ");
        let what = match it.changes.len().saturating_sub(SHOWN_KEYS) {
            0 if shown.is_empty() => String::new(),
            0 => format!(": {shown}"),
            more => format!(": {shown}, and {more} more keys"),
        };
        let when = time_text(it.after_s);
        // Writing to a string cannot fail.
        let _ = writeln!(text, "  configuration {} after {when}{what}", it.revision);
    }
    text
}
