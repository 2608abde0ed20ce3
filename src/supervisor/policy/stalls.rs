//! Stall detection: which stages are behind, and since when.

use super::{MemberId, Policy};
use messages::stages::StageId;

/// A stage is late when it is behind for 1 / this of its deadline. Healthy stages never are.
const LATE_PART: u64 = 4;
/// Shortest stall deadline before a process's first output.
const FIRST_OUTPUT_NS: u64 = 200_000_000;
/// Periods of a streaming camera without any frame that jitter does not explain.
const STUCK_PERIODS: u64 = 5;

impl Policy {
    /// The active process of a late stage, which may be about to stall: from here on, its time
    /// without a processor matters.
    pub fn late(&self, id: StageId, now_ns: u64) -> Option<MemberId> {
        let stage = &self.stages[id];
        let behind_ns = now_ns.saturating_sub(stage.progress_ns);
        let deadline_ns = match stage.period_ns.filter(|_| id.is_grabber()) {
            Some(period_ns) => self.stuck_deadline_ns(period_ns),
            None => self.stall_deadline_ns(id),
        };
        let is_late = self.has_input(id) && behind_ns > deadline_ns / LATE_PART;
        stage.active.as_ref().filter(|_| is_late).map(|active| active.id)
    }

    /// Time in nanoseconds until the next stall; `None` while no stage is behind. Looking exactly
    /// then makes outages shorter.
    pub fn stall_due_in_ns(&self, now_ns: u64) -> Option<u64> {
        let due_ns = self
            .stages
            .iter()
            .filter(|(id, stage)| {
                let has_pace = !id.is_grabber() || stage.period_ns.is_some();
                stage.is_working() && has_pace && self.has_input(*id)
            })
            .map(|(id, _)| self.stalls_at_ns(id) + 1);
        due_ns.min().map(|due_ns| due_ns.saturating_sub(now_ns))
    }

    /// Whether the active process has had pending input for too long. Having no pending input
    /// counts as progress, so the deadline starts when input arrives.
    pub(super) fn has_stalled(&mut self, id: StageId, now_ns: u64) -> bool {
        let has_input = self.has_input(id);
        let stage = &mut self.stages[id];
        if !has_input || !stage.is_working() {
            stage.progress_ns = now_ns;
        }
        now_ns > self.stalls_at_ns(id)
    }

    /// Time at which the active process of a stage with pending input has stalled unless it makes
    /// progress.
    pub(super) fn stalls_at_ns(&self, id: StageId) -> u64 {
        let stage = &self.stages[id];
        let silent_ns = stage.progress_ns.saturating_add(self.stall_deadline_ns(id));
        let has_worked =
            stage.active.as_ref().is_some_and(|active| active.has_worked(stage.output));
        match stage.period_ns.filter(|_| id.is_grabber() && has_worked) {
            // A camera may pause, but its grabber checks in meanwhile.
            Some(period_ns) => {
                let sign_ns = stage.progress_ns.max(stage.checked_in_ns);
                silent_ns.min(sign_ns.saturating_add(self.stuck_deadline_ns(period_ns)))
            }
            None => silent_ns,
        }
    }

    /// Longest time without a frame or a check-in of a grabber whose camera has this period.
    pub(super) fn stuck_deadline_ns(&self, period_ns: u64) -> u64 {
        let deadline_ns = period_ns.saturating_mul(STUCK_PERIODS);
        deadline_ns.max(self.settings.grabber_stuck_ns).min(self.settings.grabber_stall_ns)
    }

    /// Longest time that the active process of a stage may be behind.
    pub(super) fn stall_deadline_ns(&self, id: StageId) -> u64 {
        let stage = &self.stages[id];
        let deadline_ns = match id.is_grabber() {
            true => self.settings.grabber_stall_ns,
            false => stage.slowness.deadline_ns(self.settings.stall_ns),
        };
        // A new process has a backlog to work through and memory pages to touch.
        let is_new = stage.active.as_ref().is_some_and(|active| !active.has_worked(stage.output));
        if is_new { deadline_ns.max(FIRST_OUTPUT_NS) } else { deadline_ns }
    }
}
