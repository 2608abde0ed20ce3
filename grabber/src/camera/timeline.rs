//! Pacing of sources without a clock of their own.

use super::{Exposure, LastFrame};
use client::clock::{monotonic_ns, wall_ns};
use rustix::thread::{ClockId, clock_nanosleep_absolute};
use rustix::time::Timespec;

/// Due times and numbers of the frames of a source without a clock. Frame `seq` is due at
/// `epoch + seq · period`.
///
/// Since frame numbers follow from time, a grabber that is restarted continues its predecessor's numbers with
/// a gap of exactly the frames that were not captured. Small delays are caught up, since due times do not
/// move. After a delay of more than a quarter of a second the frames before the present are skipped, and their
/// numbers with them.
#[derive(Debug, Clone)]
pub struct Timeline {
    epoch_ns: u64,
    period_ns: f64,
    next_seq: u64,
}

/// Maximum delay that is caught up; a longer stop (a debugger, a suspended machine) is skipped.
const MAX_LAG_NS: u64 = 250_000_000;

/// Time before a due frame at which the source changes from sleeping to polling the clock, limited to
/// [`MAX_WATCHED_SHARE`] of the time: waking a processor takes long, and a camera's timing would not depend
/// on it.
const WATCHED_NS: u64 = 150_000;
const MAX_WATCHED_SHARE: f64 = 0.02;

impl Timeline {
    /// A timeline that starts now, or continues after a predecessor's last frame.
    pub fn new(fps: f64, last: Option<LastFrame>) -> Self {
        let period_ns = 1e9 / fps;
        match last {
            None => Self { epoch_ns: monotonic_ns() + period_ns as u64, period_ns, next_seq: 0 },
            Some(last) => {
                let since_epoch = (last.seq as f64 * period_ns) as u64;
                let mut timeline = Self {
                    epoch_ns: last.t_capture_ns.saturating_sub(since_epoch),
                    period_ns,
                    next_seq: last.seq + 1,
                };
                timeline.skip_to(monotonic_ns());
                timeline
            }
        }
    }

    /// Number of the next frame.
    pub fn next_seq(&self) -> u64 {
        self.next_seq
    }

    /// For a source whose frames take `painting_ns` to render: leaves the first half of the period to the
    /// stages that process the last frame, if there is time. A real camera would not take their processor
    /// either.
    pub fn rest(&self, painting_ns: u64) {
        let half_ns = (self.period_ns / 2.0) as u64;
        if painting_ns < half_ns / 2 {
            sleep_until(self.due_ns(self.next_seq).saturating_sub(half_ns));
        }
    }

    /// Waits until the next frame is due and returns its exposure.
    pub fn wait(&mut self, skipped: u64) -> Exposure {
        let due_ns = self.due_ns(self.next_seq);
        let watched_ns = WATCHED_NS.min((self.period_ns * MAX_WATCHED_SHARE) as u64);
        sleep_until(due_ns.saturating_sub(watched_ns));
        while monotonic_ns() < due_ns {
            // Lets other threads run meanwhile.
            std::thread::yield_now();
        }
        let exposure = Exposure {
            seq: self.next_seq,
            t_capture_ns: due_ns,
            t_capture_wall_ns: wall_ns().saturating_sub(monotonic_ns().saturating_sub(due_ns)),
            skipped,
        };
        self.next_seq += 1;
        exposure
    }

    /// If the next frame is more than a quarter of a second late, skips all frames before the present; returns
    /// their number.
    pub fn skip_late(&mut self) -> u64 {
        let now = monotonic_ns();
        if now > self.due_ns(self.next_seq) + MAX_LAG_NS { self.skip_to(now) } else { 0 }
    }

    fn skip_to(&mut self, time_ns: u64) -> u64 {
        let elapsed = time_ns.saturating_sub(self.epoch_ns) as f64;
        let next = ((elapsed / self.period_ns).ceil() as u64).max(self.next_seq);
        let skipped = next - self.next_seq;
        self.next_seq = next;
        skipped
    }

    fn due_ns(&self, seq: u64) -> u64 {
        self.epoch_ns + (seq as f64 * self.period_ns) as u64
    }
}

fn sleep_until(time_ns: u64) {
    let time = Timespec {
        tv_sec: (time_ns / 1_000_000_000) as _,
        tv_nsec: (time_ns % 1_000_000_000) as _,
    };
    // A signal interrupts the sleep; as the time is absolute, it is simply continued.
    while clock_nanosleep_absolute(ClockId::Monotonic, &time) == Err(rustix::io::Errno::INTR) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_successor_continues_the_numbers_with_a_gap_for_the_time_that_passed() {
        let fps = 1000.0;
        let now = monotonic_ns();
        let last = LastFrame { seq: 500, t_capture_ns: now - 20_000_000 };
        let timeline = Timeline::new(fps, Some(last));
        assert!(timeline.next_seq() >= 520, "{}", timeline.next_seq());
        let due = timeline.due_ns(timeline.next_seq());
        assert!(due >= now, "the next frame lies in the past");
        assert_eq!((due - last.t_capture_ns) % 1_000_000, 0, "not on the predecessor's grid");
    }

    #[test]
    fn numbers_follow_each_other() {
        let mut timeline = Timeline::new(10_000.0, None);
        let first = timeline.wait(0);
        let second = timeline.wait(0);
        assert_eq!((first.seq, second.seq), (0, 1));
        assert_eq!(second.t_capture_ns - first.t_capture_ns, 100_000);
    }
}
