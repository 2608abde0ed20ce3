//! What the rules know of a stage and of its processes.

use super::MemberId;
use super::dropping::Dropping;
use super::intensity::Intensity;
use common::stages::{FrameId, Numbers};

/// So many deaths in a row on the same input are not chance.
const POISONOUS: u32 = 2;

/// A process.
#[derive(Debug)]
pub struct Member {
    /// Its name.
    pub id: MemberId,
    /// When it was started.
    pub started_ns: u64,
    /// Connected to all its topics.
    pub ready: bool,
    /// Newest input at the moment it got ready; what came before never reached it.
    pub input_at_ready: Numbers,
    /// The stage's newest output when it began to work.
    pub output_at_work: Numbers,
    /// Runs a program that has been replaced.
    pub outdated: bool,
    /// Since when it is to end.
    pub dying_ns: Option<u64>,
    /// Killed because it had input and gave no output.
    pub stalled: bool,
}

/// A stage: its processes, and how far it has come.
#[derive(Debug, Default)]
pub struct Stage {
    /// Works.
    pub active: Option<Member>,
    /// Waits to take over.
    pub spare: Option<Member>,
    /// Starts in a row that failed, and how long to wait for the next; of the spare too.
    pub failures: u32,
    pub start_after_ns: u64,
    pub spare_failures: u32,
    pub spare_after_ns: u64,
    /// The newest frames that its output contains.
    pub output: Numbers,
    /// Newest input at the moment it reported a drop; that much it has dealt with.
    pub dropped_up_to: Numbers,
    /// Its drops since its last output; `None` when there was none.
    pub dropping: Option<Dropping>,
    /// How many processes in a row have died after the same output, and after which.
    pub deaths: u32,
    pub output_at_death: Numbers,
    /// Inputs that were skipped without another output since.
    skipped: usize,
    /// To be skipped: the input after this frame.
    pub skip_after: Option<FrameId>,
    /// A grabber has captured all it was asked to.
    pub has_finished: bool,
    /// Last time at which the stage did something, or had nothing to do.
    pub progress_ns: u64,
    /// Last time at which its active process looked around.
    pub checked_in_ns: u64,
    /// Smoothed interval between outputs; `None` before the second output of a process.
    pub period_ns: Option<u64>,
    /// When the newest output was sent.
    sent_ns: Option<u64>,
    /// The deaths of its active processes.
    pub intensity: Intensity,
    /// How often in a row there were too many of them; 0 when all is well.
    pub escalation: u32,
}

/// Outputs over which the period is smoothed.
const SMOOTHED: u64 = 8;

impl Stage {
    /// Whether its active process can be expected to work.
    pub fn is_working(&self) -> bool {
        self.active.as_ref().is_some_and(|active| active.ready && active.dying_ns.is_none())
    }

    /// Takes an output into the period: a frame number, and the one before it in the same lane. To be called
    /// before it becomes the newest.
    pub fn note_period(&mut self, seq: u64, last: Option<u64>, sent_ns: u64) {
        let before = self.sent_ns.replace(sent_ns);
        let has_worked = self.active.as_ref().is_some_and(|active| active.has_worked(self.output));
        // Between two processes there is a gap that says nothing of the camera.
        let (Some(before_ns), Some(last), true) = (before, last, has_worked) else {
            self.period_ns = None;
            return;
        };
        let period_ns = sent_ns.saturating_sub(before_ns) / (seq - last);
        let smoothed = |old_ns: u64| (old_ns * (SMOOTHED - 1) + period_ns) / SMOOTHED;
        self.period_ns = Some(self.period_ns.map_or(period_ns, smoothed));
    }

    /// A process that worked has died. When there were more deaths than even a disturbed match has, and
    /// from then on until one has lived well, returns how many that were.
    pub fn escalate(&mut self, had_lived: bool, now_ns: u64) -> Option<u32> {
        self.intensity.note(now_ns);
        let is_too_high = self.intensity.is_too_high(now_ns);
        let goes_on = self.escalation > 0 && !had_lived;
        self.escalation =
            if is_too_high || goes_on { self.escalation.saturating_add(1) } else { 0 };
        (self.escalation > 0).then_some(self.escalation)
    }

    /// A process of this stage has died by the fault of its input, as far as one can tell. Where the stage reads
    /// several lanes, it is not known which of the waiting frames it was: each time, that of another lane is
    /// skipped.
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
    /// Whether it has given output since it began to work.
    pub fn has_worked(&self, output: Numbers) -> bool {
        output.are_beyond(self.output_at_work)
    }

    /// Just started.
    pub fn new(id: MemberId, output_at_work: Numbers, now_ns: u64) -> Self {
        Self {
            id,
            started_ns: now_ns,
            ready: false,
            input_at_ready: Numbers::default(),
            output_at_work,
            outdated: false,
            dying_ns: None,
            stalled: false,
        }
    }
}
