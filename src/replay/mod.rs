//! Processes a recording with the same code that the group ran live.

mod inputs;
mod verify;

pub use verify::{Findings, Verifier};
