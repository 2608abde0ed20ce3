//! The classifier's output: runs of classified pixels.

use super::FrameHeader;
use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use serde::Serialize;

/// Most runs a message carries. A match has a few hundred; a 640×480 frame of pure noise has ten
/// thousand to ninety thousand, depending on how much of the colour space is in use. Runs that do not
/// fit are cut off, in row order, and [`RunsHeader::OVERFLOW`] is set.
pub const MAX_RUNS: usize = 32_768;

/// Pixels `begin..end` of one row, all of one class, bounded by other classes or by background.
///
/// A message lists its runs by row, within a row by column.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Pod, Zeroable, ZeroCopySend, Serialize,
)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/Run/1")]
#[repr(C)]
pub struct Run {
    /// Row in the image.
    pub row: u16,
    /// First column.
    pub begin: u16,
    /// Column after the last one.
    pub end: u16,
    /// Colour class: index into the configured colours, 0–31.
    pub class: u8,
    /// Reserved, 0.
    #[serde(skip_serializing)]
    pub reserved: u8,
}

const _: () = assert!(size_of::<Run>() == 8);

impl Run {
    /// Number of pixels; 0 for a malformed run.
    pub fn pixels(&self) -> u32 {
        u32::from(self.end.saturating_sub(self.begin))
    }
}

/// Header of a list of runs. The payload always has [`MAX_RUNS`] elements, of which the first
/// [`run_count`](Self::run_count) are valid.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/RunsHeader/3")]
#[repr(C)]
pub struct RunsHeader {
    /// The frame the runs were found in.
    pub frame: FrameHeader,
    /// When the classifier received the frame.
    pub t_frame_taken_ns: u64,
    /// When the classifier published the runs.
    pub t_sent_ns: u64,
    /// Identifies the tables the pixels were classified with: a hash of the configured colours, the
    /// gains of the light, and, where light is uneven or there is glare, of the assignment of tables to
    /// parts of the picture. Two frames of the same version had the same tables at every pixel.
    pub class_table_version: u64,
    /// Valid elements of the payload.
    pub run_count: u32,
    /// Bit set of [`OVERFLOW`](Self::OVERFLOW).
    pub flags: u32,
    /// Revision of the classifier's configuration.
    pub revision: u32,
    /// The first revision with the same colours: from there on class numbers have the same meaning.
    pub classes_since: u32,
}

const _: () = assert!(size_of::<RunsHeader>() == 104);

impl RunsHeader {
    /// Flag: the frame had more runs than fit; the rest of the picture is missing.
    pub const OVERFLOW: u32 = 1;

    /// The valid part of a payload; never longer than the payload, whatever the header claims.
    pub fn valid<'a>(&self, payload: &'a [Run]) -> &'a [Run] {
        super::filled(payload, self.run_count)
    }
}
