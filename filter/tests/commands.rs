//! The effect of commands on tracks and predictions.

mod bench;
mod pitch;

use bench::*;
use config::Config;
use messages::WorldFrame;
use pitch::*;
use touchline_filter::Filter;

/// The paper's prediction over the delay: commands under way change the predicted pose.
#[test]
fn queued_commands_lead_the_prediction() {
    let mut bench = Bench::new();
    let still = bench.see_for(60, HOME);
    assert!((still.predicted_x_mm - HOME.x).abs() < 0.05);
    // Sent 5 ms after the capture of the newest frame, so it acts from 55 ms on.
    let t_sent_ns = bench.t_ns - FRAME_NS + 5_000_000;
    bench.filter.command(&commands(7, t_sent_ns, &[(0, 2, 400.0, 400.0)]));
    let state = bench.see_for(1, HOME);
    // Predicted to 66.5 ms after that capture.
    assert_eq!(bench.world.t_predicted_ns, t_sent_ns + 61_500_000);
    assert_eq!(bench.world.commands_seq, 7);
    let way = (state.predicted_x_mm - HOME.x).hypot(state.predicted_y_mm - HOME.y);
    assert!((way - 400.0 * 0.0115).abs() < 0.2, "{way}");
    let heading = (state.predicted_y_mm - HOME.y).atan2(state.predicted_x_mm - HOME.x);
    assert!((heading - HOME.theta).abs() < 0.05, "{heading}");
    assert!(distance(&state, HOME) < 0.05);
}

/// A robot out of sight that obeys its commands, and one without commands.
#[test]
fn commands_carry_a_track_through_a_gap() {
    let outcome = |overheard: bool| {
        let noise = Noise { position_mm: 0.5, heading_deg: 1.0 };
        let mut game = Match::new(Wheels::Exact, overheard, noise, 12);
        let mut filter = Filter::new(&Config::default()).unwrap();
        let mut world = new_world();
        let mut errors = Errors::default();
        for frame in 0..800 {
            let sent = game.next_frame();
            if frame % 40 >= 30 {
                game.detections.robot_count = 0;
            }
            filter.step(&game.detections, &mut world);
            filter.command(&sent);
            if frame % 40 == 39 {
                for (robot, state) in game.robots.iter().zip(world.robots()) {
                    errors.add(robot.pose, state.x_mm, state.y_mm, state.orientation);
                }
            }
        }
        errors.rms().0
    };
    let (told, free) = (outcome(true), outcome(false));
    assert!(told < 3.0 && told < 0.3 * free, "{told} {free}");
}

#[test]
fn invalid_commands_are_ignored() {
    let t = START_NS + 60 * FRAME_NS;
    let rubbish = [
        commands(1, t, &[(0, 2, f64::NAN, 0.0)]),
        commands(2, t, &[(0, 2, 0.0, f64::INFINITY)]),
        commands(3, t, &[(0, 2, 20_001.0, 0.0)]),
        commands(4, t, &[(9, 2, 500.0, 500.0)]),
        commands(5, t, &[(0, 31, 500.0, 500.0)]),
        commands(6, t, &[(0, u32::MAX, 500.0, 500.0)]),
        commands(7, 0, &[(0, 2, 500.0, 500.0)]),
        commands(8, u64::MAX, &[(0, 2, 500.0, 500.0)]),
        commands(9, t + 3_000_000_000, &[(0, 2, 500.0, 500.0)]),
        commands(10, t - 400_000_000, &[(0, 2, 500.0, 500.0)]),
    ];
    let (mut bothered, mut spared) = (Bench::new(), Bench::new());
    // No frame has been seen yet.
    bothered.filter.command(&commands(11, t, &[(0, 2, 500.0, 500.0)]));
    bothered.see_for(60, HOME);
    spared.see_for(60, HOME);
    for message in &rubbish {
        bothered.filter.command(message);
        let mut counted_wrong = *message;
        counted_wrong.wheel_count = u32::MAX;
        counted_wrong.wheels[5].robot_id = 2;
        counted_wrong.wheels[5].left_mm_s = f64::NAN;
        if counted_wrong.wheels[0].robot_id != 0 {
            counted_wrong.wheels = [counted_wrong.wheels[0]; 32];
            bothered.filter.command(&counted_wrong);
        }
    }
    for _ in 0..20 {
        assert_eq!(bothered.see_for(1, HOME), spared.see_for(1, HOME));
        assert_eq!(bothered.world.commands_seq, WorldFrame::NO_COMMANDS);
    }
}

#[test]
fn stale_commands_no_longer_count() {
    let mut bench = Bench::new();
    bench.see_for(60, HOME);
    bench.filter.command(&commands(1, bench.t_ns, &[(0, 2, 300.0, 300.0)]));
    let memory = |bench: &Bench| bench.world.robot_memories[0].command_count;
    bench.see_for(1, HOME);
    assert_eq!(memory(&bench), 1);
    // 250 ms later.
    bench.see_for(20, HOME);
    assert_eq!(memory(&bench), 0);
    let state = bench.robot();
    assert!((state.predicted_x_mm - HOME.x).abs() < 0.1);
}
