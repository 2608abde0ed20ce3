//! Renewal: processes with an old program or an old configuration are replaced without losing a frame.
//!
//! Outdated spares are replaced first, all of them at once, then the active processes, one after the other.
//!
//! A message is in the buffers of the processes that were connected to its writer, and in the writer itself.
//! A process that starts later gets what living writers have sent before, but nothing of a writer that has
//! ended. So that no message is lost if a process is killed in the middle of a renewal:
//! * a writer is retired only when each of its readers has a spare, which has the same unread messages;
//! * no process of a stage is retired before the stage has handled all that a writer before the present one
//!   has left.
//!
//! The order of the active processes:
//! * With a new configuration, the first stage comes first: its reader still has the spare that takes over
//!   next, so nothing has to be waited for. A stage can work on what was made with either configuration.
//! * With a new program, the last stage comes first: it can read what the stage before it will say with its
//!   new program. The stage before it waits for its next spare.
//! * The grabber comes last, because replacing it costs frames.

use super::stage::Old;
use super::{Action, FIRST_WORK_NS, MemberId, Policy, Stage};
use messages::stages::StageId;

/// Longest time for which a renewal waits for the spares of the stage's readers: they may fail, perhaps
/// because of what the process that is to be replaced sends.
const HELD_NS: u64 = 2_000_000_000;
/// Longest time for which a stage is waited for that does not handle what a dead writer has left: it may
/// never have got it.
const CATCH_UP_NS: u64 = 1_000_000_000;
/// Time for which a step that does not come is expected at any moment.
const EAGER_NS: u64 = 1_000_000_000;

impl Policy {
    /// Retires a stage's active process in favour of its spare. Without an active process, while
    /// starts are paused, the next start comes at once.
    pub fn renew_stage(&mut self, stage: StageId, now_ns: u64) {
        self.renewing_ns = Some(now_ns);
        let stage = &mut self.stages[stage];
        match &mut stage.active {
            Some(active) => active.old = active.old.max(Some(Old::Configuration)),
            None => {
                stage.failures = 0;
                stage.start_after_ns = now_ns;
            }
        }
    }

    /// Marks a process that is to be replaced because its configuration is an old one.
    pub fn outdate(&mut self, id: MemberId, now_ns: u64) {
        for stage in self.stages.values_mut() {
            for member in [&mut stage.active, &mut stage.spare].into_iter().flatten() {
                if member.id == id && member.old.is_none() {
                    member.old = Some(Old::Configuration);
                    self.renewing_ns = Some(now_ns);
                }
            }
        }
    }

    /// The stages that are not renewed yet: whose active process is to be replaced, or has only just
    /// become active and given no output.
    pub fn pending_stages(&self, now_ns: u64) -> Vec<StageId> {
        let is_pending = |stage: &Stage| match &stage.active {
            Some(active) => {
                // Without frames there is no output to wait for.
                let is_untried = !active.has_worked(stage.output)
                    && now_ns < active.at_work_ns.saturating_add(FIRST_WORK_NS);
                active.old.is_some() || !active.ready || is_untried
            }
            None => true,
        };
        self.stages.iter().filter(|(_, stage)| is_pending(stage)).map(|(id, _)| id).collect()
    }

    /// Whether the next step of a start or of a renewal is expected at any moment, so that it is worth looking
    /// more often than usual.
    pub fn is_eager(&self, now_ns: u64) -> bool {
        let is_recent = |since_ns: u64| now_ns.saturating_sub(since_ns) < EAGER_NS;
        let is_renewing = self.renewing_ns.is_some_and(is_recent);
        self.stages.values().any(|stage| {
            [&stage.active, &stage.spare].into_iter().flatten().any(|member| {
                !member.ready && is_recent(member.started_ns) || member.old.is_some() && is_renewing
            })
        })
    }

    /// Replaces outdated processes: first the spare, and when the new spare is ready, the active process.
    pub(super) fn renew(&mut self, id: StageId, now_ns: u64, actions: &mut Vec<Action>) {
        if !self.is_complete() || !self.has_caught_up(id, now_ns) {
            return;
        }
        let is_free = |spare: &super::Member| spare.ready && spare.dying_ns.is_none();
        let stage = &self.stages[id];
        let is_old = stage.active.as_ref().is_some_and(|active| active.old.is_some());
        let is_spare = match &stage.spare {
            Some(spare) if spare.old.is_some() => true,
            Some(spare) if is_old && is_free(spare) => false,
            None if is_old && !self.keeps_spare(id) => false,
            _ => return,
        };
        if !is_spare && (self.comes_later(id) || self.is_held(id, now_ns)) {
            return;
        }
        let stage = &mut self.stages[id];
        let retiring = if is_spare { &mut stage.spare } else { &mut stage.active };
        if let Some(member) = retiring
            && member.dying_ns.is_none()
        {
            member.dying_ns = Some(now_ns);
            member.is_retired = true;
            stage.held_since_ns = None;
            self.renewing_ns = Some(now_ns);
            actions.push(Action::Retire { id: member.id, stage: id });
        }
    }

    /// Whether the active process of another stage is to be replaced before that of this one.
    fn comes_later(&self, id: StageId) -> bool {
        let own = self.what_is_old(id);
        self.settings.graph.stages().any(|other| {
            let old = self.what_is_old(other);
            let is_after = other.kind() > id.kind() && (id.is_grabber() || other.serves(id.lane()));
            let is_before = other.kind() < id.kind() && id.serves(other.lane());
            match id.is_grabber() {
                true => is_after && old.is_some(),
                false if own == Some(Old::Program) => is_after && old == own,
                false => is_before && !other.is_grabber() && old == own,
            }
        })
    }

    fn what_is_old(&self, id: StageId) -> Option<Old> {
        let stage = &self.stages[id];
        [&stage.active, &stage.spare].into_iter().flatten().filter_map(|member| member.old).max()
    }

    /// Whether a stage lacks a spare without which messages of this stage could be lost if it were killed
    /// now. It is waited for, but not for ever.
    fn is_held(&mut self, id: StageId, now_ns: u64) -> bool {
        let lacks_spare = |reader: StageId| {
            let spare = &self.stages[reader].spare;
            let has_spare =
                spare.as_ref().is_some_and(|spare| spare.ready && spare.dying_ns.is_none());
            self.keeps_spare(reader) && !has_spare
        };
        let is_alone = self.settings.graph.readers(id).any(lacks_spare);
        let stage = &mut self.stages[id];
        if !is_alone {
            stage.held_since_ns = None;
            return false;
        }
        let since_ns = *stage.held_since_ns.get_or_insert(now_ns);
        now_ns.saturating_sub(since_ns) < HELD_NS
    }

    /// Whether a stage has handled all that writers before the present ones have left: another process of it,
    /// started from now on, would not get it.
    fn has_caught_up(&self, id: StageId, now_ns: u64) -> bool {
        let stage = &self.stages[id];
        let done = stage.output.max(stage.dropped_up_to);
        self.settings.graph.lanes().all(|lane| {
            let writer = self.settings.graph.input(id, lane);
            let active = writer.and_then(|writer| self.stages[writer].active.as_ref());
            active.is_none_or(|writer| {
                writer.output_at_work.of(lane) <= done.of(lane)
                    || now_ns.saturating_sub(writer.at_work_ns) > CATCH_UP_NS
            })
        })
    }
}
