//! The classifier: from a raw frame to runs of pixels of one colour.
//!
//! **Consumes** `frames`: [`FrameHeader`] and the bytes the sensor gave.
//!
//! **Produces** `runs`: a [`RunsHeader`] and a list of [`Run`]s, the horizontal stretches of pixels
//! that belong to the same configured colour. Background is not listed.
//!
//! **Does** in one pass over the frame, pixel by pixel: bilinear demosaicing (eqs. 1–3 of the paper),
//! classification by three tables and two ANDs (section 4.2), for classified pixels optionally a second look
//! at hue and saturation, and run-length encoding. A colour image is never stored. Formats other than Bayer
//! are taken too; YUV pictures are classified in YUV. If the configuration gives the colour of the pitch when
//! the colours were set, the tables follow the light ([`white_balance`]). Under uneven light ([`shading`]) or glare
//! (`haze.rs`), parts of the picture have tables of their own.
//!
//! **Guarantees**
//!
//! The runs of a frame are sorted by row, then by column, do not overlap, are never empty, and are maximal:
//! two that touch differ in class. Painted on an empty picture they give exactly the class of every pixel.
//! * Every class is an index into the configured colours, at most 31.
//! * When there are more runs than room, the list is the exact beginning of the full one and
//!   [`RunsHeader::OVERFLOW`] is set.
//! * Output depends on the frame and the configuration alone, bit for bit, on every machine.
//! * A frame that is not what the configuration promises is refused with a reason, and nothing is
//!   written; no frame makes the classifier panic. After construction it allocates nothing.

// A process outlives the reader of its output: see `runtime::tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

mod correction;
mod error;
mod haze;
pub mod kernels;
pub mod lattice;
mod mask;
mod picture;
pub mod process;
mod ranks;
pub mod second_look;
mod second_look_tables;
pub mod shading;
mod stage;
mod tables;
pub mod white_balance;
mod yuv;
pub mod zones;

#[cfg(doc)]
use messages::{FrameHeader, Run, RunsHeader};

pub use correction::Correction;
pub use error::ClassifierError;
pub use kernels::scalar::{demosaic, to_rgb};
pub use kernels::{SimdChoice, SimdLevel};
pub use mask::{FieldMask, Span};
pub use picture::{BayerImage, ColorImage, ColorRow, Picture};
pub use stage::Classifier;
pub use tables::ClassTables;
pub use yuv::rgb_from_yuv;

/// Maximum number of colours: the bits of a table entry.
pub const MAX_CLASSES: usize = 32;

/// Stands for "no colour" where a class is expected. Never appears in a run.
pub const BACKGROUND: u8 = u8::MAX;
