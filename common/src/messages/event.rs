//! What has happened in a group.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What kind of thing has happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u32)]
pub enum EventKind {
    /// Something else.
    #[default]
    Other = 0,
    /// A process has ended.
    Ended = 1,
    /// A spare has taken over.
    Promoted = 2,
    /// A process had input and gave no output, and was killed.
    Stalled = 3,
    /// A process did not get ready, did not end, or gave no sign of life, and was killed.
    Killed = 4,
    /// A process was asked to end, since its successor is ready.
    Retired = 5,
    /// Inputs were dropped.
    Dropped = 6,
    /// An input that has killed two processes is skipped.
    Poisonous = 7,
    /// A new supervisor has taken over a process.
    TakenOver = 8,
    /// The camera's state has changed.
    Camera = 9,
    /// A program that is none of the group's publishes on a topic on which only those are believed.
    Stranger = 10,
}

impl EventKind {
    /// All kinds, in the order of their numbers.
    pub const ALL: [Self; 11] = [
        Self::Other,
        Self::Ended,
        Self::Promoted,
        Self::Stalled,
        Self::Killed,
        Self::Retired,
        Self::Dropped,
        Self::Poisonous,
        Self::TakenOver,
        Self::Camera,
        Self::Stranger,
    ];
}

/// Published when the supervisor has noticed or done something: a process has ended, was replaced,
/// killed, promoted; inputs were dropped. The log and the status say the same.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend, JsonSchema)]
#[type_name("touchline/GroupEvent/2")]
#[repr(C)]
pub struct GroupEvent {
    /// When it happened, nanoseconds since 1970.
    pub t_wall_ns: u64,
    /// Counts the events of this supervisor: 1 is its first.
    pub number: u64,
    /// Operating system's number of the process concerned; 0 when it concerns the whole stage.
    pub pid: u32,
    /// Its kind, a [`ProcessKind`](super::ProcessKind) or [`Attendant`](super::Attendant) number.
    pub process: u32,
    /// An [`EventKind`] number.
    pub kind: u32,
    /// Reserved, 0.
    pub reserved: u32,
    /// What happened: UTF-8, ended by a zero.
    #[schemars(with = "super::List<u8, 224>")]
    pub what: [u8; 224],
    /// The last lines that the process wrote, if it has ended, likewise; the end of them where they are
    /// too long.
    #[schemars(with = "super::List<u8, 768>")]
    pub evidence: [u8; 768],
}

const _: () = assert!(size_of::<GroupEvent>() == 1024);
