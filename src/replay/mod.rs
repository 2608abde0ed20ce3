//! Working on a recording what the group worked on live, with the same code.

mod inputs;
mod verify;

pub use verify::{Findings, Verifier};
