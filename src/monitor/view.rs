//! The group's processes and events: written by the supervisor, shown by the monitor.

use client::clock::monotonic_ns;
use config::Config;
use control::{Configured, Event};
use messages::stages::StageId;
use messages::{Attendant, Heartbeat, ProcessState};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Events kept for the status; the log on standard error has all of them.
const KEPT_EVENTS: usize = 100;

/// Silence after which the supervisor counts as stuck; it updates the view at least fifty times a
/// second.
const LATE_NS: u64 = 1_000_000_000;

/// A process of the group.
#[derive(Debug, Clone, PartialEq)]
pub struct ProcessView {
    /// Its stage.
    pub stage: StageId,
    /// Its process id.
    pub pid: u32,
    /// State in its last heartbeat; `None` before the first.
    pub state: Option<ProcessState>,
}

/// An attendant of the group.
#[derive(Debug, Clone, PartialEq)]
pub struct AttendantView {
    /// Its name.
    pub name: &'static str,
    /// Its process id; `None` while it does not run.
    pub pid: Option<u32>,
    /// Number of restarts.
    pub restarts: u64,
}

/// Shared between the supervisor, which writes, and the monitor, which reads.
pub struct GroupView {
    /// Process id of the supervisor.
    pub supervisor_pid: u32,
    inner: Mutex<Inner>,
}

#[derive(Default)]
struct Inner {
    processes: Vec<ProcessView>,
    restarts: BTreeMap<StageId, u64>,
    lacks: Vec<String>,
    attendants: Vec<AttendantView>,
    configured: Configured,
    /// The newest accepted configuration, with its revision.
    config: Option<(u32, Arc<Config>)>,
    updated_ns: Option<u64>,
    events: VecDeque<Event>,
    /// Number of events of this supervisor.
    count: u64,
    unseen_events: Vec<Event>,
}

impl GroupView {
    /// A group without processes.
    pub fn new(supervisor_pid: u32) -> Self {
        Self { supervisor_pid, inner: Mutex::default() }
    }

    /// Logs an event.
    pub fn log(&self, event: Event) {
        let mut inner = self.lock();
        inner.count += 1;
        let event = Event { number: inner.count, ..event };
        inner.unseen_events.push(event.clone());
        inner.events.push_back(event);
        if inner.events.len() > KEPT_EVENTS {
            inner.events.pop_front();
        }
    }

    /// Adds events of an earlier supervisor, which have been shown already.
    pub fn remember(&self, events: Vec<Event>) {
        self.lock().events.extend(events);
    }

    /// Replaces the list of processes.
    pub fn update(&self, processes: Vec<ProcessView>, restarts: BTreeMap<StageId, u64>) {
        let mut inner = self.lock();
        inner.processes = processes;
        inner.updated_ns = Some(monotonic_ns());
        inner.restarts = restarts;
    }

    /// The processes, and the restarts of each stage.
    pub fn processes(&self) -> (Vec<ProcessView>, BTreeMap<StageId, u64>) {
        let inner = self.lock();
        (inner.processes.clone(), inner.restarts.clone())
    }

    /// The last events, oldest first.
    pub fn events(&self) -> Vec<Event> {
        self.lock().events.iter().cloned().collect()
    }

    /// Replaces the list of parts that the group lacks.
    pub fn update_lacks(&self, lacks: Vec<String>) {
        self.lock().lacks = lacks;
    }

    /// Parts that the group lacks at the moment, one line each.
    pub fn lacks(&self) -> Vec<String> {
        self.lock().lacks.clone()
    }

    /// Replaces the list of attendants.
    pub fn update_attendants(&self, attendants: Vec<AttendantView>) {
        self.lock().attendants = attendants;
    }

    /// Replaces what is known of the configuration.
    pub fn update_configured(&self, configured: Configured) {
        self.lock().configured = configured;
    }

    /// The configuration.
    pub fn configured(&self) -> Configured {
        self.lock().configured.clone()
    }

    /// Replaces the configuration that the group goes over to.
    pub fn update_config(&self, revision: u32, config: &Config) {
        self.lock().config = Some((revision, Arc::new(config.clone())));
    }

    /// The configuration that the group goes over to, if it is another revision than the given one.
    pub fn other_config(&self, than: u32) -> Option<(u32, Arc<Config>)> {
        self.lock().config.clone().filter(|(revision, _)| *revision != than)
    }

    /// The attendants.
    pub fn attendants(&self) -> Vec<AttendantView> {
        self.lock().attendants.clone()
    }

    /// Whether the supervisor has updated the view recently.
    pub fn is_watched(&self, now_ns: u64) -> bool {
        self.lock().updated_ns.is_some_and(|at_ns| now_ns.saturating_sub(at_ns) < LATE_NS)
    }

    /// The supervisor's heartbeat.
    pub fn heartbeat(&self, now_ns: u64) -> Heartbeat {
        Heartbeat {
            t_sent_ns: now_ns,
            pid: self.supervisor_pid,
            ..Heartbeat::new(Attendant::Supervisor as u32, ProcessState::Active)
        }
    }

    /// Events that this call has not returned before.
    pub fn take_new_events(&self) -> Vec<Event> {
        std::mem::take(&mut self.lock().unseen_events)
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // Every update leaves the data consistent, so a panic elsewhere does not make it unusable.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::EventKind;

    #[test]
    fn only_new_events_are_handed_out_and_they_are_numbered() {
        let view = GroupView::new(77);
        let beat = view.heartbeat(5);
        assert_eq!((beat.pid, beat.t_sent_ns), (77, 5));
        assert_eq!(beat.process, Attendant::Supervisor as u32);
        // An earlier supervisor's.
        view.remember(vec![Event::new(EventKind::Stalled, "filter", 3, "killed", "")]);
        view.log(Event::new(EventKind::Ended, "tracker", 7, "exit status 1", ""));
        view.log(Event::new(EventKind::Killed, "gateway", 8, "killed: no sign of life", ""));
        let numbers: Vec<u64> = view.take_new_events().iter().map(|event| event.number).collect();
        assert_eq!(numbers, [1, 2]);
    }
}
