//! A step allocates nothing once all robots have been seen.

#[path = "../../tests/counting/mod.rs"]
mod counting;
mod pitch;

use bytemuck::Zeroable;
use config::Config;
use counting::allocations_in;
use messages::WorldFrame;
use pitch::{commands, detected, detected_ball, empty_frame};
use touchline_filter::Filter;

#[test]
fn a_step_allocates_nothing_once_warm() {
    let mut filter = Filter::new(&Config::default()).unwrap();
    let mut world = Box::new(WorldFrame::zeroed());
    let mut step = |seq: u64| {
        let t_ns = 1_000_000_000 + seq * 12_500_000;
        let mut frame = empty_frame(seq, t_ns);
        // Every tenth frame most robots are out of sight.
        for number in 0..if seq.is_multiple_of(10) { 3 } else { 10 } {
            let x = -900.0 + 180.0 * f64::from(number) + seq as f64;
            let pose = pitch::Pose { x, y: 100.0, theta: 0.3 };
            assert!(frame.push_robot(detected(number / 5, number % 5, pose)));
        }
        assert!(frame.push_ball(detected_ball(-300.0 + seq as f64, 50.0, 0.9)));
        let told = commands(seq, t_ns, &[(0, 0, 80.0, 80.0), (1, 2, -50.0, 60.0)]);
        allocations_in(|| {
            filter.command(&told);
            filter.step(&frame, &mut world);
        })
    };
    for seq in 0..40 {
        step(seq);
    }
    for seq in 40..120 {
        assert_eq!(step(seq), 0, "frame {seq}");
    }
    assert_eq!(world.robots().len(), 10);
}
