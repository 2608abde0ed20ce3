//! The synthetic match: a camera above robots that drive about, without either.
//!
//! [`SyntheticMatch`] knows what is true, and takes pictures of it as the camera would: through the
//! same geometry that the tracker inverts, with uneven light, motion blur, sensor noise and a Bayer
//! mosaic. It has no clock; every [`advance`](SyntheticMatch::advance) is one frame period.
//!
//! # Time
//!
//! Frame k is the instant k / `camera.fps`, which is the middle of its exposure. Poses in
//! [`truth`](SyntheticMatch::truth) are those of that instant. During the exposure everything moves
//! on evenly with the speeds given in the truth.
//!
//! The [`commands`](SyntheticMatch::commands) of frame k are sent at that instant and act from
//! `filter.actuation_delay_ms` later until the next ones do. Accelerations are limited before a
//! command is sent, so wheels do exactly what they were told: a filter that integrates eq. (7) over
//! the commands, delayed, gets the true motion. The exceptions are collisions: a robot that runs
//! into a wall, another robot or a ball that cannot give way stops dead, whatever its command, and
//! speeds up again with limited acceleration when the way is free. Before frame 0 robots had
//! commands too, which nobody saw; those reach into the first frames.
//!
//! # Sameness
//!
//! The state of frame k depends on the configuration (with its seed) and k alone, and so does every
//! pixel, noise included: rendering a frame again, or after others were skipped, gives the same
//! bytes.

mod behaviour;
mod collision;
mod light;
mod motion;
mod optics;
mod pitch;
mod play;
mod random;
mod render;
mod shape;
mod sprite;
#[cfg(test)]
mod tests;

use bytemuck::Zeroable;
use common::config::Config;
use common::geometry::GeometryError;
use common::messages::{Commands, MAX_ROBOTS, TruthFrame, TruthRobot, WheelCommand};
use play::Play;
use render::Renderer;

/// Why there can be no synthetic match.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SyntheticError {
    /// The camera geometry cannot be used.
    #[error("geometry: {0}")]
    Geometry(#[from] GeometryError),
    /// A number that makes no sense.
    #[error("{key} = {value} makes no synthetic match possible")]
    Impossible {
        /// The configuration key.
        key: &'static str,
        /// Its value.
        value: f64,
    },
    /// A colour that is not in `colors`.
    #[error("the colour \"{name}\" is not one of the configured colours")]
    UnknownColor {
        /// What was asked for.
        name: String,
    },
    /// More robots than messages carry.
    #[error("{robots} robots are configured, messages carry at most {MAX_ROBOTS}")]
    TooManyRobots {
        /// How many were asked for.
        robots: usize,
    },
    /// They would stand on each other's toes.
    #[error("the field has no room for {robots} robots and a ball")]
    NoRoom {
        /// How many were asked for.
        robots: usize,
    },
}

/// A match that exists in memory only.
#[derive(Debug, Clone)]
pub struct SyntheticMatch {
    frame_number: u64,
    play: Play,
    renderer: Renderer,
    truth: TruthFrame,
    commands: Commands,
}

impl SyntheticMatch {
    /// The match at frame 0: robots spread over the field, most already moving, some standing.
    pub fn new(config: &Config) -> Result<Self, SyntheticError> {
        let robots = config.robots.identities.len();
        if robots > MAX_ROBOTS {
            return Err(SyntheticError::TooManyRobots { robots });
        }
        let camera = &config.camera;
        for (key, pixels) in [("camera.width", camera.width), ("camera.height", camera.height)] {
            if !(2..=16_384).contains(&pixels) {
                return Err(SyntheticError::Impossible { key, value: f64::from(pixels) });
            }
        }
        let mut synthetic = Self {
            frame_number: 0,
            play: Play::new(config)?,
            renderer: Renderer::new(config)?,
            truth: TruthFrame::zeroed(),
            commands: Commands::zeroed(),
        };
        synthetic.describe();
        Ok(synthetic)
    }

    /// Moves the match on by one frame period, 1 / `camera.fps`.
    pub fn advance(&mut self) {
        self.play.advance();
        self.frame_number += 1;
        self.describe();
    }

    /// Number of the current frame, from 0.
    pub fn frame_number(&self) -> u64 {
        self.frame_number
    }

    /// What is true in the current frame. `seq` and `t_capture_ns` are 0, for the caller to fill in.
    pub fn truth(&self) -> &TruthFrame {
        &self.truth
    }

    /// What all robots, of both teams, are told in the current frame. `seq` and `t_sent_ns` are 0,
    /// for the caller to fill in.
    pub fn commands(&self) -> &Commands {
        &self.commands
    }

    /// Takes a picture of the current frame. Writes every pixel, whatever the memory held before,
    /// and leaves the bytes between the end of one row and the start of the next alone.
    ///
    /// # Panics
    ///
    /// When `stride` is less than `camera.width`, or `pixels` too short for all rows.
    pub fn render(&mut self, pixels: &mut [u8], stride: usize) {
        self.renderer.render(&self.play, self.frame_number, pixels, stride);
    }

    fn describe(&mut self) {
        let ball = self.play.ball;
        let poses = self.play.robots.iter().map(|robot| robot.pose);
        self.truth.ball_visible = self.renderer.shows_ball(ball.position, poses).into();
        self.truth.ball_x_mm = ball.position.x_mm;
        self.truth.ball_y_mm = ball.position.y_mm;
        [self.truth.ball_vx_mm_s, self.truth.ball_vy_mm_s] = ball.velocity_mm_s;
        self.truth.robot_count = self.play.robots.len() as u32;
        self.commands.wheel_count = self.play.robots.len() as u32;
        let messages = self.truth.robots.iter_mut().zip(&mut self.commands.wheels);
        for (robot, (truth, wheels)) in self.play.robots.iter().zip(messages) {
            *truth = TruthRobot {
                team: robot.team as u32,
                robot_id: robot.id,
                x_mm: robot.pose.position.x_mm,
                y_mm: robot.pose.position.y_mm,
                orientation: robot.pose.orientation,
                v_mm_s: robot.twist.v_mm_s,
                omega: robot.twist.omega,
                frames_still: robot.frames_still,
                visible: self.renderer.shows_robot(&robot.pose).into(),
            };
            let command = robot.command();
            *wheels = WheelCommand {
                team: robot.team as u32,
                robot_id: robot.id,
                left_mm_s: command.left_mm_s,
                right_mm_s: command.right_mm_s,
            };
        }
    }
}

/// Refuses zero, negative, infinite and absent numbers.
fn positive(key: &'static str, value: f64) -> Result<f64, SyntheticError> {
    if value > 0.0 && value.is_finite() {
        Ok(value)
    } else {
        Err(SyntheticError::Impossible { key, value })
    }
}

/// Refuses negative, infinite and absent numbers.
fn not_negative(key: &'static str, value: f64) -> Result<f64, SyntheticError> {
    if value == 0.0 { Ok(value) } else { positive(key, value) }
}
