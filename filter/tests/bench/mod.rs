//! A filter that is fed one frame after the other.

// Each test file uses a part of this.
#![allow(dead_code)]

use crate::pitch::*;
use config::Config;
use messages::{DetectedRobot, DetectionFrame, RobotState, TrackStatus, WorldFrame};
use touchline_filter::Filter;

/// A filter, its next frame and its last output.
pub struct Bench {
    pub filter: Filter,
    pub frame: Box<DetectionFrame>,
    pub world: Box<WorldFrame>,
    pub seq: u64,
    pub t_ns: u64,
}

impl Bench {
    pub fn new() -> Self {
        Self {
            filter: Filter::new(&Config::default()).unwrap(),
            frame: empty_frame(0, START_NS),
            world: new_world(),
            seq: 0,
            t_ns: START_NS,
        }
    }

    /// Advances by one frame that contains these robots.
    pub fn see(&mut self, robots: &[DetectedRobot]) -> &WorldFrame {
        self.see_both(robots, None)
    }

    pub fn see_ball(&mut self, x: f64, y: f64) -> &WorldFrame {
        self.see_both(&[], Some((x, y)))
    }

    pub fn see_both(&mut self, robots: &[DetectedRobot], ball: Option<(f64, f64)>) -> &WorldFrame {
        stamp(&mut self.frame, self.seq, self.t_ns);
        for &robot in robots {
            assert!(self.frame.push_robot(robot));
        }
        if let Some((x, y)) = ball {
            assert!(self.frame.push_ball(detected_ball(x, y, 0.9)));
        }
        self.step()
    }

    pub fn step(&mut self) -> &WorldFrame {
        self.filter.step(&self.frame, &mut self.world);
        self.seq += 1;
        self.t_ns += FRAME_NS;
        &self.world
    }

    /// Robot 2 of the yellow team, seen at `pose` in `frames` frames.
    pub fn see_for(&mut self, frames: usize, pose: Pose) -> RobotState {
        for _ in 0..frames {
            self.see(&[detected(0, 2, pose)]);
        }
        self.robot()
    }

    pub fn robot(&self) -> RobotState {
        let robot = self.world.robots().iter().find(|r| (r.team, r.robot_id) == (0, 2));
        *robot.expect("the robot should have a track")
    }

    pub fn status(&self) -> TrackStatus {
        TrackStatus::from_number(self.robot().status).unwrap()
    }
}

pub const HOME: Pose = Pose { x: 100.0, y: -200.0, theta: 0.7 };

pub fn distance(robot: &RobotState, pose: Pose) -> f64 {
    (robot.x_mm - pose.x).hypot(robot.y_mm - pose.y)
}

pub fn at(x: f64, y: f64, theta: f64) -> Pose {
    Pose { x, y, theta }
}
