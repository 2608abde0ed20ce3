//! The tracker: from runs to regions to robots and balls (sections 5 and 6.1 of the paper).
//!
//! Consumes `runs`, `frames` to measure what the runs have shown, and `world` as a hint; produces
//! `detections`.
//!
//! Each frame is searched as a whole, never only near the last places, so nothing stays lost. The steps, each
//! in a file of its own:
//!
//! 1. [`regions`]: touching runs of one colour are merged into regions.
//! 2. `candidates`: regions (`measured_regions`), groups of fragments, and pieces of regions grown together
//!    (`split`) become candidates for patches, measured in millimetres on the plane of the tops; and so do
//!    the pixels at the places that a team patch's shape predicts (`footprint`).
//! 3. `pairing`: candidates at the layout's distances become `hypotheses` of robots, and `assignment` chooses
//!    the largest set without contradictions. Where none fits well, `second_opinion` identifies the robot by
//!    its pixels (`agreement`).
//! 4. `pose`: the places of the patches become a pose.
//! 5. `refine`: poses are fitted to the edges of the patches in the raw picture (`raw`, `edges`,
//!    `edge_pixels`, `edge_fit`, `local_map`), and get a covariance.
//! 6. `faint`: robots whose patches are too blurred for colour classes are found by unmixing (`mixture`).
//! 7. `unknown`: robots of which only the team is known. `ball`: balls by their regions and the circle in
//!    their outline (`silhouette`), fitted to the visible part of the rim (`ball_fit`, `tinge`, `sphere`).
//!    `reasons`: why other regions became nothing.
//!
//! The core, [`Tracker`], is a pure function of its input, and no input makes it panic.

// The process must outlive the readers of its output: see `common::tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

mod agreement;
mod assignment;
mod ball;
mod ball_fit;
mod candidates;
mod cell_grid;
mod class_index;
mod edge_fit;
mod edge_pixels;
mod edges;
mod error;
mod faint;
mod footprint;
mod hypotheses;
mod linear;
mod local_map;
mod measure;
mod measured_regions;
mod mixture;
mod pairing;
mod pattern;
mod pitch;
mod pose;
mod prior;
pub mod process;
mod raw;
mod reasons;
mod refine;
pub mod regions;
mod second_opinion;
mod shares;
mod silhouette;
mod sphere;
mod split;
pub mod stage;
mod tinge;
mod unknown;

pub use stage::{Tracker, TrackerError};
