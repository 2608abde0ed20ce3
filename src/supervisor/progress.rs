//! How far each stage has come, read off the topics themselves rather than asked of the stages.

use super::drops::Dropped;
use super::pages::Pages;
use super::sys::{self, Call};
use common::bus::{Bus, BusError, Received, Subscriber};
use common::clock::monotonic_ns;
use common::config::Config;
use common::instance::Instance;
use common::messages::{
    Attendant, DetectionFrame, FrameHeader, Heartbeat, ProcessKind, ProcessState, Run, RunsHeader,
    WorldFrame,
};
use common::topics;
use grabber::camera::LastFrame;
use std::collections::VecDeque;
use std::io;
use std::time::{Duration, Instant};

/// Between two attempts to connect, at first; doubles.
const RECONNECT: Duration = Duration::from_millis(100);
/// Longest pause between two attempts.
const RECONNECT_MAX: Duration = Duration::from_secs(5);

/// Sees how far the stages come: by the topics, as long as it is connected to them, and by the pages in
/// which the stages write it down themselves, which takes neither descriptors nor memory.
pub struct Progress {
    instance: Instance,
    frame_bytes: usize,
    fps: f64,
    topics: Option<Topics>,
    pages: Pages,
    /// How far the stages had come by their pages at the last look: by now the topics must have
    /// shown as much.
    paged: [Option<u64>; ProcessKind::ALL.len()],
    seen: [Option<u64>; ProcessKind::ALL.len()],
    /// Connected since the last look: what was published before is in the pages only.
    is_fresh: bool,
    last_frame: Option<LastFrame>,
    /// Reused allocation.
    outputs: Vec<Output>,
    connect_after: Instant,
    pause: Duration,
}

/// Connected to the topics: always has the newest message of each, also when the writer is dead.
struct Topics {
    frames: Subscriber<u8, FrameHeader>,
    runs: Subscriber<Run, RunsHeader>,
    detections: Subscriber<DetectionFrame, ()>,
    world: Subscriber<WorldFrame, ()>,
    health: Subscriber<Heartbeat, ()>,
    /// In shared memory: a frame that has stalled two processes in a row is some ten frames old by
    /// then.
    recent_frames: VecDeque<Received<u8, FrameHeader>>,
    kept_frames: usize,
    /// The frame of each stage's newest output.
    last_of: [Option<FrameHeader>; ProcessKind::ALL.len()],
    // Last, so that it outlives the ports.
    _bus: Bus,
}

/// Something a stage has published.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Output {
    /// When, but not later than it was seen: others can publish too, and claim what they like.
    pub t_sent_ns: u64,
    /// The stage.
    pub kind: ProcessKind,
    /// The frame's number.
    pub seq: u64,
}

/// A sign of life.
#[derive(Debug, Clone, Copy)]
pub enum Beat {
    /// Of a stage's process.
    Stage(Sign),
    /// Of the gateway.
    Gateway {
        /// Who sent it.
        pid: u32,
    },
}

/// What a heartbeat tells the rules.
#[derive(Debug, Clone, Copy)]
pub struct Sign {
    /// Who sent it.
    pub pid: u32,
    /// Its stage.
    pub kind: ProcessKind,
    /// Where it is in its life.
    pub state: ProcessState,
    /// Inputs it has dropped so far, by reason.
    pub dropped: Dropped,
}

impl Progress {
    /// Connects.
    pub fn new(instance: &Instance, config: &Config) -> Result<Self, BusError> {
        let mut progress = Self::unconnected(instance, config);
        if let Some(error) = sys::fault(Call::ConnectToTopics) {
            return Err(failed(error));
        }
        progress.topics = Some(Topics::connect(instance, progress.frame_bytes)?);
        Ok(progress)
    }

    /// Without a connection, for a supervisor that takes over a group and has no memory left for it.
    pub fn unconnected(instance: &Instance, config: &Config) -> Self {
        Self {
            instance: instance.clone(),
            frame_bytes: config.camera.frame_bytes(),
            fps: config.camera.fps,
            topics: None,
            pages: Pages::new(instance),
            paged: Default::default(),
            seen: Default::default(),
            is_fresh: true,
            last_frame: None,
            outputs: Vec::new(),
            connect_after: Instant::now() + RECONNECT,
            pause: RECONNECT,
        }
    }

    /// Whether it is connected to the topics. If not, it sees outputs by the pages and no heartbeats.
    pub fn is_connected(&self) -> bool {
        self.topics.is_some()
    }

    /// The pages it shares with the stages.
    pub fn pages(&mut self) -> &mut Pages {
        &mut self.pages
    }

    /// Connects if it is not connected and it is time to try; `None` if there was nothing to do.
    pub fn connect(&mut self) -> Option<io::Result<()>> {
        if self.topics.is_some() || Instant::now() < self.connect_after {
            return None;
        }
        self.connect_after = Instant::now() + self.pause;
        self.pause = (self.pause * 2).min(RECONNECT_MAX);
        let connected = match sys::fault(Call::ConnectToTopics) {
            Some(error) => Err(error),
            None => Topics::connect(&self.instance, self.frame_bytes).map_err(io::Error::other),
        };
        Some(connected.map(|topics| {
            self.topics = Some(topics);
            self.paged = ProcessKind::ALL.map(|kind| self.pages.newest(kind));
            self.is_fresh = true;
        }))
    }

    /// Takes in what is new. After an error it is unconnected.
    fn receive(&mut self) -> Result<(), BusError> {
        self.outputs.clear();
        let Some(topics) = &mut self.topics else { return Ok(()) };
        let received = match sys::fault(Call::ReceiveOutputs) {
            Some(error) => Err(failed(error)),
            None => topics.outputs(self.fps, &mut self.outputs),
        };
        if received.is_ok() && !topics.misses_a_writer() {
            if let Some(frame) = topics.last_of[ProcessKind::Grabber as usize] {
                let FrameHeader { seq, t_capture_ns, .. } = frame;
                self.last_frame = Some(LastFrame { seq, t_capture_ns });
            }
            return Ok(());
        }
        self.disconnect();
        received.and(Err(failed("a process's messages cannot be seen")))
    }

    fn disconnect(&mut self) {
        if self.topics.take().is_some() {
            self.connect_after = Instant::now() + self.pause;
        }
    }

    /// What is new, in the order in which it was sent: each frame, and the newest output of the other
    /// stages. What the topics should have shown, but have not, is taken from the pages; the error says
    /// that this may be so from now on.
    pub fn outputs(&mut self) -> (&[Output], Result<(), BusError>) {
        let mut outcome = self.receive();
        let now_ns = monotonic_ns();
        for &Output { kind, seq, .. } in &self.outputs {
            let seen = &mut self.seen[kind as usize];
            *seen = (*seen).max(Some(seq));
        }
        let is_connected = self.topics.is_some();
        for kind in ProcessKind::ALL {
            let seen = &mut self.seen[kind as usize];
            if let Some(seq) = self.paged[kind as usize].filter(|&seq| Some(seq) > *seen) {
                *seen = Some(seq);
                self.outputs.push(Output { t_sent_ns: now_ns, kind, seq });
                if is_connected && !self.is_fresh {
                    outcome = Err(failed("a stage's output cannot be seen"));
                }
            }
            self.paged[kind as usize] = self.pages.newest(kind);
        }
        if outcome.is_err() {
            self.disconnect();
        } else if is_connected && !self.is_fresh {
            self.pause = RECONNECT;
        }
        self.is_fresh = false;
        self.outputs.sort_unstable();
        (&self.outputs, outcome)
    }

    /// Calls `report` with each heartbeat since the last call.
    pub fn heartbeats(&mut self, mut report: impl FnMut(Beat)) -> Result<(), BusError> {
        let Some(topics) = &self.topics else { return Ok(()) };
        let received = match sys::fault(Call::ReceiveHeartbeats) {
            Some(error) => Err(failed(error)),
            None => topics.heartbeats(&mut report),
        };
        if received.is_err() {
            self.disconnect();
        }
        received
    }

    /// The newest frame seen, from which a new grabber continues the numbers.
    pub fn last_frame(&self) -> Option<LastFrame> {
        self.last_frame
    }

    /// The first frame after this number, if it is still at hand.
    pub fn first_frame_after(&self, seq: u64) -> Option<&Received<u8, FrameHeader>> {
        let recent_frames = &self.topics.as_ref()?.recent_frames;
        let oldest = recent_frames.front()?.header().seq;
        if oldest > seq + 1 {
            return None;
        }
        recent_frames.iter().find(|frame| frame.header().seq > seq)
    }
}

impl Topics {
    fn connect(instance: &Instance, frame_bytes: usize) -> Result<Self, BusError> {
        let bus = Bus::join_as_reader(instance, "supervisor")?;
        let frames = topics::frames(frame_bytes);
        let kept_frames = topics::frames_of_evidence(frames.buffer);
        Ok(Self {
            frames: bus.subscriber(&frames)?,
            runs: bus.newest_only(&topics::RUNS)?,
            detections: bus.newest_only(&topics::DETECTIONS)?,
            world: bus.newest_only(&topics::WORLD)?,
            health: bus.subscriber(&topics::HEALTH)?,
            recent_frames: VecDeque::with_capacity(kept_frames),
            kept_frames,
            last_of: [None; ProcessKind::ALL.len()],
            _bus: bus,
        })
    }

    fn misses_a_writer(&self) -> bool {
        self.frames.misses_a_writer()
            || self.runs.misses_a_writer()
            || self.detections.misses_a_writer()
            || self.world.misses_a_writer()
            || self.health.misses_a_writer()
    }

    /// Takes in what is new on the topics. A number that the stage cannot have reached says nothing: no frame
    /// comes sooner than its camera allows, and no result is of a frame that does not exist.
    fn outputs(&mut self, fps: f64, outputs: &mut Vec<Output>) -> Result<(), BusError> {
        // Against the stream, so that the frame of every result has been seen in the end.
        let mut results: [Option<(FrameHeader, u64)>; ProcessKind::ALL.len()] = Default::default();
        while let Some(received) = self.world.receive()? {
            if let Some(world) = received.message() {
                results[ProcessKind::Filter as usize] = Some((world.frame, world.t_sent_ns));
            }
        }
        while let Some(received) = self.detections.receive()? {
            if let Some(it) = received.message() {
                results[ProcessKind::Tracker as usize] = Some((it.frame, it.t_sent_ns));
            }
        }
        while let Some(received) = self.runs.receive()? {
            let header = received.header();
            results[ProcessKind::Classifier as usize] = Some((header.frame, header.t_sent_ns));
        }
        let now_ns = monotonic_ns();
        let Self { frames, last_of, recent_frames, .. } = self;
        let mut output = |kind: ProcessKind, frame: &FrameHeader, t_sent_ns: u64| {
            let last = &mut last_of[kind as usize];
            let follows = frame.follows(last.as_ref(), now_ns, fps);
            if follows {
                *last = Some(*frame);
                let t_sent_ns = t_sent_ns.min(now_ns);
                outputs.push(Output { t_sent_ns, kind, seq: frame.seq });
            }
            follows
        };
        while let Some(frame) = frames.receive()? {
            let header = frame.header();
            if output(ProcessKind::Grabber, header, header.t_sent_ns) {
                if recent_frames.len() == self.kept_frames {
                    recent_frames.pop_front();
                }
                recent_frames.push_back(frame);
            }
        }
        let newest = recent_frames.back().map(|frame| frame.header().seq);
        for (kind, result) in ProcessKind::ALL.into_iter().zip(results) {
            // Before the first frame is seen nothing is known of frames.
            if let Some((frame, t_sent_ns)) = result
                && newest.is_none_or(|newest| frame.seq <= newest)
            {
                output(kind, &frame, t_sent_ns);
            }
        }
        Ok(())
    }

    fn heartbeats(&self, report: &mut impl FnMut(Beat)) -> Result<(), BusError> {
        while let Some(received) = self.health.receive()? {
            let Some(beat) = received.message() else { continue };
            let kind = ProcessKind::from_number(beat.process);
            let state = ProcessState::from_number(beat.state);
            if let (Some(kind), Some(state)) = (kind, state) {
                report(Beat::Stage(Sign { pid: beat.pid, kind, state, dropped: beat.dropped }));
            } else if beat.process == Attendant::Gateway as u32 {
                report(Beat::Gateway { pid: beat.pid });
            }
        }
        Ok(())
    }
}

fn failed(reason: impl ToString) -> BusError {
    BusError::Ipc { topic: "all", action: "look at the stages", reason: reason.to_string() }
}
