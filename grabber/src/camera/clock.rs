//! A camera's own clock, seen from this machine's.

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
