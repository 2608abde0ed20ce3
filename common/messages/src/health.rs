//! Heartbeats: state and counters of every process.

use super::FrameFault;
use super::json;
use bytemuck::{Pod, Zeroable};
use iceoryx2::prelude::ZeroCopySend;
use serde::Serialize;

/// The stages of a group.
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
    /// All stages, in the order in which a frame passes them.
    pub const ALL: [Self; 4] = [Self::Grabber, Self::Classifier, Self::Tracker, Self::Filter];

    /// The stage with this number in a message, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.get(number as usize).copied()
    }

    /// The stage of this [name](Self::name), if there is one.
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

/// Processes of a group that are not stages. Their numbers follow those of [`ProcessKind`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Attendant {
    /// Starts, watches and replaces the others.
    Supervisor = 4,
    /// Lets other users attach.
    Gateway = 5,
    /// Sends poses in the leagues' own protocols.
    Publisher = 6,
    /// Serves the page in a browser.
    Console = 7,
}

impl Attendant {
    /// All attendants.
    pub const ALL: [Self; 4] = [Self::Supervisor, Self::Gateway, Self::Publisher, Self::Console];

    /// Process name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Supervisor => "supervisor",
            Self::Gateway => "gateway",
            Self::Publisher => "publisher",
            Self::Console => "console",
        }
    }
}

/// Number in messages of the process with this name, stage or attendant; `u32::MAX` when there is none.
pub fn process_number(name: &str) -> u32 {
    let attendant = Attendant::ALL.into_iter().find(|attendant| attendant.name() == name);
    let stage = ProcessKind::from_name(name).map(|kind| kind as u32);
    stage.or(attendant.map(|attendant| attendant as u32)).unwrap_or(u32::MAX)
}

/// State of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum ProcessState {
    /// Connected to its topics but reading nothing: ready to take over.
    Spare = 1,
    /// Working.
    Active = 2,
    /// Has finished a bounded run, and waits to be ended.
    Finished = 3,
    /// Working without input: its camera is away, and it keeps trying.
    Waiting = 4,
}

impl ProcessState {
    /// The state with this number in a message, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        [Self::Spare, Self::Active, Self::Finished, Self::Waiting]
            .into_iter()
            .find(|&state| state as u32 == number)
    }

    /// Name in reports and JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Spare => "spare",
            Self::Active => "active",
            Self::Finished => "finished",
            Self::Waiting => "waiting",
        }
    }
}

/// Reason why a stage dropped an input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(usize)]
pub enum DropReason {
    /// Its number is not above the last processed one: a duplicate, or out of order.
    OutOfOrder = 0,
    /// A number or time in its header is impossible.
    BadHeader = 1,
    /// Not the configured size, or fewer bytes than the header says.
    WrongSize = 2,
    /// Pixel format or Bayer order unknown.
    WrongFormat = 3,
    /// The grabber could not keep up with the camera, or had no memory to loan.
    Late = 4,
    /// The output could not be published.
    NotPublished = 5,
    /// It killed two processes in a row.
    Poisonous = 6,
    /// The camera's picture arrived in part or damaged.
    Incomplete = 7,
    /// Gateway only: commands for a team that the user may not command.
    NotPermitted = 8,
}

impl DropReason {
    /// All reasons, in the order of [`Heartbeat::dropped`].
    pub const ALL: [Self; 9] = [
        Self::OutOfOrder,
        Self::BadHeader,
        Self::WrongSize,
        Self::WrongFormat,
        Self::Late,
        Self::NotPublished,
        Self::Poisonous,
        Self::Incomplete,
        Self::NotPermitted,
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
            Self::NotPermitted => "not_permitted",
        }
    }
}

/// Published by every process about ten times a second and at every change of state. Counters start at
/// zero with the process.
///
/// The supervisor's frame counters are 0. The gateway's input is `world`, and each copy sent to a client
/// counts as one output; the publisher's is `world` or `detections`, and each packet counts.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/Heartbeat/6")]
#[repr(C)]
pub struct Heartbeat {
    /// Time of publication.
    pub t_sent_ns: u64,
    /// Process id.
    pub pid: u32,
    /// A [`ProcessKind`] or [`Attendant`] number.
    #[serde(serialize_with = "json::process")]
    pub process: u32,
    /// A [`ProcessState`] number.
    #[serde(serialize_with = "json::process_state")]
    pub state: u32,
    /// [Revision](super::Revision) of the configuration it runs with.
    pub revision: u32,
    /// Newest frame number received; `u64::MAX` before the first.
    pub seq_in: u64,
    /// Newest frame number published; `u64::MAX` before the first.
    pub seq_out: u64,
    /// Inputs received.
    pub frames_in: u64,
    /// Outputs published.
    pub frames_out: u64,
    /// Frame numbers that never reached this process (gaps in its input). Gateway: outputs that did not
    /// reach a client because it was too slow. Publisher: packets that were refused.
    pub frames_missed: u64,
    /// Inputs dropped, by [`DropReason`]. Gateway and publisher: dropped messages of clients.
    pub dropped: [u64; DropReason::ALL.len()],
}

const _: () = assert!(size_of::<Heartbeat>() == 136);

impl Heartbeat {
    /// Heartbeat of a process, given by its number in messages, that has done nothing yet.
    pub fn new(process: u32, state: ProcessState) -> Self {
        Self {
            pid: std::process::id(),
            process,
            state: state as u32,
            seq_in: u64::MAX,
            seq_out: u64::MAX,
            ..Self::zeroed()
        }
    }
}

/// Header of the group's status, which is JSON text in the first `bytes` of the payload.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable, ZeroCopySend)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[type_name("touchline/StatusHeader/1")]
#[repr(C)]
pub struct StatusHeader {
    /// Time of publication.
    pub t_sent_ns: u64,
    /// Length of the text.
    pub bytes: u64,
}

/// Capacity of the status text.
pub const MAX_STATUS_BYTES: usize = 65_536;

impl From<&FrameFault> for DropReason {
    fn from(fault: &FrameFault) -> Self {
        match fault {
            FrameFault::PixelFormat(_) | FrameFault::BayerOrder(_) => Self::WrongFormat,
            FrameFault::Size { .. } | FrameFault::Truncated { .. } => Self::WrongSize,
        }
    }
}
