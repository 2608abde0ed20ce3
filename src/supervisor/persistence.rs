//! Repeats the first steps of a supervisor for as long as the system refuses them.
//!
//! A supervisor that takes over a running match may start without free descriptors or memory. Such a
//! shortage passes, and until then the match has no other supervisor; so the steps before the takeover are
//! retried. Errors that waiting does not fix are returned at once.

use super::SupervisorError;
use super::reserve::raise_limit;
use rustix::io::Errno;
use std::error::Error;
use std::io;
use std::time::{Duration, Instant};

/// Longest time that a step is repeated.
const PATIENCE: Duration = Duration::from_secs(20);
/// Pause between two attempts.
const PAUSE: Duration = Duration::from_millis(50);

/// Carries out a step, and repeats it while the system refuses a resource.
pub fn insist<T>(
    mut step: impl FnMut() -> Result<T, SupervisorError>,
) -> Result<T, SupervisorError> {
    raise_limit();
    let deadline = Instant::now() + PATIENCE;
    let mut is_said = false;
    loop {
        match step() {
            Err(error) if Instant::now() < deadline && (raise_limit() || is_refusal(&error)) => {
                if !std::mem::replace(&mut is_said, true) {
                    runtime::tell!("touchline: {error}; it is tried again");
                }
                std::thread::sleep(PAUSE);
            }
            outcome => return outcome,
        }
    }
}

/// Whether the system lacked descriptors or memory at the moment.
fn is_refusal(error: &SupervisorError) -> bool {
    const REFUSALS: [Errno; 4] = [Errno::MFILE, Errno::NFILE, Errno::NOMEM, Errno::AGAIN];
    let is_it = |error: &io::Error| {
        REFUSALS.iter().any(|errno| error.raw_os_error() == Some(errno.raw_os_error()))
    };
    let mut next: Option<&(dyn Error + 'static)> = Some(error);
    while let Some(error) = next {
        if error.downcast_ref().is_some_and(is_it) {
            return true;
        }
        next = error.source();
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;
    use client::instance::InstanceError;

    fn failed(errno: Errno) -> SupervisorError {
        InstanceError::Io { path: "/dev/shm".into(), source: errno.into() }.into()
    }

    #[test]
    fn refusals_are_retried_and_other_errors_are_returned() {
        let mut refusals = vec![Errno::MFILE, Errno::NOMEM, Errno::NFILE];
        let step = || refusals.pop().map_or(Ok("taken over"), |errno| Err(failed(errno)));
        assert_eq!(insist(step).unwrap(), "taken over");

        let mut attempts = 0;
        let step = || {
            attempts += 1;
            Err::<(), _>(failed(Errno::ACCESS))
        };
        assert!(insist(step).is_err());
        assert_eq!(attempts, 1);
    }
}
