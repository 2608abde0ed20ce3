//! Reserve of descriptors, so that the successor of a dead stage can be started even when no others are
//! left.

use super::sys::{self, Call};
use rustix::io::Errno;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::fs::File;
use std::io;

/// Descriptors in reserve: enough to start a process, or to connect to its topics (its log, three
/// standard descriptors, a pipe that reports a failure, its pidfd, and its shared memory).
const KEPT: usize = 24;

/// The reserve.
#[derive(Debug, Default)]
pub struct Reserve {
    files: Vec<File>,
}

impl Reserve {
    /// Raises this process's limit as far as permitted (the usual limit of a shell is for programs
    /// that need few), and fills the reserve as far as possible.
    pub fn new() -> Self {
        raise_limit();
        let mut reserve = Self::default();
        reserve.refill();
        reserve
    }

    /// Calls `act`, and calls it again with the reserve released if descriptors ran out.
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

    /// Refills the reserve as far as possible.
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

/// Upper bound of the limit. A group with many readers needs some hundred; a higher limit only
/// slows down programs that close every descriptor they could have.
const AMPLE: u64 = 65_536;

/// Raises a lowered limit again; returns whether it was lower.
pub fn raise_limit() -> bool {
    let limit = getrlimit(Resource::Nofile);
    let most = limit.maximum.map_or(AMPLE, |most| most.min(AMPLE));
    let is_low = limit.current.is_some_and(|current| current < most);
    // If that is not permitted, the limit stays.
    is_low && setrlimit(Resource::Nofile, Rlimit { current: Some(most), ..limit }).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_that_lacks_descriptors_is_repeated_with_the_reserve() {
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
