//! State of a stage and of its processes, as the rules see it.

use super::MemberId;
use super::dropping::Dropping;
use super::intensity::Intensity;
use super::slowness::Slowness;
use messages::stages::{FrameId, Numbers};

/// Deaths in a row on the same input that are not a coincidence.
const POISONOUS: u32 = 2;

/// What has been replaced by a newer one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Old {
    /// The configuration, or the process itself, at a user's request.
    Configuration,
    /// The program, and perhaps the configuration too.
    Program,
}

/// A process of the stage.
#[derive(Debug)]
pub struct Member {
    /// Its identifier.
    pub id: MemberId,
    /// Time of its start.
    pub started_ns: u64,
    /// Connected to all its topics.
    pub ready: bool,
    /// Newest input when it became ready; older input never reached it.
    pub input_at_ready: Numbers,
    /// The stage's newest output when it became active.
    pub output_at_work: Numbers,
    /// When it became active; for a spare, when it was started.
    pub at_work_ns: u64,
    /// What it runs with and is to be replaced for; `None` if nothing.
    pub old: Option<Old>,
    /// It was asked to end.
    pub is_retired: bool,
    /// Time at which it was killed or asked to end.
    pub dying_ns: Option<u64>,
    /// Killed because it had input and gave no output.
    pub stalled: bool,
}

/// A stage: its processes, and how far it has come.
#[derive(Debug, Default)]
pub struct Stage {
    /// The active process.
    pub active: Option<Member>,
    /// The spare, which waits for promotion.
    pub spare: Option<Member>,
    /// Failed starts in a row, and the earliest time of the next start; for the active process and
    /// the spare.
    pub failures: u32,
    pub start_after_ns: u64,
    pub spare_failures: u32,
    pub spare_after_ns: u64,
    /// Newest frames in its output.
    pub output: Numbers,
    /// Newest input when it last reported a drop; input up to here is handled.
    pub dropped_up_to: Numbers,
    /// Drops since its last output; `None` if there are none.
    pub dropping: Option<Dropping>,
    /// Deaths in a row after the same output, and that output.
    pub deaths: u32,
    pub output_at_death: Numbers,
    /// Since when its renewal waits for its readers' spares.
    pub held_since_ns: Option<u64>,
    /// Inputs skipped since its last output.
    skipped: usize,
    /// Skip the next input after this frame.
    pub skip_after: Option<FrameId>,
    /// A grabber has captured all requested frames.
    pub has_finished: bool,
    /// Last time at which the stage made progress or had no pending input.
    pub progress_ns: u64,
    /// Last time at which its active process checked in.
    pub checked_in_ns: u64,
    /// Smoothed interval between outputs; `None` before the second output of a process.
    pub period_ns: Option<u64>,
    /// Time at which the newest output was sent.
    sent_ns: Option<u64>,
    /// Whether it needs longer than the stall deadline.
    pub slowness: Slowness,
    /// Recent deaths of its active processes.
    pub intensity: Intensity,
    /// Deaths in a row over the limit; 0 when all is well.
    pub escalation: u32,
}

/// Outputs over which the period is smoothed.
const SMOOTHED: u64 = 8;

impl Stage {
    /// Whether its active process is ready and not about to end.
    pub fn is_working(&self) -> bool {
        self.active.as_ref().is_some_and(|active| active.ready && active.dying_ns.is_none())
    }

    /// Updates the period from an output: its frame number, and the previous one of the same lane.
    /// Call it before the output becomes the newest.
    pub fn note_period(&mut self, seq: u64, last: Option<u64>, sent_ns: u64) {
        let before = self.sent_ns.replace(sent_ns);
        let has_worked = self.active.as_ref().is_some_and(|active| active.has_worked(self.output));
        // The gap between two processes says nothing about the camera.
        let (Some(before_ns), Some(last), true) = (before, last, has_worked) else {
            self.period_ns = None;
            return;
        };
        let period_ns = sent_ns.saturating_sub(before_ns) / (seq - last);
        let smoothed = |old_ns: u64| (old_ns * (SMOOTHED - 1) + period_ns) / SMOOTHED;
        self.period_ns = Some(self.period_ns.map_or(period_ns, smoothed));
    }

    /// Counts the death of an active process. Returns the escalation level if deaths are more
    /// frequent than in a disturbed match, and from then on until a process has lived long enough.
    pub fn escalate(&mut self, had_lived: bool, now_ns: u64) -> Option<u32> {
        self.intensity.note(now_ns);
        let is_too_high = self.intensity.is_too_high(now_ns);
        let goes_on = self.escalation > 0 && !had_lived;
        self.escalation =
            if is_too_high || goes_on { self.escalation.saturating_add(1) } else { 0 };
        (self.escalation > 0).then_some(self.escalation)
    }

    /// Counts a death that the input probably caused, and skips an input after two. A stage that
    /// reads several lanes may have several pending frames, and the culprit is unknown: each skip
    /// takes a frame of another lane.
    pub fn died_on_input(&mut self, input: Numbers) {
        if !self.output.are_beyond(Numbers::default()) {
            return;
        }
        if self.output_at_death == self.output {
            self.deaths += 1;
        } else {
            (self.deaths, self.skipped) = (1, 0);
        }
        self.output_at_death = self.output;
        if self.deaths >= POISONOUS {
            self.deaths = 0;
            let worked_on = |lane| self.output.of(lane).map(|seq| FrameId { lane, seq });
            let mut suspects: Vec<FrameId> =
                input.ahead_of(self.output).filter_map(worked_on).collect();
            if suspects.is_empty() {
                suspects = self.output.ahead_of(Numbers::default()).filter_map(worked_on).collect();
            }
            self.skip_after = suspects.get(self.skipped % suspects.len().max(1)).copied();
            self.skipped += 1;
        }
    }
}

impl Member {
    /// Whether it has given output since it became active.
    pub fn has_worked(&self, output: Numbers) -> bool {
        output.are_beyond(self.output_at_work)
    }

    /// A process that was just started.
    pub fn new(id: MemberId, output_at_work: Numbers, now_ns: u64) -> Self {
        Self {
            id,
            started_ns: now_ns,
            ready: false,
            input_at_ready: Numbers::default(),
            output_at_work,
            at_work_ns: now_ns,
            old: None,
            is_retired: false,
            dying_ns: None,
            stalled: false,
        }
    }
}
