//! The publisher, which sends poses in the leagues' protocols.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The publisher, which sends poses in the leagues' protocols. Counters start with its process.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Published {
    /// Its process id; absent while it does not run.
    pub pid: Option<u32>,
    /// Number of restarts.
    pub restarts: u64,
    /// Protocols that are sent, by the keys of their sections.
    pub protocols: BTreeMap<String, PublishedProtocol>,
    /// Packets with commands that were passed on.
    pub commands: u64,
    /// Packets to the command port that were malformed or impossible.
    pub malformed: u64,
    /// Packets to the command port from addresses that are not allowed.
    pub not_allowed: u64,
    /// Packets to the command port beyond the permitted rate.
    pub too_many: u64,
    /// Other publishers on the same addresses at the moment.
    pub rivals: u32,
    /// Problem that is not that of one protocol; empty when there is none.
    pub problem: String,
}

/// A published protocol.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct PublishedProtocol {
    /// Packets handed to the system, counted for each receiver and interface.
    pub sent: u64,
    /// Packets that the system refused, or for which there was no interface.
    pub failed: u64,
    /// Packets larger than one Ethernet frame.
    pub large: u64,
    /// Problem and remedy; empty when there is none.
    pub problem: String,
}

impl Published {
    /// Lines for the console and for `status`.
    pub fn lines(&self) -> Vec<String> {
        let packets = |(name, it): (&String, &PublishedProtocol)| {
            let refused =
                if it.failed > 0 { format!(" ({} refused)", it.failed) } else { String::new() };
            format!("{name} {}{refused}", it.sent)
        };
        let state = if self.pid.is_some() { "" } else { "not running, " };
        let protocols: Vec<String> = self.protocols.iter().map(packets).collect();
        let mut first = format!("{state}packets: {}", protocols.join(", "));
        if protocols.is_empty() {
            first = format!("{state}no protocol is sent");
        }
        let dropped = self.malformed + self.not_allowed + self.too_many;
        if self.commands + dropped > 0 {
            first += &format!("; commands: {}, {dropped} dropped", self.commands);
            for (count, why) in [
                (self.malformed, "malformed"),
                (self.not_allowed, "not allowed"),
                (self.too_many, "too many"),
            ] {
                if count > 0 {
                    first += &format!(", {count} {why}");
                }
            }
        }
        let problems = self.protocols.iter().map(|(name, it)| (name.as_str(), &it.problem));
        let problems = problems.chain([("publishing", &self.problem)]);
        let problems = problems.filter(|(_, problem)| !problem.is_empty());
        [first].into_iter().chain(problems.map(|(name, it)| format!("{name}: {it}"))).collect()
    }
}
