//! Degraded groups: stages and spares that are missing because their starts keep failing, or that drop all
//! their input. The group goes on and reports it.

use super::Policy;
use messages::stages::StageId;

/// Failed starts in a row after which a stage counts as not working instead of as being replaced.
const DEGRADED: u32 = 3;

/// The part of a stage that is missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Degraded {
    /// The stage.
    pub stage: StageId,
    /// The kind of lack.
    pub what: Lack,
    /// Time until the next start, in nanoseconds.
    pub next_start_in_ns: u64,
}

/// The part of a stage that is missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lack {
    /// No active process: this many starts in a row have failed.
    Process(u32),
    /// No spare: this many starts of one have failed in a row.
    Spare(u32),
    /// No output: it drops all its input.
    Output,
    /// This many of its active processes have died in a short time, so the next start is delayed.
    Stability(u32),
    /// Speed: it needs longer than the stall deadline for a frame, and is left alone for longer.
    Speed,
}

impl Policy {
    /// Stages that lack something.
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
                (Lack::Stability(stage.intensity.count(now_ns)), stage.spare_after_ns)
            } else if stage.slowness.is_slow() {
                (Lack::Speed, now_ns)
            } else {
                return None;
            };
            let next_start_in_ns = at_ns.saturating_sub(now_ns);
            Some(Degraded { stage: id, what, next_start_in_ns })
        };
        self.stages.iter().filter_map(lack).collect()
    }
}
