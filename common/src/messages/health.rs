//! Signs of life.

use super::LightCorrection;
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

/// Processes of a group that are no stages. Their numbers come after those of [`ProcessKind`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Attendant {
    /// Starts, watches and replaces the others.
    Supervisor = 4,
    /// Lets other users attach.
    Gateway = 5,
}

impl Attendant {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Supervisor, Self::Gateway];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Supervisor => "supervisor",
            Self::Gateway => "gateway",
        }
    }
}

/// The number in messages of the process, stage or not, of this name; `u32::MAX` when there is none.
pub fn process_number(name: &str) -> u32 {
    let attendant = Attendant::ALL.into_iter().find(|attendant| attendant.name() == name);
    let stage = ProcessKind::from_name(name).map(|kind| kind as u32);
    stage.or(attendant.map(|attendant| attendant as u32)).unwrap_or(u32::MAX)
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
    /// Of the gateway: commands for a team that the user may not command.
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

/// Published by every process about ten times a second and at every change of state. Counters
/// start at zero with the process.
///
/// The supervisor's tells of the newest event, so whoever only follows `health` knows when there is
/// something to be read on `events`; what it takes and gives is nothing. The gateway takes `world` and
/// gives it to its clients: once to each of them. The classifier's tells how it corrects the light.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, ZeroCopySend, JsonSchema)]
#[type_name("touchline/Heartbeat/5")]
#[repr(C)]
pub struct Heartbeat {
    /// When it was published.
    pub t_sent_ns: u64,
    /// Operating system's number of the process.
    pub pid: u32,
    /// A [`ProcessKind`] or [`Attendant`] number.
    pub process: u32,
    /// A [`ProcessState`] number.
    pub state: u32,
    /// Of the gateway: programs that are attached. Of others 0.
    pub clients: u32,
    /// Newest frame number taken in; `u64::MAX` before the first.
    pub seq_in: u64,
    /// Newest frame number given out; `u64::MAX` before the first.
    pub seq_out: u64,
    /// Inputs taken.
    pub frames_in: u64,
    /// Outputs given.
    pub frames_out: u64,
    /// Frame numbers that never reached this process (gaps in its input); of the gateway, outputs that
    /// did not reach a client because it was too slow.
    pub frames_missed: u64,
    /// Inputs not worked on, by [`DropReason`]; of the gateway, what clients have sent.
    pub dropped: [u64; DropReason::ALL.len()],
    /// Of the supervisor: events in the group so far, the number of the newest. Of others 0, as are
    /// the following.
    pub events: u64,
    /// When the newest event happened, nanoseconds since 1970.
    pub t_event_wall_ns: u64,
    /// What it was, an [`EventKind`](super::EventKind) number.
    pub event_kind: u32,
    /// Whom it concerns, a [`ProcessKind`] or [`Attendant`] number.
    pub event_process: u32,
    /// Of the classifier: how it corrects the light of the frame it worked on last. Before its first frame,
    /// and of others, nothing is corrected.
    pub light: LightCorrection,
}

const _: () = assert!(size_of::<Heartbeat>() == 192);

impl Heartbeat {
    /// That of a process, of this number in messages, which has done nothing yet.
    pub fn new(process: u32, state: ProcessState) -> Self {
        Self {
            pid: std::process::id(),
            process,
            state: state as u32,
            seq_in: u64::MAX,
            seq_out: u64::MAX,
            light: LightCorrection::NONE,
            ..Self::zeroed()
        }
    }
}

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
