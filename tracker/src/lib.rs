//! The tracker: from runs to regions to robots and balls (sections 5 and 6.1 of the paper).
//!
//! Consumes `runs`, `frames` to measure what the runs have shown, and `world` as a hint; produces
//! `detections`.
//!
//! Each frame is searched as a whole, never only near the last places, so nothing stays lost. The steps, each
//! in a file of its own:
//!
//! 1. [`regions`]: touching runs of one colour are merged into regions, and measured in millimetres on the
//!    plane of the tops (`regions/measured_regions.rs`).
//! 2. `candidates`: regions, groups of fragments, pieces of regions grown together (`candidates/split.rs`),
//!    and the pixels at the places that a team patch's shape predicts (`candidates/beside.rs`,
//!    `pattern/footprint.rs`) become candidates for patches.
//! 3. `pairing`: candidates at the layout's distances become hypotheses of robots (`pairing/hypotheses.rs`),
//!    and `pairing/assignment.rs` chooses the largest set without contradictions. Where none fits well,
//!    `pairing/second_opinion.rs` identifies the robot by its pixels (`pairing/agreement.rs`).
//! 4. `pose`: the places of the patches become a pose.
//! 5. `refine`: poses are fitted to the edges of the patches in the raw picture (`raw`, and `edges` with its
//!    folder), and get a covariance.
//! 6. `faint`: robots whose patches are too blurred for colour classes are found by unmixing
//!    (`faint/search.rs`, `faint/mixture.rs`).
//! 7. `unknown`: robots of which only the team is known. `ball`: balls by their regions and the circle in
//!    their outline (`ball/silhouette.rs`), fitted to the visible part of the rim (`ball/ball_fit.rs`).
//!    `reasons`: why other regions became nothing.
//!
//! `pattern` is what is looked for: patches, their places and colours, computed once from the configuration.
//!
//! The core, [`Tracker`], is a pure function of its input, and no input makes it panic.

// The process must outlive the readers of its output: see `runtime::tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

mod ball;
mod candidates;
mod edges;
mod error;
mod faint;
mod linear;
mod pairing;
mod pattern;
mod pitch;
mod pose;
pub mod process;
mod raw;
mod reasons;
mod refine;
pub mod regions;
mod revisions;
pub mod stage;
mod unknown;

pub use stage::{Tracker, TrackerError};
