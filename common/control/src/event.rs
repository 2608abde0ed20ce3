//! Events of a group.

use bytemuck::Zeroable;
use messages::{EventKind, GroupEvent, process_number, write_text};
use serde::{Deserialize, Serialize};
use std::time::{SystemTime, UNIX_EPOCH};

/// An observation or action of the supervisor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// Seconds since 1970.
    pub time_s: f64,
    /// Number of the event; 0 for events of an earlier supervisor.
    #[serde(skip)]
    pub number: u64,
    /// Kind of the event.
    #[serde(default)]
    pub kind: EventKind,
    /// The stage concerned, or `gateway`.
    pub stage: String,
    /// The process concerned.
    pub pid: u32,
    /// Description.
    pub what: String,
    /// The last lines the process wrote, if it ended.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub evidence: String,
}

impl Event {
    /// An event that happens now.
    pub fn new(kind: EventKind, stage: &str, pid: u32, what: &str, evidence: &str) -> Self {
        Self {
            time_s: seconds_since_1970(),
            number: 0,
            kind,
            stage: stage.into(),
            pid,
            what: what.into(),
            evidence: evidence.into(),
        }
    }

    /// The event as a message. Long evidence is cut at its start, since the cause is at the end.
    pub fn message(&self) -> GroupEvent {
        let mut message = GroupEvent {
            t_wall_ns: (self.time_s * 1e9) as u64,
            number: self.number,
            pid: self.pid,
            process: process_number(&self.stage),
            kind: self.kind as u32,
            ..Zeroable::zeroed()
        };
        write_text(&mut message.what, &self.what);
        let mut begin = self.evidence.len().saturating_sub(message.evidence.len() - 1);
        while !self.evidence.is_char_boundary(begin) {
            begin += 1;
        }
        write_text(&mut message.evidence, &self.evidence[begin..]);
        message
    }
}

/// To the millisecond.
pub(crate) fn seconds_since_1970() -> f64 {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    (since_1970.as_secs_f64() * 1000.0).round() / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::read_text;
    use messages::stages::StageId;

    #[test]
    fn an_event_is_a_message_with_the_end_of_its_evidence() {
        let evidence = format!("{}the cause", "é".repeat(1000));
        let event = Event::new(EventKind::Ended, "tracker", 7, "killed", &evidence);
        let message = event.message();
        assert_eq!(
            (message.pid, message.process),
            (7, StageId::from_name("tracker").unwrap().number())
        );
        assert_eq!(message.kind, EventKind::Ended as u32);
        assert_eq!(read_text(&message.what), "killed");
        let said = read_text(&message.evidence);
        assert!(said.len() > 700 && said.starts_with('é') && said.ends_with("the cause"), "{said}");
        assert!(message.t_wall_ns > 1_600_000_000_000_000_000);
    }
}
