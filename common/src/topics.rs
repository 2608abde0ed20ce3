//! The topics: who writes them, who reads them, and how much is kept for whom.
//!
//! This table is the architecture. All topics overwrite the oldest unread message when a reader's
//! buffer is full, and discard rather than wait: no reader can hold up a writer.

use crate::bus::{Header, Message};
use crate::messages::*;
use iceoryx2::prelude::ZeroCopySend;
use schemars::JsonSchema;

/// One topic. A message on it is a slice of `Element`s with a `Header` beside it; where the element
/// is a whole message, the slice has one.
#[derive(Debug)]
pub struct Topic<Element, Header = ()> {
    /// Service name within the instance.
    pub name: &'static str,
    /// Who publishes.
    pub writer: &'static str,
    /// Who subscribes, extra consumers aside.
    pub readers: &'static str,
    /// Unread messages kept for each subscriber.
    pub buffer: usize,
    /// Messages that a reader which comes later still gets, when the next one is published: a stage
    /// that had to be started from scratch finds what came while it was not there. They live as
    /// long as their writer.
    pub history: usize,
    /// Messages a subscriber may hold at the same time. It takes address space in shared memory for
    /// each, but memory only for those it does hold.
    pub borrowed: usize,
    /// Messages a writer may be filling at the same time.
    pub loaned: usize,
    /// Bytes of a message that ordinary pictures fill: so much of each place that gets used is kept
    /// ready by its writer, lest somebody else takes the last of the shared memory in a match.
    pub ordinary_bytes: usize,
    /// Publishers at the same time: the active process, its spare, predecessors that are dead but not yet
    /// cleaned up, and some programs that have no business there.
    pub publishers: usize,
    /// Subscribers at the same time.
    pub subscribers: usize,
    /// Whether every program may publish on it. On all other topics only processes of the group are
    /// believed ([`roster`](crate::roster)).
    pub is_open: bool,
    /// Whether its writers also notify the iceoryx2 event of the same name: for readers in other
    /// languages, which cannot sleep on our [event count](crate::eventcount).
    pub notifies: bool,
    /// The number by which messages are put in order when several writers have written: those of
    /// a stage's dead process and of its successor. Where it is always 0, as they come.
    pub seq: fn(&[Element], &Header) -> u64,
    /// Capture time of the frame that a message is about; 0 on topics whose messages have no number.
    pub t_capture_ns: fn(&[Element], &Header) -> u64,
}

/// The names by which iceoryx2 tells types apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TypeNames {
    /// Of an element.
    pub element: &'static str,
    /// Of the header; `()` for none.
    pub header: &'static str,
}

impl<E: Message, H: Header> Topic<E, H> {
    /// The type names of its messages.
    #[allow(unsafe_code)]
    pub fn type_names(&self) -> TypeNames {
        // SAFETY: the function only returns a text; what it asks for is that whoever uses the same
        // name has the same layout, which is what the versions in the names are for.
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
        name,
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

/// A reader that is far behind when a stage is handed over puts a whole buffer in order.
const WHOLE_BUFFER: usize = 64 + 4;

/// A topic that a stage works through, message by message.
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

/// The newest frames are kept for readers as far as they fit into this much memory …
const KEPT_FRAMES_BYTES: usize = 128 << 20;
/// … but never fewer than these: a stage that has to be replaced at 80 frames a second may be away
/// for so long.
const FEWEST_KEPT_FRAMES: usize = 16;

/// [`FRAMES`] in a group whose frames have so many bytes: of large frames fewer are kept.
pub fn frames(frame_bytes: usize) -> Topic<u8, FrameHeader> {
    let kept = (KEPT_FRAMES_BYTES / frame_bytes.max(1)).clamp(FEWEST_KEPT_FRAMES, FRAMES.buffer);
    Topic { buffer: kept, history: kept, borrowed: frames_of_evidence(kept) + kept + 4, ..FRAMES }
}

/// How many of the kept frames the supervisor holds in its hands, as evidence should one of them
/// kill a stage. They cost no memory, being kept anyway.
pub const fn frames_of_evidence(kept: usize) -> usize {
    kept / 2
}

/// Raw frames; the payload is the pixels, `stride` bytes a row. Programs that do not know the size
/// of the frames ask for this much, and get what [`frames`] has left of it.
pub const FRAMES: Topic<u8, FrameHeader> = Topic {
    borrowed: frames_of_evidence(64) + WHOLE_BUFFER,
    // A camera is given several to fill.
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
    "filter, monitor",
    |elements, _| elements.first().map_or(0, |detections| detections.frame.seq),
    |elements, _| elements.first().map_or(0, |detections| detections.frame.t_capture_ns),
);
/// Filtered robots and ball.
pub const WORLD: Topic<WorldFrame> = Topic {
    borrowed: WHOLE_BUFFER,
    notifies: true,
    // What people's programs attach to; those that have died keep their place until it is cleared.
    subscribers: 24,
    seq: |elements, _| elements.first().map_or(0, |world| world.frame.seq),
    t_capture_ns: |elements, _| elements.first().map_or(0, |world| world.frame.t_capture_ns),
    ..topic("world", "filter", "tracker, monitor, gateway, strategies", 64)
};
/// Wheel speeds that strategies have sent to the robots.
pub const COMMANDS: Topic<Commands> = Topic {
    publishers: 8,
    is_open: true,
    ..topic("commands", "strategies, gateway, synthetic match", "filter, synthetic match", 64)
};
/// Signs of life of every process.
pub const HEALTH: Topic<Heartbeat> =
    Topic { publishers: 24, ..topic("health", "every process", "supervisor, monitor", 64) };
/// The synthetic match's own knowledge.
pub const TRUTH: Topic<TruthFrame> = topic("truth", "grabber (synthetic match)", "monitor", 64);
/// How the grabber's real camera is.
pub const CAMERA: Topic<CameraReport> = topic("camera", "grabber (real camera)", "monitor", 16);
/// What the supervisor has noticed and done; late readers get the last events too.
pub const EVENTS: Topic<GroupEvent> =
    Topic { history: 16, ..topic("events", "monitor", "loggers", 64) };
/// The report of the running group, as JSON text.
pub const STATUS: Topic<u8, StatusHeader> = topic("status", "monitor", "touchline status", 1);

/// Does something with a topic, whatever its types.
pub trait Visitor {
    /// Is given one topic.
    fn visit<E, H>(&mut self, topic: &'static Topic<E, H>)
    where
        E: Message + JsonSchema,
        H: Header + JsonSchema;
}

/// Shows a visitor all topics.
pub fn visit_all(visitor: &mut impl Visitor) {
    visitor.visit(&FRAMES);
    visitor.visit(&RUNS);
    visitor.visit(&DETECTIONS);
    visitor.visit(&WORLD);
    visitor.visit(&COMMANDS);
    visitor.visit(&TRUTH);
    visitor.visit(&CAMERA);
    visitor.visit(&HEALTH);
    visitor.visit(&EVENTS);
    visitor.visit(&STATUS);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_large_frames_fewer_are_kept() {
        let small = frames(640 * 480);
        assert_eq!((small.buffer, small.borrowed), (FRAMES.buffer, FRAMES.borrowed));
        let large = frames(2448 * 2048);
        assert!((16..32).contains(&large.buffer) && large.history == large.buffer);
        assert_eq!(frames(16_384 * 16_384).buffer, FEWEST_KEPT_FRAMES);
        assert_eq!(frames(0).buffer, FRAMES.buffer);
    }
}
