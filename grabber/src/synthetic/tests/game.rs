//! The simulation: bodies do not overlap, and the truth agrees with the commands.

use super::super::motion::{Twist, drive};
use super::*;
use crate::synthetic::SyntheticError;
use config::{DistortionConfig, GeometryConfig, IdentityConfig, Preset};
use geometry::{FieldPoint, Pose, wrap_angle};
use messages::{Team, TruthRobot};

fn pose_of(robot: &TruthRobot) -> Pose {
    Pose { position: FieldPoint::new(robot.x_mm, robot.y_mm), orientation: robot.orientation }
}

fn corners(pose: &Pose, half: f64) -> [FieldPoint; 4] {
    [[half, half], [-half, half], [-half, -half], [half, -half]]
        .map(|corner| pose.field_from_robot(corner))
}

/// A point of the field in a robot's frame.
fn in_robot(pose: &Pose, point: FieldPoint) -> [f64; 2] {
    let (sin, cos) = pose.orientation.sin_cos();
    let (dx, dy) = (point.x_mm - pose.position.x_mm, point.y_mm - pose.position.y_mm);
    [dx * cos + dy * sin, dy * cos - dx * sin]
}

/// Two squares of one size overlap if a corner of one is in the other, or if their middles are nearer than a
/// side.
fn overlap(a: &Pose, b: &Pose, half: f64) -> bool {
    let corner_inside = |of: &Pose, inside: &Pose| {
        corners(of, half).iter().any(|&corner| {
            let [x, y] = in_robot(inside, corner);
            x.abs() < half && y.abs() < half
        })
    };
    a.position.distance(b.position) < 2.0 * half || corner_inside(a, b) || corner_inside(b, a)
}

/// Simulates a match and checks in every frame that no body overlaps another or leaves the field.
fn play(config: &Config, frames: u32) -> SyntheticMatch {
    let half = config.robots.size_mm / 2.0;
    let radius = config.ball.diameter_mm / 2.0;
    let (length, width) = (config.field.length_mm / 2.0, config.field.width_mm / 2.0);
    let mut scene = SyntheticMatch::new(config).unwrap();
    for frame in 0..frames {
        let truth = scene.truth();
        let poses: Vec<Pose> = truth.robots().iter().map(pose_of).collect();
        let ball = FieldPoint::new(truth.ball_x_mm, truth.ball_y_mm);
        assert!(ball.x_mm.abs() <= length - radius + 1e-6, "{ball:?}");
        assert!(ball.y_mm.abs() <= width - radius + 1e-6, "{ball:?}");
        for (index, pose) in poses.iter().enumerate() {
            for corner in corners(pose, half) {
                assert!(corner.x_mm.abs() <= length && corner.y_mm.abs() <= width, "{corner:?}");
            }
            for other in &poses[index + 1..] {
                assert!(!overlap(pose, other, half), "frame {frame}: {pose:?} {other:?}");
            }
            let [x, y] = in_robot(pose, ball);
            let outside = (x.abs() - half).max(0.0).hypot((y.abs() - half).max(0.0));
            assert!(outside >= radius - 1e-3, "frame {frame}: ball {outside} from {pose:?}");
        }
        scene.advance();
    }
    scene
}

#[test]
fn bodies_neither_overlap_nor_leave_the_field() {
    for seed in 0..4 {
        let mut config = Config::default();
        config.synthetic.seed = seed;
        play(&config, 4000);
    }
    for preset in [Preset::MirosotLarge, Preset::Vsss3v3] {
        play(&preset.config(), 2000);
    }
}

#[test]
fn every_top_is_in_the_picture() {
    for preset in Preset::ALL {
        let mut scene = SyntheticMatch::new(&preset.config()).unwrap();
        for _ in 0..3000 {
            for robot in scene.truth().robots() {
                assert_eq!(robot.visible, 1, "{}: {robot:?}", preset.name());
            }
            scene.advance();
        }
    }
}

#[test]
fn the_match_is_lively_from_the_start_and_has_pauses() {
    for seed in 0..3 {
        let mut config = Config::default();
        config.synthetic.seed = seed;
        let mut scene = SyntheticMatch::new(&config).unwrap();
        let start: Vec<Pose> = scene.truth().robots().iter().map(pose_of).collect();
        assert_eq!(start.len(), 10);
        for _ in 0..40 {
            scene.advance();
        }
        // Half a second later.
        let standing = |scene: &SyntheticMatch, frames| {
            scene.truth().robots().iter().filter(|robot| robot.frames_still >= frames).count()
        };
        let stand = standing(&scene, 40);
        assert!((3..=6).contains(&stand), "seed {seed}: {stand} robots stand");
        for (robot, start) in scene.truth().robots().iter().zip(&start) {
            assert_eq!(robot.frames_still == 40, pose_of(robot) == *start);
        }
        // In the long run.
        let (mut still, mut fast, frames) = (0, 0, 4000);
        let mut travelled = 0.0;
        for _ in 0..frames {
            let before: Vec<_> = scene.truth().robots().iter().map(pose_of).collect();
            scene.advance();
            still += standing(&scene, 10);
            for (robot, before) in scene.truth().robots().iter().zip(before) {
                travelled += pose_of(robot).position.distance(before.position);
                fast += usize::from(robot.v_mm_s > 500.0);
            }
        }
        let share = |count: usize| count as f64 / f64::from(frames) / 10.0;
        assert!((0.2..0.7).contains(&share(still)), "seed {seed}: {} stand", share(still));
        assert!(share(fast) > 0.08, "seed {seed}: {} are fast", share(fast));
        assert!(travelled / 10.0 > 5_000.0, "seed {seed}: {travelled} mm");
    }
}

/// Simulates a match, integrates every robot's commands as a filter would, and counts the moves that agree
/// and those that do not.
fn follow_commands(config: &Config, frames: usize) -> (usize, usize) {
    let period = 1.0 / config.camera.fps;
    let delay = config.filter.actuation_delay_ms / 1000.0;
    let mut scene = SyntheticMatch::new(config).unwrap();
    let mut sent = vec![*scene.commands()];
    let (mut right, mut wrong) = (0, 0);
    for frame in 0..frames {
        let before = *scene.truth();
        scene.advance();
        let start = frame as f64 * period;
        // Commands from before the match are unknown.
        if start > delay + period {
            for (index, robot) in before.robots().iter().enumerate() {
                let (mut pose, mut t) = (pose_of(robot), start);
                while t < start + period - 1e-9 {
                    // The newest command that acts, and the time at which the next begins to.
                    let newest = ((t - delay) / period + 1e-6).floor();
                    let end = ((newest + 1.0) * period + delay).min(start + period);
                    let wheels = sent[newest as usize].wheels()[index];
                    let twist = Twist {
                        v_mm_s: (wheels.right_mm_s + wheels.left_mm_s) / 2.0,
                        omega: (wheels.right_mm_s - wheels.left_mm_s) / config.robots.wheel_base_mm,
                    };
                    pose = drive(pose, twist, end - t);
                    t = end;
                }
                let after = pose_of(&scene.truth().robots()[index]);
                let same = pose.position.distance(after.position) < 1e-6
                    && wrap_angle(pose.orientation - after.orientation).abs() < 1e-9;
                *(if same { &mut right } else { &mut wrong }) += 1;
            }
        }
        sent.push(*scene.commands());
    }
    (right, wrong)
}

#[test]
fn robots_obey_their_commands_unless_blocked() {
    for delay_ms in [0.0, 50.0, 43.0] {
        let mut config = Config::default();
        config.filter.actuation_delay_ms = delay_ms;
        let (right, wrong) = follow_commands(&config, 4000);
        let share = wrong as f64 / (right + wrong) as f64;
        assert!(share < 0.08, "delay {delay_ms} ms: {share} of all moves were wrong");
        // Collisions must occur, though.
        assert!(wrong > 20, "delay {delay_ms} ms: only {wrong} moves were blocked");
    }
}

#[test]
fn wheels_keep_their_limits() {
    let config = Config::default();
    let mut scene = SyntheticMatch::new(&config).unwrap();
    let change = config.synthetic.max_acceleration_mm_s2 / config.camera.fps + 1e-6;
    for _ in 0..4000 {
        let before = *scene.commands();
        scene.advance();
        for (before, after) in before.wheels().iter().zip(scene.commands().wheels()) {
            assert_eq!((before.team, before.robot_id), (after.team, after.robot_id));
            for (before, after) in
                [(before.left_mm_s, after.left_mm_s), (before.right_mm_s, after.right_mm_s)]
            {
                assert!((after - before).abs() <= change, "{before} to {after}");
                assert!(after.abs() <= config.synthetic.max_speed_mm_s + 1e-6);
            }
        }
    }
}

#[test]
fn the_ball_is_played_and_comes_to_rest() {
    let mut scene = SyntheticMatch::new(&Config::default()).unwrap();
    let (mut kicks, mut rest) = (0, 0);
    for _ in 0..16_000 {
        let before = *scene.truth();
        scene.advance();
        let after = scene.truth();
        let speed = after.ball_vx_mm_s.hypot(after.ball_vy_mm_s);
        let faster = speed - before.ball_vx_mm_s.hypot(before.ball_vy_mm_s);
        kicks += usize::from(faster > 50.0);
        rest += usize::from(speed == 0.0);
    }
    assert!(kicks > 10, "{kicks} kicks");
    assert!(rest > 200, "at rest in {rest} frames");
}

#[test]
fn robots_are_listed_by_team_and_number() {
    let mut config = Config::default();
    config.robots.identities.reverse();
    let scene = SyntheticMatch::new(&config).unwrap();
    let listed: Vec<_> =
        scene.truth().robots().iter().map(|robot| (robot.team, robot.robot_id)).collect();
    let mut sorted = listed.clone();
    sorted.sort_unstable();
    assert_eq!(listed, sorted);
    assert_eq!(scene.commands().wheels().len(), listed.len());
}

#[test]
fn small_and_unusual_matches_work() {
    let run = |config: &Config| {
        let mut scene = SyntheticMatch::new(config).unwrap();
        for _ in 0..300 {
            scene.advance();
        }
        render(&mut scene, config);
        *scene.truth()
    };
    let mut config = Config::default();
    config.robots.identities.truncate(1);
    assert_eq!(run(&config).robots().len(), 1);
    config.robots.identities.clear();
    assert_eq!(run(&config).robots().len(), 0);

    for (fps, exposure_us) in [(1.0, 1_000_000), (1000.0, 0), (33.3, 5000)] {
        let mut config = Config::default();
        (config.camera.fps, config.camera.exposure_us) = (fps, exposure_us);
        run(&config);
    }
    let mut config = Config::default();
    config.synthetic.max_speed_mm_s = 0.0;
    config.synthetic.max_acceleration_mm_s2 = 0.0;
    assert!(run(&config).robots().iter().all(|robot| robot.frames_still == 300));
    config.synthetic.max_speed_mm_s = 100_000.0;
    config.synthetic.max_acceleration_mm_s2 = 1_000_000.0;
    run(&config);
    // A camera that sees next to nothing of the field.
    let mut config = Config::default();
    (config.camera.width, config.camera.height) = (80, 60);
    config.geometry.distortion = DistortionConfig { k1: 0.0, ..DistortionConfig::default() };
    config.geometry.points.iter_mut().for_each(|point| {
        // The field's top-left corner, and the floor beyond it, is in the picture.
        point.image_px[0] += 30.0;
        point.image_px[1] += 40.0;
    });
    run(&config);
    // A camera that sees all of it in six pixels.
    let mut config = Config::default();
    (config.camera.width, config.camera.height) = (2, 3);
    config.geometry = GeometryConfig::above(&config.field, config.camera.picture_px(), 2200.0);
    run(&config);
}

#[test]
fn impossible_matches_are_refused_with_a_reason() {
    let refused = |change: &dyn Fn(&mut Config)| {
        let mut config = Config::default();
        change(&mut config);
        SyntheticMatch::new(&config).map(|_| ()).unwrap_err()
    };
    assert_eq!(
        refused(&|config| config.teams.blue = "beige".into()),
        SyntheticError::UnknownColor { name: "beige".into() }
    );
    assert_eq!(
        refused(&|config| config.camera.fps = 0.0),
        SyntheticError::Impossible { key: "camera.fps", value: 0.0 }
    );
    assert!(matches!(
        refused(&|config| config.robots.size_mm = f64::NAN),
        SyntheticError::Impossible { key: "robots.size_mm", .. }
    ));
    assert_eq!(
        refused(&|config| config.robots.height_mm = 3000.0),
        SyntheticError::Impossible { key: "robots.height_mm", value: 3000.0 }
    );
    assert_eq!(
        refused(&|config| config.field.width_mm = 110.0),
        SyntheticError::NoRoom { robots: 10 }
    );
    assert_eq!(
        refused(&|config| config.camera.width = 0),
        SyntheticError::Impossible { key: "camera.width", value: 0.0 }
    );
    assert!(matches!(
        refused(&|config| config.geometry.points.truncate(3)),
        SyntheticError::Geometry(_)
    ));
    let many = |config: &mut Config| {
        config.robots.identities =
            (0..33).map(|id| IdentityConfig::new(Team::Blue, id, vec!["red".into()])).collect();
    };
    assert_eq!(refused(&many), SyntheticError::TooManyRobots { robots: 33 });
}
