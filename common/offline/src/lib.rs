//! Work off line: nothing here runs for a frame of a match.
//!
//! * [`chain`]: the stages in one process, for pictures and recordings.
//! * [`calibration`]: the camera's geometry from points marked in a picture, or from the lines of the pitch.
//! * [`learning`]: colours from pictures.
//! * [`scoring`]: detections compared with labels.

// A process outlives the reader of its output: see `runtime::tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

pub mod calibration;
pub mod chain;
pub mod learning;
pub mod scoring;
