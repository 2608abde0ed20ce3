//! The classifier's correction of the light.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use serde::Serialize;

/// Correction of the light in the frame the classifier processed last.
///
/// Each channel of a pixel is multiplied by a gain before its colour is looked up, so that the pitch
/// looks as it did when the colours were set.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/LightCorrection/1")]
#[repr(C)]
pub struct LightCorrection {
    /// Gains of red, green and blue in the middle of the pitch; 1 changes nothing.
    pub gains: [f32; 3],
    /// Bit set of [`FOLLOWED`](Self::FOLLOWED), [`AT_BOUND`](Self::AT_BOUND),
    /// [`PITCH_UNSEEN`](Self::PITCH_UNSEEN) and [`GLARE`](Self::GLARE).
    pub flags: u32,
    /// Smallest and largest additional gain of all channels over the zones of the pitch; both 1 where
    /// light is taken to be even.
    pub zones: [f32; 2],
    /// Number of frames in which the gains changed since the process started.
    pub changes: u64,
}

const _: () = assert!(size_of::<LightCorrection>() == 32);

impl LightCorrection {
    /// Flag: the light is followed. Without it pictures are not corrected.
    pub const FOLLOWED: u32 = 1;
    /// Flag: a gain is at its bound; a stronger correction may be needed.
    pub const AT_BOUND: u32 = 2;
    /// Flag: too little of the pitch was seen to measure the light, so nothing was corrected.
    pub const PITCH_UNSEEN: u32 = 4;
    /// Flag: glare was found and removed where it lay; the zones are not updated meanwhile.
    pub const GLARE: u32 = 8;

    /// No correction.
    pub const NONE: Self = Self { gains: [1.0; 3], flags: 0, zones: [1.0; 2], changes: 0 };

    /// Whether a flag is set.
    pub fn has(&self, flag: u32) -> bool {
        self.flags & flag != 0
    }
}

/// The classifier's report on the light, some ten times a second while it works.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/LightReport/1")]
#[repr(C)]
pub struct LightReport {
    /// Time of publication.
    pub t_sent_ns: u64,
    /// Number of the frame that was corrected.
    pub seq: u64,
    /// The correction.
    pub correction: LightCorrection,
}

const _: () = assert!(size_of::<LightReport>() == 48);
