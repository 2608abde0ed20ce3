//! Frame numbers for cameras that count by themselves.

use super::LastFrame;

/// Converts a device's own numbers to those of the group, which always rise.
///
/// Within a session the number grows by the difference of the device's numbers, so its gaps are preserved. If
/// that difference is impossible (not positive, or far more frames than the elapsed time allows) or the
/// device was restarted, it grows by `max(1, round(elapsed / period))` instead. So in the long run each
/// number stands for one frame period.
#[derive(Debug, Clone)]
pub struct Numbering {
    period_ns: f64,
    last: Option<LastFrame>,
    device_seq: Option<u64>,
}

/// A number, and the frames lost before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Numbered {
    /// The frame's number.
    pub seq: u64,
    /// Frames that the running device has captured since the last one and that did not arrive.
    pub lost: u64,
}

/// Number of frames beyond those the elapsed time allows that may be lost in a row; more means invalid
/// numbers.
const MARGIN: f64 = 100.0;

impl Numbering {
    /// Numbers from 0, or after a predecessor's last frame; `fps` is the nominal rate.
    pub fn new(fps: f64, last: Option<LastFrame>) -> Self {
        Self { period_ns: 1e9 / fps, last, device_seq: None }
    }

    /// Must be called when the device was restarted: its numbers no longer continue the old ones.
    pub fn interrupted(&mut self) {
        self.device_seq = None;
    }

    /// Numbers a frame.
    pub fn number(&mut self, device_seq: u64, t_capture_ns: u64) -> Numbered {
        let numbered = match self.last {
            None => Numbered { seq: 0, lost: 0 },
            Some(last) => {
                let elapsed_ns = t_capture_ns.saturating_sub(last.t_capture_ns) as f64;
                let periods = elapsed_ns / self.period_ns;
                let step = self.device_seq.and_then(|before| device_seq.checked_sub(before));
                match step {
                    // A repeated number, or a lower one, means that the device was reset.
                    Some(step) if step > 0 && (step as f64) < 4.0 * periods + MARGIN => {
                        Numbered { seq: last.seq + step, lost: step - 1 }
                    }
                    _ => Numbered { seq: last.seq + (periods.round() as u64).max(1), lost: 0 },
                }
            }
        };
        self.last = Some(LastFrame { seq: numbered.seq, t_capture_ns });
        self.device_seq = Some(device_seq);
        numbered
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERIOD_NS: u64 = 10_000_000;

    fn numbering() -> Numbering {
        Numbering::new(100.0, None)
    }

    #[test]
    fn gaps_of_the_device_are_kept_and_counted() {
        let mut numbering = numbering();
        assert_eq!(numbering.number(7, 0), Numbered { seq: 0, lost: 0 });
        assert_eq!(numbering.number(8, PERIOD_NS), Numbered { seq: 1, lost: 0 });
        assert_eq!(numbering.number(12, 5 * PERIOD_NS), Numbered { seq: 5, lost: 3 });
    }

    #[test]
    fn after_an_interruption_numbers_follow_from_time() {
        let mut numbering = numbering();
        numbering.number(500, 0);
        numbering.interrupted();
        assert_eq!(numbering.number(0, 300 * PERIOD_NS), Numbered { seq: 300, lost: 0 });
        // A device that starts counting anew without notice.
        assert_eq!(numbering.number(0, 301 * PERIOD_NS), Numbered { seq: 301, lost: 0 });
        // A number that no device can have reached.
        assert_eq!(numbering.number(1 << 40, 302 * PERIOD_NS), Numbered { seq: 302, lost: 0 });
    }

    #[test]
    fn a_predecessors_numbers_are_continued() {
        let last = LastFrame { seq: 1000, t_capture_ns: 5 * PERIOD_NS };
        let mut numbering = Numbering::new(100.0, Some(last));
        assert_eq!(numbering.number(3, 15 * PERIOD_NS).seq, 1010);
    }

    proptest! {
        #[test]
        fn numbers_rise_for_any_device(
            frames in prop::collection::vec((any::<u64>(), any::<u32>(), any::<bool>()), 1..100),
        ) {
            let mut numbering = numbering();
            let mut last = None;
            for (device_seq, t_capture_ns, interrupted) in frames {
                if interrupted {
                    numbering.interrupted();
                }
                let Numbered { seq, lost } = numbering.number(device_seq, t_capture_ns.into());
                prop_assert!(last.is_none_or(|last| seq > last + lost));
                last = Some(seq);
            }
        }
    }
}
