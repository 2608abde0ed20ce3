//! What the supervisor knows and the monitor shows: who runs, and what has happened.

use bytemuck::Zeroable;
use common::messages::{GroupEvent, ProcessKind, ProcessState, write_text};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

/// Events kept for the status; the log on standard error has all of them.
const KEPT_EVENTS: usize = 100;

/// Something the supervisor noticed or did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// Seconds since 1970.
    pub time_s: f64,
    /// The stage concerned.
    pub stage: String,
    /// The process concerned.
    pub pid: u32,
    /// What happened.
    pub what: String,
    /// The last lines the process wrote, if it ended.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub evidence: String,
}

impl Event {
    /// An event of this moment.
    pub fn new(kind: ProcessKind, pid: u32, what: &str, evidence: &str) -> Self {
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self {
            time_s: (since_1970.as_secs_f64() * 1000.0).round() / 1000.0,
            stage: kind.name().into(),
            pid,
            what: what.into(),
            evidence: evidence.into(),
        }
    }

    /// As a message. Of long evidence the end is kept, where the cause stands.
    pub fn message(&self) -> GroupEvent {
        let mut message = GroupEvent {
            t_wall_ns: (self.time_s * 1e9) as u64,
            pid: self.pid,
            // Events are made of kinds, so there is one.
            process: ProcessKind::from_name(&self.stage).map_or(u32::MAX, |kind| kind as u32),
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

/// A process of the group.
#[derive(Debug, Clone, PartialEq)]
pub struct ProcessView {
    /// Its stage.
    pub kind: ProcessKind,
    /// The system's number for it.
    pub pid: u32,
    /// As it last said itself; `None` before its first word.
    pub state: Option<ProcessState>,
}

/// Shared between the supervisor, which writes, and the monitor, which reads.
pub struct GroupView {
    /// The supervisor's own number.
    pub supervisor_pid: u32,
    inner: Mutex<Inner>,
}

#[derive(Default)]
struct Inner {
    processes: Vec<ProcessView>,
    restarts: BTreeMap<ProcessKind, u64>,
    events: VecDeque<Event>,
    unseen_events: Vec<Event>,
}

impl GroupView {
    /// A group without processes.
    pub fn new(supervisor_pid: u32) -> Self {
        Self { supervisor_pid, inner: Mutex::default() }
    }

    /// Notes an event.
    pub fn log(&self, event: Event) {
        let mut inner = self.lock();
        inner.unseen_events.push(event.clone());
        inner.events.push_back(event);
        if inner.events.len() > KEPT_EVENTS {
            inner.events.pop_front();
        }
    }

    /// Takes in events of an earlier supervisor. They have been shown.
    pub fn remember(&self, events: Vec<Event>) {
        self.lock().events.extend(events);
    }

    /// Replaces what is known of the processes.
    pub fn update(&self, processes: Vec<ProcessView>, restarts: BTreeMap<ProcessKind, u64>) {
        let mut inner = self.lock();
        inner.processes = processes;
        inner.restarts = restarts;
    }

    /// The processes, and how often each stage was started again.
    pub fn processes(&self) -> (Vec<ProcessView>, BTreeMap<ProcessKind, u64>) {
        let inner = self.lock();
        (inner.processes.clone(), inner.restarts.clone())
    }

    /// The last events, oldest first.
    pub fn events(&self) -> Vec<Event> {
        self.lock().events.iter().cloned().collect()
    }

    /// Events that this call has not returned before.
    pub fn take_new_events(&self) -> Vec<Event> {
        std::mem::take(&mut self.lock().unseen_events)
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // Every update leaves the data whole, so a panic elsewhere does not make it unusable.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use common::messages::read_text;

    #[test]
    fn an_event_is_a_message_with_the_end_of_its_evidence() {
        let evidence = format!("{}the cause", "é".repeat(1000));
        let message = Event::new(ProcessKind::Tracker, 7, "killed", &evidence).message();
        assert_eq!((message.pid, message.process), (7, ProcessKind::Tracker as u32));
        assert_eq!(read_text(&message.what), "killed");
        let said = read_text(&message.evidence);
        assert!(said.len() > 700 && said.starts_with('é') && said.ends_with("the cause"), "{said}");
        assert!(message.t_wall_ns > 1_600_000_000_000_000_000);
    }
}
