//! How far a stage has come, in memory that outlives its processes.
//!
//! A supervisor watches what the stages publish and tells the next process of a stage where to go on
//! ([`handover`](crate::handover)). But a supervisor can die too, and a stage's process after it,
//! before the next supervisor has seen anything of it: what a dead process has published is not
//! shown to those who come later. So each stage also leaves a mark itself.

use crate::instance::Instance;
use crate::messages::ProcessKind;
use crate::shared_number::SharedNumber;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};

/// The number of a stage's newest output.
pub struct Mark {
    /// One more than it; 0 when there is none.
    next: SharedNumber<AtomicU64>,
}

impl Mark {
    /// The mark of a stage in an instance whose directory exists.
    pub fn open(instance: &Instance, kind: ProcessKind) -> io::Result<Self> {
        Ok(Self { next: SharedNumber::open(&instance.mark_path(kind.name()))? })
    }

    /// The newest output of all the stage's processes so far; `None` when there is none.
    pub fn newest(&self) -> Option<u64> {
        self.next.get().load(Ordering::Acquire).checked_sub(1)
    }

    /// Moves the mark to an output that has just been published.
    pub fn set(&self, seq: u64) {
        self.next.get().store(seq.saturating_add(1), Ordering::Release);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_outlives_who_has_set_it_and_goes_with_the_group() {
        let base = std::env::temp_dir().join(format!("tl-mark-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        let kind = ProcessKind::Filter;
        let mark = Mark::open(&instance, kind).unwrap();
        assert_eq!(mark.newest(), None);
        mark.set(0);
        assert_eq!(mark.newest(), Some(0));
        mark.set(4711);
        drop(mark);
        assert_eq!(Mark::open(&instance, kind).unwrap().newest(), Some(4711));
        assert_eq!(Mark::open(&instance, ProcessKind::Tracker).unwrap().newest(), None);
        instance.forget_progress().unwrap();
        assert_eq!(Mark::open(&instance, kind).unwrap().newest(), None);
        instance.remove_directory().unwrap();
    }
}
