//! The supervisor's fallible system calls, and a way for tests to make each of them fail.
//!
//! Any of these calls can fail in a healthy match: descriptors, processes, memory or a disk run out, or a
//! directory is removed. Each goes through [`ask`], so that a test can make it fail once in every place where
//! it is made, and check that the match goes on. Without [`FAULTS_VARIABLE`] the cost is one atomic
//! load.

use super::SupervisorError;
use rustix::io::Errno;
use std::collections::BTreeSet;
use std::io;
use std::panic::Location;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// For tests: set to `once`, every call fails the first time it is made in each place, from the time when
/// the group is complete or a supervisor takes over.
pub const FAULTS_VARIABLE: &str = "TOUCHLINE_SYSTEM_FAULTS";

macro_rules! calls {
    ($($call:ident = $name:literal, $errno:ident;)+) => {
        /// A place in the supervisor where it asks the system for something.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Call {
            $(#[doc = $name] $call,)+
        }

        impl Call {
            /// All calls, in the order of their numbers.
            #[cfg(test)]
            pub const ALL: &[Self] = &[$(Self::$call,)+];

            /// Description.
            pub fn name(self) -> &'static str {
                match self { $(Self::$call => $name,)+ }
            }

            /// Error of an injected failure.
            fn errno(self) -> Errno {
                match self { $(Self::$call => Errno::$errno,)+ }
            }
        }
    };
}

calls! {
    WaitForEvents = "wait for processes", NOMEM;
    MakeLog = "make a process's log", MFILE;
    ReadLog = "read a process's log", IO;
    StartProcess = "start a process", AGAIN;
    HoldProcess = "hold a process by a descriptor", MFILE;
    SignalProcess = "signal a process", NOMEM;
    ReapProcess = "ask how a process ended", NOMEM;
    ReadProcessorTimes = "read a process's times", MFILE;
    ReceiveOutputs = "receive the stages' outputs", MFILE;
    ReceiveHeartbeats = "receive heartbeats", MFILE;
    ConnectToTopics = "connect to the topics", NOMEM;
    OpenPage = "map the page of a stage", NOSPC;
    WriteRecord = "write the group's record", NOSPC;
    ReplaceRecord = "put the group's record in its place", IO;
    OpenControl = "open the socket for requests", NOSPC;
    ReceiveRequest = "receive a request", NOMEM;
    AnswerRequest = "answer a request", NOBUFS;
    MakeDirectory = "make the runtime directory", NOSPC;
    RestoreNamespace = "restore the note of the place in shared memory", NOSPC;
    TakeLock = "take the lock", MFILE;
    WriteConfig = "write the snapshot of the configuration", NOSPC;
    StartThread = "start a thread", AGAIN;
    ListProcesses = "list the group's processes", MFILE;
    KeepReserve = "keep descriptors in reserve", MFILE;
    HandleSignals = "handle signals", MFILE;
    PrepareAttendant = "prepare an attendant", MFILE;
}

/// Whether failures are injected.
static IS_ARMED: AtomicBool = AtomicBool::new(false);
/// Places, by file and line, where a call has failed as injected.
static FAILED: Mutex<BTreeSet<(&str, u32)>> = Mutex::new(BTreeSet::new());

/// Enables the injected failures, if requested. Called when the group is complete, and by a supervisor that
/// takes over.
pub fn arm() {
    if std::env::var(FAULTS_VARIABLE).is_ok_and(|value| value == "once") {
        IS_ARMED.store(true, Ordering::Relaxed);
    }
}

/// Makes a system call, or fails as injected.
#[track_caller]
pub fn ask<T>(call: Call, request: impl FnOnce() -> io::Result<T>) -> io::Result<T> {
    match fault(call) {
        Some(error) => Err(error),
        None => request(),
    }
}

/// Fails as injected. Before calls that have errors of their own.
#[track_caller]
pub fn check(call: Call) -> Result<(), SupervisorError> {
    match fault(call) {
        Some(source) => Err(SupervisorError::System { action: call.name().into(), source }),
        None => Ok(()),
    }
}

/// Injected error of a call, if it is to fail now. For calls that have errors of their own.
#[track_caller]
pub fn fault(call: Call) -> Option<io::Error> {
    if !IS_ARMED.load(Ordering::Relaxed) {
        return None;
    }
    let (file, line) = (Location::caller().file(), Location::caller().line());
    let mut failed = FAILED.lock().unwrap_or_else(PoisonError::into_inner);
    if !failed.insert((file, line)) {
        return None;
    }
    runtime::tell!("touchline: made to fail at {file}:{line}: {}", call.name());
    Some(call.errno().into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// System calls that do not go through this file are not covered by `tests/faults.rs`.
    #[test]
    fn every_call_is_made_somewhere() {
        let sources = [
            include_str!("attendants.rs"),
            include_str!("children.rs"),
            include_str!("requests.rs"),
            include_str!("evidence.rs"),
            include_str!("group.rs"),
            include_str!("group/acting.rs"),
            include_str!("janitor.rs"),
            include_str!("log.rs"),
            include_str!("mod.rs"),
            include_str!("pages.rs"),
            include_str!("premises.rs"),
            include_str!("progress.rs"),
            include_str!("record.rs"),
            include_str!("reserve.rs"),
            include_str!("starvation.rs"),
        ];
        for call in Call::ALL {
            let made = format!("Call::{call:?}");
            assert!(sources.iter().any(|source| source.contains(&made)), "{made} is made nowhere");
        }
    }
}
