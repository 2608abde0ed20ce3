//! A camera with rolling shutter: moving objects are estimated at the frame's time.

mod pitch;

use config::Config;
use geometry::wrap_angle;
use messages::DetectedRobot;
use pitch::*;
use touchline_filter::Filter;

const READOUT_US: u32 = 10_000;
/// Far below the middle.
const ROW_PX: f32 = 400.0;
const SPEED_MM_S: f64 = 2000.0;
const TURN_RAD_S: f64 = 8.0;
const BALL_MM_S: f64 = -3000.0;

/// Final errors at the capture time, all seen in a row that is captured late: of a driving robot, mm; of a
/// turning one, degrees; of a ball, mm.
fn errors(configured_us: u32) -> [f64; 3] {
    let mut config = Config::default();
    config.camera.rolling_shutter_us = configured_us;
    config.filter.ball_friction_per_s = 0.0;
    let mut filter = Filter::new(&config).unwrap();
    let mut frame = empty_frame(0, START_NS);
    let mut world = new_world();
    let last_row = f64::from(config.camera.height - 1);
    let late_s = (f64::from(ROW_PX) / last_row - 0.5) * f64::from(READOUT_US) * 1e-6;
    let driving = |t_s: f64| Pose { x: SPEED_MM_S * t_s - 700.0, y: 200.0, theta: 0.0 };
    let turning = |t_s: f64| Pose { x: 0.0, y: -300.0, theta: wrap_angle(TURN_RAD_S * t_s) };
    let ball = |t_s: f64| (600.0 + BALL_MM_S * t_s, 0.0);
    let mut last_s = 0.0;
    for number in 0..60 {
        let t_ns = START_NS + number * FRAME_NS;
        last_s = (t_ns - START_NS) as f64 * 1e-9;
        stamp(&mut frame, number, t_ns);
        for (robot_id, pose) in [(1, driving(last_s + late_s)), (2, turning(last_s + late_s))] {
            let robot = DetectedRobot { y_px: ROW_PX, ..detected(0, robot_id, pose) };
            assert!(frame.push_robot(robot));
        }
        let (x, y) = ball(last_s + late_s);
        let mut seen = detected_ball(x, y, 0.9);
        seen.y_px = ROW_PX;
        assert!(frame.push_ball(seen));
        filter.step(&frame, &mut world);
    }
    let robot = |id: u32| world.robots().iter().find(|r| (r.team, r.robot_id) == (0, id)).unwrap();
    let heading = wrap_angle(robot(2).orientation - turning(last_s).theta);
    [robot(1).x_mm - driving(last_s).x, heading.to_degrees(), world.ball.x_mm - ball(last_s).0]
        .map(f64::abs)
}

#[test]
fn poses_are_those_of_the_frames_time() {
    let [position_mm, heading_deg, ball_mm] = errors(0);
    assert!(position_mm > 5.0 && heading_deg > 1.0 && ball_mm > 8.0, "{:?}", errors(0));
    let [position_mm, heading_deg, ball_mm] = errors(READOUT_US);
    assert!(position_mm < 0.3 && heading_deg < 0.1 && ball_mm < 0.5, "{:?}", errors(READOUT_US));
}
