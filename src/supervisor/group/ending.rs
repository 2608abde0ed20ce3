//! The end of a group, or of its supervisor alone.

use super::{Group, TICK};
use crate::supervisor::GRACE;
use crate::supervisor::children::Process;
use crate::supervisor::policy::MemberId;
use rustix::process::Signal;
use std::collections::HashMap;
use std::time::{Duration, Instant};

/// Longest wait for the last results when the group is told to end.
const DRAIN: Duration = Duration::from_millis(100);

impl Group<'_> {
    /// Leaves the group running, in a state that the next supervisor can take over.
    pub fn leave(mut self) {
        // The next supervisor starts its own attendants, and clients reconnect.
        self.attendants.end();
        self.janitor.finish();
    }

    /// Ends the grabbers, waits for the last frame's results, then ends all other processes.
    pub fn end_all(mut self) {
        self.notifier.stopping();
        for process in self.processes.values().filter(|process| process.stage.is_grabber()) {
            let _ = process.signal(Signal::TERM);
        }
        let deadline = Instant::now() + DRAIN;
        let is_capturing = |processes: &HashMap<MemberId, Process>| {
            processes.values().any(|process| process.stage.is_grabber())
        };
        while Instant::now() < deadline
            && (is_capturing(&self.processes) || !self.results_are_out())
        {
            std::thread::sleep(TICK);
            self.look();
            self.processes.retain(|_, process| process.reap().is_none());
        }
        let deadline = Instant::now() + GRACE;
        for process in self.processes.values() {
            // A stopped process handles SIGTERM only after SIGCONT, which does nothing to a running
            // one.
            let _ = process.signal(Signal::TERM);
            let _ = process.signal(Signal::CONT);
        }
        while !self.processes.is_empty() {
            if Instant::now() > deadline {
                for process in self.processes.values() {
                    let _ = process.signal(Signal::KILL);
                }
            }
            self.wait();
            self.look();
            self.processes.retain(|_, process| process.reap().is_none());
        }
        // Last, so that they have passed the last results on to their clients.
        self.attendants.end();
        self.janitor.finish();
    }
}
