//! The topic table: name, payload, writer, readers, and how many messages are kept per reader.
//!
//! This table is the architecture. On every topic a full reader buffer loses its oldest message, and
//! back-pressure discards instead of waiting: no reader can hold up a writer.

use crate::stages::LANE_MARK;
use crate::*;
use crate::{Header, Message};
use iceoryx2::prelude::ZeroCopySend;
use std::fmt;

/// One topic. A message is a slice of `Element`s with a `Header` beside it. Where the element is a
/// whole message, the slice has one element.
#[derive(Debug)]
pub struct Topic<Element, Header = ()> {
    /// Service name within the instance.
    pub name: TopicName,
    /// The processes that publish.
    pub writer: &'static str,
    /// The processes that subscribe, extra consumers aside.
    pub readers: &'static str,
    /// Unread messages kept for each subscriber.
    pub buffer: usize,
    /// Older messages that a late subscriber receives with the next one published, so that a stage
    /// started from scratch finds what was published in its absence. They live as long as their writer.
    pub history: usize,
    /// Messages a subscriber may hold at the same time. Each reserves address space in shared memory,
    /// but takes memory only while it is held.
    pub borrowed: usize,
    /// Messages a writer may be filling at the same time.
    pub loaned: usize,
    /// Bytes an ordinary picture fills in a message. The writer allocates this much of every slot it
    /// uses at the start, so that no other program can take the last shared memory during a match.
    pub ordinary_bytes: usize,
    /// Publishers at the same time: the active process, its spare, dead predecessors that are not
    /// cleaned up yet, and some stray programs.
    pub publishers: usize,
    /// Subscribers at the same time.
    pub subscribers: usize,
    /// Every program may publish. On all other topics only messages from processes of the group are
    /// accepted (the roster of `touchline-client`).
    pub is_open: bool,
    /// The writers also notify the iceoryx2 event of the same name, for readers in other languages,
    /// which cannot sleep on our event count (`eventcount` in `touchline-client`).
    pub notifies: bool,
    /// Sort key of a message when several writers have published, as a stage's dead process and its
    /// successor do. Always 0 on topics read in order of arrival.
    pub seq: fn(&[Element], &Header) -> u64,
    /// Capture time of the frame the message is about; 0 on topics whose messages are not numbered.
    pub t_capture_ns: fn(&[Element], &Header) -> u64,
}

/// The name of a topic: in each lane there is one of `frames`, `runs` and `detections`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TopicName {
    base: &'static str,
    lane: u8,
}

impl TopicName {
    /// Its name without the lane.
    pub fn base(self) -> &'static str {
        self.base
    }
}

impl From<&'static str> for TopicName {
    /// In lane 0.
    fn from(base: &'static str) -> Self {
        Self { base, lane: 0 }
    }
}

/// `runs` in lane 0, `runs@1` in lane 1.
impl fmt::Display for TopicName {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self.lane {
            0 => f.pad(self.base),
            lane => f.pad(&format!("{}{LANE_MARK}{lane}", self.base)),
        }
    }
}

impl<Element, Header> Topic<Element, Header> {
    /// The same topic of another lane.
    pub fn in_lane(self, lane: u8) -> Self {
        Self { name: TopicName { lane, ..self.name }, ..self }
    }
}

/// The names by which iceoryx2 distinguishes types.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TypeNames {
    /// Type name of an element.
    pub element: &'static str,
    /// Type name of the header; `()` for none.
    pub header: &'static str,
}

impl<E: Message, H: Header> Topic<E, H> {
    /// The type names of its messages.
    #[allow(unsafe_code)]
    pub fn type_names(&self) -> TypeNames {
        // SAFETY: the function only returns a text. Its contract is that the same name means the same
        // layout everywhere, which the versions in the names guarantee.
        unsafe {
            TypeNames {
                element: <E as ZeroCopySend>::type_name(),
                header: <H as ZeroCopySend>::type_name(),
            }
        }
    }
}

const fn topic<Element, Header>(
    name: &'static str,
    writer: &'static str,
    readers: &'static str,
    buffer: usize,
) -> Topic<Element, Header> {
    Topic {
        name: TopicName { base: name, lane: 0 },
        writer,
        readers,
        buffer,
        history: 0,
        borrowed: 4,
        loaned: 2,
        ordinary_bytes: 48 << 10,
        publishers: 8,
        subscribers: 12,
        is_open: false,
        notifies: false,
        seq: |_, _| 0,
        t_capture_ns: |_, _| 0,
    }
}

/// A stage that is far behind at a hand-over sorts a whole buffer (64) and holds a few messages
/// besides.
const WHOLE_BUFFER: usize = 64 + 4;

/// A topic whose messages a stage processes one by one, in order.
const fn work<Element, Header>(
    name: &'static str,
    writer: &'static str,
    readers: &'static str,
    seq: fn(&[Element], &Header) -> u64,
    t_capture_ns: fn(&[Element], &Header) -> u64,
) -> Topic<Element, Header> {
    let base = topic(name, writer, readers, 64);
    Topic { history: 64, borrowed: WHOLE_BUFFER, seq, t_capture_ns, ..base }
}

/// Shared memory for the newest frames kept for readers …
const KEPT_FRAMES_BYTES: usize = 128 << 20;
/// … but at least this many frames are kept: the time a stage may be away while it is replaced, at 80
/// frames a second.
const MIN_KEPT_FRAMES: usize = 16;

/// [`FRAMES`] for frames of this size: the larger the frame, the fewer are kept.
pub fn frames(frame_bytes: usize) -> Topic<u8, FrameHeader> {
    let kept = (KEPT_FRAMES_BYTES / frame_bytes.max(1)).clamp(MIN_KEPT_FRAMES, FRAMES.buffer);
    Topic { buffer: kept, history: kept, borrowed: frames_of_evidence(kept) + kept + 4, ..FRAMES }
}

/// Number of kept frames the supervisor holds as evidence, in case one of them kills a stage. They cost
/// no memory, since they are kept anyway.
pub const fn frames_of_evidence(kept: usize) -> usize {
    kept / 2
}

/// Raw frames; the payload is the pixels, `stride` bytes a row. A program that does not know the frame
/// size asks for this buffer size and gets what [`frames`] leaves of it.
pub const FRAMES: Topic<u8, FrameHeader> = Topic {
    borrowed: frames_of_evidence(64) + WHOLE_BUFFER,
    // A camera driver fills several at the same time.
    loaned: 16,
    ordinary_bytes: usize::MAX,
    ..work(
        "frames",
        "grabber",
        "classifier, tracker",
        |_, header| header.seq,
        |_, header| header.t_capture_ns,
    )
};
/// Runs of classified pixels.
pub const RUNS: Topic<Run, RunsHeader> = work(
    "runs",
    "classifier",
    "tracker",
    |_, header| header.frame.seq,
    |_, header| header.frame.t_capture_ns,
);
/// Regions, robots and balls of one frame.
pub const DETECTIONS: Topic<DetectionFrame> = work(
    "detections",
    "tracker",
    "filter, monitor, publisher",
    |elements, _| elements.first().map_or(0, |detections| detections.frame.seq),
    |elements, _| elements.first().map_or(0, |detections| detections.frame.t_capture_ns),
);
/// Filtered robots and ball.
pub const WORLD: Topic<WorldFrame> = Topic {
    borrowed: WHOLE_BUFFER,
    notifies: true,
    // Strategies and loggers attach here; a dead one keeps its slot until the supervisor clears it.
    subscribers: 24,
    seq: |elements, _| elements.first().map_or(0, |world| world.frame.seq),
    t_capture_ns: |elements, _| elements.first().map_or(0, |world| world.frame.t_capture_ns),
    ..topic("world", "filter", "tracker, monitor, gateway, publisher, strategies", 64)
};
/// Wheel speeds that strategies have sent to the robots.
pub const COMMANDS: Topic<Commands> = Topic {
    publishers: 8,
    is_open: true,
    ..topic(
        "commands",
        "strategies, gateway, publisher, synthetic match",
        "filter, synthetic match",
        64,
    )
};
/// Heartbeats of all processes.
pub const HEALTH: Topic<Heartbeat> =
    Topic { publishers: 24, ..topic("health", "every process", "supervisor, monitor", 64) };
/// True poses from the synthetic match.
pub const TRUTH: Topic<TruthFrame> = topic("truth", "grabber (synthetic match)", "monitor", 64);
/// State of the grabber's real camera.
pub const CAMERA: Topic<CameraReport> = topic("camera", "grabber (real camera)", "monitor", 16);
/// State of the publisher.
pub const PUBLISHER: Topic<PublisherReport> = topic("publisher", "publisher", "monitor", 16);
/// The classifier's correction of the light.
pub const LIGHT: Topic<LightReport> = topic("light", "classifier", "monitor", 16);
/// The gateway's report.
pub const GATEWAY: Topic<GatewayReport> = topic("gateway", "gateway", "monitor", 16);
/// Observations and actions of the supervisor. Late readers get the last events too.
pub const EVENTS: Topic<GroupEvent> =
    Topic { history: 16, ..topic("events", "monitor", "loggers", 64) };
/// The report of the running group, as JSON text.
pub const STATUS: Topic<u8, StatusHeader> = topic("status", "monitor", "touchline status", 1);

/// Handles any topic, whatever its types.
pub trait Visitor {
    /// Handles one topic.
    fn visit<E, H>(&mut self, topic: &'static Topic<E, H>)
    where
        E: Message + Described,
        H: Header + Described;
}

/// Calls the visitor with every topic.
pub fn visit_all(visitor: &mut impl Visitor) {
    visitor.visit(&FRAMES);
    visitor.visit(&RUNS);
    visitor.visit(&DETECTIONS);
    visitor.visit(&WORLD);
    visitor.visit(&COMMANDS);
    visitor.visit(&TRUTH);
    visitor.visit(&CAMERA);
    visitor.visit(&PUBLISHER);
    visitor.visit(&HEALTH);
    visitor.visit(&LIGHT);
    visitor.visit(&GATEWAY);
    visitor.visit(&EVENTS);
    visitor.visit(&STATUS);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lanes_have_topics_of_their_own() {
        assert_eq!(RUNS.name.to_string(), "runs");
        assert_eq!(RUNS.in_lane(0).name, RUNS.name);
        assert_eq!(frames(1).in_lane(2).name.to_string(), "frames@2");
    }

    #[test]
    fn fewer_large_frames_are_kept() {
        let small = frames(640 * 480);
        assert_eq!((small.buffer, small.borrowed), (FRAMES.buffer, FRAMES.borrowed));
        let large = frames(2448 * 2048);
        assert!((16..32).contains(&large.buffer) && large.history == large.buffer);
        assert_eq!(frames(16_384 * 16_384).buffer, MIN_KEPT_FRAMES);
        assert_eq!(frames(0).buffer, FRAMES.buffer);
    }
}
