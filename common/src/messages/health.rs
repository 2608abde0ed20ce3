//! Signs of life.

use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use schemars::JsonSchema;

/// The kinds of process in a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u32)]
pub enum ProcessKind {
    /// Captures frames.
    Grabber = 0,
    /// Frames to runs.
    Classifier = 1,
    /// Runs to detections.
    Tracker = 2,
    /// Detections to world.
    Filter = 3,
}

impl ProcessKind {
    /// All kinds, along the way of a frame.
    pub const ALL: [Self; 4] = [Self::Grabber, Self::Classifier, Self::Tracker, Self::Filter];

    /// The kind with this number in a message, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.get(number as usize).copied()
    }

    /// The kind of this [name](Self::name), if there is one.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Subcommand and process name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Grabber => "grabber",
            Self::Classifier => "classifier",
            Self::Tracker => "tracker",
            Self::Filter => "filter",
        }
    }
}

/// Where a process is in its life.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum ProcessState {
    /// Connected to its topics, reading nothing: ready to take over.
    Spare = 1,
    /// At work.
    Active = 2,
    /// Has done all it was asked to do (a bounded run), and waits to be ended.
    Finished = 3,
    /// At work, but without input: its camera is away, and it keeps trying.
    Waiting = 4,
}

impl ProcessState {
    /// The state with this number in a message, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        [Self::Spare, Self::Active, Self::Finished, Self::Waiting]
            .into_iter()
            .find(|&state| state as u32 == number)
    }
}

/// Why a stage did not work on an input it had.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(usize)]
pub enum DropReason {
    /// Its number is not above the last one worked on: a duplicate, or out of order.
    OutOfOrder = 0,
    /// A number or time in its header is impossible.
    BadHeader = 1,
    /// Not the configured size, or fewer bytes than promised.
    WrongSize = 2,
    /// Pixel format or Bayer order unknown.
    WrongFormat = 3,
    /// The grabber itself could not keep up with the camera, or had no memory to loan.
    Late = 4,
    /// The output could not be published.
    NotPublished = 5,
    /// Two processes in a row have died of it.
    Poisonous = 6,
    /// The camera's picture came only in part, or damaged.
    Incomplete = 7,
}

impl DropReason {
    /// All reasons, in the order of [`Heartbeat::dropped`].
    pub const ALL: [Self; 8] = [
        Self::OutOfOrder,
        Self::BadHeader,
        Self::WrongSize,
        Self::WrongFormat,
        Self::Late,
        Self::NotPublished,
        Self::Poisonous,
        Self::Incomplete,
    ];

    /// Key in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::OutOfOrder => "out_of_order",
            Self::BadHeader => "bad_header",
            Self::WrongSize => "wrong_size",
            Self::WrongFormat => "wrong_format",
            Self::Late => "late",
            Self::NotPublished => "not_published",
            Self::Poisonous => "poisonous",
            Self::Incomplete => "incomplete",
        }
    }
}

/// Published by every process about ten times a second and at every change of state. Counters
/// start at zero with the process.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend, JsonSchema)]
#[type_name("touchline/Heartbeat/2")]
#[repr(C)]
pub struct Heartbeat {
    /// When it was published.
    pub t_sent_ns: u64,
    /// Operating system's number of the process.
    pub pid: u32,
    /// A [`ProcessKind`] number.
    pub process: u32,
    /// A [`ProcessState`] number.
    pub state: u32,
    /// Reserved, 0.
    pub reserved: u32,
    /// Newest frame number taken in; `u64::MAX` before the first.
    pub seq_in: u64,
    /// Newest frame number given out; `u64::MAX` before the first.
    pub seq_out: u64,
    /// Inputs taken.
    pub frames_in: u64,
    /// Outputs given.
    pub frames_out: u64,
    /// Frame numbers that never reached this process (gaps in its input).
    pub frames_missed: u64,
    /// Inputs not worked on, by [`DropReason`].
    pub dropped: [u64; DropReason::ALL.len()],
}

const _: () = assert!(size_of::<Heartbeat>() == 128);

/// Travels with the group's status, which is JSON text in the first `bytes` of the payload.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable, ZeroCopySend, JsonSchema)]
#[type_name("touchline/StatusHeader/1")]
#[repr(C)]
pub struct StatusHeader {
    /// When it was published.
    pub t_sent_ns: u64,
    /// Length of the text.
    pub bytes: u64,
}

/// Capacity of the status text.
pub const MAX_STATUS_BYTES: usize = 65_536;
