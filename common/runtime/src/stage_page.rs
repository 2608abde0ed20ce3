//! A shared page for each stage, which outlives its processes and the supervisor: how far the stage has
//! come, the supervisor's note for its next process, and the time at which its process last checked in.
//!
//! A supervisor watches the stages' outputs and tells the next process of a stage where to continue
//! ([`Handover`]). But a supervisor can die too, and a stage's process after it, before the next
//! supervisor has seen any of that process's output: iceoryx2 does not deliver a dead process's
//! messages to later subscribers. A supervisor may also lack descriptors or memory to connect to a new
//! process. So each stage itself also notes how far it has come. The page is mapped once; after that no
//! access to it can fail.

use crate::handover::Handover;
use client::instance::Instance;
use client::shared_page::{Shareable, SharedPage};
use messages::stages::StageId;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};

/// Layout of the page.
#[repr(C)]
struct Numbers {
    /// Number of the newest output plus one; 0 when there is none.
    next: AtomicU64,
    /// The supervisor's note, [`Handover::to_bits`].
    note: AtomicU64,
    /// Time at which the active process last checked in; 0 before.
    checked_in_ns: AtomicU64,
}

// SAFETY: three atomic numbers.
#[allow(unsafe_code)]
unsafe impl Shareable for Numbers {}

/// The page of a stage.
pub struct StagePage {
    page: SharedPage<Numbers>,
}

impl StagePage {
    /// Opens a stage's page in an instance, and creates it if there is none.
    pub fn open(instance: &Instance, stage: StageId) -> io::Result<Self> {
        let namespace = instance.create_namespace().map_err(io::Error::other)?;
        Ok(Self { page: SharedPage::open(&namespace.stage_page_path(stage))? })
    }

    /// The newest output of all the stage's processes so far; `None` when there is none.
    pub fn newest(&self) -> Option<u64> {
        self.page.get().next.load(Ordering::Acquire).checked_sub(1)
    }

    /// Records an output that has just been published.
    pub fn set_newest(&self, seq: u64) {
        self.page.get().next.store(seq.saturating_add(1), Ordering::Release);
    }

    /// Leaves the note for the next process of the stage; it replaces the last one.
    pub fn leave_note(&self, note: Handover) {
        self.page.get().note.store(note.to_bits(), Ordering::Release);
    }

    /// The note for a process that is about to become active; `None` when the stage has not worked yet.
    pub fn note(&self) -> Option<Handover> {
        Handover::from_bits(self.page.get().note.load(Ordering::Acquire))
    }

    /// Records that the active process has checked in.
    pub fn check_in(&self, now_ns: u64) {
        self.page.get().checked_in_ns.store(now_ns, Ordering::Relaxed);
    }

    /// Time at which the active process last checked in; 0 before.
    pub fn checked_in_ns(&self) -> u64 {
        self.page.get().checked_in_ns.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_outlives_its_writer_and_is_removed_with_the_group() {
        let base = std::env::temp_dir().join(format!("tl-page-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        let tracker = StageId::from_name("tracker@1").unwrap();
        let page = StagePage::open(&instance, StageId::FILTER).unwrap();
        assert_eq!((page.newest(), page.note(), page.checked_in_ns()), (None, None, 0));
        page.set_newest(0);
        assert_eq!(page.newest(), Some(0));
        page.set_newest(4711);
        let note = Handover { resume_after: 4711, skip_next: true };
        page.leave_note(note);
        page.check_in(5);
        drop(page);
        let page = StagePage::open(&instance, StageId::FILTER).unwrap();
        assert_eq!((page.newest(), page.note()), (Some(4711), Some(note)));
        assert_eq!(page.checked_in_ns(), 5);
        assert_eq!(StagePage::open(&instance, tracker).unwrap().newest(), None);
        instance.forget_progress().unwrap();
        assert_eq!(StagePage::open(&instance, StageId::FILTER).unwrap().newest(), None);
        instance.forget_progress().unwrap();
        instance.remove_directory().unwrap();
    }
}
