//! The pages that the supervisor shares with the stages' processes.

use super::sys::{self, Call};
use common::handover::Handover;
use common::instance::Instance;
use common::messages::ProcessKind;
use common::stage_page::StagePage;
use std::io;

/// One page for each stage.
pub struct Pages {
    instance: Instance,
    pages: [Option<StagePage>; ProcessKind::ALL.len()],
}

impl Pages {
    /// Maps those that can be mapped.
    pub fn new(instance: &Instance) -> Self {
        let mut pages = Self { instance: instance.clone(), pages: Default::default() };
        // A failure here is retried, and reported then.
        let _ = pages.open_all();
        pages
    }

    /// Maps those that could not be mapped before.
    pub fn open_all(&mut self) -> io::Result<()> {
        for kind in ProcessKind::ALL {
            if self.pages[kind as usize].is_none() {
                let open = || StagePage::open(&self.instance, kind);
                self.pages[kind as usize] = Some(sys::ask(Call::OpenPage, open)?);
            }
        }
        Ok(())
    }

    /// How far a stage has come, as its processes say.
    pub fn newest(&self, kind: ProcessKind) -> Option<u64> {
        self.pages[kind as usize].as_ref()?.newest()
    }

    /// When the process of a stage that works last looked around; 0 when that is not known.
    pub fn checked_in_ns(&self, kind: ProcessKind) -> u64 {
        self.pages[kind as usize].as_ref().map_or(0, StagePage::checked_in_ns)
    }

    /// Leaves a note for the next process of a stage. Without a page there is none to read it either.
    pub fn leave_note(&self, kind: ProcessKind, note: Handover) {
        if let Some(page) = &self.pages[kind as usize] {
            page.leave_note(note);
        }
    }
}
