//! The synthetic match: a simulated camera above simulated robots.
//!
//! [`SyntheticMatch`] holds the true state, and renders pictures of it as the camera would take them: through
//! the same geometry that the tracker inverts, with uneven light, motion blur, sensor noise and a Bayer
//! mosaic. It has no clock; every [`advance`](SyntheticMatch::advance) is one frame period.
//!
//! # Time
//!
//! Frame k is the instant k / `camera.fps`, which is the middle of its exposure. Poses in
//! [`truth`](SyntheticMatch::truth) are those of that instant. During the exposure everything moves at the
//! constant speeds given in the truth.
//!
//! The [`commands`](SyntheticMatch::commands) of frame k are sent at that instant and act from
//! `filter.actuation_delay_ms` later until the next ones do. Accelerations are limited before a command is
//! sent, so wheels obey exactly: a filter that integrates eq. (7) over the delayed commands gets the true
//! motion. The exceptions are collisions: a robot that runs into a wall, another robot or a ball that cannot
//! give way stops dead, whatever its command, and accelerates again with its limit when the way is free.
//! Before frame 0 robots had commands, too, which were not published; those act in the first frames.
//!
//! # Reproducibility
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
mod random;
mod render;
mod shape;
mod simulation;
mod slip;
mod sprite;
#[cfg(test)]
mod tests;

use bytemuck::Zeroable;
use config::{Config, IdentityConfig};
use geometry::GeometryError;
use messages::{Commands, MAX_ROBOTS, Team, TruthFrame, TruthRobot, WheelCommand};
use motion::WheelSpeeds;
use render::Renderer;
use simulation::Simulation;

/// No synthetic match is possible with this configuration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SyntheticError {
    /// The camera geometry cannot be used.
    #[error("geometry: {0}")]
    Geometry(#[from] GeometryError),
    /// A number that makes no sense.
    #[error("{key} = {value}: no synthetic match is possible with this value")]
    Impossible {
        /// The configuration key.
        key: &'static str,
        /// Its value.
        value: f64,
    },
    /// A colour that is not in `colors`.
    #[error("the colour \"{name}\" is not one of the configured colours")]
    UnknownColor {
        /// Its name.
        name: String,
    },
    /// More robots than messages carry.
    #[error("{robots} robots are configured, messages carry at most {MAX_ROBOTS}")]
    TooManyRobots {
        /// Number of configured robots.
        robots: usize,
    },
    /// The field is too small.
    #[error("the field has no room for {robots} robots and a ball")]
    NoRoom {
        /// Number of configured robots.
        robots: usize,
    },
}

/// A simulated match.
#[derive(Debug, Clone)]
pub struct SyntheticMatch {
    frame_number: u64,
    simulation: Simulation,
    renderer: Renderer,
    truth: TruthFrame,
    commands: Commands,
}

impl SyntheticMatch {
    /// The match at frame 0: robots spread over the field, most already moving, some standing.
    pub fn new(config: &Config) -> Result<Self, SyntheticError> {
        let config = &with_unknown_opponents(config);
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
            simulation: Simulation::new(config)?,
            renderer: Renderer::new(config)?,
            truth: TruthFrame::zeroed(),
            commands: Commands::zeroed(),
        };
        synthetic.describe();
        Ok(synthetic)
    }

    /// Simulates one frame period, 1 / `camera.fps`.
    pub fn advance(&mut self) {
        self.simulation.advance();
        self.frame_number += 1;
        self.describe();
    }

    /// Number of the current frame, from 0.
    pub fn frame_number(&self) -> u64 {
        self.frame_number
    }

    /// Truth of the current frame. `seq` and `t_capture_ns` are 0, for the caller to fill in.
    pub fn truth(&self) -> &TruthFrame {
        &self.truth
    }

    /// Commands of all robots, of both teams, in the current frame. `seq` and `t_sent_ns` are 0, for the
    /// caller to fill in.
    pub fn commands(&self) -> &Commands {
        &self.commands
    }

    /// Renders the current frame. Writes every pixel, and leaves the bytes between the end of one row and the
    /// start of the next alone.
    ///
    /// # Panics
    ///
    /// If `stride` is less than `camera.width`, or `pixels` too short for all rows.
    pub fn render(&mut self, pixels: &mut [u8], stride: usize) {
        self.renderer.render(&self.simulation, self.frame_number, pixels, stride);
    }

    /// Has robots obey commands of another program. Each obeys until the next command, or for
    /// `filter.command_timeout_ms`; then it returns to its simulated strategy. Its wheels keep their limits
    /// of speed and acceleration. Commands of such a robot are not among [`commands`](Self::commands), and
    /// the match is no longer [reproducible](self#reproducibility).
    pub fn obey(&mut self, commands: &Commands) {
        for wheels in commands.wheels() {
            let speeds = WheelSpeeds { left_mm_s: wheels.left_mm_s, right_mm_s: wheels.right_mm_s };
            if let Some(team) = Team::from_number(wheels.team) {
                self.simulation.obey(team, wheels.robot_id, speeds);
            }
        }
    }

    fn describe(&mut self) {
        let ball = self.simulation.ball;
        let shows_ball = self.renderer.shows_ball(ball.position, &self.simulation.robots);
        self.truth.ball_visible = shows_ball.into();
        self.truth.ball_x_mm = ball.position.x_mm;
        self.truth.ball_y_mm = ball.position.y_mm;
        [self.truth.ball_vx_mm_s, self.truth.ball_vy_mm_s] = ball.velocity_mm_s;
        self.truth.robot_count = self.simulation.robots.len() as u32;
        self.commands.wheel_count = 0;
        for (robot, truth) in self.simulation.robots.iter().zip(&mut self.truth.robots) {
            *truth = TruthRobot {
                team: robot.team as u32,
                robot_id: robot.id,
                x_mm: robot.pose.position.x_mm,
                y_mm: robot.pose.position.y_mm,
                orientation: robot.pose.orientation,
                v_mm_s: robot.twist.v_mm_s,
                omega: robot.twist.omega,
                frames_still: robot.frames_still,
                visible: self.renderer.shows_robot(robot, &self.simulation.robots).into(),
            };
            if robot.is_obeying() {
                continue;
            }
            let command = robot.command();
            let wheels = &mut self.commands.wheels[self.commands.wheel_count as usize];
            self.commands.wheel_count += 1;
            *wheels = WheelCommand {
                team: robot.team as u32,
                robot_id: robot.id,
                left_mm_s: command.left_mm_s,
                right_mm_s: command.right_mm_s,
            };
        }
    }
}

/// The configuration with robots for a team that has none, if such are to play.
fn with_unknown_opponents(config: &Config) -> Config {
    let mut config = config.clone();
    let listed = config.robots.identities.clone();
    for team in Team::ALL {
        if listed.is_empty() || listed.iter().any(|robot| robot.team == team) {
            continue;
        }
        let opponents = (0..config.synthetic.unknown_opponents).zip(listed.iter().cycle());
        config.robots.identities.extend(opponents.map(|(id, robot)| IdentityConfig {
            team,
            id,
            height_mm: None,
            ..robot.clone()
        }));
    }
    config
}

/// Rejects zero, negative, infinite and NaN numbers.
fn positive(key: &'static str, value: f64) -> Result<f64, SyntheticError> {
    if value > 0.0 && value.is_finite() {
        Ok(value)
    } else {
        Err(SyntheticError::Impossible { key, value })
    }
}

/// Rejects negative, infinite and NaN numbers.
fn not_negative(key: &'static str, value: f64) -> Result<f64, SyntheticError> {
    if value == 0.0 { Ok(value) } else { positive(key, value) }
}
