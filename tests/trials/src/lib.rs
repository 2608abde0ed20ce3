//! Trials of the whole program on this machine, behind the commands `chaos`, `stress` and `bench`.
//!
//! * [`chaos`]: disturbs a match at random, and checks that nothing is lost.
//! * [`stress`]: searches for the highest frame rate without a loss.
//! * [`bench`](mod@bench): measures the stages on frames.
//!
//! Matches are run by the program itself, in processes of its own.

// A process outlives the reader of its output: see `runtime::tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]
// Module documentation is written for readers of the source, where links to private modules work.
#![allow(rustdoc::private_intra_doc_links)]

pub mod args;
pub mod bench;
pub mod chaos;
pub mod stress;

use std::error::Error;

/// Reason for which a trial ends early; its text is for the user.
pub type TrialError = Box<dyn Error>;
