//! The tracker: from runs to regions to robots and balls (sections 5 and 6.1 of the paper).
//!
//! Consumes `runs`, `frames` to measure what the runs have shown, and `world` as a hint; produces
//! `detections`.
//!
//! One frame at a time, and each frame whole: nothing is searched only near where it was, so nothing
//! stays lost. The steps, each in a file of its own:
//!
//! 1. [`regions`]: runs that touch and have one colour become a region.
//! 2. `candidates`: regions, groups of fragments, and pieces of regions grown together become
//!    candidates for patches, measured in millimetres on the plane of the robots' tops; and so
//!    does, by `footprint`, what lies where a team patch's own shape says another patch must be.
//! 3. `pairing`: candidates that stand to each other as the layout says become hypotheses of robots,
//!    and `assignment` picks the set of hypotheses that explains most of the picture best. Where they
//!    fit badly, `second_opinion` asks the pixels instead of the regions, by `agreement`.
//! 4. `pose`: the places of the patches become a pose.
//! 5. `refine`: poses are measured to hundredths of a pixel where the patches have their edges in the
//!    raw picture (`raw`, `edges`, `edge_fit`, `local_map`), and get their covariance.
//! 6. `faint`: where patches are blurred beyond their colours, the mixture of colours in the raw picture
//!    is undone (`mixture`).
//! 7. `unknown`: robots of which only the team can be told; `ball`, from its regions and the circle in
//!    their outline (`silhouette`), measured by as much of its rim as is seen (`ball_fit`, `tinge`,
//!    `sphere`); and `reasons`: what became of everything else.
//!
//! The core, [`Tracker`], is a pure function of its input and survives any.

// A process outlives whoever reads what it says: see `common::tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

mod agreement;
mod assignment;
mod ball;
mod ball_fit;
mod candidates;
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
mod spots;
pub mod stage;
mod tinge;
mod unknown;

pub use stage::{Tracker, TrackerError};
