//! What the pictures show.

use messages::LightCorrection;
use serde::{Deserialize, Serialize};

/// Objects found in the newest frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Found {
    /// Identified robots in the newest detections.
    pub robots: u32,
    /// Robots configured.
    pub robots_configured: u32,
    /// Robots in the newest `world` of which only the team is known.
    pub unknown_robots: u32,
    /// Whether there was a ball.
    pub ball: bool,
    /// Regions.
    pub regions: u32,
}

/// Measured size of the robots' tops.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Tops {
    /// Measured size relative to the configured size.
    pub scale: f64,
    /// Pairs of patches measured, each in every frame.
    pub votes: u64,
    /// The problem and its remedy; empty when the size is right.
    pub problem: String,
}

/// Light correction in the newest frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Light {
    /// Whether it is active: `light.follow` is on, and there is a `light.pitch_rgb`.
    pub followed: bool,
    /// Gains of red, green and blue; 1 is as the colours were set.
    pub gains: [f64; 3],
    /// Smallest and largest local gain on the pitch, common to all three.
    pub zones: [f64; 2],
    /// Whether a gain is at its limit: more may be needed.
    pub at_bound: bool,
    /// Whether enough of the pitch is seen to measure the light; otherwise nothing is corrected.
    pub pitch_seen: bool,
    /// Whether glare is removed.
    pub glare: bool,
    /// Changes of the gains since this classifier started.
    pub changes: u64,
}

impl From<&LightCorrection> for Light {
    fn from(light: &LightCorrection) -> Self {
        // JSON has no non-finite numbers.
        let number = |factor: f32| match factor.is_finite() {
            true => (f64::from(factor) * 1000.0).round() / 1000.0,
            false => 0.0,
        };
        Self {
            followed: light.has(LightCorrection::FOLLOWED),
            gains: light.gains.map(number),
            zones: light.zones.map(number),
            at_bound: light.has(LightCorrection::AT_BOUND),
            pitch_seen: !light.has(LightCorrection::PITCH_UNSEEN),
            glare: light.has(LightCorrection::GLARE),
            changes: light.changes,
        }
    }
}
