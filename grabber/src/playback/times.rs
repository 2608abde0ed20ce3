//! Conversion of a recording's times and numbers to the present.

use super::Pace;
use crate::camera::LastFrame;
use messages::{FrameHeader, MAX_AGE_NS};

/// Maximum delay that is caught up; after a longer one, all further frames are shifted.
const MAX_LAG_NS: u64 = 250_000_000;
/// Maximum speed relative to the recording, so that programs that read along, and poll only ten times a
/// second, have read the frames before they are overwritten.
const MAX_SPEED: u64 = 8;

/// A frame's number and times.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ScheduledFrame {
    /// Its number now.
    pub seq: u64,
    /// Its capture time now.
    pub t_capture_ns: u64,
    /// Time at which it is to be shown.
    pub show_ns: u64,
}

/// Maps numbers and capture times of a recording to the present.
///
/// Capture times are shifted by a constant, `t = base + (t_recorded − t_first)`, since speeds depend on their
/// distances. With recorded pacing a frame is shown at its capture time. With another pacing frames may be
/// shown faster, and since no frame may lie in the future, capture times begin in the past, half of the
/// permitted age ago. If a capture time falls behind by more than the permitted lag, the base moves.
#[derive(Debug)]
pub(super) struct TimeMap {
    pace: Pace,
    /// Number and capture time, as recorded, of the first frame of this round.
    first: Option<(u64, u64)>,
    /// Number and capture time now of that frame.
    base_seq: u64,
    base_ns: Option<u64>,
    /// The last frame shown, and the actual time.
    last: Option<(ScheduledFrame, u64)>,
    period_ns: u64,
    /// Frames up to here were shown by a predecessor.
    resume_after: Option<LastFrame>,
}

impl TimeMap {
    pub fn new(pace: Pace, fps: f64, last: Option<LastFrame>) -> Self {
        Self {
            pace,
            first: None,
            base_seq: 0,
            base_ns: None,
            last: None,
            period_ns: (1e9 / fps) as u64,
            resume_after: last,
        }
    }

    /// Number and times of a frame; `None` if it was shown by a predecessor, or if its number does not rise.
    pub fn due(&mut self, header: &FrameHeader, now_ns: u64) -> Option<ScheduledFrame> {
        let (first_seq, first_ns) = *self.first.get_or_insert((header.seq, header.t_capture_ns));
        let seq = self.base_seq.checked_add(header.seq.checked_sub(first_seq)?)?;
        let offset_ns = header.t_capture_ns.checked_sub(first_ns)?;
        if let Some(resume) = self.resume_after.filter(|resume| seq <= resume.seq) {
            if seq == resume.seq && self.pace != Pace::Recorded {
                self.base_ns = resume.t_capture_ns.checked_sub(offset_ns);
            }
            return None;
        }
        if self.last.is_some_and(|(last, _)| seq <= last.seq) {
            return None;
        }
        let (shown_ns, most_lag_ns) = match self.pace {
            Pace::Recorded => (now_ns, MAX_LAG_NS),
            // The monotonic clock of a machine that has just started does not reach back far.
            Pace::Group | Pace::Steps => {
                (now_ns - (MAX_AGE_NS / 2).min(now_ns / 2), MAX_AGE_NS / 4)
            }
        };
        let base_ns = self.base_ns.get_or_insert(shown_ns.saturating_sub(offset_ns));
        let captured_ns = base_ns.checked_add(offset_ns)?;
        if shown_ns > captured_ns.saturating_add(most_lag_ns) {
            *base_ns = shown_ns.saturating_sub(offset_ns);
        }
        let t_capture_ns = *base_ns + offset_ns;
        let soonest_ns = match (self.pace, self.last) {
            (Pace::Group | Pace::Steps, Some((last, shown_ns))) => {
                let distance_ns = t_capture_ns.saturating_sub(last.t_capture_ns).min(MAX_LAG_NS);
                shown_ns.saturating_add(distance_ns / MAX_SPEED)
            }
            _ => 0,
        };
        Some(ScheduledFrame { seq, t_capture_ns, show_ns: t_capture_ns.max(soonest_ns) })
    }

    /// Records that a frame was shown.
    pub fn shown(&mut self, due: ScheduledFrame, now_ns: u64) {
        self.last = Some((due, now_ns));
    }

    /// Whether any frame was found.
    pub fn has_begun(&self) -> bool {
        self.first.is_some()
    }

    /// Starts the next round: the next frame is the first one again.
    pub fn restart(&mut self) {
        let last = self.last.map(|(last, _)| {
            (last.seq.saturating_add(1), last.t_capture_ns.saturating_add(self.period_ns))
        });
        self.first = None;
        self.base_seq = last.map_or(0, |(seq, _)| seq);
        self.base_ns = last.map(|(_, t_ns)| t_ns);
    }

    /// A time stamp of the recording, shifted to the present.
    pub fn moved(&self, t_ns: u64) -> u64 {
        match (self.first, self.base_ns) {
            (Some((_, first_ns)), Some(base_ns)) => {
                t_ns.saturating_add(base_ns).saturating_sub(first_ns)
            }
            _ => t_ns,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn frame(seq: u64, t_ms: u64) -> FrameHeader {
        FrameHeader { seq, t_capture_ns: t_ms * MS, ..Default::default() }
    }

    /// Shows a frame as soon as permitted; returns its number, capture time, and time of showing.
    fn show(times: &mut TimeMap, frame: &FrameHeader, now_ms: u64) -> Option<[u64; 3]> {
        let due = times.due(frame, now_ms * MS)?;
        let now_ns = due.show_ns.max(now_ms * MS);
        times.shown(due, now_ns);
        Some([due.seq, due.t_capture_ns / MS, now_ns / MS])
    }

    #[test]
    fn distances_and_gaps_are_kept() {
        let mut times = TimeMap::new(Pace::Recorded, 100.0, None);
        let mut show = |seq, t_ms, now_ms| {
            show(&mut times, &frame(seq, t_ms), now_ms).map(|[seq, t_ms, _]| (seq, t_ms))
        };
        assert_eq!(show(70, 5000, 900), Some((0, 900)));
        assert_eq!(show(71, 5010, 901), Some((1, 910)));
        assert_eq!(show(71, 5010, 902), None, "a repetition");
        assert_eq!(show(75, 5050, 960), Some((5, 950)), "a little late is made up for");
        assert_eq!(show(76, 5060, 2000), Some((6, 2000)), "long stops are not");
        assert_eq!(show(77, 5070, 2001), Some((7, 2010)));
        assert_eq!(times.moved(5080 * MS), 2020 * MS);
        times.restart();
        let due = times.due(&frame(70, 5000), 2011 * MS);
        assert_eq!(due.map(|due| (due.seq, due.t_capture_ns)), Some((8, 2020 * MS)));
    }

    #[test]
    fn a_successor_continues_after_its_predecessor() {
        let last = Some(LastFrame { seq: 1, t_capture_ns: 400 * MS });
        // With another pacing than the recorded one, capture times do not jump.
        for (pace, t_ms) in [(Pace::Recorded, 900), (Pace::Group, 410)] {
            let mut times = TimeMap::new(pace, 100.0, last);
            assert_eq!(times.due(&frame(70, 5000), 900 * MS), None);
            assert_eq!(times.due(&frame(71, 5010), 900 * MS), None);
            assert_eq!(show(&mut times, &frame(72, 5020), 900), Some([2, t_ms, 900]));
        }
    }

    #[test]
    fn capture_times_of_paced_frames_lie_in_the_recent_past() {
        let (half_ms, start_ms) = (MAX_AGE_NS / 2 / MS, 10 * MAX_AGE_NS / MS);
        for pace in [Pace::Group, Pace::Steps] {
            let mut times = TimeMap::new(pace, 100.0, None);
            let mut show = |seq, t_ms, now_ms| {
                let [_, t_ms, shown_ms] = show(&mut times, &frame(seq, t_ms), now_ms).unwrap();
                (t_ms, shown_ms)
            };
            let first = start_ms - half_ms;
            assert_eq!(show(0, 500, start_ms), (first, start_ms));
            assert_eq!(
                show(1, 580, start_ms + 1),
                (first + 80, start_ms + 10),
                "eight times as fast"
            );
            let later_ms = start_ms + 60_000;
            assert_eq!(show(2, 660, later_ms), (first + 160, later_ms), "after a minute's thought");
            // A person who came back an hour later.
            let late_ms = start_ms + 2 * half_ms;
            assert_eq!(show(3, 670, late_ms), (late_ms - half_ms, late_ms));
            // Played faster than recorded until the capture time reaches the present.
            let caught_up_ms = late_ms + 70;
            assert_eq!(show(4, 670 + half_ms + 70, late_ms), (caught_up_ms, caught_up_ms));
        }
        let mut times = TimeMap::new(Pace::Group, 100.0, None);
        let due = times.due(&frame(0, 500), 6 * MS).unwrap();
        assert_eq!(due.t_capture_ns, 3 * MS, "a machine just started");
    }

    #[test]
    fn invalid_times_and_numbers_are_survived() {
        let extremes = [0, 1, u64::MAX / 2, u64::MAX - 1, u64::MAX];
        for pace in [Pace::Recorded, Pace::Group] {
            for last in [None, Some(LastFrame { seq: u64::MAX, t_capture_ns: u64::MAX })] {
                let mut times = TimeMap::new(pace, 100.0, last);
                for (seq, t_capture_ns) in
                    extremes.iter().flat_map(|&a| extremes.map(move |b| (a, b)))
                {
                    let header = FrameHeader { seq, t_capture_ns, ..Default::default() };
                    times.due(&header, 1_000 * MS);
                    times.moved(t_capture_ns);
                }
            }
        }
    }
}
