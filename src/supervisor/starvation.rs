//! Starvation: time a process is ready to run without getting a processor.
//!
//! The system counts it (`/proc/PID/schedstat`), but adds a wait only when it is over. On a machine with
//! ten busy processes per processor a wait can be longer than the stall deadline, so waits in progress
//! count too: a process that is ready and has not run since the last look has waited. Stages have one
//! thread.

use super::sys::{self, Call};
use std::fs;
use std::io;

/// Scheduling times of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SchedulerTimes {
    /// Time on a processor, nanoseconds.
    ran_ns: u64,
    /// Time spent waiting for one in waits that are over, nanoseconds.
    waited_ns: u64,
    /// Running or waiting for a processor, instead of sleeping.
    is_ready: bool,
}

impl SchedulerTimes {
    /// Scheduling times of a living process.
    pub fn of(pid: u32) -> io::Result<Self> {
        let read = |file: &str| {
            let path = format!("/proc/{pid}/{file}");
            sys::ask(Call::ReadProcessorTimes, || fs::read_to_string(path))
        };
        let (times, stat) = (read("schedstat")?, read("stat")?);
        Self::parse(&times, &stat).ok_or_else(|| io::ErrorKind::InvalidData.into())
    }

    fn parse(times: &str, stat: &str) -> Option<Self> {
        let mut times = times.split_whitespace().map_while(|word| word.parse().ok());
        // The name before the state may contain anything, parentheses included.
        let (_, after_name) = stat.rsplit_once(')')?;
        Some(Self {
            ran_ns: times.next()?,
            waited_ns: times.next()?,
            is_ready: after_name.trim_start().starts_with('R'),
        })
    }
}

/// Age from which the previous look says nothing about the current wait: several may have ended
/// since.
const FRESH_NS: u64 = 40_000_000;

/// Measures the waits of one process.
#[derive(Debug, Clone, Copy, Default)]
pub struct ProcessorWait {
    last: Option<(SchedulerTimes, u64)>,
    /// Part of the wait in progress that is already counted.
    counted_ns: u64,
}

impl ProcessorWait {
    /// Waiting time since the last call, according to `times`; 0 if the last call was too long ago.
    pub fn newly_waited_ns(&mut self, times: SchedulerTimes, now_ns: u64) -> u64 {
        let is_fresh = |&(_, last_ns): &(_, u64)| now_ns.saturating_sub(last_ns) <= FRESH_NS;
        let Some((last, last_ns)) = self.last.replace((times, now_ns)).filter(is_fresh) else {
            self.counted_ns = 0;
            return 0;
        };
        let over_ns = times.waited_ns.saturating_sub(last.waited_ns);
        if over_ns > 0 || times.ran_ns != last.ran_ns {
            let new_ns = over_ns.saturating_sub(self.counted_ns);
            self.counted_ns = 0;
            return new_ns;
        }
        if !(times.is_ready && last.is_ready) {
            return 0;
        }
        let going_on_ns = now_ns.saturating_sub(last_ns);
        self.counted_ns += going_on_ns;
        going_on_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn times(ran_ms: u64, waited_ms: u64, is_ready: bool) -> SchedulerTimes {
        SchedulerTimes { ran_ns: ran_ms * MS, waited_ns: waited_ms * MS, is_ready }
    }

    /// Looks every 5 ms; returns the waiting times found, in milliseconds.
    fn waited(looks: &[SchedulerTimes]) -> Vec<u64> {
        let mut wait = ProcessorWait::default();
        let at = (0..).step_by(5).map(|ms| ms * MS);
        looks.iter().zip(at).map(|(&look, at)| wait.newly_waited_ns(look, at) / MS).collect()
    }

    #[test]
    fn a_wait_that_is_over_counts_as_the_system_says() {
        assert_eq!(waited(&[times(7, 100, true), times(8, 103, false)]), [0, 3]);
    }

    #[test]
    fn a_wait_in_progress_counts_at_once_and_not_again_when_it_is_over() {
        let ready = times(7, 100, true);
        assert_eq!(waited(&[ready, ready, ready, times(8, 112, true)]), [0, 5, 5, 2]);
    }

    #[test]
    fn old_waits_do_not_count() {
        let mut wait = ProcessorWait::default();
        assert_eq!(wait.newly_waited_ns(times(7, 100, false), 0), 0);
        assert_eq!(wait.newly_waited_ns(times(9, 900, true), 5000 * MS), 0);
        assert_eq!(wait.newly_waited_ns(times(9, 900, true), 5020 * MS), 20 * MS);
    }

    #[test]
    fn an_endless_loop_and_a_sleep_are_no_waits() {
        let looping: Vec<_> = (0..5).map(|step| times(5 * step, 100, true)).collect();
        assert_eq!(waited(&looping), [0; 5]);
        let asleep = times(7, 100, false);
        assert_eq!(waited(&[asleep; 4]), [0; 4]);
    }

    #[test]
    fn the_state_is_found_behind_any_name() {
        let parsed = SchedulerTimes::parse("12 34 5\n", "77 (tl) S (x) R 1 2").unwrap();
        assert_eq!(parsed, SchedulerTimes { ran_ns: 12, waited_ns: 34, is_ready: true });
        assert!(!SchedulerTimes::parse("12 34 5", "77 (tl) T 1").unwrap().is_ready);
        assert_eq!(SchedulerTimes::parse("", "77 (tl) R"), None);
        assert!(SchedulerTimes::of(std::process::id()).is_ok());
    }
}
