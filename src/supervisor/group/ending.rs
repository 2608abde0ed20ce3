//! The end of a group, or of its supervisor alone.

use super::{Group, TICK};
use crate::supervisor::GRACE;
use crate::supervisor::children::Process;
use crate::supervisor::policy::MemberId;
use rustix::process::Signal;
use std::collections::HashMap;
use std::time::{Duration, Instant};

/// How long the last results may take when the group is told to end.
const DRAIN: Duration = Duration::from_millis(100);

impl Group<'_> {
    /// Leaves the group to whoever comes next, in a state that can be taken over.
    pub fn leave(mut self) {
        // Processes of the other program are to serve the clients, which come again.
        self.attendants.end();
        self.janitor.finish();
    }

    /// Ends the camera, lets the last frame's results come out, and ends everybody else.
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
            // A stopped process cannot hear; a continued one that was not stopped does not care.
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
        // Last: whatever has come out has been given to its clients.
        self.attendants.end();
        self.janitor.finish();
    }
}
