//! The supervisor's decisions: which process to start, promote, retire or kill, and when.
//!
//! Input: events and the time. Output: actions, which the caller carries out. Nothing here touches a
//! process, a clock or a topic, so a test can play through every situation.
//!
//! The rules:
//! * A stage has one active process, and may have a spare that is connected but idle.
//! * A process that ends, does not get ready, or has input and gives no output within the stall
//!   deadline is replaced: by its spare at once, else by a new start. A stalled process is killed
//!   first, and its successor publishes only after it is confirmed dead.
//! * Output is progress. An invalid input counts as handled when it is dropped; a stage that drops
//!   everything is replaced once and then reported as degraded ([`dropping`]).
//! * Two deaths in a row on the same input make the next process skip that input.
//! * Back-off: the pause before the next start doubles with every failed start in a row; the rest of the
//!   group goes on. The same holds for a stage whose processes start well but die more often than any
//!   disturbance from outside explains ([`intensity`]).
//! * A streaming camera has its own rate: a grabber that neither gives a frame nor checks in for five of
//!   its periods is stuck. A grabber that checks in is waiting for its camera.
//! * While the supervisor cannot see heartbeats, no process is killed for not being ready.
//! * A process with an old program or configuration is replaced by a spare with the new one, one stage at a
//!   time ([`renewal`]).
//! * The grabber starts last, when every stage that works on its frames is ready for the first one.
//! * A fault in one lane affects only the readers of that lane: the other lanes go on.

mod degraded;
mod dropping;
mod intensity;
mod renewal;
mod slowness;
mod stage;
mod stalls;

pub use degraded::{Degraded, Lack};

use messages::ProcessKind;
use messages::stages::{FrameId, Numbers, StageGraph, StageId, StageMap};
use stage::{Member, Old, Stage};

/// Identifies a process from its start to its end; never used twice.
pub type MemberId = u64;

/// Limits and times of the rules, in nanoseconds.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Stall deadline: longest time with input and without output.
    pub stall_ns: u64,
    /// Stall deadline of a grabber: longest time without a frame.
    pub grabber_stall_ns: u64,
    /// Shortest stuck deadline of a grabber whose camera streams; the deadline is five of its
    /// periods where that is longer.
    pub grabber_stuck_ns: u64,
    /// Longest time from start to ready.
    pub ready_timeout_ns: u64,
    /// Pause after the second failed start in a row; doubles with every further one.
    pub backoff_ns: u64,
    /// Longest pause between starts.
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
    /// The active process of a stage has checked in, last at this time.
    CheckedIn(StageId, u64),
    /// A process is confirmed dead.
    Exited {
        /// The process.
        id: MemberId,
        /// Whether it failed by itself (a panic, a fault) instead of being killed from outside.
        crashed: bool,
    },
    /// A stage's newest output contains this frame.
    Output(StageId, FrameId),
    /// A stage has dropped input that is invalid for every process.
    Dropped(StageId),
    /// A grabber says that its camera is away.
    CameraIsAway(StageId),
    /// A stage was ready to run for this time, in nanoseconds, without getting a processor.
    Waited(StageId, u64),
    /// A grabber has captured all requested frames.
    Finished(StageId),
}

/// Why a process is killed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// It has input but gives no output.
    Stalled,
    /// It drops everything it gets.
    OnlyDrops,
    /// Started, but never ready.
    NotReady,
    /// Asked to end, but did not.
    DoesNotEnd,
}

/// A decision for the supervisor to carry out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Start a process.
    Start {
        /// Its identifier.
        id: MemberId,
        /// Its stage.
        stage: StageId,
        /// Start it as a spare, which waits for promotion.
        spare: bool,
    },
    /// Promote a spare to active.
    Promote {
        /// The spare.
        id: MemberId,
        /// Its stage.
        stage: StageId,
    },
    /// Kill a process with SIGKILL.
    Kill {
        /// The process.
        id: MemberId,
        /// Its stage.
        stage: StageId,
        /// The reason.
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
    /// Remove the garbage of dead processes from shared memory.
    CleanUp,
}

/// Uptime that resets the back-off: the next failure counts as the first. An output resets it too.
const GOOD_START_NS: u64 = 5_000_000_000;
/// Pause between a death and the slow work after it (next spare, clean-up), so that it does not
/// compete with the successor for the processor.
const SETTLE_NS: u64 = 100_000_000;
/// Longest normal time between two ticks. After a longer one the whole machine was busy or asleep,
/// and the time does not count against any stage.
const OWN_LAG_NS: u64 = 40_000_000;
/// Time a retired process has to end before it is killed.
const RETIREMENT_NS: u64 = 1_000_000_000;
/// Longest time the grabber's start waits for stages that are not ready.
const GRABBER_WAIT_NS: u64 = 5_000_000_000;
/// Time after which an active process without output, and without the input for one, counts as renewed.
const FIRST_WORK_NS: u64 = 1_000_000_000;

/// The rules, with their view of the group's state.
#[derive(Debug)]
pub struct Policy {
    settings: Settings,
    /// The supervisor cannot see heartbeats.
    is_blind: bool,
    stages: StageMap<Stage>,
    next_id: MemberId,
    started_ns: Option<u64>,
    last_tick_ns: u64,
    clean_up_at_ns: Option<u64>,
    /// When something was last to be renewed, or a renewal went a step further.
    renewing_ns: Option<u64>,
}

impl Policy {
    /// A group without processes; the first [`tick`](Self::tick) starts it.
    pub fn new(settings: Settings) -> Self {
        Self {
            stages: StageMap::of_defaults(settings.graph),
            settings,
            is_blind: false,
            next_id: 1,
            started_ns: None,
            last_tick_ns: 0,
            clean_up_at_ns: None,
            renewing_ns: None,
        }
    }

    /// Records an event and its time. The next [`tick`](Self::tick) returns the actions that
    /// follow.
    pub fn note(&mut self, event: Event, now_ns: u64) {
        match event {
            Event::Ready(id) => self.ready(id, now_ns),
            Event::Exited { id, crashed } => self.exited(id, crashed, now_ns),
            Event::NotStarted(id) => self.not_started(id, now_ns),
            Event::CheckedIn(stage, at_ns) => {
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

    /// Adopts a process that an earlier supervisor started, `outdated` if its program is another one than
    /// the supervisor's. Returns its identifier, or `None` if the stage has no free slot for it.
    pub fn adopt(
        &mut self,
        stage: StageId,
        spare: bool,
        outdated: bool,
        now_ns: u64,
    ) -> Option<MemberId> {
        // Started by hand, with `--lane`.
        if !self.settings.graph.has(stage) {
            return None;
        }
        let stage = &mut self.stages[stage];
        let slot = if spare { &mut stage.spare } else { &mut stage.active };
        if slot.is_some() {
            return None;
        }
        let id = self.next_id;
        self.next_id += 1;
        let old = outdated.then_some(Old::Program);
        *slot = Some(Member { ready: true, old, ..Member::new(id, stage.output, now_ns) });
        stage.progress_ns = now_ns;
        Some(id)
    }

    /// Whether a stage has turned out to be slow, so that its stalls say little about what changed last.
    pub fn is_slow(&self, stage: StageId) -> bool {
        self.stages[stage].slowness.is_slow()
    }

    /// Changes deadlines and spares.
    pub fn set_settings(&mut self, settings: Settings) {
        self.settings = settings;
    }

    /// Sets whether the supervisor cannot see heartbeats. While it cannot, no process can become
    /// ready, so the ready timeout is suspended.
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

    /// Actions to carry out now. Call it after events, and every few milliseconds.
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
        // From the last stage to the first: a stage is started before its input.
        for stage in self.settings.graph.stages().rev() {
            self.fill_active(stage, now_ns, &mut actions);
            self.fill_spare(stage, now_ns, &mut actions);
            self.kill_stuck(stage, now_ns, &mut actions);
        }
        for stage in self.settings.graph.stages() {
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
                    // A spare can get ready: deaths of active processes do not delay it.
                    stage.spare_failures = 0;
                    member.ready = true;
                    member.input_at_ready = input;
                    stage.progress_ns = now_ns;
                }
            }
        }
    }

    fn output(&mut self, stage: StageId, frame: FrameId, sent_ns: u64) {
        // The stall deadline of an idle stage runs from the arrival of its input.
        let readers: Vec<StageId> = self.settings.graph.readers(stage).collect();
        let idle: Vec<StageId> =
            readers.into_iter().filter(|&reader| !self.has_input(reader)).collect();
        let stage = &mut self.stages[stage];
        let before = stage.output.of(frame.lane);
        if before < Some(frame.seq) {
            stage.note_period(frame.seq, before, sent_ns);
            let took_ns = sent_ns.saturating_sub(stage.progress_ns);
            stage.slowness.note_output(took_ns, self.settings.stall_ns);
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
        // Further deaths do not postpone the clean-up: in a storm of deaths, dead processes would
        // soon hold every publisher slot of a topic.
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
        *failures = match () {
            // An end on request is no failure.
            () if member.is_retired => 0,
            () if good_start => 1,
            () => *failures + 1,
        };
        *start_after_ns = now_ns + settings.backoff(*failures);
        if !was_active {
            return;
        }
        stage.dropping = None;
        stage.slowness.note_end(member.stalled);
        // A kill from outside is not the process's own fault.
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

    /// Counts as a process that ended at once, except that it leaves no garbage.
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
                stage.active =
                    Some(Member { output_at_work: stage.output, at_work_ns: now_ns, ..spare });
                stage.progress_ns = now_ns;
                stage.spare_after_ns = stage.spare_after_ns.max(now_ns + SETTLE_NS);
            }
            // It is still starting, and will be ready sooner than a new one.
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

    fn kill_stuck(&mut self, id: StageId, now_ns: u64, actions: &mut Vec<Action>) {
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

    /// Newest frames available to a stage, by lane; none for a grabber.
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

    /// Whether a stage's active process has pending input: neither answered nor dropped. Always
    /// true for a grabber.
    fn has_input(&self, id: StageId) -> bool {
        let stage = &self.stages[id];
        if id.is_grabber() {
            return !stage.has_finished;
        }
        let at_ready = stage.active.as_ref().map(|active| active.input_at_ready);
        let done = stage.output.max(stage.dropped_up_to).max(at_ready.unwrap_or_default());
        self.input(id).are_beyond(done)
    }

    /// Whether a stage may start: a grabber waits, for a limited time, until every stage that works
    /// on its frames is ready.
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
    /// Pause after `failures` failures in a row; none after the first.
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
