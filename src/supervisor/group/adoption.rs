//! The beginning of a group that has lived under another supervisor.

use super::{Group, TICK};
use crate::supervisor::SupervisorError;
use crate::supervisor::children::{self, Process, is_same_program};
use crate::supervisor::policy::Action;
use crate::supervisor::progress::Beat;
use crate::supervisor::takeover::{self, Inherited};
use common::clock::monotonic_ns;
use common::messages::{EventKind, ProcessState};
use rustix::io::Errno;
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::time::{Duration, Instant};

/// How often it is tried to hold a process that is to be taken over.
const HOLD_ATTEMPTS: u32 = 10;
/// Processes give a sign of life ten times a second.
const FIRST_WORD: Duration = Duration::from_millis(600);

impl Group<'_> {
    /// Takes over processes of an earlier supervisor. Its record says what they are; of those that
    /// it does not know, or that were still starting, they say it themselves, several times a second.
    /// One that says nothing is stuck.
    pub fn adopt(&mut self, inherited: &[Inherited]) -> Result<(), SupervisorError> {
        if inherited.is_empty() {
            return Ok(());
        }
        // What is taken over has worked before.
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
            // It cannot be known that they are silent. One that is the only one of its stage works.
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
            // It has just ended.
            Err(error) if error.raw_os_error() == Some(Errno::SRCH.raw_os_error()) => return,
            Err(error) => {
                // Left alone it would work beside its successor.
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
                self.log(EventKind::Killed, stage, pid, "killed: there is another one", "");
                // One that is still there for want of a signal is in nobody's way.
                let _ = process.signal(Signal::KILL);
            }
        }
    }

    /// What is refused now may be granted a moment later.
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
