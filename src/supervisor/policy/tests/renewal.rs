//! Renewals in the middle of a match, with a process killed at every moment of them.
//!
//! Messages are kept here as iceoryx2 keeps them: a writer delivers to the processes that are connected to
//! it, and what it has sent before to those that connect later, as long as it lives itself.

use super::*;
use std::collections::VecDeque;

const SPARED: [StageId; 3] = [CLASSIFIER, TRACKER, FILTER];
const STEP_NS: u64 = 5 * MS;
/// Time from the start of a process until it is connected.
const START_NS: u64 = 60 * MS;
/// Messages kept for late readers.
const HISTORY: usize = 64;

/// A process of the match.
struct Worker {
    id: MemberId,
    stage: StageId,
    is_spare: bool,
    ready_ns: u64,
    is_ready: bool,
    /// Asked to end after its next message.
    is_ending: bool,
    inbox: BTreeSet<u64>,
    sent: VecDeque<u64>,
    /// Inputs up to here are handled.
    done: u64,
}

/// A match in which every message takes a step from stage to stage.
struct Match {
    policy: Policy,
    now_ns: u64,
    steps: u64,
    workers: Vec<Worker>,
    /// The newest output of each stage.
    newest: StageMap<u64>,
    /// Frames in `world`.
    world: Vec<u64>,
    retired: Vec<StageId>,
}

impl Match {
    fn new() -> Self {
        let mut it = Self {
            policy: Policy::new(settings(GRAPH, &SPARED)),
            now_ns: 1000 * MS,
            steps: 0,
            workers: vec![],
            newest: StageMap::of_defaults(GRAPH),
            world: vec![],
            retired: vec![],
        };
        it.run(200);
        assert!(it.policy.is_complete() && it.world.len() > 20);
        assert!(SPARED.iter().all(|&stage| it.spare_of(stage).is_some_and(|spare| spare.is_ready)));
        it
    }

    fn run(&mut self, steps: u64) {
        for _ in 0..steps {
            self.now_ns += STEP_NS;
            self.steps += 1;
            self.connect();
            // From the last stage to the first, so there is a message on every way.
            for stage in GRAPH.stages().rev() {
                self.work(stage);
            }
            for action in self.policy.tick(self.now_ns) {
                self.carry_out(action);
            }
        }
    }

    /// Connects the processes that have started to the writers that live.
    fn connect(&mut self) {
        for index in 0..self.workers.len() {
            let Worker { id, stage, ready_ns, is_ready, .. } = self.workers[index];
            if is_ready || self.now_ns < ready_ns {
                continue;
            }
            let writer = GRAPH.input(stage, 0);
            let kept: Vec<u64> = self
                .workers
                .iter()
                .filter(|it| Some(it.stage) == writer)
                .flat_map(|it| it.sent.iter().copied())
                .collect();
            let worker = &mut self.workers[index];
            worker.is_ready = true;
            worker.done = self.newest[stage];
            worker.inbox.extend(kept);
            self.policy.note(Event::Ready(id), self.now_ns);
        }
    }

    /// Has the active process of a stage work on one message.
    fn work(&mut self, stage: StageId) {
        let is_at_work = |it: &Worker| it.stage == stage && !it.is_spare && it.is_ready;
        let Some(index) = self.workers.iter().position(is_at_work) else { return };
        let worker = &mut self.workers[index];
        let done = worker.done;
        worker.inbox.retain(|&seq| seq > done);
        let seq = match stage.is_grabber() {
            true => self.steps.is_multiple_of(2).then(|| self.newest[stage] + 1),
            false => worker.inbox.first().copied(),
        };
        if let Some(seq) = seq {
            worker.done = seq;
            worker.sent.push_back(seq);
            if worker.sent.len() > HISTORY {
                worker.sent.pop_front();
            }
            let is_reader =
                |it: &&mut Worker| it.is_ready && GRAPH.input(it.stage, 0) == Some(stage);
            self.workers.iter_mut().filter(is_reader).for_each(|it| _ = it.inbox.insert(seq));
            self.newest[stage] = seq;
            if stage == FILTER {
                self.world.push(seq);
            }
            self.policy.note(Event::Output(stage, first_lane(seq)), self.now_ns);
            self.policy.note(Event::CheckedIn(stage, self.now_ns), self.now_ns);
        }
        if self.workers[index].is_ending {
            self.end(self.workers[index].id);
        }
    }

    fn carry_out(&mut self, action: Action) {
        match action {
            Action::Start { id, stage, spare } => self.workers.push(Worker {
                id,
                stage,
                is_spare: spare,
                ready_ns: self.now_ns + START_NS,
                is_ready: false,
                is_ending: false,
                inbox: BTreeSet::new(),
                sent: VecDeque::new(),
                done: 0,
            }),
            Action::Promote { id, stage } => {
                let done = self.newest[stage];
                let worker = self.workers.iter_mut().find(|it| it.id == id).unwrap();
                (worker.is_spare, worker.done) = (false, done);
            }
            Action::Retire { id, stage } => {
                let worker = self.workers.iter_mut().find(|it| it.id == id).unwrap();
                match worker.is_spare {
                    true => self.end(id),
                    false => {
                        worker.is_ending = true;
                        self.retired.push(stage);
                    }
                }
            }
            Action::Kill { id, .. } => self.end(id),
            Action::Skip { .. } | Action::CleanUp => {}
        }
    }

    fn end(&mut self, id: MemberId) {
        self.workers.retain(|it| it.id != id);
        self.policy.note(Event::Exited { id, crashed: false }, self.now_ns);
    }

    fn spare_of(&self, stage: StageId) -> Option<&Worker> {
        self.workers.iter().find(|it| it.stage == stage && it.is_spare)
    }

    /// Kills the active process of a stage, if there is one.
    fn kill(&mut self, stage: StageId) {
        let active = self.workers.iter().find(|it| it.stage == stage && !it.is_spare);
        if let Some(id) = active.map(|it| it.id) {
            self.end(id);
        }
    }

    /// Gives these stages another configuration.
    fn reload(&mut self, stages: &[StageId]) {
        for worker in self.workers.iter().filter(|it| stages.contains(&it.stage)) {
            self.policy.outdate(worker.id, self.now_ns);
        }
    }

    fn missing(&self) -> Vec<u64> {
        let (first, last) = (self.world[0], *self.world.last().unwrap());
        (first..=last).filter(|seq| !self.world.contains(seq)).collect()
    }
}

/// The kinds of change: which stages are concerned.
const CHANGES: [&[StageId]; 5] =
    [&SPARED, &[CLASSIFIER, TRACKER], &[TRACKER, FILTER], &[CLASSIFIER, FILTER], &[FILTER]];

#[test]
fn a_kill_at_any_moment_of_a_renewal_loses_no_frame() {
    for change in CHANGES {
        for killed in SPARED {
            for moment in 0..200 {
                let mut it = Match::new();
                it.reload(change);
                it.run(moment);
                it.kill(killed);
                it.run(400);
                let missing = it.missing();
                assert!(missing.is_empty(), "{change:?}, {killed} at {moment}: {missing:?}");
                assert_eq!(it.policy.pending_stages(it.now_ns), [], "{change:?}, {killed}");
            }
        }
    }
}

#[test]
fn a_kill_while_one_change_follows_the_other_loses_no_frame() {
    for apart in [1, 5, 13, 14, 15, 16, 17, 18, 25, 40, 60] {
        for killed in SPARED {
            for moment in 0..100 {
                let mut it = Match::new();
                it.reload(&SPARED);
                it.run(apart);
                it.reload(&[TRACKER, FILTER]);
                it.run(moment);
                it.kill(killed);
                it.run(400);
                let missing = it.missing();
                assert!(missing.is_empty(), "{killed} at {moment}, {apart}: {missing:?}");
                assert_eq!(it.policy.pending_stages(it.now_ns), [], "{killed} at {moment}");
            }
        }
    }
}
