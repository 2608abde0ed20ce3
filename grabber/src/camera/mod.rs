//! The interface between the grabber and sources of frames.
//!
//! A [`Camera`] delivers frames in shared memory: it takes memory from the [`FramePool`], has it filled, by
//! hardware if possible, and returns it with a description of the picture. A source that renders its frames
//! when they are due implements the simpler [`FrameRenderer`], which only fills pixels; [`RenderedCamera`]
//! makes a camera of it. A driver of real cameras implements [`Device`]; [`Link`] makes a camera of it that
//! survives faults.

mod clock;
mod device;
mod link;
mod numbering;
mod pool;
mod rate_meter;
mod rendered;
mod timeline;

pub use clock::{DeviceClock, WallClock};
pub use device::{Arrival, Delivery, Device, Fault, Session, Stream};
pub use link::Link;
pub use pool::{FrameLoan, FramePool};
pub use rendered::{FrameRenderer, RenderedCamera};
pub use timeline::Timeline;

use messages::{BayerOrder, CameraReport, Commands, FrameHeader, PixelFormat, TruthFrame};

/// Time and number of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exposure {
    /// Frame number; skipped numbers are frames that were never captured.
    pub seq: u64,
    /// Middle of the exposure, monotonic clock.
    pub t_capture_ns: u64,
    /// Middle of the exposure, wall clock.
    pub t_capture_wall_ns: u64,
    /// Frames the source had to skip before this one because the grabber was late.
    pub skipped: u64,
}

/// Layout of a frame's bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from the start of a row to the start of the next.
    pub stride: u32,
    /// Encoding of the pixels.
    pub pixel_format: PixelFormat,
    /// Colours of the top-left 2×2 pixels; only for Bayer formats.
    pub bayer_order: BayerOrder,
    /// Exposure time; 0 when unknown.
    pub exposure_us: u32,
}

/// A frame in shared memory, not yet published.
pub struct Captured {
    /// Its pixels.
    pub frame: FrameLoan,
    /// Time and number.
    pub exposure: Exposure,
    /// Layout of its bytes.
    pub picture: Picture,
}

impl Captured {
    /// The header of the frame, published at `t_sent_ns`.
    pub fn header(&self, t_sent_ns: u64) -> FrameHeader {
        let Self { exposure, picture, .. } = self;
        FrameHeader {
            seq: exposure.seq,
            t_capture_ns: exposure.t_capture_ns,
            t_capture_wall_ns: exposure.t_capture_wall_ns,
            t_sent_ns,
            camera_id: 0,
            width: picture.width,
            height: picture.height,
            stride: picture.stride,
            pixel_format: picture.pixel_format as u32,
            bayer_order: picture.bayer_order as u32,
            exposure_us: picture.exposure_us,
            revision: 0,
        }
    }
}

/// A frame number and its capture time, from which a successor continues.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LastFrame {
    /// Its number.
    pub seq: u64,
    /// When it was captured, monotonic clock.
    pub t_capture_ns: u64,
}

/// A source cannot deliver.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// A file could not be read, or is not a picture of the right kind.
    #[error("{path}: {problem}")]
    Picture {
        /// The file or folder.
        path: String,
        /// The problem, and what would be right.
        problem: String,
    },
    /// A recording cannot be played.
    #[error("{0}")]
    Recording(String),
    /// The synthetic match cannot be built.
    #[error("synthetic match: {0}")]
    Synthetic(String),
    /// Frames come from another program, but the configuration names none.
    #[error(
        "the source external takes frames of a program that the configuration permits: put the name under which \
         it joins the group into access.publishers"
    )]
    External,
    /// All memory of the topic is held by readers: possible only if a reader breaks the rules.
    #[error("no shared memory for another frame: {0}")]
    NoMemory(String),
}

/// A source of frames. It owns their numbers and capture times.
pub trait Camera {
    /// Waits for the next frame, if possible for at most [`MAX_WAIT`](runtime::process::MAX_WAIT), since
    /// the process has a heartbeat to send. `None` if there was none.
    ///
    /// An error ends the process, except [`CameraError::NoMemory`], which loses a frame.
    fn capture(&mut self, pool: &mut FramePool) -> Result<Option<Captured>, CameraError>;

    /// The truth of the frame just captured; only for simulated sources.
    fn truth(&self) -> Option<&TruthFrame> {
        None
    }

    /// The commands sent up to the frame just captured; only for sources that simulate strategies.
    fn commands(&self) -> &[Commands] {
        &[]
    }

    /// Commands of another program; simulated robots obey them.
    fn obey(&mut self, _commands: &Commands) {}

    /// Whether a regular pause precedes the next frame.
    fn is_waiting(&self) -> bool {
        false
    }

    /// Whether there will be no more frames.
    fn is_over(&self) -> bool {
        false
    }

    /// State of a real camera.
    fn report(&self) -> Option<&CameraReport> {
        None
    }
}
