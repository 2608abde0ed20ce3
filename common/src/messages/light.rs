//! What the classifier does about the light.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use schemars::JsonSchema;

/// How the classifier corrects the light of the frame it worked on last.
///
/// A correction is what each channel of a pixel is multiplied with before its colour is looked up, as
/// if the pitch looked as it did when the colours were set.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend, JsonSchema)]
#[type_name("touchline/LightCorrection/1")]
#[repr(C)]
pub struct LightCorrection {
    /// What red, green and blue are multiplied with in the middle of the pitch; 1 changes nothing.
    pub gains: [f32; 3],
    /// Bit set of [`FOLLOWED`](Self::FOLLOWED), [`AT_BOUND`](Self::AT_BOUND),
    /// [`PITCH_UNSEEN`](Self::PITCH_UNSEEN) and [`GLARE`](Self::GLARE).
    pub flags: u32,
    /// What all channels are multiplied with besides, on the parts of the pitch where that is least and
    /// where it is most; both 1 where light is taken to be even.
    pub zones: [f32; 2],
    /// How often the gains have changed from one frame to the next since the process began.
    pub changes: u64,
}

const _: () = assert!(size_of::<LightCorrection>() == 32);

impl LightCorrection {
    /// Flag: the light is followed. Without it pictures are taken as they are.
    pub const FOLLOWED: u32 = 1;
    /// Flag: a gain has reached its bound; more may be needed.
    pub const AT_BOUND: u32 = 2;
    /// Flag: too little was seen of the pitch to tell the light, so nothing was corrected.
    pub const PITCH_UNSEEN: u32 = 4;
    /// Flag: there was glare, which was taken off where it lay. Then zones rest.
    pub const GLARE: u32 = 8;

    /// Pictures are taken as they are.
    pub const NONE: Self = Self { gains: [1.0; 3], flags: 0, zones: [1.0; 2], changes: 0 };

    /// Whether a flag is set.
    pub fn has(&self, flag: u32) -> bool {
        self.flags & flag != 0
    }
}
