//! Errors against the truth of a synthetic match.

use serde::{Deserialize, Serialize};

/// Errors against the truth, raw and filtered.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Accuracy {
    /// Errors of the tracker's detections.
    pub detections: Errors,
    /// Errors of the filter's world, at capture time.
    pub world: Errors,
    /// Errors in it of robots of which only the team is known; absent if there was none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unknown: Option<UnknownErrors>,
}

/// Errors of robots of which only the team is known.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct UnknownErrors {
    /// Share of the visible ones that were tracked.
    pub followed_ratio: f64,
    /// Tracks without a robot, counted in each frame.
    pub ghosts: u64,
    /// Number of times a robot's track number changed.
    pub switches: u64,
    /// RMS distance of the team patch, which defines the position.
    pub patch_rms_mm: f64,
    /// 99th percentile of the distance.
    pub patch_p99_mm: f64,
}

/// Errors of poses.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Errors {
    /// Share of the visible robots that were found under their right identity.
    pub found_ratio: f64,
    /// Robots reported in place of another one, or of none.
    pub wrong_identity: u64,
    /// RMS distance.
    pub position_rms_mm: f64,
    /// 99th percentile of the distance.
    pub position_p99_mm: f64,
    /// RMS difference in heading.
    pub heading_rms_deg: f64,
    /// 99th percentile of the difference.
    pub heading_p99_deg: f64,
    /// Errors of robots that have been standing still for half a second.
    pub standing: StandingErrors,
    /// Share of the frames with a visible ball in which it was found.
    pub ball_found_ratio: f64,
    /// RMS distance.
    pub ball_rms_mm: f64,
}

/// Errors of robots standing still.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct StandingErrors {
    /// Number of poses.
    pub samples: u64,
    /// RMS distance.
    pub position_rms_mm: f64,
    /// 99th percentile of the distance.
    pub position_p99_mm: f64,
    /// Largest distance.
    pub position_max_mm: f64,
    /// RMS difference in heading.
    pub heading_rms_deg: f64,
    /// 99th percentile of the difference.
    pub heading_p99_deg: f64,
    /// Largest difference in heading.
    pub heading_max_deg: f64,
}
