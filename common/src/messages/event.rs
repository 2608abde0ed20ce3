//! What has happened in a group.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use schemars::JsonSchema;

/// Published when the supervisor has noticed or done something: a process has ended, was replaced,
/// killed, promoted; inputs were dropped. The log and the status say the same.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend, JsonSchema)]
#[type_name("touchline/GroupEvent/1")]
#[repr(C)]
pub struct GroupEvent {
    /// When it happened, nanoseconds since 1970.
    pub t_wall_ns: u64,
    /// Operating system's number of the process concerned; 0 when it concerns the whole stage.
    pub pid: u32,
    /// Its kind, a [`ProcessKind`](super::ProcessKind) number.
    pub process: u32,
    /// What happened: UTF-8, ended by a zero.
    #[schemars(with = "super::List<u8, 240>")]
    pub what: [u8; 240],
    /// The last lines that the process wrote, if it has ended, likewise; the end of them where they are
    /// too long.
    #[schemars(with = "super::List<u8, 768>")]
    pub evidence: [u8; 768],
}

const _: () = assert!(size_of::<GroupEvent>() == 1024);
