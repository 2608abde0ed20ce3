//! Two cameras: a fault in one lane affects that lane and at most the filter.

use super::*;

const LANES: StageGraph = StageGraph::with_lanes(2);
const SPARED: [StageId; 3] = [CLASSIFIER, TRACKER, FILTER];

fn in_lane(stage: StageId, lane: u8) -> StageId {
    StageId::new(stage.kind(), lane)
}

/// Two lanes at 80 frames a second; every stage answers at once unless a test holds it up.
struct TwoCameras {
    play: Play,
    seq: u64,
    silent: Vec<StageId>,
}

impl TwoCameras {
    fn new(spares: &[StageId]) -> Self {
        let mut cameras = Self { play: Play::with(LANES, spares), seq: 0, silent: vec![] };
        cameras.run(100);
        cameras.play.actions.clear();
        cameras
    }

    /// Lets time pass, and returns the actions taken meanwhile.
    fn run(&mut self, ms: u64) -> Vec<Action> {
        let mut actions = vec![];
        for step in 0..ms / 5 {
            // The lanes are out of phase: each camera has its own clock.
            match step % 2 {
                0 => self.frame(0),
                _ => self.frame(1),
            }
            actions.extend(self.play.run(5));
        }
        actions
    }

    /// Sends a frame through a lane up to the first stage that is held up.
    fn frame(&mut self, lane: u8) {
        self.seq += 1;
        for stage in LANES.stages().filter(|stage| stage.serves(lane)) {
            if self.silent.contains(&stage) {
                return;
            }
            let frame = FrameId { lane, seq: self.seq };
            self.play.policy.note(Event::Output(stage, frame), self.play.now_ns);
            self.play.policy.note(Event::CheckedIn(stage, self.play.now_ns), self.play.now_ns);
        }
    }

    /// Holds a stage up until it has a new process.
    fn is_held_up(&mut self, stage: StageId) -> Vec<Action> {
        self.silent.push(stage);
        let actions = self.run(400);
        self.silent.clear();
        actions
    }

    fn poison(&mut self, stage: StageId, lane: u8) -> Vec<Action> {
        let mut actions = vec![];
        for _ in 0..2 {
            // The input is pending, and the process dies of it.
            for before in LANES.stages().filter(|it| it.serves(lane) && *it < stage) {
                let frame = FrameId { lane, seq: self.seq + 1 };
                self.play.policy.note(Event::Output(before, frame), self.play.now_ns);
            }
            self.play.end(stage, true);
            actions.extend(self.play.run(20));
        }
        actions
    }
}

fn concerned(actions: &[Action]) -> BTreeSet<StageId> {
    let stage = |action: &Action| match action {
        Action::Start { stage, .. }
        | Action::Promote { stage, .. }
        | Action::Kill { stage, .. }
        | Action::Retire { stage, .. }
        | Action::Skip { stage, .. } => Some(*stage),
        Action::CleanUp => None,
    };
    actions.iter().filter_map(stage).collect()
}

#[test]
fn all_lanes_start_and_cameras_last() {
    let mut play =
        Play { policy: Policy::new(settings(LANES, &[])), now_ns: 1000 * MS, actions: vec![] };
    let order: Vec<String> =
        started(&play.run(20)).into_iter().map(|(stage, _)| stage.to_string()).collect();
    let begin = ["filter", "tracker@1", "classifier@1", "tracker", "classifier"];
    assert_eq!(order[..5], begin);
    assert_eq!(
        BTreeSet::from_iter(&order[5..]),
        BTreeSet::from(["grabber", "grabber@1"].map(String::from).each_ref())
    );
}

#[test]
fn healthy_lanes_are_left_alone() {
    let mut cameras = TwoCameras::new(&SPARED);
    assert_eq!(concerned(&cameras.run(10_000)), BTreeSet::new());
}

#[test]
fn a_stall_or_a_death_in_one_lane_never_touches_the_other() {
    for lane in [0, 1] {
        for stage in [GRABBER, CLASSIFIER, TRACKER] {
            for spares in [&[][..], &SPARED] {
                let stage = in_lane(stage, lane);
                let mut cameras = TwoCameras::new(spares);
                let killed = kills(&cameras.is_held_up(stage));
                assert_eq!(killed.first(), Some(&(stage, Cause::Stalled)), "{stage}");
                assert!(killed.iter().all(|(it, _)| *it == stage), "{stage}: {killed:?}");
                cameras.play.exit(stage);
                cameras.run(1000);
                assert_eq!(concerned(&cameras.play.actions), BTreeSet::from([stage]));
                assert!(cameras.play.policy.is_complete());
            }
        }
    }
}

#[test]
fn a_lane_without_camera_does_not_keep_the_other_from_being_filtered() {
    let mut cameras = TwoCameras::new(&SPARED);
    let away = in_lane(GRABBER, 1);
    cameras.silent.push(away);
    for _ in 0..100 {
        cameras.play.policy.note(Event::CameraIsAway(away), cameras.play.now_ns);
        assert_eq!(concerned(&cameras.run(100)), BTreeSet::new());
    }
    // A stalled filter is noticed by the lane that still runs.
    cameras.silent.push(FILTER);
    let killed = kills(&cameras.run(100));
    assert!(killed.contains(&(FILTER, Cause::Stalled)), "{killed:?}");
}

#[test]
fn a_poisonous_frame_is_skipped_in_its_lane() {
    for lane in [0, 1] {
        for stage in [in_lane(CLASSIFIER, lane), in_lane(TRACKER, lane), FILTER] {
            let mut cameras = TwoCameras::new(&SPARED);
            let last = cameras.play.policy.stages[stage].output.of(lane).unwrap();
            let actions = cameras.poison(stage, lane);
            let skip = Action::Skip { stage, after: FrameId { lane, seq: last } };
            assert!(actions.contains(&skip), "{stage}: {actions:?}");
            assert_eq!(concerned(&actions), BTreeSet::from([stage]));
        }
    }
}

#[test]
fn a_filter_that_dies_with_pending_frames_of_two_lanes_skips_one_after_the_other() {
    let mut cameras = TwoCameras::new(&[FILTER]);
    // Its processes give no output and are killed as stalled.
    cameras.silent.push(FILTER);
    let skip = |action: &Action| match action {
        Action::Skip { stage: FILTER, after } => Some(after.lane),
        _ => None,
    };
    let skipped: Vec<u8> = cameras.run(5000).iter().filter_map(skip).collect();
    assert!(skipped.starts_with(&[0, 1]), "{skipped:?}");
}

#[test]
fn a_renewal_goes_through_all_lanes_and_reaches_the_cameras_last() {
    let mut cameras = TwoCameras::new(&SPARED);
    for stage in LANES.stages() {
        cameras.play.policy.renew_stage(stage, cameras.play.now_ns);
    }
    let actions = cameras.run(5000);
    let retired = |action: &Action| match action {
        Action::Retire { stage, .. } => Some(*stage),
        _ => None,
    };
    let retired: Vec<StageId> = actions.iter().filter_map(retired).collect();
    assert_eq!(BTreeSet::from_iter(retired.clone()), LANES.stages().collect());
    assert!(retired[5..].iter().all(|stage| stage.is_grabber()), "{retired:?}");
}

#[test]
fn a_stage_of_a_lane_that_the_group_lacks_is_not_adopted() {
    let mut policy = Policy::new(settings(GRAPH, &[]));
    for stage in LANES.stages().filter(|stage| !GRAPH.has(*stage)) {
        assert_eq!(policy.adopt(stage, false, false, MS), None, "{stage}");
    }
    assert!(policy.adopt(FILTER, false, false, MS).is_some());
}
