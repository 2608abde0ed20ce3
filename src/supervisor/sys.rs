//! The supervisor's fallible system calls, and a way for tests to make each of them fail.
//!
//! Any of these calls can fail in a healthy match: descriptors, processes, memory or a disk run out, or a
//! directory is removed. Each goes through [`ask`] with its own [`Call`], so that a test can make every one
//! of them fail once and check that the match goes on. Without [`FAULTS_VARIABLE`] the cost is one atomic
//! load.

use rustix::io::Errno;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};

/// For tests: set to `once`, every call fails the first time it is made when the group is complete.
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
}

/// One bit per call that is still to fail; 0 outside tests.
static TO_FAIL: AtomicU64 = AtomicU64::new(0);

/// Enables the injected failures, if requested. Called when the group is complete.
pub fn arm() {
    if std::env::var(FAULTS_VARIABLE).is_ok_and(|value| value == "once") {
        TO_FAIL.store(u64::MAX, Ordering::Relaxed);
    }
}

/// Makes a system call, or fails as injected.
pub fn ask<T>(call: Call, request: impl FnOnce() -> io::Result<T>) -> io::Result<T> {
    match fault(call) {
        Some(error) => Err(error),
        None => request(),
    }
}

/// Injected error of a call, if it is to fail now. For calls that have errors of their own.
pub fn fault(call: Call) -> Option<io::Error> {
    if TO_FAIL.load(Ordering::Relaxed) == 0 {
        return None;
    }
    let bit = 1 << call as u64;
    if TO_FAIL.fetch_and(!bit, Ordering::Relaxed) & bit == 0 {
        return None;
    }
    runtime::tell!("touchline: made to fail: {}", call.name());
    Some(call.errno().into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// System calls that do not go through this file are not covered by `tests/faults.rs`.
    #[test]
    fn every_call_is_made_somewhere_and_has_a_bit() {
        assert!(Call::ALL.len() < 64);
        let sources = [
            include_str!("attendants.rs"),
            include_str!("children.rs"),
            include_str!("control.rs"),
            include_str!("evidence.rs"),
            include_str!("group.rs"),
            include_str!("group/acting.rs"),
            include_str!("janitor.rs"),
            include_str!("log.rs"),
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
