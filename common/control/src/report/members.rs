//! The processes of a group, and the programs that attach to it.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One stage, all its processes taken together.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Stage {
    /// Inputs taken. Counters of a process that was killed may lack its last tenth of a second.
    pub frames_in: u64,
    /// Outputs given.
    pub frames_out: u64,
    /// Numbers missing in its input.
    pub frames_missed: u64,
    /// Inputs dropped, by reason.
    pub dropped: BTreeMap<String, u64>,
    /// Number of its processes that have ended and were replaced.
    pub restarts: u64,
    /// Processor time used, by all its processes.
    pub cpu_seconds: f64,
    /// Share of one processor over the last second.
    pub cpu_percent: f64,
    /// Memory in use now (at the end of a run: at the last measurement), shared memory included.
    pub rss_bytes: u64,
    /// Its processes.
    pub processes: Vec<Process>,
}

/// One process.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Process {
    /// Its process id.
    pub pid: u32,
    /// `starting`, `spare`, `active`, `waiting` (for its camera) or `finished`.
    pub state: String,
}

/// An attendant: a process that serves people or programs, and that no stage needs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct AttendantState {
    /// Its process id; absent while it does not run.
    pub pid: Option<u32>,
    /// Number of restarts.
    pub restarts: u64,
}

/// The gateway, through which other users attach. Counters start with its process.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Gateway {
    /// Group of users that may attach.
    pub group: String,
    /// Path of its socket.
    pub socket: String,
    /// Its process id; absent while it does not run.
    pub pid: Option<u32>,
    /// Number of restarts.
    pub restarts: u64,
    /// Programs that are attached.
    pub clients: u32,
    /// Messages delivered to them.
    pub given: u64,
    /// Messages that a client lost because it was too slow.
    pub lost: u64,
    /// Client messages that were invalid, impossible or not permitted.
    pub refused: u64,
    /// Client messages with commands for a team that the user may not command.
    pub not_permitted: u64,
}

/// A sender of commands. If several command a robot, it obeys the command sent last.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Commander {
    /// Process id of the publisher.
    pub pid: u32,
    /// Its name in the group; `grabber` plays both teams of the synthetic match.
    pub name: String,
    /// User id of the sender behind the gateway.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub user: Option<u32>,
    /// Robots that obey it: team and number.
    pub robots: Vec<String>,
    /// Robots that it commands too, but that obey a later command of another sender.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub overruled: Vec<String>,
    /// Its messages so far.
    pub messages: u64,
    /// It publishes faster than its commands can be used; the rest is dropped.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub floods: bool,
}

/// A foreign program that publishes on a protected topic.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Stranger {
    /// Its process id.
    pub pid: u32,
    /// Its name in the group; empty when unknown.
    pub name: String,
    /// Name of its executable; empty when it is gone.
    pub program: String,
    /// The topic.
    pub topic: String,
    /// Its messages, all ignored.
    pub messages: u64,
}

impl Stranger {
    /// Its known names, in parentheses.
    pub fn full_name(&self) -> String {
        match (self.name.as_str(), self.program.as_str()) {
            ("", "") => "(gone)".into(),
            (name, "") => format!("({name})"),
            ("", program) => format!("(program {program})"),
            (name, program) => format!("({name}, program {program})"),
        }
    }
}
