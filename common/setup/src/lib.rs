//! Setting a pitch up, off line: nothing here runs for a frame of a match.
//!
//! * [`calibration`]: the camera's geometry from points marked in a picture.
//! * [`learning`]: colours from pictures.

// A process outlives the reader of its output: see `runtime::tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

pub mod calibration;
pub mod learning;
