//! Events in a group: a process ended, was replaced, and so on.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use serde::{Deserialize, Serialize};

/// Kind of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u32)]
pub enum EventKind {
    /// Something else.
    #[default]
    Other = 0,
    /// A process ended.
    Ended = 1,
    /// A spare took over.
    Promoted = 2,
    /// A process had input but gave no output, and was killed.
    Stalled = 3,
    /// A process did not become ready, did not end, or sent no heartbeat, and was killed.
    Killed = 4,
    /// A process was asked to end, since its successor is ready.
    Retired = 5,
    /// Inputs were dropped.
    Dropped = 6,
    /// An input that killed two processes is skipped.
    Poisonous = 7,
    /// A new supervisor took over a process.
    TakenOver = 8,
    /// The camera's state changed.
    Camera = 9,
    /// A program outside the group published on a topic reserved for processes of the group.
    Stranger = 10,
    /// The group goes over to another configuration.
    Reconfigured = 11,
    /// A user has marked the moment.
    Marked = 12,
}

impl EventKind {
    /// All kinds, in the order of their numbers.
    pub const ALL: [Self; 13] = [
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
        Self::Reconfigured,
        Self::Marked,
    ];

    /// The kind with this number in a message, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|&kind| kind as u32 == number)
    }
}

/// Published when the supervisor notices or does something: a process ended, was replaced, killed or
/// promoted; inputs were dropped. The log and the status say the same.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/GroupEvent/2")]
#[repr(C)]
pub struct GroupEvent {
    /// Time of the event, nanoseconds since 1970.
    pub t_wall_ns: u64,
    /// Number of the event since this supervisor started; the first is 1.
    pub number: u64,
    /// Process id of the process concerned; 0 when the event concerns the whole stage.
    pub pid: u32,
    /// Process concerned, a [`ProcessKind`](super::ProcessKind) or [`Attendant`](super::Attendant)
    /// number.
    pub process: u32,
    /// An [`EventKind`] number.
    pub kind: u32,
    /// Reserved, 0.
    pub reserved: u32,
    /// Description: UTF-8, ended by a zero.
    #[cfg_attr(feature = "schema", schemars(with = "crate::structure::List<u8, 224>"))]
    pub what: [u8; 224],
    /// The last lines written by a process that ended, in the same form. A longer text is cut at its
    /// beginning.
    #[cfg_attr(feature = "schema", schemars(with = "crate::structure::List<u8, 768>"))]
    pub evidence: [u8; 768],
}

const _: () = assert!(size_of::<GroupEvent>() == 1024);
