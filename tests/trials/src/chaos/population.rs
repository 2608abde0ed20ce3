//! The current processes of the group, and signals to them.
//!
//! Processes become known by their heartbeats. Each is then held by a pidfd, and accepted only if its
//! command line names the group under test, so that no signal reaches another process, even if the
//! kernel reuses a process id.

use messages::{Heartbeat, ProcessKind, ProcessState};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::OwnedFd;
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};
use std::collections::BTreeMap;
use std::time::Instant;

/// A living process of the group.
#[derive(Debug)]
pub struct Member {
    /// Its process id.
    pub pid: u32,
    /// Its stage.
    pub kind: ProcessKind,
    state: ProcessState,
    t_sent_ns: u64,
    /// Revision of its configuration.
    revision: u32,
    pidfd: OwnedFd,
    /// Was disturbed, so its end is expected.
    disturbed: bool,
    /// Was disturbed in a way that it does not survive.
    doomed: bool,
    resume_at: Option<Instant>,
}

/// The end of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Death {
    /// Its process id.
    pub pid: u32,
    /// Its stage.
    pub kind: ProcessKind,
    /// Revision of its configuration.
    pub revision: u32,
    /// Whether a disturbance caused it.
    pub provoked: bool,
}

/// The living processes of the group.
#[derive(Debug)]
pub struct Population {
    instance: String,
    members: BTreeMap<u32, Member>,
}

impl Population {
    /// No process is known yet.
    pub fn new(instance: &str) -> Self {
        Self { instance: instance.into(), members: BTreeMap::new() }
    }

    /// Takes a heartbeat into account.
    pub fn note(&mut self, beat: &Heartbeat) {
        let kind = ProcessKind::from_number(beat.process);
        let state = ProcessState::from_number(beat.state);
        let (Some(kind), Some(state)) = (kind, state) else { return };
        if let Some(member) = self.members.get_mut(&beat.pid) {
            (member.state, member.t_sent_ns) = (state, beat.t_sent_ns);
            return;
        }
        // The process may have died since its heartbeat.
        if let Some(pidfd) = hold(beat.pid, &self.instance) {
            let member = Member {
                pid: beat.pid,
                kind,
                state,
                t_sent_ns: beat.t_sent_ns,
                revision: beat.revision,
                pidfd,
                disturbed: false,
                doomed: false,
                resume_at: None,
            };
            self.members.insert(beat.pid, member);
        }
    }

    /// Removes the processes that have ended, and returns them.
    pub fn take_ended(&mut self) -> Vec<Death> {
        let dead: Vec<u32> = self
            .members
            .values()
            .filter(|member| has_ended(&member.pidfd))
            .map(|m| m.pid)
            .collect();
        let remove = |pid| self.members.remove(&pid);
        let deaths = dead.into_iter().filter_map(remove);
        deaths
            .map(|member| Death {
                pid: member.pid,
                kind: member.kind,
                revision: member.revision,
                provoked: member.disturbed,
            })
            .collect()
    }

    /// Continues processes whose pause is over.
    pub fn resume(&mut self, now: Instant) {
        for member in self.members.values_mut().filter(|m| m.resume_at.is_some_and(|at| at <= now))
        {
            member.resume_at = None;
            send(member, Signal::CONT);
        }
    }

    /// The active process of a stage, unless it is paused or about to end.
    pub fn active(&self, kind: ProcessKind) -> Option<u32> {
        self.newest_in_state(kind, ProcessState::Active)
    }

    /// The spare of a stage, unless it is paused or about to end.
    pub fn spare(&self, kind: ProcessKind) -> Option<u32> {
        self.newest_in_state(kind, ProcessState::Spare)
    }

    /// Kills a process.
    pub fn kill(&mut self, pid: u32) {
        self.disturb(pid, Signal::KILL, |member| member.doomed = true);
    }

    /// Freezes a process permanently.
    pub fn stop(&mut self, pid: u32) {
        self.disturb(pid, Signal::STOP, |member| member.doomed = true);
    }

    /// Freezes a process until the given time.
    pub fn pause(&mut self, pid: u32, until: Instant) {
        self.disturb(pid, Signal::STOP, |member| member.resume_at = Some(until));
    }

    /// Makes a process panic.
    pub fn panic(&mut self, pid: u32) {
        self.disturb(pid, Signal::USR2, |member| member.doomed = true);
    }

    /// Expects an orderly end of a process.
    pub fn expect_end(&mut self, pid: u32) {
        if let Some(member) = self.members.get_mut(&pid) {
            (member.disturbed, member.doomed) = (true, true);
        }
    }

    fn disturb(&mut self, pid: u32, signal: Signal, note: impl FnOnce(&mut Member)) {
        if let Some(member) = self.members.get_mut(&pid) {
            send(member, signal);
            member.disturbed = true;
            note(member);
        }
    }

    /// The newest process that reports this state: while a spare takes over, the last heartbeats of the
    /// old process are still under way.
    fn newest_in_state(&self, kind: ProcessKind, state: ProcessState) -> Option<u32> {
        self.members
            .values()
            .filter(|member| member.kind == kind && member.state == state)
            .filter(|member| !member.doomed && member.resume_at.is_none())
            .filter(|member| !has_ended(&member.pidfd))
            .max_by_key(|member| member.t_sent_ns)
            .map(|member| member.pid)
    }
}

/// A pidfd of the process with this id, if it belongs to the group.
pub fn hold(pid: u32, instance: &str) -> Option<OwnedFd> {
    let pidfd = pidfd_open(Pid::from_raw(pid as i32)?, PidfdFlags::empty()).ok()?;
    // Checked after the pidfd was opened: from here on it cannot refer to another process.
    belongs_to(pid, instance).then_some(pidfd)
}

/// Whether a process's command line names the group.
pub fn belongs_to(pid: u32, instance: &str) -> bool {
    let command_line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
    names_instance(&command_line, instance)
}

fn names_instance(command_line: &[u8], instance: &str) -> bool {
    let words: Vec<&[u8]> = command_line.split(|&byte| byte == 0).collect();
    words.windows(2).any(|pair| pair == [b"--instance", instance.as_bytes()])
}

/// Whether a process catches the signal that makes it panic, instead of being killed by it.
pub fn panics_on_command(pid: u32) -> bool {
    listens_to(pid, Signal::USR2)
}

/// Whether a process catches a signal yet.
pub fn listens_to(pid: u32, signal: Signal) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    catches(&status, signal)
}

fn catches(status: &str, signal: Signal) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (signal.as_raw() - 1) & 1 == 1
}

/// Whether a process has ended, even if it has not been reaped yet.
pub fn has_ended(pidfd: &OwnedFd) -> bool {
    let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
    poll(&mut [PollFd::new(pidfd, PollFlags::IN)], Some(&at_once)).is_ok_and(|ready| ready > 0)
}

/// An error means that the process has ended, which is noticed elsewhere.
fn send(member: &Member, signal: Signal) {
    let _ = pidfd_send_signal(&member.pidfd, signal);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_command_line_that_names_the_group_belongs_to_it() {
        let line = b"touchline\0filter\0--instance\0chaos-1\0--spare\0";
        assert!(names_instance(line, "chaos-1"));
        assert!(!names_instance(line, "chaos-11"));
        assert!(!names_instance(b"vi\0chaos-1\0", "chaos-1"));
        assert!(!names_instance(b"", "chaos-1"));
        assert!(hold(std::process::id(), "chaos-1").is_none(), "that is us");
    }

    #[test]
    fn caught_signals_are_read_off_the_mask() {
        let status = "Name:\ttl-filter\nSigIgn:\t0000000000001000\nSigCgt:\t0000000000000800\n";
        assert!(catches(status, Signal::USR2), "12 is bit 11");
        assert!(!catches(status, Signal::USR1));
        assert!(!catches("", Signal::USR2));
    }

    #[test]
    fn a_process_that_is_not_ours_is_not_taken_in() {
        let mut population = Population::new("chaos-1");
        let mut beat: Heartbeat = bytemuck::Zeroable::zeroed();
        (beat.pid, beat.state) = (std::process::id(), ProcessState::Active as u32);
        population.note(&beat);
        assert_eq!(population.active(ProcessKind::Grabber), None);
        assert!(population.members.is_empty());
    }
}
