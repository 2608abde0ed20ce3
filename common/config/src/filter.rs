//! Filter configuration.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Filtering: from detections to poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FilterConfig {
    /// Measurement noise of a robot's position, 1σ (R in eq. 14), for detections without a covariance;
    /// the tracker's detections have one.
    #[schemars(range(min = 0.001, max = 1000))]
    pub position_noise_mm: f64,
    /// Measurement noise of a robot's heading, 1σ (R in eq. 14), for the same detections.
    #[schemars(range(min = 0.001, max = 180))]
    pub heading_noise_deg: f64,
    /// Distance over which the errors of successive measurements stay correlated, about a fifth of a
    /// pixel: measurements count for little until the patches have moved this far. 0 if errors are
    /// independent.
    #[schemars(range(min = 0, max = 1000))]
    pub repeat_distance_mm: f64,
    /// Acceleration noise of a robot without known commands, 1σ (Q in eq. 12).
    #[schemars(range(min = 0.001, max = 1_000_000))]
    pub acceleration_noise_mm_s2: f64,
    /// Angular acceleration noise of a robot without known commands, 1σ.
    #[schemars(range(min = 0.001, max = 1_000_000))]
    pub angular_acceleration_noise_deg_s2: f64,
    /// Deviation of a commanded robot's speed from its command, 1σ (wheel slip, battery). This and the
    /// next two are for real robots; those of the synthetic match obey exactly, unless `synthetic.slip`
    /// is set.
    #[schemars(range(min = 0.001, max = 100_000))]
    pub command_noise_mm_s: f64,
    /// Deviation of a commanded robot's turning rate from its command, 1σ.
    #[schemars(range(min = 0.001, max = 100_000))]
    pub command_noise_deg_s: f64,
    /// Sideways sliding speed of a robot, 1σ.
    #[schemars(range(min = 0.001, max = 100_000))]
    pub lateral_noise_mm_s: f64,
    /// Factor by which a robot's accelerations and slides are larger in a collision.
    #[schemars(range(min = 1, max = 1000))]
    pub collision_factor: f64,
    /// Time constant with which a robot's wheels follow a command; 0 is eq. (11) as printed.
    #[schemars(range(min = 0, max = 10_000))]
    pub command_lag_ms: f64,
    /// A command older than this is ignored, and the robot counts as uncommanded.
    #[schemars(range(min = 0, max = 60_000))]
    pub command_timeout_ms: f64,
    /// Time from sending a command until the robot acts on it; poses are predicted this far ahead of
    /// now.
    #[schemars(range(min = 0, max = 1000))]
    pub actuation_delay_ms: f64,
    /// Gate: a measurement whose squared Mahalanobis distance from the prediction is larger, even under
    /// the hypothesis of a collision or a kick, is ignored as an outlier. 16.27 is the 99.9 % point for
    /// three dimensions.
    #[schemars(range(min = 0.001, max = 1_000_000))]
    pub gate_chi2: f64,
    /// Consecutive outliers that agree with each other after which the filter accepts them and starts
    /// over.
    #[schemars(range(min = 1, max = 10_000))]
    pub reinit_after: u32,
    /// Least confidence, 0–1, of a detection that starts a track or starts it over. Less is enough to
    /// correct a track that has just been seen nearby.
    #[schemars(range(min = 0, max = 1))]
    pub start_confidence: f64,
    /// Time after which an unseen robot or ball is forgotten.
    #[schemars(range(min = 1, max = 600_000))]
    pub forget_after_ms: f64,
    /// Measurement noise of the ball, 1σ, for detections without a covariance.
    #[schemars(range(min = 0.001, max = 1000))]
    pub ball_noise_mm: f64,
    /// Acceleration noise of a rolling ball, 1σ.
    #[schemars(range(min = 0.001, max = 1_000_000))]
    pub ball_acceleration_noise_mm_s2: f64,
    /// Factor by which the ball's acceleration is larger in a kick.
    #[schemars(range(min = 1, max = 10_000))]
    pub ball_kick_factor: f64,
    /// Fraction of its speed that a rolling ball loses per second.
    #[schemars(range(min = 0, max = 1))]
    pub ball_friction_per_s: f64,
}

impl FilterConfig {
    /// Correlation time of the noises above, seconds: one frame at 80 fps.
    pub const NOISE_LASTS_S: f64 = 0.0125;
    /// Wheel speed from which on wheels slip as configured; slower ones slip less.
    pub const FULL_SLIP_MM_S: f64 = 300.0;
}
