//! The gateway's own report.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use serde::Serialize;

/// The gateway's clients and what became of messages, some ten times a second and whenever a client comes
/// or goes. Counts start at zero with the process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/GatewayReport/1")]
#[repr(C)]
pub struct GatewayReport {
    /// Time of publication.
    pub t_sent_ns: u64,
    /// Messages given to clients.
    pub given: u64,
    /// Messages that did not reach a client because it was too slow.
    pub lost: u64,
    /// Messages of clients for teams that they may not command.
    pub not_permitted: u64,
    /// Dropped messages of clients, those included.
    pub refused: u64,
    /// Process id.
    pub pid: u32,
    /// Attached clients.
    pub clients: u32,
}

const _: () = assert!(size_of::<GatewayReport>() == 48);
