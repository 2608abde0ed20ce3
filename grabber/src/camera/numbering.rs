//! Frame numbers for cameras that count by themselves.

use super::LastFrame;

/// Makes of a device's own numbers those of the group, which rise without end, whatever happens to
/// the device.
///
/// While a device streams, its gaps are kept. After an interruption the gap follows from the time
/// that has passed, so that in the end each number stands for one frame period.
#[derive(Debug, Clone)]
pub struct Numbering {
    period_ns: f64,
    last: Option<LastFrame>,
    device_seq: Option<u64>,
}

/// A number, and what it says about the time before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Numbered {
    /// The frame's number.
    pub seq: u64,
    /// Frames that the running device has captured since the last one, but that have not come.
    pub lost: u64,
}

/// A device may lose so many frames more in a row than there was time for; then its numbers are
/// rubbish.
const MARGIN: f64 = 100.0;

impl Numbering {
    /// Numbers from 0, or after a predecessor's last frame, at about so many frames a second.
    pub fn new(fps: f64, last: Option<LastFrame>) -> Self {
        Self { period_ns: 1e9 / fps, last, device_seq: None }
    }

    /// The device has been started anew: its numbers mean nothing compared with those before.
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
                    // A duplicate number, or one from the past, is a device that was reset.
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
        // A device that starts to count again without a word.
        assert_eq!(numbering.number(0, 301 * PERIOD_NS), Numbered { seq: 301, lost: 0 });
        // A number no device can have reached.
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
        fn numbers_rise_whatever_a_device_says(
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
