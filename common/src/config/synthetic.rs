//! Keys of the synthetic match.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The synthetic match.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SyntheticConfig {
    /// The same seed gives the same match, pixel for pixel.
    #[schemars(range(max = i64::MAX))]
    pub seed: u64,
    /// So many robots play in each team of which `robots.identities` lists nobody. They wear the
    /// identification colours of those that are listed: opponents of which only the team's colour is
    /// known. With `robots.report_unknown` they are followed.
    #[schemars(range(max = 16))]
    pub unknown_opponents: u32,
    /// Fastest a robot drives.
    #[schemars(range(min = 0, max = 100_000))]
    pub max_speed_mm_s: f64,
    /// Strongest a robot accelerates.
    #[schemars(range(min = 0, max = 1_000_000))]
    pub max_acceleration_mm_s2: f64,
    /// How far robots stray from what they are told: so many times what the filter allows for with
    /// `command_noise_mm_s`, `command_noise_deg_s` and `lateral_noise_mm_s`. 0: not at all.
    #[schemars(range(min = 0, max = 100))]
    pub slip: f64,
    /// Red, green and blue of the floor.
    pub floor_rgb: [u8; 3],
    /// Overall brightness; 1 is what the colours were set for.
    #[schemars(range(min = 0, max = 10))]
    pub brightness: f64,
    /// How much darker the corners are than the middle, 0–1.
    #[schemars(range(min = 0, max = 1))]
    pub vignette: f64,
    /// How much darker the right side is than the left, 0–1.
    #[schemars(range(min = 0, max = 1))]
    pub gradient: f64,
    /// Colour of the light, as the temperature of a glowing body; 6500 is what the colours were set
    /// for, less is redder.
    #[schemars(range(min = 1000, max = 40_000))]
    pub color_temperature_k: f64,
    /// A lamp mirrored in floor and robots, 0–1; 1 is white.
    #[schemars(range(min = 0, max = 1))]
    pub glare: f64,
    /// How far out of focus the lens is: standard deviation of the spot it makes of a point, in pixels,
    /// besides that of a sharp lens.
    #[schemars(range(min = 0, max = 20))]
    pub defocus_px: f64,
    /// Sensor noise, 1σ, in grey levels of 255.
    #[schemars(range(min = 0, max = 100))]
    pub noise: f64,
}
