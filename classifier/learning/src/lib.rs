//! Learning colours from pictures, off line: nothing here runs during a match.
//!
//! * [`labels`]: marked contents of pictures.
//! * [`samples`]: pixels of known colour, from labelled pictures.
//! * [`scene`]: camera, pitch and robots, prepared for many pictures.
//! * [`separate`]: from samples to the bounds of colours.
//! * [`confusion`]: separation of samples by given bounds.
//! * [`palette`]: initial colours without samples.
//! * [`candidates`]: patches guessed from pictures without labels.
//! * [`blobs`]: connected pixels of one class.
//!
//! All functions are pure, except [`labels::Labels::load`].

// A process outlives the reader of its output: see `common::tell`.
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
