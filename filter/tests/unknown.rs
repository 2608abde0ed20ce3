//! Unidentified robots: association, begin and end of tracks, and no duplicates of identified robots.

#[path = "../../tests/counting/mod.rs"]
mod counting;
mod pitch;

use config::Config;
use counting::allocations_in;
use geometry::layout::Layout;
use messages::{
    ClearStale, DetectedRobot, DetectionFrame, MAX_UNKNOWN_ROBOTS, RobotState, TrackStatus,
    UnknownRobotState, WorldFrame,
};
use pitch::*;
use proptest::prelude::*;
use std::sync::LazyLock;
use touchline_filter::Filter;
use touchline_filter::unknown::FRAMES_TO_CONFIRM;

const YELLOW: u32 = 0;
const BLUE: u32 = 1;

fn config() -> Config {
    let mut config = Config::default();
    config.robots.report_unknown = true;
    config
}

/// Position of the team patch in a robot's frame.
fn arm() -> [f64; 2] {
    static ARM: LazyLock<[f64; 2]> =
        LazyLock::new(|| Layout::new(&config().robots).patches[0].centroid_mm);
    *ARM
}

/// A team patch at a position.
fn patch(team: u32, [x, y]: [f64; 2]) -> DetectedRobot {
    let [dx, dy] = arm();
    let place = ((dx * dx + dy * dy) / 2.0 + 1.0) as f32;
    DetectedRobot {
        covariance: [place, 0.0, 0.0, place, 0.0, 3.3],
        confidence: 0.4,
        orientation: 0.0,
        ..detected(team, u32::MAX, Pose { x, y, theta: 0.0 })
    }
}

/// The team patch of a robot at a pose.
fn patch_of(team: u32, pose: Pose) -> DetectedRobot {
    let ([dx, dy], (sin, cos)) = (arm(), pose.theta.sin_cos());
    patch(team, [pose.x + cos * dx - sin * dy, pose.y + sin * dx + cos * dy])
}

struct Bench {
    filter: Filter,
    frame: Box<DetectionFrame>,
    world: Box<WorldFrame>,
    seq: u64,
}

impl Bench {
    fn new() -> Self {
        Self::with(&config())
    }

    fn with(config: &Config) -> Self {
        Self {
            filter: Filter::new(config).unwrap(),
            frame: empty_frame(0, START_NS),
            world: new_world(),
            seq: 0,
        }
    }

    fn see(&mut self, robots: &[DetectedRobot]) {
        stamp(&mut self.frame, self.seq, START_NS + self.seq * FRAME_NS);
        robots.iter().for_each(|&robot| assert!(self.frame.push_robot(robot)));
        self.filter.step(&self.frame, &mut self.world);
        self.seq += 1;
    }

    fn see_for(&mut self, frames: u32, robots: &[DetectedRobot]) {
        (0..frames).for_each(|_| self.see(robots));
    }

    fn unknown(&self) -> &[UnknownRobotState] {
        self.world.unknown_robots()
    }

    /// Track numbers.
    fn ids(&self) -> Vec<u32> {
        self.unknown().iter().map(|robot| robot.track_id).collect()
    }

    fn only(&self) -> UnknownRobotState {
        let [robot] = self.unknown() else { panic!("{:?}", self.unknown()) };
        *robot
    }

    /// Yellow 2.
    fn named(&self) -> RobotState {
        *self.world.robots().iter().find(|robot| (robot.team, robot.robot_id) == (0, 2)).unwrap()
    }
}

fn off(robot: &UnknownRobotState, [x, y]: [f64; 2]) -> f64 {
    (robot.x_mm - x).hypot(robot.y_mm - y)
}

#[test]
fn a_track_is_published_after_enough_frames_and_ends_when_unseen() {
    let mut bench = Bench::new();
    let place = [100.0, 50.0];
    for _ in 1..FRAMES_TO_CONFIRM {
        bench.see(&[patch(BLUE, place)]);
        assert!(bench.unknown().is_empty());
    }
    bench.see_for(20, &[patch(BLUE, place)]);
    let robot = bench.only();
    assert_eq!((robot.team, robot.track_id), (BLUE, 1));
    assert_eq!(robot.status, TrackStatus::Measured as u32);
    assert_eq!(robot.frames_tracked, FRAMES_TO_CONFIRM + 19);
    assert!(off(&robot, place) < 0.1 && robot.vx_mm_s.abs() < 1.0, "{robot:?}");
    // The centre is somewhere around the patch.
    let [dx, dy] = arm();
    assert!(robot.covariance[0].sqrt() > dx.hypot(dy) / 2f64.sqrt(), "{robot:?}");
    assert!(bench.world.robots().is_empty());

    let forget = (config().filter.forget_after_ms / 12.5) as u32;
    bench.see_for(forget, &[]);
    assert_eq!(bench.only().status, TrackStatus::Coasting as u32);
    assert!(bench.only().visibility < 0.05);
    bench.see(&[]);
    assert!(bench.unknown().is_empty());
    // It comes back with a new number.
    bench.see_for(FRAMES_TO_CONFIRM, &[patch(BLUE, place)]);
    assert_eq!(bench.ids(), [2]);
}

#[test]
fn flickering_detections_start_no_track() {
    let mut bench = Bench::new();
    let mut random = Random(4);
    for frame in 0..400 {
        let place = [random.between(-1000.0, 1000.0), random.between(-800.0, 800.0)];
        // Two frames of three.
        bench.see(&if frame % 3 == 0 { vec![] } else { vec![patch(BLUE, place)] });
        assert!(bench.unknown().is_empty(), "{frame}");
    }
    assert_eq!(bench.world.last_track_id, 0);
}

#[test]
fn velocity_and_prediction_follow_the_patch() {
    let mut bench = Bench::new();
    let mut place = [-600.0, 0.0];
    for _ in 0..40 {
        place[0] += 1000.0 * 0.0125;
        bench.see(&[patch(BLUE, place)]);
    }
    let robot = bench.only();
    assert!((robot.vx_mm_s - 1000.0).abs() < 20.0 && robot.vy_mm_s.abs() < 20.0, "{robot:?}");
    let ahead_s = (bench.world.t_predicted_ns - bench.world.frame.t_capture_ns) as f64 * 1e-9;
    assert!((robot.predicted_x_mm - place[0] - 1000.0 * ahead_s).abs() < 2.0, "{robot:?}");
}

/// Two pass each other at 62 mm, both at 1.5 m/s; one is hidden for a while just then.
#[test]
fn robots_that_pass_closely_keep_their_numbers() {
    for hidden in [0..0, 36..46, 30..50] {
        let mut bench = Bench::new();
        let mut random = Random(9);
        for frame in 0..80 {
            let along = (f64::from(frame) - 40.0) * 1500.0 * 0.0125;
            let places = [[along, 31.0], [-along, -31.0]];
            let seen = places.map(|[x, y]| [x + 0.4 * random.normal(), y + 0.4 * random.normal()]);
            let mut robots = vec![patch(BLUE, seen[0])];
            if !hidden.contains(&frame) {
                robots.push(patch(BLUE, seen[1]));
            }
            bench.see(&robots);
            if frame > 3 {
                assert_eq!(bench.ids(), [1, 2], "{frame}");
                assert!(off(&bench.unknown()[0], places[0]) < 2.0, "{frame}");
                let most = if hidden.contains(&frame) { 60.0 } else { 2.0 };
                assert!(off(&bench.unknown()[1], places[1]) < most, "{frame}");
            }
        }
    }
}

#[test]
fn a_struck_robot_keeps_its_track() {
    let mut bench = Bench::new();
    let mut place = [-500.0, 200.0];
    for frame in 0..80 {
        // Full speed, then from one frame to the next backwards and sideways.
        let velocity = if frame < 40 { [1500.0, 0.0] } else { [-300.0, 700.0] };
        for (place, velocity) in place.iter_mut().zip(velocity) {
            *place += velocity * 0.0125;
        }
        bench.see(&[patch(BLUE, place)]);
    }
    assert_eq!(bench.ids(), [1]);
    assert!(off(&bench.only(), place) < 1.0);
}

#[test]
fn teams_do_not_mix() {
    let mut bench = Bench::new();
    bench.see_for(10, &[patch(BLUE, [0.0, 0.0])]);
    bench.see_for(10, &[patch(YELLOW, [0.0, 0.0])]);
    assert_eq!(bench.unknown().iter().map(|robot| robot.team).collect::<Vec<_>>(), [YELLOW, BLUE]);
    assert_eq!(bench.ids(), [2, 1]);
    assert_eq!(bench.unknown()[1].frames_unseen, 10);
}

/// An identified robot with a hidden identification patch: no duplicate, and its position is still tracked.
#[test]
fn an_unrecognised_robot_has_no_duplicate_track() {
    let mut bench = Bench::new();
    let mut pose = Pose { x: -700.0, y: 100.0, theta: 0.5 };
    let drive = |pose: &mut Pose| {
        let (v, omega) = (900.0, 1.5);
        pose.theta += omega * 0.0125;
        pose.x += v * 0.0125 * pose.theta.cos();
        pose.y += v * 0.0125 * pose.theta.sin();
    };
    for _ in 0..40 {
        drive(&mut pose);
        bench.see(&[detected(YELLOW, 2, pose)]);
    }
    let forget = (config().filter.forget_after_ms / 12.5) as u32;
    for frame in 1..forget {
        drive(&mut pose);
        bench.see(&[patch_of(YELLOW, pose)]);
        let robot = bench.named();
        assert!(bench.unknown().is_empty(), "{frame}");
        assert_eq!(robot.status, TrackStatus::Located as u32, "{frame}");
        // The association does not confirm the identity.
        assert_eq!(robot.frames_unseen, frame);
        assert!(robot.visibility < 1.0);
        let error = (robot.x_mm - pose.x).hypot(robot.y_mm - pose.y);
        assert!(error < 5.0 + 0.2 * f64::from(frame), "{frame}: {error}");
        let sigma = (robot.covariance[0] + robot.covariance[6]).sqrt();
        assert!(error < 4.0 * sigma, "{frame}: {error} {sigma}");
    }
    // Now the identity is lost, but not the robot.
    for _ in 0..10 {
        drive(&mut pose);
        bench.see(&[patch_of(YELLOW, pose)]);
    }
    assert!(bench.world.robots().is_empty());
    assert_eq!(bench.ids(), [1]);
    // Recognised again, it has a single track again.
    drive(&mut pose);
    bench.see(&[detected(YELLOW, 2, pose)]);
    assert_eq!((bench.world.robots().len(), bench.unknown().len()), (1, 0));
}

/// Two patches, either of which may be the robot that was not recognised.
#[test]
fn an_ambiguous_association_moves_no_robot() {
    let mut bench = Bench::new();
    let pose = Pose { x: 0.0, y: 0.0, theta: 0.0 };
    bench.see_for(40, &[detected(YELLOW, 2, pose)]);
    bench.see_for(4, &[]);
    let ([dx, dy], before) = (arm(), bench.named());
    bench.see(&[patch(YELLOW, [dx + 3.0, dy]), patch(YELLOW, [dx - 3.0, dy])]);
    let robot = bench.named();
    assert_eq!(robot.status, TrackStatus::Coasting as u32);
    assert!((robot.x_mm - before.x_mm).abs() < 0.1);
}

/// A jump while the robot is not recognised starts a track; recognition ends it.
#[test]
fn a_duplicate_ends_when_its_robot_is_recognised() {
    let mut bench = Bench::new();
    let (from, to) = (Pose { x: -900.0, ..Pose::default() }, Pose { x: 600.0, ..Pose::default() });
    bench.see_for(40, &[detected(YELLOW, 2, from)]);
    bench.see_for(FRAMES_TO_CONFIRM, &[patch_of(YELLOW, to)]);
    assert_eq!(bench.ids(), [1]);
    let reinit = config().filter.reinit_after;
    bench.see_for(reinit, &[detected(YELLOW, 2, to)]);
    assert_eq!(bench.named().status, TrackStatus::Initialised as u32);
    assert!((bench.named().x_mm - to.x).abs() < 1.0);
    assert!(bench.unknown().is_empty());
}

/// Identified robots are filtered as if there were no unidentified ones.
#[test]
fn named_robots_are_not_disturbed() {
    let noise = Noise { position_mm: 0.5, heading_deg: 1.0 };
    let mut game = Match::new(Wheels::Lagging(0.02), true, noise, 5);
    let (mut with, mut without) = (Bench::new(), Bench::with(&Config::default()));
    for frame in 0..300 {
        let sent = game.next_frame();
        let mut robots = game.detections.robots().to_vec();
        without.see(&robots);
        robots.push(patch(BLUE, [f64::from(frame) * 5.0 - 700.0, 300.0]));
        robots.push(patch(YELLOW, [0.0, -500.0]));
        with.see(&robots);
        assert_eq!(with.world.robots(), without.world.robots());
        assert!(without.unknown().is_empty());
        with.filter.command(&sent);
        without.filter.command(&sent);
    }
    assert_eq!(with.unknown().len(), 2);
}

/// Ten that come, go, are hidden and pass each other; and clutter.
fn bustle(frames: u64) -> Vec<Vec<DetectedRobot>> {
    let noise = Noise { position_mm: 0.5, heading_deg: 1.0 };
    let mut game = Match::new(Wheels::Exact, false, noise, 77);
    game.collisions_every_s = Some(1.0);
    let mut random = Random(3);
    (0..frames)
        .map(|_| {
            game.next_frame();
            let mut robots = vec![];
            for (index, &robot) in game.detections.robots().iter().enumerate() {
                let pose = Pose {
                    x: robot.x_mm.into(),
                    y: robot.y_mm.into(),
                    theta: robot.orientation.into(),
                };
                match random.unit() {
                    hidden if hidden < 0.1 => {}
                    named if named < 0.8 && index < 3 => robots.push(robot),
                    _ => robots.push(patch_of(robot.team, pose)),
                }
            }
            if random.unit() < 0.3 {
                let place = [random.between(-1000.0, 1000.0), random.between(-800.0, 800.0)];
                robots.push(patch(BLUE, place));
            }
            robots
        })
        .collect()
}

#[test]
fn a_successor_carries_on_bit_for_bit() {
    let frames = bustle(300);
    let mut first = Bench::new();
    let mut worlds = vec![];
    for robots in &frames {
        first.see(robots);
        let mut world = first.world.clone();
        world.clear_stale();
        worlds.push(world);
    }
    let noted = |world: &WorldFrame| world.unknown_memory_count > world.unknown_robot_count;
    assert!(worlds.iter().filter(|world| noted(world)).count() > 20);
    for start in (0..250).step_by(5) {
        let mut second = Bench::new();
        second.filter.resume(&worlds[start]);
        second.seq = start as u64 + 1;
        for index in start + 1..start + 40 {
            second.see(&frames[index]);
            second.world.clear_stale();
            assert!(
                bytemuck::bytes_of(&*second.world) == bytemuck::bytes_of(&*worlds[index]),
                "resumed after {start}, frame {index}"
            );
        }
    }
}

#[test]
fn a_step_allocates_nothing_once_warm() {
    let mut bench = Bench::new();
    let frames = bustle(300);
    for (seq, robots) in frames.iter().enumerate() {
        stamp(&mut bench.frame, bench.seq, START_NS + bench.seq * FRAME_NS);
        robots.iter().for_each(|&robot| assert!(bench.frame.push_robot(robot)));
        let Bench { filter, frame, world, .. } = &mut bench;
        let allocations = allocations_in(|| filter.step(frame, world));
        bench.seq += 1;
        assert!(seq < 150 || allocations == 0, "frame {seq}: {allocations}");
    }
}

/// More detections than there is room for.
#[test]
fn the_number_of_tracks_is_bounded() {
    let mut bench = Bench::new();
    let many: Vec<_> = (0..32).map(|i| patch(BLUE, [f64::from(i) * 100.0 - 1600.0, 0.0])).collect();
    bench.see_for(10, &many);
    assert_eq!(bench.unknown().len(), MAX_UNKNOWN_ROBOTS);
    let others: Vec<_> =
        (0..32).map(|i| patch(BLUE, [f64::from(i) * 100.0 - 1600.0, 9000.0])).collect();
    bench.see_for(10, &others);
    assert_eq!(bench.unknown().len(), MAX_UNKNOWN_ROBOTS);
    assert!(bench.unknown().iter().all(|robot| robot.y_mm == 0.0 && robot.frames_unseen == 10));
}

/// A predecessor's message may contain a number twice, or have used up all numbers.
#[test]
fn track_numbers_are_unique_after_resuming() {
    let three = [patch(YELLOW, [0.0, 0.0]), patch(BLUE, [300.0, 0.0]), patch(BLUE, [600.0, 0.0])];
    let mut bench = Bench::new();
    bench.see_for(5, &three);
    assert_eq!(bench.ids(), [1, 2, 3]);

    let mut world = bench.world.clone();
    world.unknown_robot_memories[1].track_id = 1;
    world.last_track_id = u32::MAX;
    bench.filter.resume(&world);
    // The first keeps the number; the second has to be seen for a while to get one. 1 would be next.
    bench.see(&three);
    assert_eq!(bench.ids(), [1, 3]);
    bench.see_for(5, &three);
    assert_eq!(bench.ids(), [1, 2, 3]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Arbitrary bytes in a predecessor's message: no panic, and only finite numbers come out.
    #[test]
    fn invalid_input_is_survived(seed in any::<u64>(), share in 0.0..1.0) {
        let mut bench = Bench::new();
        bustle(40).iter().for_each(|robots| bench.see(robots));
        let mut world = bench.world.clone();
        let mut random = Random(seed);
        let memories = bytemuck::bytes_of_mut(&mut world.unknown_robot_memories);
        for byte in memories {
            if random.unit() < share * share * share {
                *byte = (random.unit() * 256.0) as u8;
            }
        }
        world.unknown_memory_count = (random.unit() * 40.0) as u32;
        bench.filter.resume(&world);
        for robots in bustle(20) {
            bench.see(&robots);
            for robot in bench.unknown() {
                let numbers = [robot.x_mm, robot.y_mm, robot.vx_mm_s, robot.vy_mm_s,
                    robot.predicted_x_mm, robot.predicted_y_mm];
                prop_assert!(numbers.iter().chain(&robot.covariance).all(|n| n.is_finite()));
                prop_assert!(robot.track_id > 0);
            }
            let mut ids = bench.ids();
            ids.sort_unstable();
            ids.dedup();
            prop_assert_eq!(ids.len(), bench.unknown().len());
        }
    }
}
