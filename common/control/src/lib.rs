//! What a running group tells, and what it can be asked for.
//!
//! [`read_status`] reads the [`Report`] that the group's monitor publishes, [`ask`] sends a [`Request`] to its
//! supervisor. All processes of a group and all programs
//! beside it share these types.

mod configured;
mod event;
pub mod report;
mod request;
mod status;

pub use configured::{Configured, KEPT_REVISIONS, Revised};
pub use event::Event;
pub use report::Report;
pub use request::{Answer, Done, MAX_REQUEST_BYTES, Request, ask};
pub use status::{read_status, requests};
