//! State of the publisher: what it sends in the leagues' protocols, and what it receives.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;

/// Most protocols in a report.
pub const MAX_OUTPUTS: usize = 8;

/// One published protocol. Counters start with the publisher's process.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/OutputReport/1")]
#[repr(C)]
pub struct OutputReport {
    /// Key of its section in `[publish]`: UTF-8, ended by a zero.
    #[cfg_attr(feature = "schema", schemars(with = "crate::structure::List<u8, 16>"))]
    pub name: [u8; 16],
    /// Packets handed to the system, counted for each receiver and interface.
    pub sent: u64,
    /// Packets that the system refused, or for which there was no interface.
    pub failed: u64,
    /// Packets larger than one Ethernet frame.
    pub large: u64,
    /// Problem and remedy, in the form of the name; empty when there is none.
    #[cfg_attr(feature = "schema", schemars(with = "crate::structure::List<u8, 248>"))]
    pub problem: [u8; 248],
}

/// Published by the publisher several times a second.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/PublisherReport/1")]
#[repr(C)]
pub struct PublisherReport {
    /// Time of publication.
    pub t_sent_ns: u64,
    /// Packets with commands that were passed on.
    pub commands: u64,
    /// Packets to the command port that were malformed or impossible.
    pub malformed: u64,
    /// Packets to the command port from addresses that are not allowed.
    pub not_allowed: u64,
    /// Packets to the command port beyond the permitted rate.
    pub too_many: u64,
    /// Valid elements of `outputs`.
    pub output_count: u32,
    /// Other publishers on the same addresses at the moment.
    pub rivals: u32,
    /// Published protocols.
    pub outputs: [OutputReport; MAX_OUTPUTS],
    /// Problem that is not that of one protocol: UTF-8, ended by a zero; empty when there is none.
    #[cfg_attr(feature = "schema", schemars(with = "crate::structure::List<u8, 256>"))]
    pub problem: [u8; 256],
}

const _: () = assert!(size_of::<OutputReport>() == 288);
const _: () = assert!(size_of::<PublisherReport>() == 48 + MAX_OUTPUTS * 288 + 256);

impl PublisherReport {
    /// The published protocols.
    pub fn outputs(&self) -> &[OutputReport] {
        crate::filled(&self.outputs, self.output_count)
    }
}
