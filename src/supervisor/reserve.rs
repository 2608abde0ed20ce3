//! Descriptors kept in reserve, for the moment in which there are none left: a stage has died and its
//! successor is to be started.

use super::sys::{self, Call};
use rustix::io::Errno;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::fs::File;
use std::io;

/// What it takes to start a process or to connect to the topics of one: its log, three standard
/// descriptors, a pipe to hear of a failure, a hold on it, and its shared memory.
const KEPT: usize = 24;

/// The descriptors.
#[derive(Debug, Default)]
pub struct Reserve {
    files: Vec<File>,
}

impl Reserve {
    /// Fills it as far as that is possible, and first allows this process as many descriptors as it may
    /// allow itself: the usual limit of a shell is for programs that do not know better.
    pub fn new() -> Self {
        raise_limit();
        let mut reserve = Self::default();
        reserve.refill();
        reserve
    }

    /// Does something that needs descriptors, and does it again with those in reserve when there were
    /// none left.
    pub fn lend<T>(&mut self, mut act: impl FnMut() -> io::Result<T>) -> io::Result<T> {
        match act() {
            Err(error) if is_want_of_descriptors(&error) => {
                raise_limit();
                self.files.clear();
                let outcome = act();
                self.refill();
                outcome
            }
            outcome => outcome,
        }
    }

    /// Fills up what could not be filled up before.
    pub fn refill(&mut self) {
        while self.files.len() < KEPT {
            match sys::ask(Call::KeepReserve, || File::open("/dev/null")) {
                Ok(file) => self.files.push(file),
                Err(_) => return,
            }
        }
    }
}

fn is_want_of_descriptors(error: &io::Error) -> bool {
    [Errno::MFILE, Errno::NFILE]
        .iter()
        .any(|errno| error.raw_os_error() == Some(errno.raw_os_error()))
}

/// A group with many readers needs some hundred; more than this would only cost programs that close all
/// the descriptors they could have.
const AMPLE: u64 = 65_536;

/// Allows this process again what somebody may have taken from it; returns whether it had less.
pub fn raise_limit() -> bool {
    let limit = getrlimit(Resource::Nofile);
    let most = limit.maximum.map_or(AMPLE, |most| most.min(AMPLE));
    let is_low = limit.current.is_some_and(|current| current < most);
    // Where that is not permitted, the limit stays.
    is_low && setrlimit(Resource::Nofile, Rlimit { current: Some(most), ..limit }).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_fails_for_want_of_descriptors_is_done_again_with_those_in_reserve() {
        let mut reserve = Reserve::default();
        reserve.refill();
        assert_eq!(reserve.files.len(), KEPT);
        let mut attempts = 0;
        let outcome = reserve.lend(|| {
            attempts += 1;
            if attempts == 1 { Err(Errno::MFILE.into()) } else { Ok(attempts) }
        });
        assert_eq!((outcome.unwrap(), reserve.files.len()), (2, KEPT));
        let outcome: io::Result<()> = reserve.lend(|| {
            attempts += 1;
            Err(Errno::AGAIN.into())
        });
        assert!(outcome.is_err() && attempts == 3, "that is no want of descriptors");
    }
}
