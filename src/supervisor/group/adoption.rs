//! Takeover: adopts the processes of a group that ran under another supervisor.

use super::{Group, TICK};
use crate::supervisor::SupervisorError;
use crate::supervisor::children::{self, Process, is_same_program};
use crate::supervisor::policy::Action;
use crate::supervisor::progress::Beat;
use crate::supervisor::takeover::{self, Inherited};
use client::clock::monotonic_ns;
use messages::{EventKind, ProcessState};
use rustix::io::Errno;
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::time::{Duration, Instant};

/// Attempts to open a process that is to be adopted.
const HOLD_ATTEMPTS: u32 = 10;
/// Longest wait for the first heartbeat; a process sends ten a second.
const FIRST_WORD: Duration = Duration::from_millis(600);

impl Group<'_> {
    /// Adopts processes of an earlier supervisor. The record gives their roles; a process that is
    /// not in the record, or was still starting, is identified by its next heartbeat. A process
    /// that sends none is stuck.
    pub fn adopt(&mut self, inherited: &[Inherited]) -> Result<(), SupervisorError> {
        if inherited.is_empty() {
            return Ok(());
        }
        // An inherited group was complete before.
        self.ever_complete = true;
        let mut silent = BTreeMap::new();
        for stage in inherited {
            match stage.spare {
                Some(true) => self.take_in(stage, ProcessState::Spare),
                Some(false) => self.take_in(stage, ProcessState::Active),
                None => drop(silent.insert(stage.pid, *stage)),
            }
        }
        let deadline = Instant::now() + FIRST_WORD;
        while !silent.is_empty() && Instant::now() < deadline {
            let mut signs = Vec::new();
            let heard = self.progress.heartbeats(|beat| {
                if let Beat::Stage(sign) = beat {
                    signs.push(sign);
                }
            });
            if heard.is_err() || !self.progress.is_connected() {
                break;
            }
            for sign in signs {
                if let Some(stage) = silent.remove(&sign.pid) {
                    self.take_in(&stage, sign.state);
                }
            }
            std::thread::sleep(TICK);
        }
        if !self.progress.is_connected() {
            // Without heartbeats a silent process cannot be recognised. The only process of a stage
            // counts as the active one.
            for stage in silent.values() {
                let is_alone =
                    !inherited.iter().any(|it| it.stage == stage.stage && it.pid != stage.pid);
                let state = if is_alone { ProcessState::Active } else { ProcessState::Spare };
                self.take_in(stage, state);
            }
            silent.clear();
        }
        for stage in silent.values() {
            let what = "killed: it did not answer the new supervisor";
            self.log(EventKind::Killed, stage.stage, stage.pid, what, "");
            takeover::kill(stage.pid);
        }
        self.act(Action::CleanUp)
    }

    fn take_in(&mut self, inherited: &Inherited, state: ProcessState) {
        let &Inherited { stage, pid, .. } = inherited;
        let process = match self.hold(inherited) {
            Ok(process) => process,
            // The process has just ended.
            Err(error) if error.raw_os_error() == Some(Errno::SRCH.raw_os_error()) => return,
            Err(error) => {
                // If left alone, it would work beside its successor.
                let what = format!("killed: it cannot be taken over: {error}");
                self.log(EventKind::Killed, stage, pid, &what, "");
                return takeover::kill(pid);
            }
        };
        let outdated = !is_same_program(Path::new("/proc/self/exe"), &children::program_of(pid));
        let spare = state == ProcessState::Spare;
        match self.policy.adopt(stage, spare, outdated, monotonic_ns()) {
            Some(id) => {
                self.log(EventKind::TakenOver, stage, pid, "taken over", "");
                self.states.insert(pid, state);
                self.processes.insert(id, process);
            }
            None => {
                self.log(
                    EventKind::Killed,
                    stage,
                    pid,
                    "killed: there is another one, or the group has no such stage",
                    "",
                );
                // Best effort: if the signal fails, the extra process does no harm.
                let _ = process.signal(Signal::KILL);
            }
        }
    }

    /// Opens an inherited process; retried, since the system may refuse only for a moment.
    fn hold(&mut self, inherited: &Inherited) -> io::Result<Process> {
        let mut attempts = 0;
        loop {
            attempts += 1;
            match self.reserve.lend(|| Process::adopt(inherited.stage, inherited.pid)) {
                Err(error)
                    if attempts < HOLD_ATTEMPTS
                        && error.raw_os_error() != Some(Errno::SRCH.raw_os_error()) =>
                {
                    std::thread::sleep(TICK);
                }
                outcome => return outcome,
            }
        }
    }
}
