//! Robots in `world` of which nothing is known but their team.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use schemars::JsonSchema;

/// Most of them a message carries.
pub const MAX_UNKNOWN_ROBOTS: usize = super::MAX_ROBOTS;
/// Hypotheses about their motion: drives freely, struck; in this order.
pub const UNKNOWN_HYPOTHESES: usize = 2;

/// One robot of which only the team is known, as the filter sees it: an opponent whose patches nobody
/// has configured, or a robot that has lost one. It has no number in its team and no heading.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend, JsonSchema)]
#[type_name("touchline/UnknownRobotState/1")]
#[repr(C)]
pub struct UnknownRobotState {
    /// A [`Team`](super::Team) number.
    pub team: u32,
    /// Names the track, not the robot: from 1, the same for as long as the robot is followed, and never
    /// given to another. A robot that was lost and is found again has a new one. Counting starts over
    /// with [`prior_world_seq`](super::WorldFrame::prior_world_seq) being
    /// [`NO_WORLD`](super::WorldFrame::NO_WORLD).
    pub track_id: u32,
    /// A [`TrackStatus`](super::TrackStatus) number.
    pub status: u32,
    /// Frames in a row without a usable measurement.
    pub frames_unseen: u32,
    /// Frames since it was first seen.
    pub frames_tracked: u32,
    /// 0–1: 1 when seen in this frame, falling while coasting.
    pub visibility: f32,
    /// Where its team patch is at capture time, and so, to within the patch's distance from it, its
    /// centre.
    pub x_mm: f64,
    /// Where its team patch is at capture time.
    pub y_mm: f64,
    /// Velocity.
    pub vx_mm_s: f64,
    /// Velocity.
    pub vy_mm_s: f64,
    /// Covariance of (x_mm, y_mm, vx_mm_s, vy_mm_s) as place and velocity of the robot's centre, row by
    /// row. Most of it is the unknown direction in which the centre lies from the patch.
    pub covariance: [f64; 16],
    /// Position predicted to [`WorldFrame::t_predicted_ns`](super::WorldFrame::t_predicted_ns).
    pub predicted_x_mm: f64,
    /// Position predicted to [`WorldFrame::t_predicted_ns`](super::WorldFrame::t_predicted_ns).
    pub predicted_y_mm: f64,
}

/// One hypothesis about such a robot's motion and the Kalman filter that follows it.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend, JsonSchema)]
#[type_name("touchline/UnknownRobotHypothesis/1")]
#[repr(C)]
pub struct UnknownRobotHypothesis {
    /// How likely it is; both add up to 1.
    pub probability: f64,
    /// x_mm, y_mm, vx_mm_s, vy_mm_s of its team patch at capture time.
    pub mean: [f64; 4],
    /// Upper triangle of the covariance of `mean`, row by row.
    pub covariance: [f64; 10],
}

/// What the filter needs to carry on with such a robot's track exactly. Of no interest to anyone but
/// the filter's successor.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend, JsonSchema)]
#[type_name("touchline/UnknownRobotMemory/1")]
#[repr(C)]
pub struct UnknownRobotMemory {
    /// A [`Team`](super::Team) number.
    pub team: u32,
    /// As in [`UnknownRobotState`]; 0 for what has not been seen often enough to be one.
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
    /// Drives freely, struck.
    pub hypotheses: [UnknownRobotHypothesis; UNKNOWN_HYPOTHESES],
}

const _: () = assert!(size_of::<UnknownRobotState>() == 24 + 22 * 8);
const _: () = assert!(size_of::<UnknownRobotHypothesis>() == 120);
const _: () = assert!(size_of::<UnknownRobotMemory>() == 32 + UNKNOWN_HYPOTHESES * 120);
