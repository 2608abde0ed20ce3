//! Independent counts: which frames were captured, and which of them came to `world`, in which order and
//! when.

use std::collections::{BTreeMap, BTreeSet};

/// A `world` message as the observer received it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Arrival {
    seen_ns: u64,
    t_capture_ns: u64,
}

/// A captured frame that did not come to `world`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Missing {
    /// Its number.
    pub seq: u64,
    /// When it was captured.
    pub t_capture_ns: u64,
}

/// Frame numbers that were never captured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Gap {
    /// How many.
    pub frames: u64,
    /// Capture time of the frame after them.
    pub until_ns: u64,
}

/// How long a disturbance was felt, in nanoseconds; `None` if it still is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Outage {
    /// Time to the next `world`, of any frame.
    pub next_world_ns: Option<u64>,
    /// Time to the next `world` of a frame captured after the disturbance.
    pub fresh_world_ns: Option<u64>,
}

/// All counts so far.
#[derive(Debug, Default)]
pub struct Tally {
    first: Option<u64>,
    last: Option<u64>,
    captured: u64,
    captured_again: u64,
    gaps: Vec<Gap>,
    /// Captured and not in `world` yet: under way or lost.
    pending: BTreeMap<u64, u64>,
    order: Order,
    arrivals: Vec<Arrival>,
    /// Numbers that the observer may have overlooked because it was too slow.
    overlooked: u64,
    frames_blind: bool,
    world_blind: bool,
}

impl Tally {
    /// Counts a captured frame.
    pub fn captured(&mut self, seq: u64, t_capture_ns: u64) {
        let blind = std::mem::take(&mut self.frames_blind);
        if let Some(last) = self.last {
            if seq <= last {
                self.captured_again += 1;
                return;
            }
            let frames = seq - last - 1;
            if frames > 0 && blind {
                self.overlooked += frames;
            } else if frames > 0 {
                self.gaps.push(Gap { frames, until_ns: t_capture_ns });
            }
        }
        self.first.get_or_insert(seq);
        self.last = Some(seq);
        self.captured += 1;
        self.pending.insert(seq, t_capture_ns);
    }

    /// Counts a `world`. All frames captured before it must have been counted by then.
    pub fn arrived(&mut self, seq: u64, t_capture_ns: u64, seen_ns: u64) {
        // Frames under way when the observer started do not count.
        if self.first.is_none_or(|first| seq < first) {
            return;
        }
        if std::mem::take(&mut self.world_blind)
            && let Some(last) = self.order.last
        {
            let overlooked: Vec<u64> =
                self.pending.range(last + 1..seq.max(last + 1)).map(|(&seq, _)| seq).collect();
            self.overlooked += overlooked.len() as u64;
            for seq in overlooked {
                self.pending.remove(&seq);
            }
            self.order.blind();
        }
        self.order.met(seq);
        self.pending.remove(&seq);
        self.arrivals.push(Arrival { seen_ns, t_capture_ns });
    }

    /// The observer found its buffer of frames full: frames missing before the next one may have been
    /// overwritten before they were read.
    pub fn frames_may_be_overwritten(&mut self) {
        self.frames_blind = true;
    }

    /// The same for `world`.
    pub fn worlds_may_be_overwritten(&mut self) {
        self.world_blind = true;
    }

    /// Frames captured.
    pub fn frames_captured(&self) -> u64 {
        self.captured
    }

    /// Frames whose number had come before.
    pub fn frames_captured_again(&self) -> u64 {
        self.captured_again
    }

    /// Numbers that were not captured.
    pub fn gaps(&self) -> &[Gap] {
        &self.gaps
    }

    /// Numbers that the observer may have overlooked because it was too slow.
    pub fn overlooked(&self) -> u64 {
        self.overlooked
    }

    /// The order of `world`.
    pub fn order(&self) -> &Order {
        &self.order
    }

    /// Frames that are lost: later ones are in `world`, or they were captured before `deadline_ns`.
    pub fn missing(&self, deadline_ns: u64) -> Vec<Missing> {
        self.pending
            .iter()
            .filter(|&(&seq, &t_capture_ns)| {
                Some(seq) < self.order.last || t_capture_ns < deadline_ns
            })
            .map(|(&seq, &t_capture_ns)| Missing { seq, t_capture_ns })
            .collect()
    }

    /// The wait of a reader that starts at that time.
    pub fn outage(&self, from_ns: u64) -> Outage {
        let after = &self.arrivals[self.arrivals.partition_point(|a| a.seen_ns <= from_ns)..];
        let waited = |arrival: &Arrival| arrival.seen_ns - from_ns;
        Outage {
            next_world_ns: after.first().map(waited),
            fresh_world_ns: after.iter().find(|a| a.t_capture_ns > from_ns).map(waited),
        }
    }

    /// Intervals between `world` messages, from `from_ns` on, in nanoseconds.
    pub fn intervals_ns(&self, from_ns: u64) -> impl Iterator<Item = u64> {
        let from = self.arrivals.partition_point(|arrival| arrival.seen_ns < from_ns);
        self.arrivals[from..].windows(2).map(|pair| pair[1].seen_ns - pair[0].seen_ns)
    }
}

/// Checks that numbers come once each, and in rising order.
#[derive(Debug, Default)]
pub struct Order {
    last: Option<u64>,
    /// Numbers skipped so far.
    skipped: BTreeSet<u64>,
    received: u64,
    duplicates: Vec<u64>,
    out_of_order: Vec<u64>,
    blind: bool,
}

/// Longer jumps are rubbish or a new match; their numbers are not recorded.
const LONGEST_JUMP: u64 = 100_000;

impl Order {
    /// Counts a number.
    pub fn met(&mut self, seq: u64) {
        self.received += 1;
        let blind = std::mem::take(&mut self.blind);
        match self.last {
            Some(last) if seq <= last => {
                if self.skipped.remove(&seq) {
                    self.out_of_order.push(seq);
                } else {
                    self.duplicates.push(seq);
                }
                return;
            }
            Some(last) if !blind && seq - last <= LONGEST_JUMP => {
                self.skipped.extend(last + 1..seq);
            }
            _ => {}
        }
        self.last = Some(seq);
    }

    /// Numbers skipped before the next one are not the writer's fault.
    pub fn blind(&mut self) {
        self.blind = true;
    }

    /// Numbers that came.
    pub fn received(&self) -> u64 {
        self.received
    }

    /// Numbers that came again.
    pub fn duplicates(&self) -> &[u64] {
        &self.duplicates
    }

    /// Numbers that came after a higher one.
    pub fn out_of_order(&self) -> &[u64] {
        &self.out_of_order
    }

    /// Numbers between the first and the last that never came.
    pub fn skipped(&self) -> u64 {
        self.skipped.len() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames 10 ns apart, captured at 10 · seq.
    fn with(captured: &[u64], arrived: &[u64]) -> Tally {
        let mut tally = Tally::default();
        for &seq in captured {
            tally.captured(seq, 10 * seq);
        }
        for (index, &seq) in arrived.iter().enumerate() {
            tally.arrived(seq, 10 * seq, 1000 + 10 * index as u64);
        }
        tally
    }

    fn missing(tally: &Tally, deadline_ns: u64) -> Vec<u64> {
        tally.missing(deadline_ns).iter().map(|missing| missing.seq).collect()
    }

    #[test]
    fn an_overtaken_frame_is_missing_and_one_under_way_is_not() {
        let tally = with(&[1, 2, 3, 4, 5], &[1, 2, 4]);
        assert_eq!(missing(&tally, 0), [3]);
        assert_eq!(missing(&tally, 51), [3, 5], "5 has had its time");
        assert!(tally.order().duplicates().is_empty() && tally.order().out_of_order().is_empty());
    }

    #[test]
    fn duplicates_and_wrong_order_are_distinguished() {
        let tally = with(&[1, 2, 3, 4], &[1, 3, 2, 3, 4, 1]);
        assert_eq!(
            (tally.order().duplicates(), tally.order().out_of_order()),
            (&[3, 1][..], &[2][..])
        );
        assert_eq!(missing(&tally, u64::MAX), [0u64; 0], "2 came late, but it came");
    }

    #[test]
    fn an_uncaptured_number_is_a_gap_and_not_missing() {
        let tally = with(&[1, 2, 6], &[1, 2, 6]);
        assert_eq!(tally.gaps(), [Gap { frames: 3, until_ns: 60 }]);
        assert_eq!(missing(&tally, u64::MAX), [0u64; 0]);
        assert_eq!((tally.frames_captured(), tally.frames_captured_again()), (3, 0));
    }

    #[test]
    fn frames_that_come_again_are_counted_once() {
        let tally = with(&[1, 2, 1], &[1, 2]);
        assert_eq!((tally.frames_captured(), tally.frames_captured_again()), (2, 1));
    }

    #[test]
    fn a_world_from_before_the_first_frame_seen_does_not_count() {
        let tally = with(&[5, 6], &[3, 4, 5, 6]);
        assert_eq!(tally.order().received(), 2);
    }

    #[test]
    fn a_slow_observer_counts_no_losses() {
        let mut tally = with(&[1, 2, 3, 4, 5], &[1]);
        tally.worlds_may_be_overwritten();
        tally.arrived(4, 40, 2000);
        tally.arrived(5, 50, 2010);
        tally.frames_may_be_overwritten();
        tally.captured(9, 90);
        assert_eq!(tally.overlooked(), 2 + 3);
        assert_eq!((missing(&tally, 0), tally.gaps()), (vec![], &[][..]));
        assert_eq!(tally.order().skipped(), 0);
    }

    #[test]
    fn an_outage_ends_with_the_next_world_and_with_the_next_fresh_one() {
        // The `world` messages of frames 1, 2, 3 (captured at 10, 20, 30) come at 1000, 1010, 1020.
        let mut tally = with(&[1, 2, 3], &[1, 2, 3]);
        tally.captured(4, 1015);
        tally.arrived(4, 1015, 1030);
        let outage = tally.outage(1005);
        assert_eq!((outage.next_world_ns, outage.fresh_world_ns), (Some(5), Some(25)));
        let still_out = tally.outage(1030);
        assert_eq!((still_out.next_world_ns, still_out.fresh_world_ns), (None, None));
        assert_eq!(tally.intervals_ns(1010).collect::<Vec<_>>(), [10, 10]);
    }

    #[test]
    fn a_new_match_with_old_numbers_shows_as_duplicates() {
        let tally = with(&[1, 2, 3], &[1, 2, 3, 1, 2]);
        assert_eq!(tally.order().duplicates(), [1, 2]);
    }
}
