//! Processes a recording with the same code that the group ran live.

mod configurations;
mod inputs;
mod verify;

pub use configurations::ConfigurationError;
pub use verify::{Findings, Verifier};
