//! Learning colours from pictures.
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

pub mod blobs;
pub mod candidates;
pub mod confusion;
pub mod labels;
pub mod palette;
pub mod picture;
pub mod samples;
pub mod scene;
pub mod separate;
