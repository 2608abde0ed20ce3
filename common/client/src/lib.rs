//! Attaching to a running group: reading its topics, sending commands.
//!
//! * [`consumer`]: everything that a strategy or a logger needs. Start here.
//! * [`gateway`]: the same for programs of other users, through the group's gateway.
//! * [`bus`]: publishers and subscribers of any topic, for processes of the group.
//! * [`instance`]: a group's name, its directory and its names in shared memory.
//! * [`memory`]: shared memory, and how much of it messages take.
//!
//! The messages and the table of topics are in the crate `touchline-messages`.

// A process must survive the reader of its output.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

pub mod bus;
pub mod clock;
pub mod consumer;
pub mod eventcount;
pub mod gateway;
pub mod instance;
pub mod memory;
pub mod private;
mod rhythm;
pub mod roster;
pub mod shared_page;
pub mod wake_up;
