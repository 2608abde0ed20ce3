//! What every process of a group runs in: heartbeats, signals, hand-over between a stage and its spare,
//! scheduling, output that cannot block.
//!
//! * [`process`]: the process of a stage. [`attendant`]: that of an attendant.
//! * [`stage_page`], [`handover`]: what a stage's processes leave each other.
//! * [`scheduling`], [`memory_rank`], [`descriptors`]: what they ask of the system.
//! * [`mod@tell`]: messages for the user. [`output`]: results of commands, on the standard output and in files.
//!   [`user_config`]: their configuration file.

// A process must survive the reader of its output: see `tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

pub mod attendant;
pub mod descriptors;
pub mod handover;
pub mod heap;
pub mod memory_rank;
pub mod orphan;
pub mod output;
pub mod prefetch;
pub mod process;
pub mod scheduling;
pub mod stage_page;
pub mod tell;
pub mod user_config;
