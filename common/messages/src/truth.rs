//! The true state of the synthetic match; a real match has no such topic.

use super::json;
use super::{MAX_ROBOTS, filled};
use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use serde::Serialize;

/// True pose and speed of one robot.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/TruthRobot/1")]
#[repr(C)]
pub struct TruthRobot {
    /// A [`Team`](super::Team) number.
    #[serde(serialize_with = "json::team")]
    pub team: u32,
    /// Number of the robot in its team.
    pub robot_id: u32,
    /// Centre of the robot in the middle of the exposure.
    pub x_mm: f64,
    /// Centre of the robot in the middle of the exposure.
    pub y_mm: f64,
    /// Heading in the middle of the exposure, radians, in (−π, π].
    pub orientation: f64,
    /// Speed along the heading.
    pub v_mm_s: f64,
    /// Turning rate, rad/s.
    pub omega: f64,
    /// Number of frames up to this one in which it has not moved at all.
    pub frames_still: u32,
    /// 1 when its whole top is inside the picture and nothing hides it.
    pub visible: u32,
}

/// The true state of the synthetic match in one frame.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/TruthFrame/1")]
#[repr(C)]
pub struct TruthFrame {
    /// The frame this belongs to.
    pub seq: u64,
    /// Middle of the exposure of that frame.
    pub t_capture_ns: u64,
    /// Valid elements of `robots`.
    pub robot_count: u32,
    /// 1 when the ball is in the picture and nothing hides it.
    pub ball_visible: u32,
    /// Centre of the ball.
    pub ball_x_mm: f64,
    /// Centre of the ball.
    pub ball_y_mm: f64,
    /// Velocity of the ball.
    pub ball_vx_mm_s: f64,
    /// Velocity of the ball.
    pub ball_vy_mm_s: f64,
    /// All robots, by team and number.
    pub robots: [TruthRobot; MAX_ROBOTS],
}

const _: () = assert!(size_of::<TruthFrame>() == 56 + MAX_ROBOTS * 56);

impl TruthFrame {
    /// All robots.
    pub fn robots(&self) -> &[TruthRobot] {
        filled(&self.robots, self.robot_count)
    }
}
