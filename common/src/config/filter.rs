//! Keys of the filter.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// From detections to filtered poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FilterConfig {
    /// Measurement noise of a robot's position, 1σ (R in eq. 14), for detections that do not say how
    /// uncertain they are; the tracker's do.
    #[schemars(range(min = 0.001, max = 1000))]
    pub position_noise_mm: f64,
    /// Measurement noise of a robot's heading, 1σ (R in eq. 14), likewise.
    #[schemars(range(min = 0.001, max = 180))]
    pub heading_noise_deg: f64,
    /// The error of a measurement stays the same until the patches have moved by about this much, a
    /// fifth of a pixel; until then further measurements count for little. 0 if each has an error of
    /// its own.
    #[schemars(range(min = 0, max = 1000))]
    pub repeat_distance_mm: f64,
    /// How strongly a robot of unknown commands may accelerate, 1σ (Q in eq. 12).
    #[schemars(range(min = 0.001, max = 1_000_000))]
    pub acceleration_noise_mm_s2: f64,
    /// How strongly a robot of unknown commands may change its turning rate, 1σ.
    #[schemars(range(min = 0.001, max = 1_000_000))]
    pub angular_acceleration_noise_deg_s2: f64,
    /// How far a commanded robot's speed may stray from its command, 1σ (wheel slip, battery). This and
    /// the next two are for real robots; those of the synthetic match obey to the letter, unless
    /// `synthetic.slip` is 1.
    #[schemars(range(min = 0.001, max = 100_000))]
    pub command_noise_mm_s: f64,
    /// How far a commanded robot's turning rate may stray from its command, 1σ.
    #[schemars(range(min = 0.001, max = 100_000))]
    pub command_noise_deg_s: f64,
    /// How fast a robot may slide sideways, 1σ.
    #[schemars(range(min = 0.001, max = 100_000))]
    pub lateral_noise_mm_s: f64,
    /// In a collision a robot's accelerations and slides are so many times as strong.
    #[schemars(range(min = 1, max = 1000))]
    pub collision_factor: f64,
    /// Time constant with which a robot's wheels follow a command; 0 is eq. (11) as printed.
    #[schemars(range(min = 0, max = 10_000))]
    pub command_lag_ms: f64,
    /// A command older than this no longer counts: the robot is taken to be free.
    #[schemars(range(min = 0, max = 60_000))]
    pub command_timeout_ms: f64,
    /// Time from sending a command until the robot acts on it; poses are predicted to now plus this.
    #[schemars(range(min = 0, max = 1000))]
    pub actuation_delay_ms: f64,
    /// A measurement whose squared Mahalanobis distance from the prediction exceeds this, even if
    /// there was a collision or a kick, is an outlier and ignored; 16.27 is the 99.9 % point for
    /// three dimensions.
    #[schemars(range(min = 0.001, max = 1_000_000))]
    pub gate_chi2: f64,
    /// After so many outliers in a row that agree with each other the filter believes them and
    /// starts over.
    #[schemars(range(min = 1, max = 10_000))]
    pub reinit_after: u32,
    /// A robot or ball must be seen with at least this confidence, 0–1, for a track to start, or to
    /// start over; less is enough to correct a track that has just been seen nearby.
    #[schemars(range(min = 0, max = 1))]
    pub start_confidence: f64,
    /// A robot or ball unseen for longer is forgotten.
    #[schemars(range(min = 1, max = 600_000))]
    pub forget_after_ms: f64,
    /// Measurement noise of the ball, 1σ, for detections that do not say how uncertain they are.
    #[schemars(range(min = 0.001, max = 1000))]
    pub ball_noise_mm: f64,
    /// How strongly a rolling ball may accelerate, 1σ.
    #[schemars(range(min = 0.001, max = 1_000_000))]
    pub ball_acceleration_noise_mm_s2: f64,
    /// In a kick the ball's acceleration is so many times as strong.
    #[schemars(range(min = 1, max = 10_000))]
    pub ball_kick_factor: f64,
    /// Fraction of its speed that a rolling ball loses in a second.
    #[schemars(range(min = 0, max = 1))]
    pub ball_friction_per_s: f64,
}

impl FilterConfig {
    /// Seconds for which its noises are taken to last: a frame at 80 fps.
    pub const NOISE_LASTS_S: f64 = 0.0125;
    /// From this wheel speed on wheels slip as configured; slower ones less.
    pub const FULL_SLIP_MM_S: f64 = 300.0;
}
