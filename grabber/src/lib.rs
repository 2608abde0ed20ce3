//! The grabber: takes frames from a camera and writes them straight into shared memory.
//!
//! * Consumes: a camera, picture files, a recording, or the synthetic match ([`source`]), whose robots obey
//!   `commands`.
//! * Produces: `frames`; for a real camera also `camera`, for the synthetic match also `truth` and
//!   `commands`, for a recording those of these topics that were recorded.
//! * Guarantees: never waits for a reader. Frame numbers rise; a gap is a frame that was never captured.
//!   Capture times are the source's own.

// A process outlives the reader of its output: see `runtime::tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

pub mod camera;
mod camera_reporter;
mod external;
pub mod genicam;
mod injector;
mod jpeg;
pub mod listing;
pub mod mosaic;
mod picture_camera;
pub mod pictures;
pub mod playback;
mod png;
pub mod process;
pub mod source;
pub mod synthetic;
pub mod v4l2;
