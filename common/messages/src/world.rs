//! The filter's output: positions of robots and ball, at capture time and when the next command will
//! act.

use super::json;
use super::{FrameHeader, MAX_UNKNOWN_ROBOTS, UnknownRobotMemory, UnknownRobotState, filled};
use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use serde::Serialize;

/// Most robots a message carries: two teams of eleven and some reserve.
pub const MAX_ROBOTS: usize = 32;

/// How a track got its state in this frame.
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
    /// Predicted only: the measurement lay outside the gate and was ignored.
    Gated = 4,
    /// Predicted, and corrected in position by a robot of its team that could not be identified: its
    /// identification patch is hidden. A robot that stays unidentified for long is forgotten like an
    /// unseen one.
    Located = 5,
}

impl TrackStatus {
    /// The status with this number in a message, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        [
            Self::Absent,
            Self::Initialised,
            Self::Measured,
            Self::Coasting,
            Self::Gated,
            Self::Located,
        ]
        .into_iter()
        .find(|&status| status as u32 == number)
    }

    /// Name in reports and JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Absent => "absent",
            Self::Initialised => "initialised",
            Self::Measured => "measured",
            Self::Coasting => "coasting",
            Self::Gated => "gated",
            Self::Located => "located",
        }
    }
}

/// Hypotheses about a robot's motion, weighed against each other by the filter, in this order: steered
/// (by its commands, or standing when there are none), free, struck.
pub const ROBOT_HYPOTHESES: usize = 3;
/// Hypotheses about the ball's motion, in this order: rolling, struck.
pub const BALL_HYPOTHESES: usize = 2;
/// Most commands per robot that act or wait to act.
pub const MAX_QUEUED_COMMANDS: usize = 12;

/// Most `commands` messages used between two frames; the rest waits for the next frame.
pub const MAX_USED_COMMANDS: usize = 32;

/// One robot as estimated by the filter.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/RobotState/3")]
#[repr(C)]
pub struct RobotState {
    /// A [`Team`](super::Team) number.
    #[serde(serialize_with = "json::team")]
    pub team: u32,
    /// Number of the robot in its team.
    pub robot_id: u32,
    /// A [`TrackStatus`] number.
    #[serde(serialize_with = "json::track_status")]
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
    /// Velocity along x at capture time: `v_mm_s` · cos(`orientation`).
    pub vx_mm_s: f64,
    /// Velocity along y at capture time: `v_mm_s` · sin(`orientation`).
    pub vy_mm_s: f64,
    /// Covariance of (x_mm, y_mm, orientation, v_mm_s, omega), row by row.
    pub covariance: [f64; 25],
    /// Position predicted to [`WorldFrame::t_predicted_ns`].
    pub predicted_x_mm: f64,
    /// Position predicted to [`WorldFrame::t_predicted_ns`].
    pub predicted_y_mm: f64,
    /// Heading predicted to [`WorldFrame::t_predicted_ns`].
    pub predicted_orientation: f64,
}

/// One hypothesis about a robot's motion, with its extended Kalman filter.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/RobotHypothesis/1")]
#[repr(C)]
pub struct RobotHypothesis {
    /// Probability; those of one robot add up to 1.
    pub probability: f64,
    /// x_mm, y_mm, orientation, v_mm_s, omega at capture time.
    pub mean: [f64; 5],
    /// Upper triangle of the covariance of `mean`, row by row.
    pub covariance: [f64; 15],
}

/// A command that acts or will act on a robot.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/QueuedCommand/1")]
#[repr(C)]
pub struct QueuedCommand {
    /// When it was sent to the robot.
    pub t_sent_ns: u64,
    /// Circumferential speed of the left wheel.
    pub left_mm_s: f64,
    /// Circumferential speed of the right wheel.
    pub right_mm_s: f64,
}

/// Identifies a message on the topic `commands`. Every sender counts its own messages, so the time is
/// part of the name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/CommandsName/1")]
#[repr(C)]
pub struct CommandsName {
    /// [`Commands::seq`](super::Commands::seq)
    pub seq: u64,
    /// [`Commands::t_sent_ns`](super::Commands::t_sent_ns)
    pub t_sent_ns: u64,
}

/// State besides [`RobotState`] with which a successor of the filter continues a robot's track exactly.
/// Only the filter reads it.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/RobotMemory/1")]
#[repr(C)]
pub struct RobotMemory {
    /// In this order: steered, free, struck.
    pub hypotheses: [RobotHypothesis; ROBOT_HYPOTHESES],
    /// Capture time of the newest measurement used.
    pub t_seen_ns: u64,
    /// Capture time of the newest measurement outside the gate.
    pub t_gated_ns: u64,
    /// The newest measurement outside the gate: x_mm, y_mm, orientation.
    pub gated_pose: [f64; 3],
    /// Number of consecutive measurements outside the gate, up to that one, that agree with one
    /// another.
    pub gated_agreeing: u32,
    /// Valid elements of `commands`.
    pub command_count: u32,
    /// Commands that act or will act, by time.
    pub commands: [QueuedCommand; MAX_QUEUED_COMMANDS],
}

/// The ball as estimated by the filter.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/BallState/1")]
#[repr(C)]
pub struct BallState {
    /// A [`TrackStatus`] number.
    #[serde(serialize_with = "json::track_status")]
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

/// One hypothesis about the ball's motion, with its Kalman filter.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/BallHypothesis/1")]
#[repr(C)]
pub struct BallHypothesis {
    /// Probability; the two add up to 1.
    pub probability: f64,
    /// x_mm, y_mm, vx_mm_s, vy_mm_s at capture time.
    pub mean: [f64; 4],
    /// Upper triangle of the covariance of `mean`, row by row.
    pub covariance: [f64; 10],
}

/// State besides [`BallState`] with which a successor of the filter continues the ball's track exactly.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/BallMemory/1")]
#[repr(C)]
pub struct BallMemory {
    /// In this order: rolling, struck.
    pub hypotheses: [BallHypothesis; BALL_HYPOTHESES],
    /// Capture time of the newest measurement used.
    pub t_seen_ns: u64,
    /// Capture time of the newest measurement outside the gate.
    pub t_gated_ns: u64,
    /// The newest measurement outside the gate: x_mm, y_mm.
    pub gated_position: [f64; 2],
    /// Number of consecutive measurements outside the gate, up to that one, that agree with one
    /// another.
    pub gated_agreeing: u32,
    /// Reserved, 0.
    pub reserved: u32,
}

/// The filtered state of the match after one frame. A restarted filter continues from the last `world`,
/// with the same results as one that never stopped.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/WorldFrame/5")]
#[repr(C)]
pub struct WorldFrame {
    /// The frame this belongs to.
    pub frame: FrameHeader,
    /// When the classifier received the frame.
    pub t_frame_taken_ns: u64,
    /// When the classifier published the runs.
    pub t_runs_ns: u64,
    /// When the tracker received the runs.
    pub t_runs_taken_ns: u64,
    /// When the tracker published the detections.
    pub t_detections_ns: u64,
    /// When the filter received the detections.
    pub t_detections_taken_ns: u64,
    /// When the filter published this message.
    pub t_sent_ns: u64,
    /// Time of the predicted poses: when a command sent now will act.
    pub t_predicted_ns: u64,
    /// Frame number of the `world` whose tracks were continued; [`WorldFrame::NO_WORLD`] for a filter
    /// that started from nothing.
    pub prior_world_seq: u64,
    /// Number of the newest `commands` message ever used; [`WorldFrame::NO_COMMANDS`] for none.
    pub commands_seq: u64,
    /// Valid elements of `robots`.
    pub robot_count: u32,
    /// Valid elements of `commands`.
    pub command_count: u32,
    /// Valid elements of `unknown_robots`.
    pub unknown_robot_count: u32,
    /// Valid elements of `unknown_robot_memories`: `unknown_robots` and further candidates.
    pub unknown_memory_count: u32,
    /// The last [`UnknownRobotState::track_id`] assigned.
    pub last_track_id: u32,
    /// Revision of the classifier's configuration.
    pub classifier_revision: u32,
    /// Revision of the tracker's configuration.
    pub tracker_revision: u32,
    /// Revision of the filter's configuration.
    pub revision: u32,
    /// The `commands` messages used since the prior `world`, in that order. From these, the prior
    /// `world` and the detections of the frame this message can be computed again.
    pub commands: [CommandsName; MAX_USED_COMMANDS],
    /// Tracked robots, by team and number.
    pub robots: [RobotState; MAX_ROBOTS],
    /// Tracked robots of which only the team is known, by team and track. None of them is among
    /// `robots`.
    pub unknown_robots: [UnknownRobotState; MAX_UNKNOWN_ROBOTS],
    /// The ball.
    pub ball: BallState,
    /// For the filter's successor: one element for each of `robots`, in the same order.
    pub robot_memories: [RobotMemory; MAX_ROBOTS],
    /// For the filter's successor.
    pub ball_memory: BallMemory,
    /// For the filter's successor: one element for each of `unknown_robots`, in the same order, then
    /// candidates that have not been seen often enough.
    pub unknown_robot_memories: [UnknownRobotMemory; MAX_UNKNOWN_ROBOTS],
}

const _: () = assert!(size_of::<RobotState>() == 24 + 35 * 8);
const _: () = assert!(size_of::<BallState>() == 16 + 22 * 8);
const _: () = assert!(size_of::<RobotHypothesis>() == 168);
const _: () = assert!(size_of::<QueuedCommand>() == 24);
const _: () =
    assert!(size_of::<RobotMemory>() == ROBOT_HYPOTHESES * 168 + 48 + MAX_QUEUED_COMMANDS * 24);
const _: () = assert!(size_of::<BallMemory>() == BALL_HYPOTHESES * 120 + 40);
const _: () = assert!(
    size_of::<WorldFrame>()
        == 168
            + MAX_USED_COMMANDS * 16
            + MAX_ROBOTS * (304 + 840)
            + 192
            + 280
            + MAX_UNKNOWN_ROBOTS * (200 + 272)
);

impl WorldFrame {
    /// Value of `commands_seq` when no commands were used.
    pub const NO_COMMANDS: u64 = u64::MAX;
    /// Value of `prior_world_seq` when there is no prior `world`.
    pub const NO_WORLD: u64 = u64::MAX;

    /// The `commands` messages used since the prior `world`.
    pub fn commands(&self) -> &[CommandsName] {
        filled(&self.commands, self.command_count)
    }

    /// Tracked robots; none of them is [`Absent`](TrackStatus::Absent).
    pub fn robots(&self) -> &[RobotState] {
        filled(&self.robots, self.robot_count)
    }

    /// Tracked robots of which only the team is known. None of them is among [`robots`](Self::robots).
    pub fn unknown_robots(&self) -> &[UnknownRobotState] {
        filled(&self.unknown_robots, self.unknown_robot_count)
    }
}
