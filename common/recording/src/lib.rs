//! Recordings: MCAP files with the exact messages of a group's topics, and scenes for common viewers.
//!
//! * [`Channel`] is the table of a recording's contents and their encodings.
//! * [`Writer`] writes a file in small chunks, so that little is lost if the process or the power
//!   fails.
//! * [`Reader`] reads a file, finished or not, in the order in which the messages were sent.
//! * [`Archive`] finds any moment of a file by its time, without reading what comes before it.
//! * [`recover`](recover::recover) makes an unfinished or damaged file a proper recording.
//!
//! Frames are written as `foxglove.RawImage` (protobuf) with our own header in an additional field,
//! which viewers skip. Our other messages are written in their memory layout, described by their schema
//! ([`messages::structure`]), with one rule: **bytes missing at the end of a message are
//! zeros**, and so are list elements beyond their count. A detections message with room for 32,768 runs
//! thus takes a few kilobytes. The scene for viewers (`foxglove.SceneUpdate`, JSON) is derived from
//! `world` and never read back.

// A process must survive the reader of its output: see `runtime::tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

mod archive;
mod bytes;
mod channel;
mod chunk;
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

pub use archive::{Archive, Moment};
pub use channel::{Channel, Description};
pub use damage::{Damage, Damages, Fault};
pub use image::{Frame, decode_frame, encode_frame};
pub use message::{decode_list, decode_message, encode_list, encode_message};
pub use reader::{Entry, Reader};
pub use scene::{ball_pose, field_scene, robot_poses, world_scene};
pub use setup::Setup;
pub use writer::Writer;

use std::path::PathBuf;

/// Errors of reading and writing recordings.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file could not be opened, read or written.
    #[error("{}: {action}: {source}", path.display())]
    Io {
        /// The recording.
        path: PathBuf,
        /// The attempted action.
        action: &'static str,
        /// The system's answer.
        source: std::io::Error,
    },
    /// The file is not a recording, or is damaged.
    #[error("{}: {problem}", path.display())]
    Format {
        /// The recording.
        path: PathBuf,
        /// The problem.
        problem: String,
    },
}
