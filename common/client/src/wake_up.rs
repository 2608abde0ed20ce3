//! Waiting for a topic to have something new: by sleeping, by spinning, or by both.

use crate::clock::monotonic_ns;
use crate::eventcount::EventCount;
use crate::rhythm::Rhythm;
use std::thread::yield_now;
use std::time::Duration;

/// How a reader waits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Strategy {
    /// Sleeps until it is woken.
    Event,
    /// Never sleeps.
    Spin,
    /// Sleeps until shortly before the next message is expected.
    Predictive,
}

/// Waits until a topic has something new.
pub struct WakeUp {
    published: EventCount,
    /// The count at the caller's last look at the topic.
    seen: u32,
    strategy: Strategy,
    rhythm: Rhythm,
}

impl WakeUp {
    /// Creates a wake-up whose first wait returns at once, since the caller has not looked yet.
    pub(crate) fn new(published: EventCount, strategy: Strategy) -> Self {
        let seen = published.read().wrapping_sub(1);
        Self { published, seen, strategy, rhythm: Rhythm::default() }
    }

    /// Returns when something was published since the last return, when `timeout` has passed, or on a
    /// signal; the caller checks the topic for what happened.
    ///
    /// To be called when the topic is empty. Nothing published after the caller's last look is missed:
    /// it makes the next wait return at once.
    pub fn wait(&mut self, timeout: Duration) {
        if self.is_unchanged() {
            let deadline_ns = monotonic_ns() + timeout.as_nanos() as u64;
            match self.strategy {
                Strategy::Event => self.sleep_until(deadline_ns),
                Strategy::Spin => self.spin_until(deadline_ns),
                Strategy::Predictive => self.wait_in_rhythm(deadline_ns),
            }
            // The time of arrival is known only for messages that were waited for.
            if !self.is_unchanged() {
                self.rhythm.arrived(monotonic_ns());
            }
        }
        self.seen = self.published.read();
    }

    fn is_unchanged(&self) -> bool {
        self.published.read() == self.seen
    }

    fn sleep_until(&self, deadline_ns: u64) {
        let now_ns = monotonic_ns();
        if now_ns < deadline_ns {
            self.published.sleep(self.seen, Duration::from_nanos(deadline_ns - now_ns));
        }
    }

    fn spin_until(&self, deadline_ns: u64) {
        while self.is_unchanged() && monotonic_ns() < deadline_ns {
            // Yielding costs a third of a microsecond. Without it, the process that is to publish could
            // be kept from this processor, for good if the spinning one has real-time priority.
            yield_now();
        }
    }

    /// Sleeps until shortly before the next message is expected, spins while it is expected, and
    /// sleeps again if it does not come.
    fn wait_in_rhythm(&self, deadline_ns: u64) {
        if let Some(expected) = self.rhythm.next() {
            self.sleep_until(expected.from_ns.min(deadline_ns));
            self.spin_until(expected.until_ns.min(deadline_ns));
        }
        if self.is_unchanged() {
            self.sleep_until(deadline_ns);
        }
    }
}
