//! What is learned from pictures, off line: nothing here runs while a match is on.
//!
//! * [`labels`]: what somebody says is to be seen in pictures.
//! * [`samples`]: pixels of known colour, out of labelled pictures.
//! * [`scene`]: camera, pitch and robots, prepared for many pictures.
//! * [`separate`]: from samples to the bounds of colours.
//! * [`confusion`]: how well bounds tell samples apart.
//! * [`palette`]: colours to begin with when there are no samples.
//! * [`candidates`]: patches guessed from pictures without labels.
//! * [`blobs`]: connected pixels of one class.
//!
//! Everything here is a pure function of what it is given, except [`labels::Labels::load`].

// A process outlives whoever reads what it says: see `common::tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

pub mod blobs;
pub mod candidates;
pub mod confusion;
pub mod labels;
pub mod palette;
pub mod picture;
pub mod samples;
pub mod scene;
pub mod separate;
