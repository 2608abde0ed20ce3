//! The filter with any sequence of detections, commands and resumptions. Every published pose is finite
//! and on or near a pitch, and the filter can resume from its own output.
#![no_main]

use bytemuck::{Pod, bytes_of_mut};
use config::Config;
use messages::{
    Commands, DetectedBall, DetectedRobot, DetectionFrame, RobotId, TrackStatus, WorldFrame,
};
use filter::Filter;
use libfuzzer_sys::fuzz_target;

/// Detections farther away are rejected; a track may coast slightly farther.
const FAR_MM: f64 = 1e6;

struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn byte(&mut self) -> Option<u8> {
        let (&first, rest) = self.0.split_first()?;
        self.0 = rest;
        Some(first)
    }

    /// Overwrites a part of a value, as far as the bytes last.
    fn fill<T: Pod>(&mut self, value: &mut T) {
        let to = bytes_of_mut(value);
        let length = to.len().min(self.0.len());
        let (first, rest) = self.0.split_at(length);
        to[..length].copy_from_slice(first);
        self.0 = rest;
    }
}

fn is_absent(status: u32) -> bool {
    status == TrackStatus::Absent as u32
}

fn check(world: &WorldFrame) {
    for robot in world.robots().iter().filter(|robot| !is_absent(robot.status)) {
        let numbers = [robot.x_mm, robot.y_mm, robot.predicted_x_mm, robot.predicted_y_mm];
        assert!(numbers.iter().all(|number| number.abs() < FAR_MM), "{robot:?}");
        let angles = [robot.orientation, robot.predicted_orientation];
        assert!(angles.iter().all(|angle| angle.abs() <= 3.15), "{robot:?}");
        assert!(robot.v_mm_s.is_finite() && robot.omega.is_finite(), "{robot:?}");
        assert!(robot.covariance.iter().all(|number| number.is_finite()), "{robot:?}");
    }
    for robot in world.unknown_robots().iter().filter(|robot| !is_absent(robot.status)) {
        let numbers = [robot.x_mm, robot.y_mm, robot.predicted_x_mm, robot.predicted_y_mm];
        assert!(numbers.iter().all(|number| number.abs() < FAR_MM), "{robot:?}");
        assert!(robot.vx_mm_s.is_finite() && robot.vy_mm_s.is_finite(), "{robot:?}");
        assert!(robot.covariance.iter().all(|number| number.is_finite()), "{robot:?}");
        assert!(robot.track_id > 0, "{robot:?}");
    }
    let ball = &world.ball;
    if !is_absent(ball.status) {
        let numbers = [ball.x_mm, ball.y_mm, ball.predicted_x_mm, ball.predicted_y_mm];
        assert!(numbers.iter().all(|number| number.abs() < FAR_MM), "{ball:?}");
        assert!(ball.covariance.iter().all(|number| number.is_finite()), "{ball:?}");
    }
}

fuzz_target!(|bytes: &[u8]| {
    let mut bytes = Bytes(bytes);
    let mut config = Config::default();
    config.robots.report_unknown = true;
    let mut filter = Filter::new(&config).expect("the defaults can be used");
    let mut detections: Box<DetectionFrame> = bytemuck::zeroed_box();
    let mut world: Box<WorldFrame> = bytemuck::zeroed_box();
    let mut t_ns = 1_000_000_000_u64;
    while let Some(kind) = bytes.byte() {
        match kind % 8 {
            // Any header at all.
            0 => bytes.fill(&mut detections.frame),
            // A plausible robot with any numbers.
            1 | 2 => {
                let slot = usize::from(kind / 8) % 4;
                let robot: &mut DetectedRobot = &mut detections.robots[slot];
                bytes.fill(robot);
                if kind % 8 == 1 {
                    let number = robot.robot_id.number().unwrap_or(5) % 6;
                    robot.team %= 2;
                    robot.robot_id =
                        if number == 5 { RobotId::UNKNOWN } else { RobotId::from(number) };
                    (robot.x_mm, robot.y_mm) = (robot.x_mm % 1100.0, robot.y_mm % 900.0);
                    robot.confidence = 0.9;
                }
                detections.robot_count = u32::from(bytes.byte().unwrap_or(1));
            }
            3 => {
                let ball: &mut DetectedBall = &mut detections.balls[0];
                bytes.fill(ball);
                detections.ball_count = u32::from(bytes.byte().unwrap_or(1));
            }
            4 => {
                let mut commands: Commands = bytemuck::Zeroable::zeroed();
                (commands.wheel_count, commands.t_sent_ns) = (2, t_ns);
                bytes.fill(&mut commands.wheels[0]);
                bytes.fill(&mut commands.wheels[1]);
                filter.command(&commands);
            }
            // Its own output with a part corrupted.
            5 => {
                let place = usize::from(bytes.byte().unwrap_or(0)) % 4;
                bytes.fill(&mut world.robot_memories[place].hypotheses[0]);
                bytes.fill(&mut world.robots[place]);
                bytes.fill(&mut world.unknown_robot_memories[place]);
                world.robot_count = world.robot_count.max(1);
                world.unknown_memory_count = world.unknown_memory_count.max(1);
                filter.resume(&world);
            }
            6 => filter.resume(&world),
            _ => {
                t_ns += u64::from(kind) * 1_000_000;
                detections.frame.t_capture_ns = t_ns;
            }
        }
        filter.step(&detections, &mut world);
        check(&world);
    }
});
