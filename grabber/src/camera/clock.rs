//! A camera's own clock, and the wall clock, seen from this machine's monotonic one.

/// Translates times of a device's clock into times of this machine's monotonic clock.
///
/// A frame's data arrive some time after it was taken: at least the time the transfer takes, and
/// sometimes much more. The device's own time does not have that jitter, but counts from another
/// moment and a little faster or slower. So the shortest time ever seen between the two is taken for
/// the difference of the clocks, and is let grow as fast as clocks can drift apart.
#[derive(Debug, Clone, Default)]
pub struct DeviceClock {
    /// This clock minus the device's, and when it was looked at last, on the device's clock.
    offset: Option<(i64, u64)>,
}

/// Clocks drift apart by less than 100 µs in a second.
const DRIFT_PER_S: f64 = 100e-6;
/// So late no frame is; the device's clock was set.
const JUMP_NS: i64 = 200_000_000;

impl DeviceClock {
    /// The time on this machine's clock at which the device's showed `device_ns`, plus the shortest
    /// time of transfer. `arrived_ns` is when the frame began to arrive. A device without a clock
    /// (`device_ns` is 0) leaves the arrival.
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

/// Tells how old a stamp of the wall clock is, which libraries give, while that clock may be set at any
/// moment.
#[derive(Debug, Clone, Default)]
pub struct WallClock {
    /// The wall clock minus the monotonic one, when it was looked at last.
    offset_ns: Option<i64>,
}

/// What the two clocks may part in the time between two frames. Slewed, the wall clock changes by at most
/// half a microsecond in a millisecond.
const STEP_NS: u64 = 1_000_000;

impl WallClock {
    /// The age of a stamp that was made since the last call, given what both clocks say now; 0 if the
    /// wall clock was set since.
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
    fn late_arrivals_do_not_matter() {
        let mut clock = DeviceClock::default();
        for frame in 0..200 {
            let device_ns = 77_000 + frame * PERIOD_NS;
            let late_ns = frame * 7919 % 5_000_000;
            let arrived_ns = 5_000_000_000_000 + device_ns + late_ns;
            let error = clock.local_ns(device_ns, arrived_ns) - (5_000_000_000_000 + device_ns);
            // Until a frame comes early again, 100 µs in a second are granted to drift.
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
    fn a_clock_that_was_set_is_believed_again() {
        let mut clock = DeviceClock::default();
        clock.local_ns(9_000_000_000, 50_000_000_000);
        assert_eq!(clock.local_ns(5, 50_012_500_000), 50_012_500_000, "the device was restarted");
        assert_eq!(clock.local_ns(7_000_000_000, 50_025_000_000), 50_025_000_000, "set forward");
        assert_eq!(clock.local_ns(0, 123), 123, "no clock at all");
    }

    #[test]
    fn a_wall_clock_that_is_set_makes_nothing_old() {
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
        fn nothing_a_device_says_does_harm(times in prop::collection::vec((any::<u64>(), any::<u64>()), 1..50)) {
            let mut clock = DeviceClock::default();
            for (device_ns, arrived_ns) in times {
                clock.local_ns(device_ns, arrived_ns);
            }
        }
    }
}
