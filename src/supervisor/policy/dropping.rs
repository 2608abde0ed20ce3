//! Stages that give no output because they drop their input.
//!
//! An invalid input (a wrong size, an unknown format) counts as handled when it is dropped. But a stage that
//! drops everything does not work, whatever the reason: its process is replaced once, in case the fault is
//! its own. A successor that drops everything too is kept, since another one would do no better, and the
//! group counts as degraded.

use super::Policy;
use messages::stages::StageId;

/// Time and number of drops without an output that are not a coincidence.
const ONLY_DROPS_NS: u64 = 2_000_000_000;
const FEWEST_DROPS: u32 = 20;
/// Time after the last drop from which the drops say nothing about the next input.
const RECENT_NS: u64 = 1_000_000_000;

/// The drops of a stage since its last output.
#[derive(Debug, Clone, Copy)]
pub struct Dropping {
    since_ns: u64,
    last_ns: u64,
    /// Number of reported drops.
    reports: u32,
}

impl Policy {
    /// Records that a stage has dropped its input up to the newest.
    pub(super) fn dropped(&mut self, id: StageId, now_ns: u64) {
        let input = self.input(id);
        let stage = &mut self.stages[id];
        stage.dropped_up_to = input;
        stage.progress_ns = now_ns;
        let begin = Dropping { since_ns: now_ns, last_ns: now_ns, reports: 0 };
        let goes_on = |before: &Dropping| now_ns.saturating_sub(before.last_ns) < RECENT_NS;
        let before = stage.dropping.filter(goes_on).unwrap_or(begin);
        let reports = before.reports.saturating_add(1);
        stage.dropping = Some(Dropping { last_ns: now_ns, reports, ..before });
    }

    /// Whether a stage drops all its input. A grabber's drops concern only its camera.
    pub(super) fn only_drops(&self, id: StageId, now_ns: u64) -> bool {
        !id.is_grabber()
            && self.stages[id].dropping.is_some_and(|dropping| {
                dropping.last_ns.saturating_sub(dropping.since_ns) > ONLY_DROPS_NS
                    && dropping.reports >= FEWEST_DROPS
                    && now_ns.saturating_sub(dropping.last_ns) < RECENT_NS
            })
    }

    /// Whether to replace the process of a stage that drops all its input: only one that has given
    /// output.
    pub(super) fn is_to_be_replaced_for_drops(&self, id: StageId, now_ns: u64) -> bool {
        let stage = &self.stages[id];
        let has_worked = |active: &super::Member| active.has_worked(stage.output);
        self.only_drops(id, now_ns) && stage.active.as_ref().is_some_and(has_worked)
    }
}
