//! Degraded groups: stages and spares that are missing because starts keep failing, or that do nothing. The group is kept alive, and says so.

use super::Policy;
use common::stages::StageId;

/// Failures in a row after which a stage counts as not working, rather than as being replaced.
const DEGRADED: u32 = 3;

/// The part of a stage that is missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Degraded {
    /// The stage.
    pub stage: StageId,
    /// How.
    pub what: Lack,
    /// When the next attempt is due, from now on in nanoseconds.
    pub next_start_in_ns: u64,
}

/// The part of a stage that is missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lack {
    /// It does not work: so many starts in a row have failed.
    Process(u32),
    /// It works without a spare: so many starts of one have failed.
    Spare(u32),
    /// It drops all its input.
    Output,
    /// It works, but so many of its processes have died in a short time that there is a pause before the
    /// next.
    Peace(u32),
}

impl Policy {
    /// Stages of which something is missing, and what.
    pub fn degraded(&self, now_ns: u64) -> Vec<Degraded> {
        let lack = |(id, stage): (StageId, &super::Stage)| {
            let (what, at_ns) = if stage.failures >= DEGRADED && !stage.is_working() {
                (Lack::Process(stage.failures), stage.start_after_ns)
            } else if self.only_drops(id, now_ns) {
                (Lack::Output, now_ns)
            } else if stage.spare_failures >= DEGRADED
                && !stage.spare.as_ref().is_some_and(|spare| spare.ready)
            {
                (Lack::Spare(stage.spare_failures), stage.spare_after_ns)
            } else if stage.escalation > 0
                && (stage.intensity.count(now_ns) > 0 || now_ns < stage.spare_after_ns)
            {
                (Lack::Peace(stage.intensity.count(now_ns)), stage.spare_after_ns)
            } else {
                return None;
            };
            let next_start_in_ns = at_ns.saturating_sub(now_ns);
            Some(Degraded { stage: id, what, next_start_in_ns })
        };
        self.stages.iter().filter_map(lack).collect()
    }
}
