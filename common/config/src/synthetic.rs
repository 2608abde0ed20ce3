//! Configuration of the synthetic match.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The synthetic match.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SyntheticConfig {
    /// The same seed gives the same match, pixel for pixel.
    #[schemars(range(max = i64::MAX))]
    pub seed: u64,
    /// Number of robots in each team of which `robots.identities` lists none. They wear the
    /// identification colours of the listed robots, as opponents of which only the team's colour is
    /// known. With `robots.report_unknown` they are followed.
    #[schemars(range(max = 16))]
    pub unknown_opponents: u32,
    /// Highest speed of a robot.
    #[schemars(range(min = 0, max = 100_000))]
    pub max_speed_mm_s: f64,
    /// Highest acceleration of a robot.
    #[schemars(range(min = 0, max = 1_000_000))]
    pub max_acceleration_mm_s2: f64,
    /// Deviation of robots from their commands, as a multiple of what the filter assumes with
    /// `command_noise_mm_s`, `command_noise_deg_s` and `lateral_noise_mm_s`. 0: no deviation.
    #[schemars(range(min = 0, max = 100))]
    pub slip: f64,
    /// Red, green and blue of the floor.
    pub floor_rgb: [u8; 3],
    /// Overall brightness; the colours were set for 1.
    #[schemars(range(min = 0, max = 10))]
    pub brightness: f64,
    /// Loss of brightness from the middle to the corners, 0–1.
    #[schemars(range(min = 0, max = 1))]
    pub vignette: f64,
    /// Loss of brightness from the left side to the right, 0–1.
    #[schemars(range(min = 0, max = 1))]
    pub gradient: f64,
    /// Colour temperature of the light. The colours were set for 6500; less is redder.
    #[schemars(range(min = 1000, max = 40_000))]
    pub color_temperature_k: f64,
    /// Strength of a lamp mirrored in floor and robots, 0–1; 1 is white.
    #[schemars(range(min = 0, max = 1))]
    pub glare: f64,
    /// Defocus of the lens: standard deviation of a point's image in pixels, in addition to that of a
    /// sharp lens.
    #[schemars(range(min = 0, max = 20))]
    pub defocus_px: f64,
    /// Sensor noise, 1σ, in grey levels of 255.
    #[schemars(range(min = 0, max = 100))]
    pub noise: f64,
}
