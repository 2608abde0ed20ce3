//! Counts frames end to end: captured, and arrived in `world`.

use control::report::Frames;
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
    /// In `world` but not yet seen as captured: the two topics are read one after the other. Frames
    /// captured before a monitor that started beside a running group are here too; they do not
    /// count.
    early: BTreeSet<u64>,
    missing: u64,
    /// Numbers that this monitor missed while it was away.
    not_seen: u64,
    /// Captured frames whose `world` it may have missed.
    not_seen_in_world: u64,
}

/// Whether earlier messages may have been overwritten before the monitor read them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sight {
    /// It has seen every message.
    Whole,
    /// It was away or not connected, and may have missed messages.
    Broken,
}

/// Most frames in flight, which are not missing yet: more than the deepest buffer on the way.
const IN_FLIGHT: usize = 256;

impl Flow {
    /// Counts a captured frame. An old number is a frame published again by a foreign program; the
    /// stages drop it, and it is not counted.
    pub fn captured(&mut self, seq: u64, sight: Sight) {
        if self.last >= Some(seq) {
            return;
        }
        if let (Some(last), Sight::Broken) = (self.last, sight) {
            self.not_seen += seq - last - 1;
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

    /// Counts a published `world`.
    pub fn arrived(&mut self, seq: u64, sight: Sight) {
        if self.last_world >= Some(seq) {
            self.duplicates += 1;
            return;
        }
        self.last_world = Some(seq);
        if sight == Sight::Broken {
            let later = self.pending.split_off(&seq);
            self.not_seen_in_world += std::mem::replace(&mut self.pending, later).len() as u64;
        }
        if self.pending.remove(&seq) {
            self.world += 1;
        } else {
            self.early.insert(seq);
            if self.early.len() > IN_FLIGHT {
                self.early.pop_first();
            }
        }
    }

    /// The counts so far; `complete` when no frame is in flight any more.
    pub fn frames(&self, dropped_by_grabber: u64, complete: bool) -> Frames {
        // `world`s are in order, so a frame older than the last one is lost.
        let overtaken = self.pending.iter().filter(|&&seq| Some(seq) < self.last_world).count();
        let lost = if complete { self.pending.len() } else { overtaken };
        let span = match (self.first, self.last) {
            (Some(first), Some(last)) => last - first + 1,
            _ => 0,
        };
        Frames {
            captured: self.captured,
            dropped_by_grabber,
            never_captured: span.saturating_sub(self.captured + self.not_seen),
            not_seen: self.not_seen,
            not_seen_in_world: self.not_seen_in_world,
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
            flow.captured(seq, Sight::Whole);
        }
        for seq in [0, 1, 3, 3, 2, 6] {
            flow.arrived(seq, Sight::Whole);
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
        flow.arrived(5, Sight::Whole);
        flow.captured(5, Sight::Whole);
        let frames = flow.frames(0, true);
        assert_eq!((frames.world, frames.missing_in_world), (1, 0));
    }

    #[test]
    fn frames_captured_before_the_monitor_started_do_not_count() {
        let mut flow = Flow::default();
        for seq in [1, 2, 3, 4] {
            flow.arrived(seq, Sight::Whole);
        }
        flow.captured(4, Sight::Whole);
        flow.captured(5, Sight::Whole);
        flow.arrived(5, Sight::Whole);
        let frames = flow.frames(0, true);
        assert_eq!((frames.captured, frames.world, frames.missing_in_world), (2, 2, 0));
    }

    #[test]
    fn a_frame_published_again_counts_once() {
        let mut flow = Flow::default();
        for seq in [0, 1, 0] {
            flow.captured(seq, Sight::Whole);
        }
        flow.arrived(0, Sight::Whole);
        flow.arrived(1, Sight::Whole);
        let frames = flow.frames(0, true);
        assert_eq!((frames.captured, frames.missing_in_world), (2, 0));
    }

    #[test]
    fn unseen_frames_do_not_count_as_lost() {
        let mut flow = Flow::default();
        for seq in 0..100 {
            flow.captured(seq, Sight::Whole);
        }
        for seq in 0..97 {
            flow.arrived(seq, Sight::Whole);
        }
        // Missed 200 frames; the last 64 of each topic are still there, of `world` one frame
        // behind.
        for seq in 236..300 {
            flow.captured(seq, Sight::Broken);
        }
        for seq in 235..299 {
            flow.arrived(seq, Sight::Broken);
        }
        let frames = flow.frames(0, false);
        assert_eq!((frames.captured, frames.not_seen), (164, 136));
        assert_eq!((frames.never_captured, frames.missing_in_world), (0, 0));
        assert_eq!((frames.world, frames.not_seen_in_world), (97 + 63, 3));
        assert_eq!(frames.duplicates_in_world, 0);
        // A gap that the monitor has watched does count.
        flow.captured(310, Sight::Whole);
        assert_eq!(flow.frames(0, false).never_captured, 10);
        let frames = flow.frames(0, true);
        assert_eq!(
            frames.captured,
            frames.world + frames.not_seen_in_world + frames.missing_in_world
        );
    }

    #[test]
    fn a_long_outage_is_counted_without_growing() {
        let mut flow = Flow::default();
        for seq in 0..10_000 {
            flow.captured(seq, Sight::Whole);
        }
        assert_eq!(flow.frames(0, true).missing_in_world, 10_000);
        assert!(flow.pending.len() <= IN_FLIGHT);
    }
}
