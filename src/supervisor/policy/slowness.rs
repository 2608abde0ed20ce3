//! Patience with a slow stage.
//!
//! A process that needs longer than the stall deadline for a frame looks as if it had stalled: on a slow
//! computer, in a debug build, or with a picture in which there is a lot to search. Its successor then does the same,
//! and if each of them is killed, less work is done than by any of them. So when a process stalls soon after it
//! replaced one that stalled, the stage gets twice the time, up to a limit; when its outputs have come
//! quickly for some time, half of it again. A single stall, or a stall now and then, changes nothing.

/// A process that stalls before so many outputs may just be slow.
const SOON: u32 = 16;
/// So many quick outputs in a row show that the stage is not slow any more.
const STEADY: u32 = 200;
/// The deadline is doubled so often at most.
const MOST_DOUBLINGS: u32 = 5;
/// An output is quick when it took at most 1 / this of the deadline.
const QUICK_PART: u64 = 2;

/// How slow a stage has turned out to be.
#[derive(Debug, Default)]
pub struct Slowness {
    doublings: u32,
    /// Outputs of the active process.
    outputs: u32,
    /// Quick outputs in a row.
    quick: u32,
    /// The last process of the stage was killed because it had stalled.
    follows_stall: bool,
}

impl Slowness {
    /// The stall deadline of this stage, if `deadline_ns` is that of a quick one.
    pub fn deadline_ns(&self, deadline_ns: u64) -> u64 {
        deadline_ns << self.doublings
    }

    /// Whether the stage has more time than a quick one.
    pub fn is_slow(&self) -> bool {
        self.doublings > 0
    }

    /// The stage gave an output, so long after its input was there or its last output was sent. `deadline_ns` is
    /// that of a quick stage.
    pub fn note_output(&mut self, took_ns: u64, deadline_ns: u64) {
        self.outputs = self.outputs.saturating_add(1);
        self.quick = if took_ns <= deadline_ns / QUICK_PART { self.quick + 1 } else { 0 };
        if self.quick >= STEADY {
            self.quick = 0;
            self.doublings = self.doublings.saturating_sub(1);
        }
    }

    /// The active process has ended; `stalled` if it was killed because it had stalled.
    pub fn note_end(&mut self, stalled: bool) {
        if stalled && self.follows_stall && self.outputs < SOON {
            self.doublings = (self.doublings + 1).min(MOST_DOUBLINGS);
        }
        self.follows_stall = stalled;
        (self.outputs, self.quick) = (0, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEADLINE_NS: u64 = 40;

    #[test]
    fn time_is_doubled_only_when_a_successor_stalls_soon_and_taken_back_later() {
        let mut stage = Slowness::default();
        // Stalls now and then, however many.
        for _ in 0..100 {
            (0..SOON).for_each(|_| stage.note_output(5, DEADLINE_NS));
            stage.note_end(true);
        }
        assert_eq!(stage.deadline_ns(DEADLINE_NS), 40);
        // Deaths of another kind.
        for _ in 0..100 {
            stage.note_end(false);
        }
        stage.note_end(true);
        assert!(!stage.is_slow());
        stage.note_output(30, DEADLINE_NS);
        stage.note_end(true);
        assert_eq!(stage.deadline_ns(DEADLINE_NS), 80);
        (0..1000).for_each(|_| stage.note_end(true));
        assert_eq!(stage.deadline_ns(DEADLINE_NS), 40 << MOST_DOUBLINGS);
        // Slow outputs show nothing, quick ones do.
        (0..10 * STEADY).for_each(|_| stage.note_output(60, DEADLINE_NS));
        assert_eq!(stage.deadline_ns(DEADLINE_NS), 40 << MOST_DOUBLINGS);
        (0..STEADY * MOST_DOUBLINGS).for_each(|_| stage.note_output(20, DEADLINE_NS));
        assert_eq!(stage.deadline_ns(DEADLINE_NS), 40);
    }
}
