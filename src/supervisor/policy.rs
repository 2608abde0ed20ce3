//! What to do when: the supervisor's decisions, without doing any of them.
//!
//! Events and the time go in, actions come out. Nothing here touches a process, a clock or a
//! topic, so every situation can be played through in a test.
//!
//! The rules:
//! * A stage has one active process, and may have a spare that is connected but idle.
//! * A process that ends, does not get ready, or has input and gives no output within the stall
//!   deadline is replaced: by its spare at once, else by a new start. A stalled process is killed
//!   first, and its successor speaks only when it is confirmed dead.
//! * A stage makes progress by its output. Dropping an input that no process could work on deals with that input;
//!   a stage that drops everything is replaced once and then said to be degraded ([`dropping`]).
//! * Two deaths in a row on the same input make the next process skip that input.
//! * Starts that fail quickly, again and again, are spaced out; the rest of the group goes on. So are
//!   those of a stage whose processes die more often than any disturbance from outside explains
//!   ([`intensity`]): each of them may have had a good start.
//! * A camera that streams has its own rate: a grabber that gives no frame for five of its periods and
//!   does not look around either is stuck. One that looks around waits for its camera.
//! * While the supervisor sees only part of what happens, nobody is blamed for what it does not see.
//! * A process of an outdated program is replaced by a spare of the new one, one stage at a time.
//! * A camera starts last, when every stage that works on its frames is ready to see the first one.
//! * What happens to a stage of one lane concerns its readers only: the other lanes go on.

mod degraded;
mod dropping;
mod intensity;
mod stage;
mod stalls;

pub use degraded::{Degraded, Lack};

use common::messages::ProcessKind;
use common::stages::{FrameId, Numbers, StageGraph, StageId, StageMap};
use stage::{Member, Stage};

/// Identifies a process from its start to its end; never used twice.
pub type MemberId = u64;

/// The numbers the rules need, in nanoseconds.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Input without output for so long is a stall.
    pub stall_ns: u64,
    /// A camera may be silent for so long.
    pub grabber_stall_ns: u64,
    /// A grabber whose camera streams may be stuck for so long at least, and for
    /// five of its frames.
    pub grabber_stuck_ns: u64,
    /// From start to ready.
    pub ready_timeout_ns: u64,
    /// First pause between failed starts; doubles.
    pub backoff_ns: u64,
    /// Longest pause.
    pub backoff_max_ns: u64,
    /// The group's stages.
    pub graph: StageGraph,
    /// Kinds of stage that keep a spare.
    pub spares: Vec<ProcessKind>,
}

/// Something that happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// A process is connected to all its topics.
    Ready(MemberId),
    /// A process could not be started at all.
    NotStarted(MemberId),
    /// When the working process of a stage has last looked around.
    LookedAround(StageId, u64),
    /// A process is gone for certain.
    Exited {
        /// Which.
        id: MemberId,
        /// Whether it fell by itself (a panic, a fault), rather than being ended from outside.
        crashed: bool,
    },
    /// A stage's newest output contains this frame.
    Output(StageId, FrameId),
    /// A stage has dropped input that no process of it could work on.
    Dropped(StageId),
    /// A grabber says that its camera is away.
    CameraIsAway(StageId),
    /// A stage was ready to run for so long (nanoseconds), but got no processor.
    Waited(StageId, u64),
    /// A grabber has captured all it was asked to.
    Finished(StageId),
}

/// Why a process is killed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// Input, but no output.
    Stalled,
    /// It drops everything it gets.
    OnlyDrops,
    /// Started, but never ready.
    NotReady,
    /// Asked to end, but did not.
    DoesNotEnd,
}

/// Something to be done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Start a process.
    Start {
        /// Name it is known by from now on.
        id: MemberId,
        /// Its stage.
        stage: StageId,
        /// Whether it is to wait for promotion.
        spare: bool,
    },
    /// Let a spare take over.
    Promote {
        /// The spare.
        id: MemberId,
        /// Its stage.
        stage: StageId,
    },
    /// Kill a process, which cannot refuse.
    Kill {
        /// The process.
        id: MemberId,
        /// Its stage.
        stage: StageId,
        /// Why.
        cause: Cause,
    },
    /// Ask a process to end, so that its spare takes over.
    Retire {
        /// The process.
        id: MemberId,
        /// Its stage.
        stage: StageId,
    },
    /// Make the next process of a stage skip the first input after this output: two have died of it.
    Skip {
        /// The stage.
        stage: StageId,
        /// The newest frame of that lane in its output.
        after: FrameId,
    },
    /// Remove from shared memory what dead processes have left.
    CleanUp,
}

/// A process that gave output, or lived for so long, had a good start: the next failure counts as
/// the first.
const GOOD_START_NS: u64 = 5_000_000_000;
/// Pause between a death and the slow work after it (next spare, clean-up), so that it does not
/// compete with the successor for the processor.
const SETTLE_NS: u64 = 100_000_000;
/// Between two looks of the supervisor itself. If it was away for longer, the whole machine was
/// busy or asleep, and that time is nobody's fault.
const OWN_LAG_NS: u64 = 40_000_000;
/// A process that was asked to end and did not within this time is killed.
const RETIREMENT_NS: u64 = 1_000_000_000;
/// The camera does not wait longer than this for stages that do not get ready.
const GRABBER_WAIT_NS: u64 = 5_000_000_000;

/// The state of the group as the rules see it.
#[derive(Debug)]
pub struct Policy {
    settings: Settings,
    /// Heartbeats are not seen.
    is_blind: bool,
    stages: StageMap<Stage>,
    next_id: MemberId,
    started_ns: Option<u64>,
    last_tick_ns: u64,
    clean_up_at_ns: Option<u64>,
}

impl Policy {
    /// Nothing runs yet; the first [`tick`](Self::tick) starts the group.
    pub fn new(settings: Settings) -> Self {
        Self {
            stages: StageMap::of_defaults(settings.graph),
            settings,
            is_blind: false,
            next_id: 1,
            started_ns: None,
            last_tick_ns: 0,
            clean_up_at_ns: None,
        }
    }

    /// Takes note of an event and of when it happened; what has to be done about it comes from the next
    /// [`tick`](Self::tick).
    pub fn note(&mut self, event: Event, now_ns: u64) {
        match event {
            Event::Ready(id) => self.ready(id, now_ns),
            Event::Exited { id, crashed } => self.exited(id, crashed, now_ns),
            Event::NotStarted(id) => self.not_started(id, now_ns),
            Event::LookedAround(stage, at_ns) => {
                let stage = &mut self.stages[stage];
                stage.checked_in_ns = stage.checked_in_ns.max(at_ns.min(now_ns));
            }
            Event::Output(stage, frame) => self.output(stage, frame, now_ns),
            Event::Dropped(stage) => self.dropped(stage, now_ns),
            Event::CameraIsAway(grabber) => self.stages[grabber].progress_ns = now_ns,
            Event::Waited(stage, waited_ns) => {
                let stage = &mut self.stages[stage];
                let excuse = |since_ns: u64| since_ns.saturating_add(waited_ns).min(now_ns);
                stage.progress_ns = excuse(stage.progress_ns);
                stage.checked_in_ns = excuse(stage.checked_in_ns);
            }
            Event::Finished(grabber) => self.stages[grabber].has_finished = true,
        }
    }

    /// Takes in a process that an earlier supervisor has started. Returns the name it is known by
    /// from now on; `None` when the stage has no place for it.
    pub fn adopt(
        &mut self,
        stage: StageId,
        spare: bool,
        outdated: bool,
        now_ns: u64,
    ) -> Option<MemberId> {
        let stage = &mut self.stages[stage];
        let slot = if spare { &mut stage.spare } else { &mut stage.active };
        if slot.is_some() {
            return None;
        }
        let id = self.next_id;
        self.next_id += 1;
        *slot = Some(Member { ready: true, outdated, ..Member::new(id, stage.output, now_ns) });
        stage.progress_ns = now_ns;
        Some(id)
    }

    /// Has a stage's active process replaced in good order, by its spare where it has one. Where there
    /// is none, because starts have failed again and again, the next start comes at once.
    pub fn renew_stage(&mut self, stage: StageId, now_ns: u64) {
        let stage = &mut self.stages[stage];
        match &mut stage.active {
            Some(active) => active.outdated = true,
            None => {
                stage.failures = 0;
                stage.start_after_ns = now_ns;
            }
        }
    }

    /// Whether heartbeats are seen. While they are not, nobody can be known to be ready.
    pub fn set_blind(&mut self, is_blind: bool, now_ns: u64) {
        if self.is_blind && !is_blind {
            for stage in self.stages.values_mut() {
                for member in [&mut stage.active, &mut stage.spare].into_iter().flatten() {
                    member.started_ns = now_ns;
                }
            }
        }
        self.is_blind = is_blind;
    }

    /// Everything that is to be done now. Call after events, and every few milliseconds.
    pub fn tick(&mut self, now_ns: u64) -> Vec<Action> {
        let away_ns = now_ns.saturating_sub(self.last_tick_ns);
        if away_ns > OWN_LAG_NS {
            for stage in self.settings.graph.stages() {
                self.note(Event::Waited(stage, away_ns), now_ns);
            }
        }
        self.last_tick_ns = now_ns;
        self.started_ns.get_or_insert(now_ns);

        let mut actions = Vec::new();
        // Against the stream: a stage is there before its input is.
        for stage in self.settings.graph.stages().rev() {
            self.fill_active(stage, now_ns, &mut actions);
            self.fill_spare(stage, now_ns, &mut actions);
            self.kill_the_stuck(stage, now_ns, &mut actions);
            self.renew(stage, now_ns, &mut actions);
        }
        if self.clean_up_at_ns.is_some_and(|at| now_ns >= at) {
            self.clean_up_at_ns = None;
            actions.push(Action::CleanUp);
        }
        actions
    }

    /// Whether every stage has an active process that is ready.
    pub fn is_complete(&self) -> bool {
        self.stages.values().all(Stage::is_working)
    }

    fn ready(&mut self, id: MemberId, now_ns: u64) {
        for stage in self.settings.graph.stages() {
            let input = self.input(stage);
            let stage = &mut self.stages[stage];
            for member in [&mut stage.active, &mut stage.spare].into_iter().flatten() {
                if member.id == id && !member.ready {
                    // What kills working processes is nothing against the next spare.
                    stage.spare_failures = 0;
                    member.ready = true;
                    member.input_at_ready = input;
                    stage.progress_ns = now_ns;
                }
            }
        }
    }

    fn output(&mut self, stage: StageId, frame: FrameId, sent_ns: u64) {
        // The clock of a stage that had nothing to do starts with its input.
        let readers: Vec<StageId> = self.settings.graph.readers(stage).collect();
        let idle: Vec<StageId> =
            readers.into_iter().filter(|&reader| !self.has_input(reader)).collect();
        let stage = &mut self.stages[stage];
        let before = stage.output.of(frame.lane);
        if before < Some(frame.seq) {
            stage.note_period(frame.seq, before, sent_ns);
            stage.output.raise(frame);
            stage.dropping = None;
            stage.progress_ns = stage.progress_ns.max(sent_ns);
        }
        for reader in idle {
            let reader = &mut self.stages[reader];
            reader.progress_ns = reader.progress_ns.max(sent_ns);
        }
    }

    fn exited(&mut self, id: MemberId, crashed: bool, now_ns: u64) {
        // Not put off by further deaths: in a storm of them, the dead would soon hold every slot that
        // a topic has for publishers.
        self.clean_up_at_ns.get_or_insert(now_ns + SETTLE_NS);
        let Some((stage, was_active)) = self.stage_of(id) else { return };
        let input = self.input(stage);
        let (settings, stage) = (&self.settings, &mut self.stages[stage]);
        let (slot, failures, start_after_ns) = match was_active {
            true => (&mut stage.active, &mut stage.failures, &mut stage.start_after_ns),
            false => (&mut stage.spare, &mut stage.spare_failures, &mut stage.spare_after_ns),
        };
        let Some(member) = slot.take() else { return };
        let had_lived = now_ns - member.started_ns >= GOOD_START_NS;
        let good_start = had_lived || was_active && member.has_worked(stage.output);
        *failures = if good_start { 1 } else { *failures + 1 };
        *start_after_ns = now_ns + settings.backoff(*failures);
        if !was_active {
            return;
        }
        stage.dropping = None;
        // Not the fault of a process that somebody kills.
        let is_its_own_fault = crashed || member.stalled;
        if is_its_own_fault {
            stage.died_on_input(input);
        }
        let level = is_its_own_fault.then(|| stage.escalate(had_lived, now_ns)).flatten();
        if let Some(level) = level {
            let pause_ns = settings.backoff(level + 1);
            stage.start_after_ns = stage.start_after_ns.max(now_ns + pause_ns);
            stage.spare_after_ns = stage.spare_after_ns.max(now_ns + pause_ns);
        }
    }

    /// The stage of a process, and whether the process is its active one.
    fn stage_of(&self, id: MemberId) -> Option<(StageId, bool)> {
        let is_it = |member: &Option<Member>| member.as_ref().is_some_and(|member| member.id == id);
        self.stages.iter().find_map(|(id, stage)| match () {
            () if is_it(&stage.active) => Some((id, true)),
            () if is_it(&stage.spare) => Some((id, false)),
            () => None,
        })
    }

    /// As a process that ended at once, except that there is nothing to be cleaned up after it.
    fn not_started(&mut self, id: MemberId, now_ns: u64) {
        let Some((stage, is_active)) = self.stage_of(id) else { return };
        let stage = &mut self.stages[stage];
        let (slot, failures, start_after_ns) = match is_active {
            true => (&mut stage.active, &mut stage.failures, &mut stage.start_after_ns),
            false => (&mut stage.spare, &mut stage.spare_failures, &mut stage.spare_after_ns),
        };
        *slot = None;
        *failures += 1;
        *start_after_ns = now_ns + self.settings.backoff(*failures + 1);
    }

    fn fill_active(&mut self, id: StageId, now_ns: u64, actions: &mut Vec<Action>) {
        let may_start = self.may_start(id, now_ns);
        let stage = &mut self.stages[id];
        if stage.active.is_some() {
            return;
        }
        if let Some(after) = stage.skip_after.take() {
            actions.push(Action::Skip { stage: id, after });
        }
        match stage.spare.take() {
            Some(spare) if spare.ready && spare.dying_ns.is_none() => {
                actions.push(Action::Promote { id: spare.id, stage: id });
                stage.active = Some(Member { output_at_work: stage.output, ..spare });
                stage.progress_ns = now_ns;
                stage.spare_after_ns = stage.spare_after_ns.max(now_ns + SETTLE_NS);
            }
            // Started only lately; it will be ready sooner than another one.
            Some(spare) => stage.spare = Some(spare),
            None if may_start && now_ns >= stage.start_after_ns => {
                let member = start(&mut self.next_id, id, false, actions);
                stage.active = Some(Member::new(member, stage.output, now_ns));
            }
            None => {}
        }
    }

    fn fill_spare(&mut self, id: StageId, now_ns: u64, actions: &mut Vec<Action>) {
        let keeps_spare = self.keeps_spare(id);
        let stage = &mut self.stages[id];
        if keeps_spare
            && stage.spare.is_none()
            && stage.is_working()
            && now_ns >= stage.spare_after_ns
        {
            let member = start(&mut self.next_id, id, true, actions);
            stage.spare = Some(Member::new(member, stage.output, now_ns));
        }
    }

    fn keeps_spare(&self, stage: StageId) -> bool {
        self.settings.spares.contains(&stage.kind())
    }

    fn kill_the_stuck(&mut self, id: StageId, now_ns: u64, actions: &mut Vec<Action>) {
        let stalled = self.has_stalled(id, now_ns);
        let only_drops = self.is_to_be_replaced_for_drops(id, now_ns);
        let stage = &mut self.stages[id];
        let late = |member: &Member| {
            !member.ready
                && !self.is_blind
                && now_ns - member.started_ns > self.settings.ready_timeout_ns
        };
        let candidates =
            [(&mut stage.active, stalled, only_drops), (&mut stage.spare, false, false)];
        for (member, stalled, only_drops) in candidates {
            let Some(member) = member else { continue };
            let cause = match member.dying_ns {
                Some(since) if now_ns - since > RETIREMENT_NS => Cause::DoesNotEnd,
                Some(_) => continue,
                None if late(member) => Cause::NotReady,
                None if stalled => Cause::Stalled,
                None if only_drops => Cause::OnlyDrops,
                None => continue,
            };
            member.dying_ns = Some(now_ns);
            member.stalled |= cause == Cause::Stalled;
            actions.push(Action::Kill { id: member.id, stage: id, cause });
        }
    }

    /// Replaces an outdated spare, then, when its successor is ready, the outdated active process;
    /// one stage at a time, and the grabber, whose replacement costs frames, last.
    fn renew(&mut self, id: StageId, now_ns: u64, actions: &mut Vec<Action>) {
        let is_outdated = |stage: StageId| {
            let stage = &self.stages[stage];
            [&stage.active, &stage.spare].into_iter().flatten().any(|member| member.outdated)
        };
        let others_first = id.is_grabber()
            && self.settings.graph.stages().any(|other| !other.is_grabber() && is_outdated(other));
        if !is_outdated(id) || others_first || !self.is_complete() {
            return;
        }
        let keeps_spare = self.keeps_spare(id);
        let stage = &mut self.stages[id];
        let retiring = match (&mut stage.active, &mut stage.spare) {
            (_, Some(spare)) if spare.outdated => spare,
            (Some(active), Some(spare)) if active.outdated && spare.ready => active,
            (Some(active), None) if active.outdated && !keeps_spare => active,
            _ => return,
        };
        if retiring.dying_ns.is_none() {
            retiring.dying_ns = Some(now_ns);
            actions.push(Action::Retire { id: retiring.id, stage: id });
        }
    }

    /// The newest frames that a stage can read; a grabber reads none.
    fn input(&self, stage: StageId) -> Numbers {
        let mut input = Numbers::default();
        for lane in self.settings.graph.lanes() {
            let writer = self.settings.graph.input(stage, lane);
            if let Some(seq) = writer.and_then(|writer| self.stages[writer].output.of(lane)) {
                input.raise(FrameId { lane, seq });
            }
        }
        input
    }

    /// Whether a stage's active process has input that it has neither answered nor dropped. A
    /// camera always has.
    fn has_input(&self, id: StageId) -> bool {
        let stage = &self.stages[id];
        if id.is_grabber() {
            return !stage.has_finished;
        }
        let at_ready = stage.active.as_ref().map(|active| active.input_at_ready);
        let done = stage.output.max(stage.dropped_up_to).max(at_ready.unwrap_or_default());
        self.input(id).are_beyond(done)
    }

    /// A camera starts when every stage that works on its frames is there, or when it has waited long enough.
    fn may_start(&self, stage: StageId, now_ns: u64) -> bool {
        if !stage.is_grabber() {
            return true;
        }
        let waited_ns = now_ns - self.started_ns.unwrap_or(now_ns);
        let works_for_it = |id: &StageId| id.serves(stage.lane()) && !id.is_grabber();
        let mut rest = self.settings.graph.stages().filter(works_for_it);
        rest.all(|id| self.stages[id].is_working()) || waited_ns > GRABBER_WAIT_NS
    }
}

impl Settings {
    /// The pause after so many failures in a row; none after the first.
    pub fn backoff(&self, failures: u32) -> u64 {
        match failures {
            0 | 1 => 0,
            _ => {
                self.backoff_ns.saturating_mul(1 << (failures - 2).min(20)).min(self.backoff_max_ns)
            }
        }
    }
}

fn start(
    next_id: &mut MemberId,
    stage: StageId,
    spare: bool,
    actions: &mut Vec<Action>,
) -> MemberId {
    let id = *next_id;
    *next_id += 1;
    actions.push(Action::Start { id, stage, spare });
    id
}

#[cfg(test)]
mod tests;
