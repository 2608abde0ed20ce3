//! What the grabber needs from a source of frames.
//!
//! A [`Camera`] brings frames in shared memory: it takes memory from the [`FramePool`], has it
//! filled, by hardware if possible, and gives it back with what it knows about the picture. A source
//! that paints its frames itself, when they are due, is a [`Painter`], which is simpler: it gets the
//! pixels to fill. [`Painted`] makes a camera of it. A driver of real cameras is a [`Device`];
//! [`Link`] makes a camera of it, one that survives what cameras do.

mod clock;
mod device;
mod link;
mod numbering;
mod pace;
mod painted;
mod pool;
mod timeline;

pub use clock::{DeviceClock, WallClock};
pub use device::{Arrival, Delivery, Device, Fault, Session, Stream};
pub use link::Link;
pub use painted::{Painted, Painter};
pub use pool::{FrameLoan, FramePool};
pub use timeline::Timeline;

use common::messages::{BayerOrder, CameraReport, Commands, FrameHeader, PixelFormat, TruthFrame};

/// When a frame was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exposure {
    /// Frame number; numbers left out are frames that were never captured.
    pub seq: u64,
    /// Middle of the exposure, monotonic clock.
    pub t_capture_ns: u64,
    /// The same on the wall clock.
    pub t_capture_wall_ns: u64,
    /// Frames the source had to skip before this one because the grabber was late.
    pub skipped: u64,
}

/// What a frame's bytes are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from the start of a row to the start of the next.
    pub stride: u32,
    /// What the bytes mean.
    pub pixel_format: PixelFormat,
    /// Colours of the top-left 2×2 pixels, where the format is a Bayer one.
    pub bayer_order: BayerOrder,
    /// Exposure time; 0 when unknown.
    pub exposure_us: u32,
}

/// A frame that has arrived, in shared memory, not yet published.
pub struct Captured {
    /// Its pixels.
    pub frame: FrameLoan,
    /// When it was taken.
    pub exposure: Exposure,
    /// What its bytes are.
    pub picture: Picture,
}

impl Captured {
    /// The header of the frame, to be handed on at `t_sent_ns`.
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
            reserved: 0,
        }
    }
}

/// A frame number and its capture time, from which a later grabber can continue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LastFrame {
    /// Its number.
    pub seq: u64,
    /// When it was captured, monotonic clock.
    pub t_capture_ns: u64,
}

/// Why a source cannot deliver.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// A file could not be read, or is not a picture of the right kind.
    #[error("{path}: {problem}")]
    Picture {
        /// The file or folder.
        path: String,
        /// What is wrong with it, and what would be right.
        problem: String,
    },
    /// A recording cannot be played.
    #[error("{0}")]
    Recording(String),
    /// The synthetic match cannot be built.
    #[error("synthetic match: {0}")]
    Synthetic(String),
    /// Frames are to come from another program, but the configuration names none.
    #[error(
        "the source external takes frames of a program that the configuration permits: put the name under which \
         it joins the group into access.publishers"
    )]
    External,
    /// All of the topic's memory is in readers' hands: possible only if a reader breaks the rules.
    #[error("no shared memory for another frame: {0}")]
    NoMemory(String),
}

/// A source of frames. It owns their numbers and capture times.
pub trait Camera {
    /// Waits for the next frame, but not much longer than
    /// [`LOOK_AROUND`](common::process::LOOK_AROUND) if it can be helped: the process has a
    /// heartbeat to send. `None` when nothing has come.
    ///
    /// An error ends the process, except [`CameraError::NoMemory`], which loses a frame.
    fn capture(&mut self, pool: &mut FramePool) -> Result<Option<Captured>, CameraError>;

    /// For a source that knows what is really there: the truth of the frame just captured.
    fn truth(&self) -> Option<&TruthFrame> {
        None
    }

    /// For a source that plays the strategies too: the commands sent up to the frame just captured.
    fn commands(&self) -> &[Commands] {
        &[]
    }

    /// Somebody else has sent commands; robots that are only played obey them.
    fn obey(&mut self, _commands: &Commands) {}

    /// Whether the next frame is known to be a long time off, and nothing is wrong about that.
    fn is_waiting(&self) -> bool {
        false
    }

    /// Whether there will be no more frames.
    fn is_over(&self) -> bool {
        false
    }

    /// How a real camera is.
    fn report(&self) -> Option<&CameraReport> {
        None
    }
}
