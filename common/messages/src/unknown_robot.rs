//! Robots in `world` of which only the team is known.

use super::json;
use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use serde::Serialize;

/// Most such robots a message carries.
pub const MAX_UNKNOWN_ROBOTS: usize = super::MAX_ROBOTS;
/// Hypotheses about their motion, in this order: driving freely, struck.
pub const UNKNOWN_HYPOTHESES: usize = 2;

/// One robot of which the filter knows only the team: an opponent whose patches are not configured, or
/// a robot that has lost a patch. It has no number in its team and no heading.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/UnknownRobotState/1")]
#[repr(C)]
pub struct UnknownRobotState {
    /// A [`Team`](super::Team) number.
    #[serde(serialize_with = "json::team")]
    pub team: u32,
    /// Identifies the track, not the robot: from 1, constant while the robot is followed, and never
    /// reused. A robot that is lost and found again has a new one. Counting restarts when
    /// [`prior_world_seq`](super::WorldFrame::prior_world_seq) is
    /// [`NO_WORLD`](super::WorldFrame::NO_WORLD).
    pub track_id: u32,
    /// A [`TrackStatus`](super::TrackStatus) number.
    #[serde(serialize_with = "json::track_status")]
    pub status: u32,
    /// Frames in a row without a usable measurement.
    pub frames_unseen: u32,
    /// Frames since it was first seen.
    pub frames_tracked: u32,
    /// 0–1: 1 when seen in this frame, falling while coasting.
    pub visibility: f32,
    /// Position of its team patch at capture time. Its centre lies within the patch's distance from
    /// there.
    pub x_mm: f64,
    /// Position of its team patch at capture time.
    pub y_mm: f64,
    /// Velocity.
    pub vx_mm_s: f64,
    /// Velocity.
    pub vy_mm_s: f64,
    /// Covariance of (x_mm, y_mm, vx_mm_s, vy_mm_s) as position and velocity of the robot's centre, row
    /// by row. Most of it is the unknown direction from the patch to the centre.
    pub covariance: [f64; 16],
    /// Position predicted to [`WorldFrame::t_predicted_ns`](super::WorldFrame::t_predicted_ns).
    pub predicted_x_mm: f64,
    /// Position predicted to [`WorldFrame::t_predicted_ns`](super::WorldFrame::t_predicted_ns).
    pub predicted_y_mm: f64,
}

/// One hypothesis about such a robot's motion, with its Kalman filter.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/UnknownRobotHypothesis/1")]
#[repr(C)]
pub struct UnknownRobotHypothesis {
    /// Probability; the two add up to 1.
    pub probability: f64,
    /// x_mm, y_mm, vx_mm_s, vy_mm_s of its team patch at capture time.
    pub mean: [f64; 4],
    /// Upper triangle of the covariance of `mean`, row by row.
    pub covariance: [f64; 10],
}

/// State with which a successor of the filter continues such a robot's track exactly. Only the filter
/// reads it.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/UnknownRobotMemory/1")]
#[repr(C)]
pub struct UnknownRobotMemory {
    /// A [`Team`](super::Team) number.
    pub team: u32,
    /// The `track_id` of [`UnknownRobotState`]; 0 for a candidate that has not been seen often enough.
    pub track_id: u32,
    /// A [`TrackStatus`](super::TrackStatus) number.
    pub status: u32,
    /// Frames in a row without a usable measurement.
    pub frames_unseen: u32,
    /// Frames since it was first seen.
    pub frames_tracked: u32,
    /// Reserved, 0.
    pub reserved: u32,
    /// Capture time of the newest measurement.
    pub t_seen_ns: u64,
    /// In this order: driving freely, struck.
    pub hypotheses: [UnknownRobotHypothesis; UNKNOWN_HYPOTHESES],
}

const _: () = assert!(size_of::<UnknownRobotState>() == 24 + 22 * 8);
const _: () = assert!(size_of::<UnknownRobotHypothesis>() == 120);
const _: () = assert!(size_of::<UnknownRobotMemory>() == 32 + UNKNOWN_HYPOTHESES * 120);
