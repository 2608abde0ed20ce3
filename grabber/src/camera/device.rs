//! What a driver has to provide: a device that can be opened, and a stream that brings frames.
//!
//! Drivers do nothing about trouble but to say what it is. Trying again, numbering, and telling
//! others is the same for all of them and done by [`Link`](super::Link).

use super::{FrameLoan, FramePool, Picture};
use common::messages::CameraState;
use std::time::Duration;

/// What is wrong with a camera.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{problem}")]
pub struct Fault {
    /// In one word, for programs.
    pub state: CameraState,
    /// In a sentence, for people: what, and what to do about it.
    pub problem: String,
}

impl Fault {
    /// A fault of this kind.
    pub fn new(state: CameraState, problem: impl Into<String>) -> Self {
        Self { state, problem: problem.into() }
    }
}

/// A camera that may be there, or not, or not yet.
pub trait Device: Send + Sync {
    /// What it is called on the command line.
    fn name(&self) -> String;

    /// Finds it and makes it ready: format, rate, settings. May take seconds; called on a thread of
    /// its own.
    fn open(&self) -> Result<Box<dyn Session>, Fault>;
}

/// A camera that is ready to stream.
pub trait Session: Send {
    /// Frames a second, as far as the camera or its driver promises any number.
    fn promised_fps(&self) -> Option<f64>;

    /// Starts it. From here on everything happens on the grabber's own thread. Also says what it
    /// is, for people: model, format, way of transfer.
    fn start(self: Box<Self>, pool: &mut FramePool) -> Result<(Box<dyn Stream>, String), Fault>;
}

/// A streaming camera. Stopped when it is dropped.
pub trait Stream {
    /// Waits for what comes next, for so long at most; `None` when nothing has come.
    fn next(&mut self, pool: &mut FramePool, timeout: Duration) -> Result<Option<Arrival>, Fault>;
}

/// What a stream brings.
// Most arrivals are frames; boxing them would allocate memory for each.
#[allow(clippy::large_enum_variant)]
pub enum Arrival {
    /// A whole frame.
    Frame(Delivery),
    /// A frame of which parts are missing or damaged.
    Incomplete,
    /// A whole frame for which there was no shared memory.
    NoMemory,
}

/// A frame as the driver hands it over.
pub struct Delivery {
    /// Its pixels.
    pub frame: FrameLoan,
    /// What its bytes are.
    pub picture: Picture,
    /// The device's own number. Gaps are frames that did not reach the driver; those reported as
    /// incomplete have numbers too.
    pub device_seq: u64,
    /// Middle of the exposure, monotonic clock.
    pub t_capture_ns: u64,
}
