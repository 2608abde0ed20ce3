//! A filter that takes over from another continues exactly, and survives taking over invalid data.

mod pitch;

use bytemuck::Zeroable;
use config::Config;
use messages::{Commands, DetectionFrame, WorldFrame};
use pitch::*;
use proptest::prelude::*;
use touchline_filter::Filter;

/// Input of one frame: detections, and the commands after it.
type Input = (Box<DetectionFrame>, Commands);

/// A match with all special cases: commands for some robots, collisions, gaps, outliers, duplicates, a ball,
/// a pause, a clock that stands still for a frame.
fn inputs(frames: u64) -> Vec<Input> {
    let noise = Noise { position_mm: 0.5, heading_deg: 1.0 };
    let mut game = Match::new(Wheels::Lagging(0.02), true, noise, 21);
    game.collisions_every_s = Some(1.0);
    let (mut ball, mut random) = (Ball::new(3), Random(5));
    let mut pause_ns = 0;
    (0..frames)
        .map(|seq| {
            let mut sent = game.next_frame();
            // The filter receives one team's commands, not the other's.
            sent.wheel_count = 5;
            ball.roll();
            let mut frame = game.detections.clone();
            frame.robot_count = 0;
            for &robot in game.detections.robots() {
                let mut robot = robot;
                if random.unit() < 0.1 {
                    continue;
                }
                if random.unit() < 0.05 {
                    robot.x_mm += random.between(-500.0, 500.0) as f32;
                }
                assert!(frame.push_robot(robot));
                if random.unit() < 0.02 {
                    robot.y_mm += 100.0;
                    assert!(frame.push_robot(robot));
                }
            }
            if seq % 90 > 60 {
                // The last robot is lifted and put down.
                frame.robot_count = frame.robot_count.saturating_sub(1);
            }
            if ball.frames_hidden == 0 {
                assert!(frame.push_ball(detected_ball(ball.position.0, ball.position.1, 0.8)));
            }
            if random.unit() < 0.1 {
                let (x, y) = (random.between(-1000.0, 1000.0), random.between(-800.0, 800.0));
                assert!(frame.push_ball(detected_ball(x, y, 0.5)));
            }
            if seq == frames / 2 {
                pause_ns = 1_500_000_000;
            }
            frame.frame.t_capture_ns += pause_ns;
            if seq == frames / 3 {
                frame.frame.t_capture_ns -= FRAME_NS;
            }
            frame.t_sent_ns += pause_ns;
            sent.t_sent_ns += pause_ns;
            (frame, sent)
        })
        .collect()
}

/// Contents of a message, without what lies behind its counts.
fn said(world: &WorldFrame) -> Vec<u8> {
    let count = world.robots().len();
    let mut bytes = vec![];
    for part in [
        bytemuck::bytes_of(&world.frame),
        bytemuck::cast_slice(&[
            world.t_frame_taken_ns,
            world.t_runs_ns,
            world.t_runs_taken_ns,
            world.t_detections_ns,
            world.t_detections_taken_ns,
            world.t_sent_ns,
            world.t_predicted_ns,
            world.commands_seq,
            world.prior_world_seq,
        ]),
        bytemuck::bytes_of(&world.robot_count),
        bytemuck::cast_slice(world.commands()),
        bytemuck::cast_slice(&world.robots[..count]),
        bytemuck::cast_slice(&world.robot_memories[..count]),
        bytemuck::bytes_of(&world.ball),
        bytemuck::bytes_of(&world.ball_memory),
    ] {
        bytes.extend_from_slice(part);
    }
    bytes
}

#[test]
fn a_successor_carries_on_bit_for_bit() {
    let inputs = inputs(400);
    let config = Config::default();
    let mut first = Filter::new(&config).unwrap();
    let mut worlds = vec![];
    for (frame, sent) in &inputs {
        let mut world = new_world();
        first.step(frame, &mut world);
        // Commands arrive between frames.
        first.command(sent);
        worlds.push(world);
    }
    let statuses: std::collections::BTreeSet<u32> =
        worlds.iter().flat_map(|world| world.robots()).map(|robot| robot.status).collect();
    assert_eq!(statuses.len(), 4, "the match should show every status");
    assert!(worlds.iter().flat_map(|w| &w.robot_memories).any(|m| m.command_count > 3));

    // A successor at every seventh frame, which runs for 60.
    for start in (0..inputs.len()).step_by(7) {
        let mut successor = Filter::new(&config).unwrap();
        successor.resume(&worlds[start]);
        let end = inputs.len().min(start + 60);
        let mut world = new_world();
        for index in start + 1..end {
            // Commands that the predecessor received after its last world.
            successor.command(&inputs[index - 1].1);
            successor.step(&inputs[index].0, &mut world);
            assert!(said(&world) == said(&worlds[index]), "resumed after {start}, frame {index}");
        }
    }
}

/// Commands received twice have no further effect.
#[test]
fn repeated_commands_change_nothing() {
    let noise = Noise { position_mm: 0.5, heading_deg: 1.0 };
    let mut game = Match::new(Wheels::Exact, true, noise, 8);
    let config = Config::default();
    let (mut once, mut twice) = (Filter::new(&config).unwrap(), Filter::new(&config).unwrap());
    let (mut a, mut b) = (new_world(), new_world());
    let mut heard = vec![];
    for _ in 0..200 {
        heard.push(game.next_frame());
        once.step(&game.detections, &mut a);
        twice.step(&game.detections, &mut b);
        // Only the count of commands differs.
        (a.command_count, b.command_count) = (0, 0);
        assert!(said(&a) == said(&b));
        once.command(&heard[heard.len() - 1]);
        for commands in heard.iter().rev().take(3).rev() {
            twice.command(commands);
        }
    }
    assert_eq!(a.commands_seq, 199);
}

fn some_world() -> Box<WorldFrame> {
    let mut filter = Filter::new(&Config::default()).unwrap();
    let mut world = new_world();
    for (frame, sent) in inputs(50) {
        filter.step(&frame, &mut world);
        filter.command(&sent);
    }
    assert_eq!(world.robots().len(), 10);
    world
}

#[test]
fn invalid_tracks_are_dropped_and_the_others_kept() {
    type Spoil = fn(&mut WorldFrame);
    let spoils: [(Spoil, usize); 14] = [
        (|w| w.robot_memories[3].hypotheses[1].covariance[7] = f64::NAN, 9),
        (|w| w.robot_memories[3].hypotheses[1].covariance[0] = -1.0, 9),
        (|w| w.robot_memories[3].hypotheses[2].covariance[1] = 1e12, 9),
        (|w| w.robot_memories[3].hypotheses[2].mean[2] = 100.0, 9),
        (|w| w.robot_memories[3].hypotheses[2].mean[4] = f64::INFINITY, 9),
        (|w| w.robot_memories[3].hypotheses[0].probability = 2.0, 9),
        (|w| w.robot_memories[3].gated_pose[0] = f64::NAN, 9),
        (|w| w.robot_memories[3].command_count = 1000, 9),
        (|w| w.robot_memories[3].commands = [bytemuck::cast([u64::MAX; 3]); 12], 9),
        (|w| w.robot_memories[3].t_seen_ns = u64::MAX, 9),
        (|w| w.robots[3].team = 7, 9),
        (|w| w.robots[3].status = 77, 9),
        (|w| w.robots[3].robot_id = w.robots[4].robot_id, 9),
        (|w| w.robot_count = 5, 5),
    ];
    let good = some_world();
    let frame = empty_frame(50, good.frame.t_capture_ns + FRAME_NS);
    for (index, (spoil, expected)) in spoils.into_iter().enumerate() {
        let mut world = good.clone();
        // Full, so that a spoilt element is not hidden behind the count.
        world.robot_memories[3].command_count = world.robot_memories[3].command_count.max(1);
        spoil(&mut world);
        let mut filter = Filter::new(&Config::default()).unwrap();
        filter.resume(&world);
        let mut out = new_world();
        filter.step(&frame, &mut out);
        assert_eq!(out.robots().len(), expected, "spoil {index}");
    }
    let mut world = good.clone();
    world.ball_memory.hypotheses[0].mean[0] = f64::NAN;
    let mut filter = Filter::new(&Config::default()).unwrap();
    filter.resume(&world);
    let mut out = new_world();
    filter.step(&frame, &mut out);
    assert_eq!((out.ball.status, out.robots().len()), (0, 10));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Arbitrary bytes: no panic, only finite numbers come out, and the next frames are filtered.
    #[test]
    fn invalid_input_is_survived(seed in any::<u64>(), share in 0.0..1.0) {
        let mut world = some_world();
        let t_ns = world.frame.t_capture_ns;
        let mut random = Random(seed);
        for byte in bytemuck::bytes_of_mut(&mut *world) {
            if random.unit() < share * share * share {
                *byte = (random.unit() * 256.0) as u8;
            }
        }
        let mut filter = Filter::new(&Config::default()).unwrap();
        filter.resume(&world);
        let mut out = Box::new(WorldFrame::zeroed());
        let mut frame = empty_frame(50, t_ns);
        for seq in 1..=10 {
            stamp(&mut frame, 49 + seq, t_ns + seq * FRAME_NS);
            let pose = Pose { x: 100.0, y: 50.0, theta: 1.0 };
            prop_assert!(frame.push_robot(detected(0, 1, pose)));
            filter.step(&frame, &mut out);
            for robot in out.robots() {
                let numbers = [robot.x_mm, robot.y_mm, robot.orientation, robot.v_mm_s,
                    robot.omega, robot.predicted_x_mm, robot.predicted_y_mm];
                prop_assert!(numbers.iter().chain(&robot.covariance).all(|n| n.is_finite()));
            }
        }
        let robot = out.robots().iter().find(|r| (r.team, r.robot_id) == (0, 1)).unwrap();
        prop_assert!((robot.x_mm - 100.0).abs() < 1.0, "{robot:?}");
    }
}
