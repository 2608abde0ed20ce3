//! The filter's reaction to outliers, jumps, gaps, irregular clocks and invalid input.

mod bench;
mod pitch;

use bench::*;
use config::Config;
use messages::{DetectedRobot, RobotState, TrackStatus, WorldFrame};
use pitch::*;
use proptest::prelude::*;
use std::f64::consts::PI;
use touchline_filter::{Filter, FilterError};

#[test]
fn a_track_starts_at_first_sight_with_enough_confidence() {
    let mut bench = Bench::new();
    let doubtful = DetectedRobot { confidence: 0.1, ..detected(0, 2, HOME) };
    assert_eq!(bench.see(&[doubtful]).robots().len(), 0);
    let state = bench.see_for(1, HOME);
    assert_eq!(bench.status(), TrackStatus::Initialised);
    assert!(distance(&state, HOME) < 1e-4);
    assert_eq!((state.visibility, state.frames_unseen, state.frames_gated), (1.0, 0, 0));
    bench.see(&[doubtful]);
    assert_eq!(bench.status(), TrackStatus::Measured);
}

#[test]
fn headers_and_times_are_passed_on() {
    let mut bench = Bench::new();
    stamp(&mut bench.frame, 17, START_NS);
    bench.frame.frame.camera_id = 3;
    bench.frame.t_runs_ns = START_NS + 1;
    let frame = bench.frame.clone();
    let world = bench.step();
    assert_eq!(world.frame, frame.frame);
    assert_eq!((world.t_runs_ns, world.t_detections_ns), (frame.t_runs_ns, frame.t_sent_ns));
    assert_eq!(world.t_predicted_ns, START_NS + TRACKER_NS + 50_000_000);
    assert_eq!((world.t_sent_ns, world.commands_seq), (0, WorldFrame::NO_COMMANDS));
    assert_eq!((world.robot_count, world.ball.status), (0, TrackStatus::Absent as u32));
}

#[test]
fn a_single_outlier_moves_nothing() {
    for outlier in [
        at(HOME.x + 300.0, HOME.y, HOME.theta),
        at(HOME.x, HOME.y - 60.0, HOME.theta),
        at(HOME.x, HOME.y, HOME.theta + PI / 2.0),
        at(HOME.x, HOME.y, HOME.theta + PI),
    ] {
        let (mut hit, mut spared) = (Bench::new(), Bench::new());
        hit.see_for(40, HOME);
        spared.see_for(40, HOME);
        let gated = hit.see_for(1, outlier);
        spared.see(&[]);
        assert_eq!(hit.status(), TrackStatus::Gated, "{outlier:?}");
        assert_eq!((gated.frames_gated, gated.frames_unseen), (1, 1));
        assert!(gated.visibility < 1.0);
        // Exactly as if nothing had been seen.
        let coasting = spared.robot();
        assert_eq!((gated.x_mm, gated.y_mm), (coasting.x_mm, coasting.y_mm));
        assert_eq!(gated.covariance, coasting.covariance);
        let after = hit.see_for(1, HOME);
        assert_eq!(hit.status(), TrackStatus::Measured);
        assert!(distance(&after, HOME) < 0.01 && after.frames_gated == 0, "{after:?}");
    }
}

#[test]
fn outliers_that_do_not_agree_never_count() {
    let mut bench = Bench::new();
    bench.see_for(40, HOME);
    for frame in 0..12 {
        let there = at(HOME.x + 300.0 + 150.0 * f64::from(frame % 3), HOME.y, HOME.theta);
        let state = bench.see_for(1, there);
        assert_eq!(bench.status(), TrackStatus::Gated);
        assert_eq!(state.frames_gated, frame as u32 + 1);
        assert!(distance(&state, HOME) < 1.0);
    }
}

#[test]
fn a_jump_is_followed_after_the_configured_number_of_frames() {
    let mut bench = Bench::new();
    bench.see_for(40, HOME);
    let there = at(HOME.x - 200.0, HOME.y + 224.0, HOME.theta + 2.0);
    let expected = [TrackStatus::Gated, TrackStatus::Gated, TrackStatus::Initialised];
    for status in expected {
        bench.see_for(1, there);
        assert_eq!(bench.status(), status);
    }
    assert!(distance(&bench.robot(), there) < 1e-3);
    let state = bench.see_for(1, there);
    assert_eq!(bench.status(), TrackStatus::Measured);
    assert!(distance(&state, there) < 0.5, "{state:?}");
}

/// A motion that only the struck hypothesis explains is followed at once.
#[test]
fn a_collision_is_followed_at_once() {
    let mut bench = Bench::new();
    let mut pose = at(-500.0, 0.0, 0.0);
    for _ in 0..40 {
        pose.x += 1200.0 * 0.0125;
        bench.see_for(1, pose);
    }
    // Stops dead: 15 mm from the predicted position.
    for _ in 0..5 {
        let state = bench.see_for(1, pose);
        assert_eq!(bench.status(), TrackStatus::Measured);
        assert!(distance(&state, pose) < 1.5, "{state:?}");
    }
}

#[test]
fn an_unseen_robot_coasts_fades_and_is_forgotten() {
    let mut bench = Bench::new();
    let mut pose = at(-500.0, 0.0, 0.0);
    for _ in 0..40 {
        pose.x += 5.0;
        bench.see_for(1, pose);
    }
    let mut before = bench.robot();
    for frame in 1..=80 {
        bench.see(&[]);
        let state = bench.robot();
        assert_eq!(bench.status(), TrackStatus::Coasting);
        assert_eq!(state.frames_unseen, frame);
        for index in [0, 6, 12] {
            assert!(state.covariance[index] > before.covariance[index], "{frame} {index}");
        }
        assert!(state.visibility < before.visibility);
        if frame == 8 {
            // 400 mm/s for 0.1 s.
            assert!((state.x_mm - (pose.x + 40.0)).abs() < 8.0, "{}", state.x_mm - pose.x);
        }
        before = state;
    }
    assert!(before.visibility < 0.01);
    assert_eq!(bench.see(&[]).robots().len(), 0);
}

#[test]
fn robots_are_filtered_independently() {
    let noise = Noise { position_mm: 0.5, heading_deg: 1.0 };
    let mut game = Match::new(Wheels::Lagging(0.03), true, noise, 2);
    let (mut all, mut one) = (Bench::new(), Bench::new());
    for _ in 0..300 {
        let sent = game.next_frame();
        let robots = game.detections.robots().to_vec();
        let alone: Vec<_> =
            robots.iter().copied().filter(|r| (r.team, r.robot_id) == (0, 2.into())).collect();
        all.see(&robots);
        one.see(&alone);
        assert_eq!(all.robot(), one.robot());
        all.filter.command(&sent);
        one.filter.command(&sent);
    }
    assert_eq!(all.world.robots().len(), 10);
    assert_eq!(one.world.robots().len(), 1);
}

/// Unidentified detections take up room in `detections`, but start no robot track.
#[test]
fn unidentified_robots_have_no_track_and_no_effect() {
    let (mut bench, mut alone) = (Bench::new(), Bench::new());
    for frame in 0..60 {
        let pose = at(100.0 + f64::from(frame) * 5.0, -200.0, 0.0);
        let unknown = detected(0, u32::MAX, at(pose.x + 1.0, pose.y, 1.0));
        let other = detected(1, u32::MAX, at(-300.0, 50.0, 0.0));
        let known = detected(0, 2, pose);
        alone.see(&[known]);
        bench.see(&[known, unknown, other]);
        assert_eq!(bench.world.robots().len(), 1);
        assert_eq!(bench.robot(), alone.robot());
    }
}

#[test]
fn headings_wrap() {
    let mut bench = Bench::new();
    for frame in 0..200 {
        // Two turns at 5 rad/s, starting near the seam.
        let theta = 3.0 + 5.0 * 0.0125 * f64::from(frame);
        let state = bench.see_for(1, at(0.0, 0.0, theta));
        assert!(state.orientation > -PI && state.orientation <= PI);
        assert!(state.predicted_orientation > -PI && state.predicted_orientation <= PI);
        let error = geometry::wrap_angle(state.orientation - theta);
        assert!(error.abs() < 0.05, "{frame} {error}");
        if frame > 20 {
            assert_eq!(bench.status(), TrackStatus::Measured);
            assert!((state.omega - 5.0).abs() < 0.5, "{}", state.omega);
        }
    }
}

#[test]
fn clocks_that_stand_jump_or_run_backwards_are_survived() {
    let mut bench = Bench::new();
    bench.see_for(60, HOME);
    let near = at(HOME.x + 0.2, HOME.y, HOME.theta);
    // The same instant again: one more measurement of it.
    bench.t_ns -= FRAME_NS;
    let before = bench.robot();
    let again = bench.see_for(1, near);
    assert_eq!(bench.status(), TrackStatus::Measured);
    assert!(again.covariance[0] < before.covariance[0]);
    // A short pause: still the same track.
    bench.t_ns += 300_000_000;
    bench.see_for(1, near);
    assert_eq!(bench.status(), TrackStatus::Measured);
    // A long one, backwards, and arbitrary times: a fresh start each time.
    for t_ns in [bench.t_ns + 1_100_000_000, 20_000_000, u64::MAX, 0, u64::MAX - 1, START_NS] {
        bench.t_ns = t_ns;
        stamp(&mut bench.frame, bench.seq, t_ns.min(u64::MAX / 2));
        bench.frame.frame.t_capture_ns = t_ns;
        assert!(bench.frame.push_robot(detected(0, 2, near)));
        bench.filter.step(&bench.frame, &mut bench.world);
        assert_eq!(bench.status(), TrackStatus::Initialised, "{t_ns}");
        assert!(distance(&bench.robot(), near) < 1e-3);
        assert!(bench.robot().predicted_x_mm.is_finite());
    }
    bench.t_ns += FRAME_NS;
    bench.see_for(1, near);
    assert_eq!(bench.status(), TrackStatus::Measured);
}

#[test]
fn frames_of_any_rate_are_followed() {
    let mut bench = Bench::new();
    let mut random = Random(6);
    let mut x = -800.0;
    for frame in 0..150 {
        let state = bench.see_for(1, at(x, 0.0, 0.0));
        if frame > 20 {
            assert_eq!(bench.status(), TrackStatus::Measured);
            assert!((state.x_mm - x).abs() < 0.1 && (state.v_mm_s - 400.0).abs() < 30.0);
        }
        // 20 to 1000 frames a second.
        let dt_ns = random.between(1e6, 50e6) as u64;
        bench.t_ns = bench.t_ns - FRAME_NS + dt_ns;
        x += 400.0 * dt_ns as f64 * 1e-9;
    }
}

#[test]
fn the_likelier_of_two_detections_of_one_robot_is_used() {
    let mut bench = Bench::new();
    let far = DetectedRobot { confidence: 1.0, ..detected(0, 2, at(600.0, 300.0, 0.0)) };
    bench.see_for(40, HOME);
    for robots in [[detected(0, 2, HOME), far], [far, detected(0, 2, HOME)]] {
        bench.see(&robots);
        assert_eq!(bench.status(), TrackStatus::Measured);
        assert!(distance(&bench.robot(), HOME) < 0.01);
        assert_eq!(bench.world.robots().len(), 1);
    }
    // Without a track, the more confident one.
    let mut bench = Bench::new();
    bench.see(&[detected(0, 2, HOME), far]);
    assert!((bench.robot().x_mm - 600.0).abs() < 1e-3);
}

#[test]
fn the_ball_is_followed_through_a_kick() {
    let mut bench = Bench::new();
    for _ in 0..40 {
        bench.see_ball(0.0, 0.0);
    }
    for frame in 1..=10 {
        // 2.4 m/s from one frame to the next.
        let (x, y) = (30.0 * f64::from(frame), 0.0);
        let ball = bench.see_ball(x, y).ball;
        assert_eq!(ball.status, TrackStatus::Measured as u32);
        assert!((ball.x_mm - x).abs() < 2.0 && ball.y_mm.abs() < 0.5, "{frame} {ball:?}");
    }
    let ball = bench.world.ball;
    assert!((ball.vx_mm_s - 2400.0).abs() < 100.0);
    let ahead_s = (bench.world.t_predicted_ns - (bench.t_ns - FRAME_NS)) as f64 * 1e-9;
    assert!((ball.predicted_x_mm - (300.0 + 2400.0 * ahead_s)).abs() < 8.0, "{ball:?}");
    // A hidden ball rolls on and becomes less certain.
    let before = ball;
    let after = bench.see(&[]).ball;
    assert_eq!(after.status, TrackStatus::Coasting as u32);
    assert!(after.x_mm > before.x_mm + 25.0 && after.covariance[0] > before.covariance[0]);
}

#[test]
fn the_ball_is_chosen_among_candidates() {
    let mut bench = Bench::new();
    for _ in 0..40 {
        bench.see_ball(0.0, 0.0);
    }
    let ball_among = |bench: &mut Bench, candidates: &[(f64, f64, f32)]| {
        stamp(&mut bench.frame, bench.seq, bench.t_ns);
        for &(x, y, confidence) in candidates {
            assert!(bench.frame.push_ball(detected_ball(x, y, confidence)));
        }
        bench.step().ball
    };
    // The one at the track, though another has a higher confidence.
    let ball = ball_among(&mut bench, &[(500.0, 0.0, 1.0), (0.5, 0.0, 0.6), (20.0, 20.0, 0.9)]);
    assert_eq!(ball.status, TrackStatus::Measured as u32);
    assert!(ball.x_mm.hypot(ball.y_mm) < 0.5, "{ball:?}");
    // Two in the same place: the one of higher confidence.
    let ball = ball_among(&mut bench, &[(0.0, -1.0, 0.3), (0.0, 1.0, 0.9)]);
    assert!(ball.y_mm > 0.0, "{ball:?}");
    // Candidates of low confidence elsewhere are no ball, however long they persist.
    for _ in 0..30 {
        let ball = ball_among(&mut bench, &[(500.0, 0.0, 0.1), (150.0, 0.0, 0.1)]);
        assert_eq!(ball.status, TrackStatus::Coasting as u32);
        assert!(ball.x_mm.abs() < 5.0, "{ball:?}");
    }
    // A persistent candidate of high confidence is, also while the track is fresh.
    for _ in 0..20 {
        ball_among(&mut bench, &[(0.0, 0.0, 0.9)]);
    }
    for (frame, expected) in
        [TrackStatus::Gated, TrackStatus::Gated, TrackStatus::Initialised].into_iter().enumerate()
    {
        // Even if other candidates with a higher confidence flicker later.
        let confidence = if frame == 0 { 0.5 } else { 0.95 };
        let elsewhere = (-900.0 + 200.0 * frame as f64, 800.0, confidence);
        let ball = ball_among(&mut bench, &[elsewhere, (1000.0, -700.0, 0.8)]);
        assert_eq!(ball.status, expected as u32);
    }
    assert!((bench.world.ball.x_mm - 1000.0).abs() < 1e-3);
}

#[test]
fn impossible_configurations_are_refused() {
    let mut config = Config::default();
    config.filter.position_noise_mm = 0.0;
    let error = Filter::new(&config).unwrap_err();
    assert!(
        matches!(error, FilterError::Impossible { key: "filter.position_noise_mm", .. }),
        "{error}"
    );
    config = Config::default();
    config.filter.ball_friction_per_s = f64::NAN;
    assert!(Filter::new(&config).is_err());
}

fn any_robot() -> impl Strategy<Value = DetectedRobot> {
    let number = prop_oneof![
        4 => -1500.0f32..1500.0,
        1 => any::<f32>(),
        1 => Just(f32::NAN),
        1 => Just(f32::MAX),
    ];
    let small = prop_oneof![8 => 0u32..4, 1 => any::<u32>()];
    (small.clone(), small, [number.clone(), number.clone(), number.clone(), number]).prop_map(
        |(team, robot_id, [x_mm, y_mm, orientation, confidence])| DetectedRobot {
            team,
            robot_id: robot_id.into(),
            x_mm,
            y_mm,
            orientation,
            confidence,
            ..Default::default()
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Any detections: no panic, at most one track per configured robot, sorted, finite.
    #[test]
    fn any_detections_are_survived(
        frames in prop::collection::vec(
            (prop::collection::vec(any_robot(), 0..32), 0u64..60_000_000),
            1..60,
        ),
        robot_count in any::<u32>(),
        ball_count in any::<u32>(),
    ) {
        let mut bench = Bench::new();
        for (robots, dt_ns) in frames {
            bench.t_ns = bench.t_ns - FRAME_NS + dt_ns;
            stamp(&mut bench.frame, bench.seq, bench.t_ns);
            for robot in &robots {
                prop_assert!(bench.frame.push_robot(*robot));
                let ball = detected_ball(robot.x_mm.into(), robot.y_mm.into(), robot.confidence);
                bench.frame.push_ball(ball);
            }
            let world = bench.step();
            let identity = |robot: &RobotState| (robot.team, robot.robot_id);
            prop_assert!(world.robots().is_sorted_by(|a, b| identity(a) < identity(b)));
            for robot in world.robots() {
                prop_assert!(robot.team < 2 && robot.robot_id < 5);
                let numbers = [robot.x_mm, robot.y_mm, robot.orientation, robot.v_mm_s,
                    robot.omega, robot.predicted_x_mm, robot.predicted_y_mm];
                prop_assert!(numbers.iter().chain(&robot.covariance).all(|n| n.is_finite()));
                prop_assert!(robot.x_mm.abs() < 200_000.0);
            }
            let ball = &world.ball;
            prop_assert!(ball.covariance.iter().chain([&ball.x_mm]).all(|n| n.is_finite()));
        }
        // Counts beyond the arrays.
        bench.frame.robot_count = robot_count;
        bench.frame.ball_count = ball_count;
        bench.step();
    }
}
