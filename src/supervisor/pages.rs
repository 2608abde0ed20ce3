//! The pages that the supervisor shares with the stages' processes.

use super::sys::{self, Call};
use common::handover::Handover;
use common::instance::Instance;
use common::stage_page::StagePage;
use common::stages::{StageGraph, StageId, StageMap};
use std::io;

/// One page for each stage.
pub struct Pages {
    instance: Instance,
    graph: StageGraph,
    pages: StageMap<Option<StagePage>>,
}

impl Pages {
    /// Maps those that can be mapped.
    pub fn new(instance: &Instance, graph: StageGraph) -> Self {
        let mut pages =
            Self { instance: instance.clone(), graph, pages: StageMap::of_defaults(graph) };
        // A failure here is retried, and reported then.
        let _ = pages.open_all();
        pages
    }

    /// Maps those that could not be mapped before.
    pub fn open_all(&mut self) -> io::Result<()> {
        for stage in self.graph.stages() {
            if self.pages[stage].is_none() {
                let open = || StagePage::open(&self.instance, stage);
                self.pages[stage] = Some(sys::ask(Call::OpenPage, open)?);
            }
        }
        Ok(())
    }

    /// How far a stage has come, as its processes say.
    pub fn newest(&self, stage: StageId) -> Option<u64> {
        self.pages[stage].as_ref()?.newest()
    }

    /// When the process of a stage that works last looked around; 0 when that is not known.
    pub fn checked_in_ns(&self, stage: StageId) -> u64 {
        self.pages[stage].as_ref().map_or(0, StagePage::checked_in_ns)
    }

    /// Leaves a note for the next process of a stage. Without a page there is none to read it either.
    pub fn leave_note(&self, stage: StageId, note: Handover) {
        if let Some(page) = &self.pages[stage] {
            page.leave_note(note);
        }
    }
}
