//! The messages: everything that crosses a process boundary.
//!
//! Messages are plain C structures of fixed size so that any language can read them in place:
//! explicit widths, no padding (the `Pod` derive refuses to compile a structure that has any), and
//! lists as a count beside an array of fixed capacity. Elements beyond a count hold stale bytes of
//! earlier messages; use the accessor methods, which never show them.
//!
//! Each message type has a name with a trailing version. iceoryx2 compares the names when a program
//! attaches, so **a change of layout or meaning must raise the version**; the size assertions below
//! each message make a change of layout impossible to miss.
//!
//! All `t_*_ns` stamps are nanoseconds of the monotonic clock of this machine, unless the name says
//! `wall`. Every output repeats the header of the frame it was made from and the times at which each
//! stage received and published it, so the path of a frame can be read from any one message.

mod camera;
mod command;
mod detection;
mod event;
mod frame;
mod gateway;
mod health;
pub mod interface;
mod json;
mod light;
mod message;
mod pixel_format;
mod publisher;
mod revision;
mod run;
pub mod stages;
mod stale;
#[cfg(feature = "schema")]
pub mod structure;
pub mod topics;
mod truth;
mod unknown_robot;
mod world;

pub use camera::{CameraReport, CameraState, read_text, write_text};
pub use command::{Commands, MAX_COMMANDS, WheelCommand, are_possible_speeds};
pub use detection::{
    DetectedBall, DetectedRobot, DetectionFrame, MAX_BALLS, MAX_PATCHES, MAX_REGIONS, MAX_REJECTED,
    Region, RejectReason, Rejected, RobotId,
};
pub use event::{EventKind, GroupEvent};
pub use frame::{BayerOrder, FrameFault, FrameHeader, MAX_AGE_NS, PixelLayout, reachable_frames};
pub use gateway::GatewayReport;
pub use health::{
    Attendant, DropReason, Heartbeat, MAX_STATUS_BYTES, ProcessKind, ProcessState, StatusHeader,
    process_number,
};
pub use light::{LightCorrection, LightReport};
pub use message::{Described, Header, Message};
pub use pixel_format::PixelFormat;
pub use publisher::{MAX_OUTPUTS, OutputReport, PublisherReport};
pub use revision::Revision;
pub use run::{MAX_RUNS, Run, RunsHeader};
pub use stale::ClearStale;
pub use truth::{TruthFrame, TruthRobot};
pub use unknown_robot::{
    MAX_UNKNOWN_ROBOTS, UNKNOWN_HYPOTHESES, UnknownRobotHypothesis, UnknownRobotMemory,
    UnknownRobotState,
};
pub use world::{
    BALL_HYPOTHESES, BallHypothesis, BallMemory, BallState, CommandsName, MAX_QUEUED_COMMANDS,
    MAX_ROBOTS, MAX_USED_COMMANDS, QueuedCommand, ROBOT_HYPOTHESES, RobotHypothesis, RobotMemory,
    RobotState, TrackStatus, WorldFrame,
};

/// The colour a team wears. Rules since the paper give blue and yellow to the two teams of a match.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Serialize, serde::Deserialize,
)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
#[repr(u32)]
pub enum Team {
    /// Wears yellow.
    Yellow = 0,
    /// Wears blue.
    Blue = 1,
}

impl Team {
    /// Both teams, in the order of their numbers in messages.
    pub const ALL: [Team; 2] = [Team::Yellow, Team::Blue];

    /// The team with this number in a message, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.get(number as usize).copied()
    }

    /// The team's name in the league.
    pub fn name(self) -> &'static str {
        match self {
            Team::Yellow => "yellow",
            Team::Blue => "blue",
        }
    }
}

/// The valid part of a fixed-capacity list. A count beyond the capacity (garbage from outside) gives
/// the whole array instead of a panic.
fn filled<T>(items: &[T], count: u32) -> &[T] {
    &items[..items.len().min(count as usize)]
}

/// Appends to a fixed-capacity list; `false` when it is full.
fn push<T>(items: &mut [T], count: &mut u32, item: T) -> bool {
    match items.get_mut(*count as usize) {
        Some(slot) => {
            *slot = item;
            *count += 1;
            true
        }
        None => false,
    }
}
