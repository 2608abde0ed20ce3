//! Predicts when the next message of a periodic sender arrives.
//!
//! The arrival times are followed by an alpha-beta filter (a second-order phase-locked loop, see Kalata,
//! *The tracking index*, 1984) with phase φ and period T. For a message that arrives at t:
//!
//! ```text
//! n = round((t − φ) / T)          periods since the last message
//! d = t − (φ + n·T)               deviation
//! φ ← φ + n·T + 0.2·d
//! T ← T + 0.02·d / n
//! ```
//!
//! A running mean of |d| gives the width of the window in which the next message is expected.

/// Consecutive periodic messages after which predictions are used.
const TRUSTED_AFTER: u32 = 8;
/// Gains of phase and period (α and β); the filter forgets in about ten messages.
const PHASE_GAIN: f64 = 0.2;
const PERIOD_GAIN: f64 = 0.02;
/// Gain of the running mean of |deviation|.
const DEVIATION_GAIN: f64 = 0.05;
/// Half width of the expected window, in mean deviations; nearly every message arrives within it.
const MARGIN_DEVIATIONS: f64 = 3.0;
/// Longest half width. If messages are this irregular, a few microseconds of wake-up time do not
/// matter.
const LONGEST_MARGIN_NS: f64 = 150_000.0;

/// A pause of more periods ends the rhythm.
const MAX_PERIODS: f64 = 8.0;

/// Estimator for messages that arrive at regular intervals.
#[derive(Debug, Clone, Default)]
pub struct Rhythm {
    last_ns: u64,
    /// Smoothed time at which the last message was due.
    phase_ns: f64,
    period_ns: f64,
    deviation_ns: f64,
    in_rhythm: u32,
}

/// Window in which a message is expected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Expected {
    /// Probably not before this.
    pub from_ns: u64,
    /// Probably not after this.
    pub until_ns: u64,
}

impl Rhythm {
    /// Updates the estimate with a message that arrived at this time.
    pub fn arrived(&mut self, now_ns: u64) {
        let since_last_ns = now_ns.saturating_sub(self.last_ns) as f64;
        // Some messages may be missing, or were received without a wait.
        let periods = ((now_ns as f64 - self.phase_ns) / self.period_ns).round().max(1.0);
        let due_ns = self.phase_ns + periods * self.period_ns;
        let deviation_ns = now_ns as f64 - due_ns;
        if self.in_rhythm > 0 && periods <= MAX_PERIODS && deviation_ns.abs() < self.period_ns / 4.0
        {
            self.phase_ns = due_ns + PHASE_GAIN * deviation_ns;
            self.period_ns += PERIOD_GAIN * deviation_ns / periods;
            self.deviation_ns += DEVIATION_GAIN * (deviation_ns.abs() - self.deviation_ns);
            self.in_rhythm = self.in_rhythm.saturating_add(1);
        } else {
            // The first message, a pause, a burst, or another rate: two messages give a new estimate.
            self.phase_ns = now_ns as f64;
            self.period_ns = since_last_ns;
            self.deviation_ns = since_last_ns / 8.0;
            self.in_rhythm = u32::from(self.last_ns > 0);
        }
        self.last_ns = now_ns;
    }

    /// The window of the next message; `None` while there is no rhythm.
    pub fn next(&self) -> Option<Expected> {
        if self.in_rhythm < TRUSTED_AFTER {
            return None;
        }
        let expected_ns = self.phase_ns + self.period_ns;
        let margin_ns = (MARGIN_DEVIATIONS * self.deviation_ns)
            .min(self.period_ns / 4.0)
            .min(LONGEST_MARGIN_NS);
        Some(Expected {
            from_ns: (expected_ns - margin_ns) as u64,
            until_ns: (expected_ns + margin_ns) as u64,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const START_NS: u64 = 7_000_000_000_000;

    fn after(times_ns: impl IntoIterator<Item = u64>) -> Rhythm {
        let mut rhythm = Rhythm::default();
        for time_ns in times_ns {
            rhythm.arrived(time_ns);
        }
        rhythm
    }

    #[test]
    fn a_camera_is_followed_closely() {
        let period_ns = 12_500_000;
        let rhythm = after((0..200).map(|n| START_NS + n * period_ns + n * 7919 % 60_000));
        let expected = rhythm.next().unwrap();
        let due_ns = START_NS + 200 * period_ns;
        assert!((expected.from_ns..expected.until_ns).contains(&(due_ns + 30_000)), "{expected:?}");
        assert!(expected.until_ns - expected.from_ns < 200_000, "{expected:?}");
    }

    #[test]
    fn without_a_rhythm_nothing_is_expected() {
        assert_eq!(after([]).next(), None);
        assert_eq!(after((0..5).map(|n| START_NS + n * 1000)).next(), None);
        let doubling = (0..20).map(|n| START_NS + (1 << n) * 1_000_000);
        assert_eq!(after(doubling).next(), None);
    }

    #[test]
    fn a_missing_message_does_not_upset_it() {
        let period_ns = 1_000_000;
        let some = (0..100).filter(|n| n % 7 != 0).map(|n| START_NS + n * period_ns);
        let expected = after(some).next().unwrap();
        assert!(expected.from_ns.abs_diff(START_NS + 100 * period_ns) < 50_000, "{expected:?}");
    }

    #[test]
    fn another_rate_is_learnt() {
        let slow = (0..50).map(|n| START_NS + n * 12_500_000);
        let fast = (0..50).map(|n| START_NS + 700_000_000 + n * 1_000_000);
        let expected = after(slow.chain(fast)).next().unwrap();
        let due_ns = START_NS + 750_000_000;
        assert!(expected.from_ns.abs_diff(due_ns) < 300_000, "{expected:?}");
    }

    proptest! {
        /// The expected window lies within a period or so of the last message, for any arrival times.
        #[test]
        fn nothing_is_expected_ages_from_now(gaps_ns in prop::collection::vec(0..1u64 << 40, 0..60)) {
            let mut now_ns = START_NS;
            let mut rhythm = Rhythm::default();
            for gap_ns in gaps_ns {
                now_ns += gap_ns;
                rhythm.arrived(now_ns);
                if let Some(expected) = rhythm.next() {
                    prop_assert!(expected.from_ns <= expected.until_ns);
                    prop_assert!(expected.until_ns < now_ns + (1 << 42));
                }
            }
        }
    }
}
