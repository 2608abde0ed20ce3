//! Counting frames end to end: which were captured, and which of them arrived.

use super::report::Frames;
use std::collections::BTreeSet;

/// Follows frame numbers from capture to `world`.
#[derive(Debug, Default)]
pub struct Flow {
    first: Option<u64>,
    last: Option<u64>,
    captured: u64,
    world: u64,
    last_world: Option<u64>,
    duplicates: u64,
    /// Captured and not yet in `world`.
    pending: BTreeSet<u64>,
    /// In `world` before this monitor saw them captured: the two topics are read one after the
    /// other. Or captured before its time, when it begins beside a running group: then they do not
    /// count.
    early: BTreeSet<u64>,
    missing: u64,
}

/// Frames in flight are not missing yet. More than the deepest buffer on the way.
const IN_FLIGHT: usize = 256;

impl Flow {
    /// A frame was captured. An old number is a frame that some other program has published again;
    /// the stages drop it, and so does the count.
    pub fn captured(&mut self, seq: u64) {
        if self.last >= Some(seq) {
            return;
        }
        self.first.get_or_insert(seq);
        self.last = self.last.max(Some(seq));
        self.captured += 1;
        if self.early.remove(&seq) {
            self.world += 1;
        } else {
            self.pending.insert(seq);
        }
        if self.pending.len() > IN_FLIGHT {
            self.pending.pop_first();
            self.missing += 1;
        }
    }

    /// A frame's world was published.
    pub fn arrived(&mut self, seq: u64) {
        if self.last_world >= Some(seq) {
            self.duplicates += 1;
            return;
        }
        self.last_world = Some(seq);
        if self.pending.remove(&seq) {
            self.world += 1;
        } else {
            self.early.insert(seq);
            if self.early.len() > IN_FLIGHT {
                self.early.pop_first();
            }
        }
    }

    /// The counts so far; `complete` when nothing can be in flight any more.
    pub fn frames(&self, dropped_by_grabber: u64, complete: bool) -> Frames {
        // What came to `world` after a frame can only have overtaken it if that frame is lost.
        let overtaken = self.pending.iter().filter(|&&seq| Some(seq) < self.last_world).count();
        let lost = if complete { self.pending.len() } else { overtaken };
        let span = match (self.first, self.last) {
            (Some(first), Some(last)) => last - first + 1,
            _ => 0,
        };
        Frames {
            captured: self.captured,
            dropped_by_grabber,
            never_captured: span - self.captured.min(span),
            world: self.world,
            missing_in_world: self.missing + lost as u64,
            duplicates_in_world: self.duplicates,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_losses_and_duplicates_are_told_apart() {
        let mut flow = Flow::default();
        for seq in [0, 1, 2, 3, 6, 7] {
            flow.captured(seq);
        }
        for seq in [0, 1, 3, 3, 2, 6] {
            flow.arrived(seq);
        }
        let running = flow.frames(0, false);
        assert_eq!((running.captured, running.never_captured, running.world), (6, 2, 4));
        // 2 came after 3: out of order, so it counts as duplicate and as missing.
        assert_eq!((running.missing_in_world, running.duplicates_in_world), (1, 2));
        assert_eq!(flow.frames(0, true).missing_in_world, 2, "7 never arrived");
    }

    #[test]
    fn a_world_seen_before_its_frame_is_not_missing() {
        let mut flow = Flow::default();
        flow.arrived(5);
        flow.captured(5);
        let frames = flow.frames(0, true);
        assert_eq!((frames.world, frames.missing_in_world), (1, 0));
    }

    #[test]
    fn frames_captured_before_the_monitors_time_do_not_count() {
        let mut flow = Flow::default();
        for seq in [1, 2, 3, 4] {
            flow.arrived(seq);
        }
        flow.captured(4);
        flow.captured(5);
        flow.arrived(5);
        let frames = flow.frames(0, true);
        assert_eq!((frames.captured, frames.world, frames.missing_in_world), (2, 2, 0));
    }

    #[test]
    fn a_frame_published_again_counts_once() {
        let mut flow = Flow::default();
        for seq in [0, 1, 0] {
            flow.captured(seq);
        }
        flow.arrived(0);
        flow.arrived(1);
        let frames = flow.frames(0, true);
        assert_eq!((frames.captured, frames.missing_in_world), (2, 0));
    }

    #[test]
    fn a_long_outage_is_counted_without_growing() {
        let mut flow = Flow::default();
        for seq in 0..10_000 {
            flow.captured(seq);
        }
        assert_eq!(flow.frames(0, true).missing_in_world, 10_000);
        assert!(flow.pending.len() <= IN_FLIGHT);
    }
}
