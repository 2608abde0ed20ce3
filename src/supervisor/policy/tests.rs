//! Sequences of events played through the rules.

use super::*;

mod lanes;
mod renewal;

use std::collections::BTreeSet;

const MS: u64 = 1_000_000;
const GRAPH: StageGraph = StageGraph::SINGLE;
const GRABBER: StageId = StageId::new(ProcessKind::Grabber, 0);
const CLASSIFIER: StageId = StageId::new(ProcessKind::Classifier, 0);
const TRACKER: StageId = StageId::new(ProcessKind::Tracker, 0);
const FILTER: StageId = StageId::FILTER;

fn settings(graph: StageGraph, spares: &[StageId]) -> Settings {
    Settings {
        stall_ns: 40 * MS,
        grabber_stall_ns: 1000 * MS,
        grabber_stuck_ns: 100 * MS,
        ready_timeout_ns: 10_000 * MS,
        backoff_ns: 100 * MS,
        backoff_max_ns: 5000 * MS,
        graph,
        spares: spares.iter().map(|stage| stage.kind()).collect(),
    }
}

/// Plays time forward in steps of 5 ms, answering starts with readiness, and collects actions.
struct Play {
    policy: Policy,
    now_ns: u64,
    actions: Vec<Action>,
}

impl Play {
    fn new(spares: &[StageId]) -> Self {
        Self::with(GRAPH, spares)
    }

    fn with(graph: StageGraph, spares: &[StageId]) -> Self {
        let policy = Policy::new(settings(graph, spares));
        let mut play = Self { policy, now_ns: 1000 * MS, actions: vec![] };
        play.run(200);
        assert!(play.policy.is_complete());
        play
    }

    fn run(&mut self, ms: u64) -> Vec<Action> {
        let mut new = vec![];
        for _ in 0..ms / 5 {
            self.now_ns += 5 * MS;
            for action in self.policy.tick(self.now_ns) {
                match action {
                    Action::Start { id, .. } => self.policy.note(Event::Ready(id), self.now_ns),
                    Action::Kill { id, .. } | Action::Retire { id, .. } => {
                        let ended = Event::Exited { id, crashed: false };
                        self.policy.note(ended, self.now_ns);
                    }
                    _ => {}
                }
                new.push(action);
            }
        }
        self.actions.extend(&new);
        new
    }

    fn output(&mut self, stage: StageId, seq: u64) {
        let frame = FrameId { lane: stage.lane(), seq };
        self.policy.note(Event::Output(stage, frame), self.now_ns);
    }

    fn exit(&mut self, stage: StageId) {
        self.end(stage, false);
    }

    fn end(&mut self, stage: StageId, crashed: bool) {
        let id = self.policy.stages[stage].active.as_ref().unwrap().id;
        self.policy.note(Event::Exited { id, crashed }, self.now_ns);
    }
}

fn first_lane(seq: u64) -> FrameId {
    FrameId { lane: 0, seq }
}

fn started(actions: &[Action]) -> Vec<(StageId, bool)> {
    actions
        .iter()
        .filter_map(|action| match *action {
            Action::Start { stage, spare, .. } => Some((stage, spare)),
            _ => None,
        })
        .collect()
}

#[test]
fn the_camera_starts_when_every_stage_downstream_is_ready() {
    let play = Play::new(&[]);
    let order: Vec<_> = started(&play.actions).into_iter().map(|(stage, _)| stage).collect();
    assert_eq!(order, [FILTER, TRACKER, CLASSIFIER, GRABBER]);
}

#[test]
fn a_dead_stage_is_restarted_at_once_and_then_with_growing_pauses() {
    let mut play = Play::new(&[]);
    let mut pauses = vec![];
    for _ in 0..5 {
        play.exit(TRACKER);
        let died = play.now_ns;
        while started(&play.run(5)).is_empty() {}
        pauses.push((play.now_ns - died) / MS);
    }
    assert_eq!(pauses, [5, 100, 200, 400, 800]);
    play.run(6000);
    play.exit(TRACKER);
    assert_eq!(started(&play.run(5)), [(TRACKER, false)]);
}

#[test]
fn a_spare_takes_over_and_the_next_one_is_started_later() {
    let mut play = Play::new(&[FILTER]);
    play.exit(FILTER);
    let actions = play.run(5);
    assert!(matches!(actions[..], [Action::Promote { stage: FILTER, .. }]), "{actions:?}");
    assert_eq!(started(&play.run(200)), [(FILTER, true)]);
}

#[test]
fn input_without_output_is_a_stall_but_no_input_is_not() {
    let mut play = Play::new(&[]);
    for stage in [GRABBER, CLASSIFIER] {
        play.output(stage, 7);
    }
    play.run(500);
    play.output(GRABBER, 8);
    let kills = |actions: &[Action]| {
        actions.iter().filter(|action| matches!(action, Action::Kill { .. })).count()
    };
    assert_eq!(kills(&play.run(40)), 0);
    let actions = play.run(10);
    assert!(
        actions.iter().any(|action| matches!(
            action,
            Action::Kill { stage: CLASSIFIER, cause: Cause::Stalled, .. }
        )),
        "{actions:?}"
    );
}

#[test]
fn dropping_bad_input_is_progress() {
    let mut play = Play::new(&[]);
    for seq in 0..50 {
        play.output(GRABBER, seq);
        play.policy.note(Event::Dropped(CLASSIFIER), play.now_ns);
        let actions = play.run(10);
        assert!(actions.is_empty(), "{actions:?}");
    }
}

#[test]
fn a_stage_that_drops_everything_is_replaced_once_and_then_degraded() {
    let mut play = Play::new(&[]);
    let mut seq = 0;
    let mut drop_all = |play: &mut Play, times: u64| {
        let mut kills = vec![];
        for _ in 0..times {
            seq += 1;
            play.output(GRABBER, seq);
            play.policy.note(Event::Dropped(CLASSIFIER), play.now_ns);
            let actions = play.run(15);
            kills.extend(actions.into_iter().filter_map(|action| match action {
                Action::Kill { stage, cause, .. } => Some((stage, cause)),
                _ => None,
            }));
        }
        kills
    };
    for stage in GRAPH.stages() {
        play.output(stage, 0);
    }
    assert_eq!(drop_all(&mut play, 60), [], "it may be a few bad frames");
    assert_eq!(play.policy.degraded(play.now_ns), []);
    assert_eq!(drop_all(&mut play, 120), [(CLASSIFIER, Cause::OnlyDrops)]);
    assert_eq!(drop_all(&mut play, 400), [], "another one would do no better");
    let [degraded] = play.policy.degraded(play.now_ns)[..] else { panic!("it is said") };
    assert_eq!((degraded.stage, degraded.what), (CLASSIFIER, Lack::Output));
    play.output(CLASSIFIER, 700);
    assert_eq!(play.policy.degraded(play.now_ns), []);
}

#[test]
fn drops_long_ago_are_no_reason_to_replace_a_process() {
    let mut play = Play::new(&[]);
    for stage in GRAPH.stages() {
        play.output(stage, 0);
    }
    for seq in 1..=30 {
        play.output(GRABBER, seq);
        play.policy.note(Event::Dropped(CLASSIFIER), play.now_ns);
    }
    let wait = |play: &mut Play| {
        for _ in 0..100 {
            play.policy.note(Event::CameraIsAway(GRABBER), play.now_ns);
            play.policy.note(Event::CheckedIn(GRABBER, play.now_ns), play.now_ns);
            let actions = play.run(50);
            assert!(actions.is_empty(), "{actions:?}");
        }
    };
    wait(&mut play);
    play.output(GRABBER, 31);
    play.policy.note(Event::Dropped(CLASSIFIER), play.now_ns);
    wait(&mut play);
}

#[test]
fn dropped_and_unreceived_inputs_are_not_pending() {
    let mut play = Play::new(&[]);
    play.output(GRABBER, 5);
    play.policy.note(Event::Dropped(CLASSIFIER), play.now_ns);
    assert!(play.run(500).is_empty(), "the last frame was dropped");
    play.output(GRABBER, 6);
    play.exit(CLASSIFIER);
    let actions = play.run(50);
    assert_eq!(started(&actions), [(CLASSIFIER, false)]);
    assert!(play.run(500).iter().all(|action| *action == Action::CleanUp), "6 was before it");
    play.output(GRABBER, 7);
    let actions = play.run(250);
    assert!(actions.iter().any(|action| matches!(action, Action::Kill { .. })), "{actions:?}");
}

#[test]
fn an_input_that_has_killed_two_processes_is_skipped() {
    let mut play = Play::new(&[TRACKER]);
    play.output(TRACKER, 41);
    play.output(CLASSIFIER, 42);
    let skips = |actions: &[Action]| {
        actions.contains(&Action::Skip { stage: TRACKER, after: FrameId { lane: 0, seq: 41 } })
    };
    play.end(TRACKER, true);
    assert!(!skips(&play.run(20)), "once is chance");
    play.end(TRACKER, true);
    let actions = play.run(150);
    let first = actions.iter().find(|action| **action != Action::CleanUp);
    assert!(
        matches!(first, Some(Action::Skip { after: FrameId { lane: 0, seq: 41 }, .. })),
        "the successor must find it before it works: {actions:?}"
    );
}

#[test]
fn kills_from_outside_are_not_blamed_on_the_input() {
    let mut play = Play::new(&[TRACKER]);
    play.output(TRACKER, 41);
    play.output(CLASSIFIER, 42);
    for round in 0..3 {
        play.exit(TRACKER);
        let actions = play.run(150 << round);
        assert!(!actions.iter().any(|action| matches!(action, Action::Skip { .. })));
    }
}

#[test]
fn outdated_processes_are_renewed_stage_by_stage() {
    let spares = [CLASSIFIER, TRACKER, FILTER];
    let mut play =
        Play { policy: Policy::new(settings(GRAPH, &spares)), now_ns: 1000 * MS, actions: vec![] };
    for stage in GRAPH.stages() {
        assert!(play.policy.adopt(stage, false, true, play.now_ns).is_some());
        assert!(play.policy.adopt(stage, false, true, play.now_ns).is_none(), "one is enough");
        if spares.contains(&stage) {
            play.policy.adopt(stage, true, true, play.now_ns);
        }
    }
    let actions = play.run(3000);
    let retired: Vec<StageId> = actions
        .iter()
        .filter_map(|action| match *action {
            Action::Retire { stage, .. } => Some(stage),
            _ => None,
        })
        .collect();
    assert_eq!(retired.len(), 7, "{retired:?}");
    // All spares at once, then the active processes from the last stage to the first.
    assert_eq!(retired[3..], [FILTER, TRACKER, CLASSIFIER, GRABBER]);
    assert!(play.policy.is_complete());
    assert!(
        !actions.iter().any(|action| matches!(
            action,
            Action::Start { stage: CLASSIFIER | TRACKER | FILTER, spare: false, .. }
        )),
        "each was handed over to a spare: {actions:?}"
    );
}

#[test]
fn a_stage_is_renewed_on_request_by_its_spare_and_only_once() {
    let mut play = Play::new(&[FILTER]);
    play.policy.renew_stage(FILTER, play.now_ns);
    let actions = play.run(20);
    assert!(
        matches!(
            actions[..],
            [Action::Retire { stage: FILTER, .. }, Action::Promote { stage: FILTER, .. }]
        ),
        "{actions:?}"
    );
    assert_eq!(started(&play.run(300)), [(FILTER, true)], "and all is as before");
}

#[test]
fn a_stage_without_spare_is_renewed_by_a_new_start() {
    let mut play = Play::new(&[]);
    play.run(500);
    play.policy.renew_stage(GRABBER, play.now_ns);
    assert_eq!(started(&play.run(20)), [(GRABBER, false)]);
}

#[test]
fn a_stage_that_waits_for_its_next_start_is_started_at_once_on_request() {
    let mut play = Play::new(&[]);
    for _ in 0..5 {
        play.exit(TRACKER);
        while started(&play.run(5)).is_empty() {}
    }
    play.exit(TRACKER);
    assert!(started(&play.run(100)).is_empty(), "it waits");
    play.policy.renew_stage(TRACKER, play.now_ns);
    assert_eq!(started(&play.run(5)), [(TRACKER, false)]);
}

#[test]
fn time_without_a_processor_does_not_count() {
    let mut play = Play::new(&[]);
    play.output(GRABBER, 1);
    let mut excused = 0;
    for _ in 0..25 {
        let actions = play.run(15);
        assert!(actions.is_empty(), "{actions:?}");
        if play.policy.late(CLASSIFIER, play.now_ns).is_some() {
            play.policy.note(Event::Waited(CLASSIFIER, 15 * MS), play.now_ns);
            excused += 1;
        }
    }
    assert!(excused > 10, "{excused}");
}

#[test]
fn no_stage_stalls_because_the_whole_machine_was_away() {
    let mut play = Play::new(&[]);
    play.output(GRABBER, 1);
    play.now_ns += 3000 * MS;
    let actions = play.run(20);
    assert!(!actions.iter().any(|action| matches!(action, Action::Kill { .. })), "{actions:?}");
}

#[test]
fn cleaning_up_is_not_put_off_by_further_deaths() {
    let mut play = Play::new(&[]);
    play.run(500);
    let mut actions = vec![];
    for stage in [CLASSIFIER, TRACKER, FILTER] {
        play.exit(stage);
        actions.extend(play.run(50));
    }
    assert!(actions.contains(&Action::CleanUp), "{actions:?}");
}

#[test]
fn garbage_is_cleaned_up_after_the_successor_has_settled() {
    let mut play = Play::new(&[]);
    play.run(500);
    play.exit(CLASSIFIER);
    assert!(!play.run(50).contains(&Action::CleanUp));
    assert!(play.run(100).contains(&Action::CleanUp));
}

#[test]
fn the_deadline_runs_from_the_time_sent_however_late_it_is_seen() {
    let mut play = Play::new(&[]);
    for stage in GRAPH.stages() {
        play.output(stage, 1);
    }
    play.run(5);
    let last_look_ns = play.now_ns;
    let sent_ns = |ms: u64| last_look_ns + ms * MS;
    // Both outputs are seen 20 ms after they were sent: one frame is answered, the other is not.
    for (stage, seq, ms) in [(GRABBER, 2, 3), (CLASSIFIER, 2, 4), (GRABBER, 3, 15)] {
        play.policy.note(Event::Output(stage, first_lane(seq)), sent_ns(ms));
    }
    assert!(play.policy.tick(sent_ns(20)).is_empty());
    let due_ns = play.policy.stall_due_in_ns(sent_ns(20)).unwrap();
    assert_eq!(due_ns, (4 + 40 - 20) * MS + 1, "the tracker's: it was given frame 2 at 4 ms");
    for stage in [TRACKER, FILTER] {
        play.policy.note(Event::Output(stage, first_lane(2)), sent_ns(5));
    }
    let due_ns = play.policy.stall_due_in_ns(sent_ns(20)).unwrap();
    assert_eq!(due_ns, (15 + 40 - 20) * MS + 1, "the classifier's: it was given frame 3 at 15 ms");
}

#[test]
fn a_busy_stage_within_its_deadline_is_not_late() {
    let mut play = Play::new(&[]);
    for stage in GRAPH.stages() {
        play.output(stage, 1);
    }
    play.run(5);
    play.output(GRABBER, 2);
    let is_late = |play: &Play, ms| play.policy.late(CLASSIFIER, play.now_ns + ms * MS).is_some();
    assert!(!is_late(&play, 9) && is_late(&play, 11));
    assert!(play.policy.late(TRACKER, play.now_ns + 11 * MS).is_none());
}

#[test]
fn the_time_of_the_next_stall_is_known() {
    let mut play = Play::new(&[]);
    assert_eq!(play.policy.stall_due_in_ns(play.now_ns), None);
    for stage in GRAPH.stages() {
        play.output(stage, 1);
    }
    play.run(5);
    assert_eq!(play.policy.stall_due_in_ns(play.now_ns), None, "all is dealt with");
    play.output(GRABBER, 2);
    let due_ns = play.policy.stall_due_in_ns(play.now_ns).unwrap();
    assert!((1..=40 * MS + 1).contains(&due_ns), "{due_ns}");
    // The stall is decided at the announced time, not before.
    let at_ns = play.now_ns + due_ns;
    let is_kill = |action: &Action| matches!(action, Action::Kill { cause: Cause::Stalled, .. });
    while play.now_ns + 5 * MS < at_ns {
        assert!(!play.run(5).iter().any(is_kill));
    }
    assert!(play.policy.tick(at_ns).iter().any(is_kill));
}

/// Streams these frames at 80 frames a second through all stages.
fn stream(play: &mut Play, frames: std::ops::Range<u64>) {
    for seq in frames {
        let sent_ns = play.now_ns;
        for stage in GRAPH.stages() {
            play.policy.note(Event::Output(stage, first_lane(seq)), sent_ns);
        }
        play.now_ns += 5 * MS / 2;
        play.run(10);
    }
}

fn kills(actions: &[Action]) -> Vec<(StageId, Cause)> {
    let kill = |action: &Action| match *action {
        Action::Kill { stage, cause, .. } => Some((stage, cause)),
        _ => None,
    };
    actions.iter().filter_map(kill).collect()
}

#[test]
fn a_grabber_that_is_stuck_is_noticed_by_the_rate_of_its_camera() {
    let mut play = Play::new(&[]);
    stream(&mut play, 0..40);
    let frozen_ns = play.now_ns;
    assert_eq!(kills(&play.run(80)), [], "a hiccup");
    let killed = kills(&play.run(30));
    assert_eq!(killed, [(GRABBER, Cause::Stalled)]);
    assert!(play.now_ns - frozen_ns <= 115 * MS, "five periods, at least 100 ms");

    // Ten frames a second: five periods are half a second.
    let mut play = Play::new(&[]);
    for seq in 0..40 {
        for stage in GRAPH.stages() {
            play.output(stage, seq);
        }
        play.run(100);
    }
    assert_eq!(kills(&play.run(380)), []);
    assert_eq!(kills(&play.run(40)), [(GRABBER, Cause::Stalled)]);
}

#[test]
fn a_grabber_that_waits_for_its_camera_is_not_stuck() {
    let mut play = Play::new(&[]);
    stream(&mut play, 0..40);
    for _ in 0..18 {
        play.policy.note(Event::CheckedIn(GRABBER, play.now_ns), play.now_ns);
        assert_eq!(kills(&play.run(50)), [], "it looks around");
    }
    for _ in 0..4 {
        play.policy.note(Event::CheckedIn(GRABBER, play.now_ns), play.now_ns);
        play.run(50);
    }
    let killed = kills(&play.actions);
    assert_eq!(killed, [(GRABBER, Cause::Stalled)], "but not for ever");
}

#[test]
fn the_first_frame_of_a_grabber_may_take_its_time() {
    let mut play = Play::new(&[]);
    stream(&mut play, 0..40);
    play.exit(GRABBER);
    assert_eq!(started(&play.run(5)), [(GRABBER, false)]);
    assert_eq!(kills(&play.run(900)), [], "its camera has to be opened");
}

#[test]
fn failed_starts_are_retried_with_pauses_and_reported() {
    let mut play = Play::new(&[TRACKER]);
    play.policy.note(Event::Finished(GRABBER), play.now_ns);
    play.exit(TRACKER);
    let mut attempts = vec![];
    while attempts.len() < 6 {
        play.now_ns += 5 * MS;
        for action in play.policy.tick(play.now_ns) {
            match action {
                Action::Start { id, stage: TRACKER, .. } => {
                    attempts.push(play.now_ns);
                    play.policy.note(Event::NotStarted(id), play.now_ns);
                }
                Action::Start { .. } | Action::Kill { .. } => panic!("{action:?}"),
                _ => {}
            }
        }
    }
    let pauses: Vec<_> = attempts.windows(2).map(|pair| (pair[1] - pair[0]) / MS).collect();
    assert_eq!(pauses, [100, 200, 400, 800, 1600]);
    let degraded = play.policy.degraded(play.now_ns);
    assert_eq!(degraded.len(), 1, "{degraded:?}");
    assert_eq!((degraded[0].stage, degraded[0].what), (TRACKER, Lack::Spare(6)));
    assert!(play.policy.is_complete(), "the spare has taken over");
    assert_eq!(started(&play.run(4000)), [(TRACKER, true)]);
    assert_eq!(play.policy.degraded(play.now_ns), []);
}

#[test]
fn restarts_are_slowed_down_after_constant_deaths_but_not_after_disturbances() {
    let die = |every_ms: u64, deaths: u64| {
        let mut play = Play::new(&[TRACKER]);
        let mut seq = 0;
        for _ in 0..deaths {
            for _ in 0..every_ms / 10 {
                seq += 1;
                for stage in GRAPH.stages() {
                    play.output(stage, seq);
                }
                play.run(10);
            }
            if play.policy.stages[TRACKER].active.is_some() {
                play.end(TRACKER, true);
            }
        }
        play
    };
    let mut disturbed = die(500, 60);
    assert_eq!(disturbed.policy.degraded(disturbed.now_ns), []);
    disturbed.run(200);
    assert!(disturbed.policy.is_complete());
    let mut storm = die(20, 1000);
    let starts = started(&storm.actions).len();
    assert!(starts < 60, "{starts} starts in 20 seconds");
    assert!(!storm.policy.degraded(storm.now_ns).is_empty());
    storm.policy.note(Event::Finished(GRABBER), storm.now_ns);
    storm.run(12_000);
    assert!(storm.policy.is_complete(), "it is not given up");
    assert_eq!(storm.policy.degraded(storm.now_ns), []);
}

#[test]
fn without_heartbeats_no_process_is_killed_for_not_being_ready() {
    let mut play = Play::new(&[]);
    play.policy.note(Event::Finished(GRABBER), play.now_ns);
    play.exit(TRACKER);
    let start = |play: &mut Play, ms: u64| {
        for _ in 0..ms / 5 {
            play.now_ns += 5 * MS;
            let actions = play.policy.tick(play.now_ns);
            play.actions.extend(&actions);
        }
        kills(&play.actions)
    };
    play.policy.set_blind(true, play.now_ns);
    assert_eq!(start(&mut play, 15_000), []);
    play.policy.set_blind(false, play.now_ns);
    assert_eq!(start(&mut play, 9000), [], "its time begins now");
    assert_eq!(start(&mut play, 2000), [(TRACKER, Cause::NotReady)]);
}

/// Plays a tracker that takes so long for each frame, while frames come every 10 ms.
fn slow_tracker(takes_ms: u64, ms: u64) -> Play {
    let mut play = Play::new(&[TRACKER]);
    let (mut seq, mut tracked, mut works_until) = (0, 0, 0);
    let mut worker = None;
    for now in (0..ms).step_by(5) {
        if now % 10 == 0 {
            seq += 1;
            for stage in [GRABBER, CLASSIFIER] {
                play.output(stage, seq);
            }
        }
        let active = play.policy.stages[TRACKER].active.as_ref().map(|active| active.id);
        if active != worker {
            (worker, works_until) = (active, now + takes_ms);
        }
        if active.is_some() && now >= works_until && tracked < seq {
            tracked = seq;
            play.output(TRACKER, seq);
            play.output(FILTER, seq);
            works_until = now + takes_ms;
        }
        play.run(5);
    }
    play
}

#[test]
fn a_slow_stage_is_left_alone_after_a_few_kills() {
    let stalls = |play: &Play| kills(&play.actions).len();
    let play = slow_tracker(100, 20_000);
    assert!((1..=6).contains(&stalls(&play)), "{} kills", stalls(&play));
    assert_eq!(play.policy.degraded(play.now_ns).len(), 1, "it is said");
    assert!(play.policy.is_slow(TRACKER) && !play.policy.is_slow(CLASSIFIER));
    let play = slow_tracker(20, 5_000);
    assert_eq!(stalls(&play), 0);
    assert_eq!(play.policy.degraded(play.now_ns), []);
}
