//! Recordings: MCAP files that hold what went over the topics of a group, exactly, together with
//! what common viewers need to draw it.
//!
//! * [`Channel`] is the table of what a recording may hold and how each message is written.
//! * [`Writer`] writes one file, in small chunks, so that little is lost with a process or the power.
//! * [`Reader`] reads one, finished or not, in the order in which things happened.
//! * [`recover`](recover::recover) makes a proper file of one that was never finished.
//!
//! Frames are written as `foxglove.RawImage` (protobuf) with our own header in a further field, which
//! viewers pass over. Our other messages are written as they lie in memory, described by their schema
//! ([`common::messages::structure`]), with one rule: **bytes missing at the end of a message are
//! zeros**, and so are list elements behind their count; a detections message, made for 32,768 runs,
//! takes a few kilobytes. The scene for viewers (`foxglove.SceneUpdate`, JSON) is derived from
//! `world` and never read back.

// A process outlives whoever reads what it says: see `common::tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

mod bytes;
mod channel;
mod damage;
mod image;
mod message;
mod reader;
pub mod recover;
mod scan;
mod scene;
mod setup;
mod summary;
mod wire;
mod writer;

pub use channel::Channel;
pub use damage::{Damage, Damages, Fault};
pub use image::{Frame, decode_frame, encode_frame};
pub use message::{decode_list, decode_message, encode_list, encode_message};
pub use reader::{Entry, Reader};
pub use scene::{ball_pose, field_scene, robot_poses, world_scene};
pub use setup::Setup;
pub use writer::Writer;

use std::path::PathBuf;

/// What went wrong with a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file could not be opened, read or written.
    #[error("{}: {action}: {source}", path.display())]
    Io {
        /// The recording.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not a recording, or is damaged.
    #[error("{}: {problem}", path.display())]
    Format {
        /// The recording.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
}
