//! The interface of a driver: a device that can be opened, and a stream that delivers frames.
//!
//! Drivers report faults and do nothing else about them. Retrying, numbering and reporting is common to all
//! drivers and done by [`Link`](super::Link).

use super::{FrameLoan, FramePool, Picture};
use messages::CameraState;
use std::time::Duration;

/// A camera's fault.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{problem}")]
pub struct Fault {
    /// Its kind, for programs.
    pub state: CameraState,
    /// One sentence for people: what happened, and what to do about it.
    pub problem: String,
}

impl Fault {
    /// A fault of this kind.
    pub fn new(state: CameraState, problem: impl Into<String>) -> Self {
        Self { state, problem: problem.into() }
    }
}

/// A camera that may be present or absent.
pub trait Device: Send + Sync {
    /// Its name on the command line.
    fn name(&self) -> String;

    /// Finds and configures it: format, rate, settings. May take seconds; called on a thread of its own.
    fn open(&self) -> Result<Box<dyn Session>, Fault>;
}

/// A camera ready to stream.
pub trait Session: Send {
    /// Frames per second, if the camera or its driver promises a rate.
    fn promised_fps(&self) -> Option<f64>;

    /// Starts it. From here on everything happens on the grabber's own thread. Also returns a description for
    /// people: model, format, kind of transfer.
    fn start(self: Box<Self>, pool: &mut FramePool) -> Result<(Box<dyn Stream>, String), Fault>;
}

/// A streaming camera. Stopped when it is dropped.
pub trait Stream {
    /// Waits for the next arrival, for at most `timeout`; `None` if there was none.
    fn next(&mut self, pool: &mut FramePool, timeout: Duration) -> Result<Option<Arrival>, Fault>;
}

/// An event on a stream.
// Most arrivals are frames; boxing them would allocate memory for each.
#[allow(clippy::large_enum_variant)]
pub enum Arrival {
    /// A whole frame.
    Frame(Delivery),
    /// A frame with missing or damaged parts.
    Incomplete,
    /// A whole frame for which there was no shared memory.
    NoMemory,
}

/// A frame as delivered by the driver.
pub struct Delivery {
    /// Its pixels.
    pub frame: FrameLoan,
    /// Layout of its bytes.
    pub picture: Picture,
    /// The device's own number. Gaps are frames that did not reach the driver; incomplete frames have
    /// numbers, too.
    pub device_seq: u64,
    /// Middle of the exposure, monotonic clock.
    pub t_capture_ns: u64,
}
