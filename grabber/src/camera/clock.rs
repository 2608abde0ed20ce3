//! Conversion of a camera's clock, and of the wall clock, to this machine's monotonic clock.

/// Converts times of a device's clock to times of this machine's monotonic clock.
///
/// A frame arrives at least the transfer time after it was taken, sometimes much later. The device's own
/// stamp has no such jitter, but another origin and a slightly different rate. So the offset between the
/// clocks is estimated as the minimum of arrival minus stamp, similar to the clock filter of NTP:
///
/// ```text
/// offset ← min(arrival − stamp, offset + drift · Δt)
/// ```
///
/// The second term lets it grow as fast as clocks can drift apart.
#[derive(Debug, Clone, Default)]
pub struct DeviceClock {
    /// This clock minus the device's, and the device's time of the last update.
    offset: Option<(i64, u64)>,
}

/// Maximum relative drift of two clocks.
const DRIFT_PER_S: f64 = 100e-6;
/// Difference that no delay explains: the device's clock was set.
const JUMP_NS: i64 = 200_000_000;

impl DeviceClock {
    /// This machine's time at which the device's clock showed `device_ns`, plus the minimal transfer time.
    /// `arrived_ns` is the time at which the frame began to arrive; it is returned for a device without a
    /// clock (`device_ns` is 0).
    pub fn local_ns(&mut self, device_ns: u64, arrived_ns: u64) -> u64 {
        if device_ns == 0 {
            return arrived_ns;
        }
        let now = arrived_ns.wrapping_sub(device_ns) as i64;
        let offset = match self.offset {
            Some((offset, last_ns)) if device_ns >= last_ns => {
                let drift_ns = (device_ns - last_ns) as f64 * DRIFT_PER_S;
                let grown = offset.saturating_add(drift_ns as i64);
                if now.saturating_sub(grown).saturating_abs() > JUMP_NS {
                    now
                } else {
                    now.min(grown)
                }
            }
            _ => now,
        };
        self.offset = Some((offset, device_ns));
        device_ns.wrapping_add(offset as u64)
    }
}

/// Computes the age of wall-clock stamps, which libraries give, although that clock may be set at any time.
#[derive(Debug, Clone, Default)]
pub struct WallClock {
    /// The wall clock minus the monotonic one, at the last call.
    offset_ns: Option<i64>,
}

/// Maximum change of the offset between two frames. While being slewed, the wall clock gains at most half a
/// microsecond per millisecond.
const STEP_NS: u64 = 1_000_000;

impl WallClock {
    /// The age of a stamp made since the last call, given the present values of both clocks; 0 if the wall
    /// clock was set since.
    pub fn age_ns(&mut self, stamp_ns: u64, wall_ns: u64, monotonic_ns: u64) -> u64 {
        let offset_ns = wall_ns.wrapping_sub(monotonic_ns) as i64;
        let last_ns = self.offset_ns.replace(offset_ns);
        let is_steady = last_ns.is_some_and(|last_ns| last_ns.abs_diff(offset_ns) < STEP_NS);
        if is_steady { wall_ns.saturating_sub(stamp_ns) } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERIOD_NS: u64 = 12_500_000;

    #[test]
    fn late_arrivals_do_not_move_the_offset() {
        let mut clock = DeviceClock::default();
        for frame in 0..200 {
            let device_ns = 77_000 + frame * PERIOD_NS;
            let late_ns = frame * 7919 % 5_000_000;
            let arrived_ns = 5_000_000_000_000 + device_ns + late_ns;
            let error = clock.local_ns(device_ns, arrived_ns) - (5_000_000_000_000 + device_ns);
            // Until a frame arrives early again, a drift of 100 µs per second is allowed for.
            assert!(frame < 50 || error < 300_000, "{frame}: {error} ns");
        }
    }

    #[test]
    fn a_drifting_clock_is_followed() {
        for rate in [1.0 - 50e-6, 1.0 + 50e-6] {
            let mut clock = DeviceClock::default();
            let mut worst = 0;
            for frame in 1..10_000_u64 {
                let arrived_ns = 1_000_000_000 + frame * PERIOD_NS;
                let device_ns = (arrived_ns as f64 * rate) as u64;
                worst = worst.max(clock.local_ns(device_ns, arrived_ns).abs_diff(arrived_ns));
            }
            assert!(worst < 10_000, "{worst} ns");
        }
    }

    #[test]
    fn the_offset_is_measured_anew_after_the_clock_was_set() {
        let mut clock = DeviceClock::default();
        clock.local_ns(9_000_000_000, 50_000_000_000);
        assert_eq!(clock.local_ns(5, 50_012_500_000), 50_012_500_000, "the device was restarted");
        assert_eq!(clock.local_ns(7_000_000_000, 50_025_000_000), 50_025_000_000, "set forward");
        assert_eq!(clock.local_ns(0, 123), 123, "no clock at all");
    }

    #[test]
    fn setting_the_wall_clock_ages_no_stamp() {
        let (mut clock, wall_ns) = (WallClock::default(), 1_700_000_000_000_000_000);
        assert_eq!(clock.age_ns(wall_ns - 70_000, wall_ns, 5_000_000_000), 0, "not known yet");
        let next_ns = wall_ns + PERIOD_NS;
        assert_eq!(clock.age_ns(next_ns - 70_000, next_ns, 5_000_000_000 + PERIOD_NS), 70_000);
        for set_ns in [next_ns + 150_000_000, next_ns - 3_600_000_000_000] {
            let age_ns = clock.age_ns(next_ns - 70_000, set_ns, 5_000_000_000 + 2 * PERIOD_NS);
            assert_eq!(age_ns, 0);
            let age_ns = clock.age_ns(set_ns, set_ns + 90_000, 5_000_090_000 + 2 * PERIOD_NS);
            assert_eq!(age_ns, 90_000, "and is believed again");
        }
        clock.age_ns(0, u64::MAX, 0);
        clock.age_ns(u64::MAX, 0, u64::MAX);
    }

    proptest! {
        #[test]
        fn any_device_times_are_survived(times in prop::collection::vec((any::<u64>(), any::<u64>()), 1..50)) {
            let mut clock = DeviceClock::default();
            for (device_ns, arrived_ns) in times {
                clock.local_ns(device_ns, arrived_ns);
            }
        }
    }
}
