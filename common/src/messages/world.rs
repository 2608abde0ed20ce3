//! The filter's output: where everything is, at capture time and when the next command will act.

use super::{FrameHeader, filled};
use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;

/// Most robots a message carries: two teams of eleven and room for a league's next idea.
pub const MAX_ROBOTS: usize = 32;

/// How a track came by its state in this frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum TrackStatus {
    /// No track in this slot; nothing else in the structure means anything.
    Absent = 0,
    /// Started, or started over, from this frame's detection.
    Initialised = 1,
    /// Predicted and corrected by this frame's detection.
    Measured = 2,
    /// Predicted only: not seen in this frame.
    Coasting = 3,
    /// Predicted only: what was seen lay outside the gate and was ignored.
    Gated = 4,
}

impl TrackStatus {
    /// The status with this number in a message, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        [Self::Absent, Self::Initialised, Self::Measured, Self::Coasting, Self::Gated]
            .into_iter()
            .find(|&status| status as u32 == number)
    }
}

/// One robot's track: the complete state of its filter.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[type_name("touchline/RobotState/1")]
#[repr(C)]
pub struct RobotState {
    /// A [`Team`](super::Team) number.
    pub team: u32,
    /// Number of the robot in its team.
    pub robot_id: u32,
    /// A [`TrackStatus`] number.
    pub status: u32,
    /// Frames in a row without a usable measurement.
    pub frames_unseen: u32,
    /// Frames in a row whose measurement lay outside the gate.
    pub frames_gated: u32,
    /// 0–1: 1 when seen in this frame, falling while coasting.
    pub visibility: f32,
    /// Centre of the robot at capture time.
    pub x_mm: f64,
    /// Centre of the robot at capture time.
    pub y_mm: f64,
    /// Heading at capture time, radians, in (−π, π].
    pub orientation: f64,
    /// Speed along the heading.
    pub v_mm_s: f64,
    /// Turning rate, rad/s.
    pub omega: f64,
    /// Covariance of (x_mm, y_mm, orientation, v_mm_s, omega), row by row.
    pub covariance: [f64; 25],
    /// Position predicted to [`WorldFrame::t_predicted_ns`].
    pub predicted_x_mm: f64,
    /// Position predicted to [`WorldFrame::t_predicted_ns`].
    pub predicted_y_mm: f64,
    /// Heading predicted to [`WorldFrame::t_predicted_ns`].
    pub predicted_orientation: f64,
}

/// The ball's track: the complete state of its filter.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[type_name("touchline/BallState/1")]
#[repr(C)]
pub struct BallState {
    /// A [`TrackStatus`] number.
    pub status: u32,
    /// Frames in a row without a usable measurement.
    pub frames_unseen: u32,
    /// Frames in a row whose measurement lay outside the gate.
    pub frames_gated: u32,
    /// 0–1: 1 when seen in this frame, falling while coasting.
    pub visibility: f32,
    /// Centre of the ball at capture time.
    pub x_mm: f64,
    /// Centre of the ball at capture time.
    pub y_mm: f64,
    /// Velocity.
    pub vx_mm_s: f64,
    /// Velocity.
    pub vy_mm_s: f64,
    /// Covariance of (x_mm, y_mm, vx_mm_s, vy_mm_s), row by row.
    pub covariance: [f64; 16],
    /// Position predicted to [`WorldFrame::t_predicted_ns`].
    pub predicted_x_mm: f64,
    /// Position predicted to [`WorldFrame::t_predicted_ns`].
    pub predicted_y_mm: f64,
}

/// The filtered state of the match after one frame. A filter that starts anew continues from the
/// last one of these.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[type_name("touchline/WorldFrame/1")]
#[repr(C)]
pub struct WorldFrame {
    /// The frame it belongs to.
    pub frame: FrameHeader,
    /// When the classifier handed on the runs.
    pub t_runs_ns: u64,
    /// When the tracker handed on the detections.
    pub t_detections_ns: u64,
    /// When the filter handed on this message.
    pub t_sent_ns: u64,
    /// The instant the predicted poses belong to: when a command sent now will act.
    pub t_predicted_ns: u64,
    /// Number of the newest `commands` message that was used; [`WorldFrame::NO_COMMANDS`] for none.
    pub commands_seq: u64,
    /// Valid elements of `robots`.
    pub robot_count: u32,
    /// Reserved, 0.
    pub reserved: u32,
    /// Tracked robots, by team and number.
    pub robots: [RobotState; MAX_ROBOTS],
    /// The ball.
    pub ball: BallState,
}

const _: () = assert!(size_of::<RobotState>() == 24 + 33 * 8);
const _: () = assert!(size_of::<BallState>() == 16 + 22 * 8);
const _: () = assert!(size_of::<WorldFrame>() == 112 + MAX_ROBOTS * 288 + 192);

impl WorldFrame {
    /// Value of `commands_seq` when no commands were used.
    pub const NO_COMMANDS: u64 = u64::MAX;

    /// Tracked robots.
    pub fn robots(&self) -> &[RobotState] {
        filled(&self.robots, self.robot_count)
    }
}
