//! From the times and numbers of a recording to those of now.

use super::Pace;
use crate::camera::LastFrame;
use common::messages::{FrameHeader, MOST_AGE_NS};

/// A delay of more than this is not made up for: the rest is shown that much later.
const MAX_LAG_NS: u64 = 250_000_000;

/// What frames of a recording are called now, and when they are taken to be captured.
///
/// Frames keep their distances in time, since speeds depend on them. Played as they were recorded, they
/// are captured when they are shown. Where somebody else says when that is, they may come faster, and no
/// frame can be of the future: so they lie in the past, half of what is allowed at first.
#[derive(Debug)]
pub(super) struct Times {
    pace: Pace,
    /// The first frame of this round: number and capture time, as recorded.
    first: Option<(u64, u64)>,
    /// What that frame is called now, and when it was captured.
    base_seq: u64,
    base_ns: Option<u64>,
    /// The last frame shown: number and time, now.
    last: Option<(u64, u64)>,
    period_ns: u64,
    /// Numbers up to here were shown by a predecessor.
    resume_after: Option<LastFrame>,
}

impl Times {
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

    /// Number of a frame, and the time before which it is not to be shown, which is that of its
    /// capture; `None` if it was shown by a predecessor, or cannot be told from one shown already.
    pub fn due(&mut self, header: &FrameHeader, now_ns: u64) -> Option<(u64, u64)> {
        let (first_seq, first_ns) = *self.first.get_or_insert((header.seq, header.t_capture_ns));
        let seq = self.base_seq.checked_add(header.seq.checked_sub(first_seq)?)?;
        let offset_ns = header.t_capture_ns.checked_sub(first_ns)?;
        if let Some(resume) = self.resume_after.filter(|resume| seq <= resume.seq) {
            if seq == resume.seq && self.pace != Pace::Recorded {
                self.base_ns = resume.t_capture_ns.checked_sub(offset_ns);
            }
            return None;
        }
        if self.last.is_some_and(|(last, _)| seq <= last) {
            return None;
        }
        let (shown_ns, most_lag_ns) = match self.pace {
            Pace::Recorded => (now_ns, MAX_LAG_NS),
            // On a machine that was just started there is not so much of a past.
            Pace::Group | Pace::Steps => {
                (now_ns - (MOST_AGE_NS / 2).min(now_ns / 2), MOST_AGE_NS / 4)
            }
        };
        let base_ns = self.base_ns.get_or_insert(shown_ns.saturating_sub(offset_ns));
        let captured_ns = base_ns.checked_add(offset_ns)?;
        if shown_ns > captured_ns.saturating_add(most_lag_ns) {
            *base_ns = shown_ns.saturating_sub(offset_ns);
        }
        Some((seq, *base_ns + offset_ns))
    }

    /// A frame was shown.
    pub fn shown(&mut self, seq: u64, t_ns: u64) {
        self.last = Some((seq, t_ns));
    }

    /// Whether any frame was found.
    pub fn have_begun(&self) -> bool {
        self.first.is_some()
    }

    /// The next frame is the first one again.
    pub fn begin_anew(&mut self) {
        let last = self
            .last
            .map(|(seq, t_ns)| (seq.saturating_add(1), t_ns.saturating_add(self.period_ns)));
        self.first = None;
        self.base_seq = last.map_or(0, |(seq, _)| seq);
        self.base_ns = last.map(|(_, t_ns)| t_ns);
    }

    /// A stamp of the recording, now.
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

    #[test]
    fn distances_and_gaps_are_kept() {
        let mut times = Times::new(Pace::Recorded, 100.0, None);
        let mut show = |seq, t_ms, now_ms: u64| {
            let (seq, t_ns) = times.due(&frame(seq, t_ms), now_ms * MS)?;
            times.shown(seq, t_ns);
            Some((seq, t_ns / MS))
        };
        assert_eq!(show(70, 5000, 900), Some((0, 900)));
        assert_eq!(show(71, 5010, 901), Some((1, 910)));
        assert_eq!(show(71, 5010, 902), None, "a repetition");
        assert_eq!(show(75, 5050, 960), Some((5, 950)), "a little late is made up for");
        assert_eq!(show(76, 5060, 2000), Some((6, 2000)), "long stops are not");
        assert_eq!(show(77, 5070, 2001), Some((7, 2010)));
        assert_eq!(times.moved(5080 * MS), 2020 * MS);
        times.begin_anew();
        assert_eq!(times.due(&frame(70, 5000), 2011 * MS), Some((8, 2020 * MS)));
    }

    #[test]
    fn a_successor_goes_on_behind_its_predecessor() {
        let last = Some(LastFrame { seq: 1, t_capture_ns: 400 * MS });
        let mut times = Times::new(Pace::Recorded, 100.0, last);
        assert_eq!(times.due(&frame(70, 5000), 900 * MS), None);
        assert_eq!(times.due(&frame(71, 5010), 900 * MS), None);
        assert_eq!(times.due(&frame(72, 5020), 900 * MS), Some((2, 900 * MS)));
        let mut times = Times::new(Pace::Group, 100.0, last);
        assert_eq!(times.due(&frame(70, 5000), 900 * MS), None);
        assert_eq!(times.due(&frame(71, 5010), 900 * MS), None);
        assert_eq!(times.due(&frame(72, 5020), 900 * MS), Some((2, 410 * MS)), "no jump in time");
    }

    #[test]
    fn what_others_pace_lies_in_the_past_and_never_too_far() {
        let (half_ms, start_ms) = (MOST_AGE_NS / 2 / MS, 10 * MOST_AGE_NS / MS);
        for pace in [Pace::Group, Pace::Steps] {
            let mut times = Times::new(pace, 100.0, None);
            let mut show = |seq, t_ms, now_ms: u64| {
                let (seq, t_ns) = times.due(&frame(seq, t_ms), now_ms * MS).unwrap();
                times.shown(seq, t_ns);
                t_ns / MS
            };
            let first = show(0, 500, start_ms);
            assert_eq!(first, start_ms - half_ms);
            assert_eq!(show(1, 510, start_ms + 1), first + 10, "ten times as fast");
            assert_eq!(show(2, 520, start_ms + 60_000), first + 20, "after a minute's thought");
            // A person who came back an hour later.
            let late_ms = start_ms + 2 * half_ms;
            assert_eq!(show(3, 530, late_ms), late_ms - half_ms);
            // Faster than time itself for so long that the recording has caught up.
            assert_eq!(show(4, 530 + half_ms + 70, late_ms), late_ms + 70, "to be waited for");
        }
        let mut times = Times::new(Pace::Group, 100.0, None);
        assert_eq!(
            times.due(&frame(0, 500), 5 * MS),
            Some((0, 5 * MS / 2)),
            "a machine just started"
        );
    }

    #[test]
    fn rubbish_times_and_numbers_do_no_harm() {
        let extremes = [0, 1, u64::MAX / 2, u64::MAX - 1, u64::MAX];
        for pace in [Pace::Recorded, Pace::Group] {
            for last in [None, Some(LastFrame { seq: u64::MAX, t_capture_ns: u64::MAX })] {
                let mut times = Times::new(pace, 100.0, last);
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
