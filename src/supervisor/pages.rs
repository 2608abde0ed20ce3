//! The pages that the supervisor shares with the stages' processes.

use super::sys::{self, Call};
use client::instance::Instance;
use messages::stages::{StageGraph, StageId, StageMap};
use runtime::handover::Handover;
use runtime::stage_page::StagePage;
use std::io;

/// One page for each stage.
pub struct Pages {
    instance: Instance,
    graph: StageGraph,
    pages: StageMap<Option<StagePage>>,
}

impl Pages {
    /// Maps the pages; the rest is left to [`open_all`](Self::open_all).
    pub fn new(instance: &Instance, graph: StageGraph) -> Self {
        let mut pages =
            Self { instance: instance.clone(), graph, pages: StageMap::of_defaults(graph) };
        // A failure here is retried, and reported then.
        let _ = pages.open_all();
        pages
    }

    /// Maps the pages that are not mapped yet.
    pub fn open_all(&mut self) -> io::Result<()> {
        for stage in self.graph.stages() {
            if self.pages[stage].is_none() {
                let open = || StagePage::open(&self.instance, stage);
                self.pages[stage] = Some(sys::ask(Call::OpenPage, open)?);
            }
        }
        Ok(())
    }

    /// Newest output of a stage, as its processes recorded it.
    pub fn newest(&self, stage: StageId) -> Option<u64> {
        self.pages[stage].as_ref()?.newest()
    }

    /// Last time at which a stage's active process checked in; 0 when unknown.
    pub fn checked_in_ns(&self, stage: StageId) -> u64 {
        self.pages[stage].as_ref().map_or(0, StagePage::checked_in_ns)
    }

    /// Leaves a note for the next process of a stage. Without a page the process could not read one
    /// either.
    pub fn leave_note(&self, stage: StageId, note: Handover) {
        if let Some(page) = &self.pages[stage] {
            page.leave_note(note);
        }
    }
}
