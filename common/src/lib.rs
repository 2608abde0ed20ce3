//! Code shared by two or more Touchline processes: messages and topics, geometry between image and
//! field, configuration, and the frame every process runs in.
//!
//! Dependencies point one way: stages depend on this crate and never on each other, so a message
//! is the only thing one stage can know about another.
//!
//! # Coordinate frames
//!
//! * **image**: pixels; the centre of the top-left pixel is (0, 0), x to the right, y down.
//! * **field**: millimetres on the floor; origin at the centre of the pitch, x along its length
//!   towards the goal on the right of an upright picture, y to the left of x, z up. Angles are in
//!   radians, counter-clockwise from x.
//! * **robot**: millimetres; origin at the centre of the robot's top, x forward, y to the left.

// A process must survive the reader of its output: see `common::tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

pub mod attendant;
pub mod body;
pub mod bus;
pub mod calibration;
pub mod clock;
pub mod config;
pub mod consumer;
pub mod descriptors;
pub mod eventcount;
pub mod gateway;
pub mod geometry;
pub mod handover;
pub mod heap;
pub mod input;
pub mod instance;
pub mod interface;
pub mod layout;
mod lens;
pub mod memory;
pub mod memory_rank;
pub mod messages;
pub mod orphan;
pub mod prefetch;
pub mod private;
pub mod process;
mod rhythm;
pub mod rolling_shutter;
pub mod roster;
pub mod scheduling;
mod shared_page;
pub mod stage_page;
pub mod stages;
pub mod tell;
pub mod top_scale;
pub mod topics;
pub mod wake_up;
