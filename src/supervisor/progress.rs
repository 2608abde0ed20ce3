//! Progress of each stage: its newest output, read from the topics instead of asked from the stage.

use super::drops::Dropped;
use super::pages::Pages;
use super::sys::{self, Call};
use client::bus::{Bus, BusError, Received, Subscriber};
use client::clock::monotonic_ns;
use client::instance::Instance;
use config::Config;
use grabber::camera::LastFrame;
use messages::stages::{FrameId, Numbers, StageGraph, StageId, StageMap};
use messages::topics;
use messages::{
    Attendant, DetectionFrame, FrameHeader, Heartbeat, ProcessKind, ProcessState, Run, RunsHeader,
    WorldFrame,
};
use std::collections::VecDeque;
use std::io;
use std::time::{Duration, Instant};

/// First pause between two attempts to connect; doubles.
const RECONNECT: Duration = Duration::from_millis(100);
/// Longest pause between two attempts.
const RECONNECT_MAX: Duration = Duration::from_secs(5);

/// Observes the progress of the stages: through the topics while connected, and through the pages
/// in which the stages record it themselves, which takes neither descriptors nor memory.
pub struct Progress {
    instance: Instance,
    frame_bytes: usize,
    fps: f64,
    graph: StageGraph,
    topics: Option<Topics>,
    pages: Pages,
    /// Progress according to the pages at the last look: by now the topics must have shown as much.
    paged: StageMap<Option<u64>>,
    seen: StageMap<Numbers>,
    /// Connected since the last look: earlier outputs are only in the pages.
    is_fresh: bool,
    /// The newest frame of each lane.
    last_frames: Vec<Option<LastFrame>>,
    /// Reused allocation.
    outputs: Vec<Output>,
    connect_after: Instant,
    pause: Duration,
}

/// Connections to the topics: always hold the newest message of each, even if its writer is dead.
struct Topics {
    lanes: Vec<LaneTopics>,
    world: Subscriber<WorldFrame, ()>,
    health: Subscriber<Heartbeat, ()>,
    /// Frame of each stage's newest output.
    last_of: StageMap<Option<FrameHeader>>,
    // Last, so that it outlives the ports.
    _bus: Bus,
}

/// Connections to the topics of one lane.
struct LaneTopics {
    frames: Subscriber<u8, FrameHeader>,
    runs: Subscriber<Run, RunsHeader>,
    detections: Subscriber<DetectionFrame, ()>,
    /// Newest frames, held in shared memory: a frame that has stalled two processes in a row is
    /// some ten frames old by then.
    recent_frames: VecDeque<Received<u8, FrameHeader>>,
    kept_frames: usize,
}

/// An output of a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Output {
    /// Time sent, capped at the time it was seen: other programs can publish too, with any time.
    pub t_sent_ns: u64,
    /// The stage.
    pub stage: StageId,
    /// A frame that the output contains.
    pub frame: FrameId,
}

/// A heartbeat.
#[derive(Debug, Clone, Copy)]
pub enum Beat {
    /// From a stage's process.
    Stage(Sign),
    /// From an attendant.
    Attendant {
        /// Its process id.
        pid: u32,
    },
}

/// Content of a stage's heartbeat.
#[derive(Debug, Clone, Copy)]
pub struct Sign {
    /// Its process id.
    pub pid: u32,
    /// Its stage.
    pub stage: StageId,
    /// Its state.
    pub state: ProcessState,
    /// Revision of its configuration.
    pub revision: u32,
    /// Inputs it has dropped so far, by reason.
    pub dropped: Dropped,
}

impl Progress {
    /// Connects.
    pub fn new(instance: &Instance, config: &Config, graph: StageGraph) -> Result<Self, BusError> {
        let mut progress = Self::unconnected(instance, config, graph);
        if let Some(error) = sys::fault(Call::ConnectToTopics) {
            return Err(failed(error));
        }
        progress.topics = Some(Topics::connect(instance, progress.frame_bytes, graph)?);
        Ok(progress)
    }

    /// Recognises impossible frame numbers by another frame rate.
    pub fn use_fps(&mut self, fps: f64) {
        self.fps = fps;
    }

    /// Starts without a connection: for a supervisor that takes over a group and lacks the memory
    /// to connect.
    pub fn unconnected(instance: &Instance, config: &Config, graph: StageGraph) -> Self {
        Self {
            instance: instance.clone(),
            frame_bytes: config.camera.frame_bytes(),
            fps: config.camera.fps,
            graph,
            topics: None,
            pages: Pages::new(instance, graph),
            paged: StageMap::of_defaults(graph),
            seen: StageMap::of_defaults(graph),
            is_fresh: true,
            last_frames: graph.lanes().map(|_| None).collect(),
            outputs: Vec::new(),
            connect_after: Instant::now() + RECONNECT,
            pause: RECONNECT,
        }
    }

    /// Whether it is connected to the topics. Otherwise it sees outputs through the pages, and no
    /// heartbeats.
    pub fn is_connected(&self) -> bool {
        self.topics.is_some()
    }

    /// The pages shared with the stages.
    pub fn pages(&mut self) -> &mut Pages {
        &mut self.pages
    }

    /// Connects if it is unconnected and an attempt is due; otherwise returns `None`.
    pub fn connect(&mut self) -> Option<io::Result<()>> {
        if self.topics.is_some() || Instant::now() < self.connect_after {
            return None;
        }
        self.connect_after = Instant::now() + self.pause;
        self.pause = (self.pause * 2).min(RECONNECT_MAX);
        let connected = match sys::fault(Call::ConnectToTopics) {
            Some(error) => Err(error),
            None => Topics::connect(&self.instance, self.frame_bytes, self.graph)
                .map_err(io::Error::other),
        };
        Some(connected.map(|topics| {
            self.topics = Some(topics);
            self.paged = StageMap::new(self.graph, |stage| self.pages.newest(stage));
            self.is_fresh = true;
        }))
    }

    /// Reads new outputs from the topics. After an error it is unconnected.
    fn receive(&mut self) -> Result<(), BusError> {
        self.outputs.clear();
        let Some(topics) = &mut self.topics else { return Ok(()) };
        let received = match sys::fault(Call::ReceiveOutputs) {
            Some(error) => Err(failed(error)),
            None => topics.outputs(self.fps, &mut self.outputs),
        };
        if received.is_ok() && !topics.misses_a_writer() {
            for (lane, last) in self.graph.lanes().zip(&mut self.last_frames) {
                let frame = topics.last_of[StageId::new(ProcessKind::Grabber, lane)];
                if let Some(FrameHeader { seq, t_capture_ns, .. }) = frame {
                    *last = Some(LastFrame { seq, t_capture_ns });
                }
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

    /// New outputs, ordered by time sent: every frame, and the newest output of each other stage.
    /// Outputs that the topics missed are taken from the pages; then an error says that outputs may
    /// be missed from now on.
    pub fn outputs(&mut self) -> (&[Output], Result<(), BusError>) {
        let mut outcome = self.receive();
        let now_ns = monotonic_ns();
        for &Output { stage, frame, .. } in &self.outputs {
            self.seen[stage].raise(frame);
        }
        let is_connected = self.topics.is_some();
        for stage in self.graph.stages() {
            let frame = self.paged[stage].map(|seq| FrameId { lane: stage.lane(), seq });
            if let Some(frame) = frame
                && self.seen[stage].raise(frame)
            {
                self.outputs.push(Output { t_sent_ns: now_ns, stage, frame });
                if is_connected && !self.is_fresh {
                    outcome = Err(failed("a stage's output cannot be seen"));
                }
            }
            self.paged[stage] = self.pages.newest(stage);
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

    /// The newest frame seen in a lane; a new grabber continues its numbers.
    pub fn last_frame(&self, lane: u8) -> Option<LastFrame> {
        *self.last_frames.get(usize::from(lane))?
    }

    /// The first frame of a lane after this one, if it is still kept.
    pub fn first_frame_after(&self, frame: FrameId) -> Option<&Received<u8, FrameHeader>> {
        let lane = self.topics.as_ref()?.lanes.get(usize::from(frame.lane))?;
        let oldest = lane.recent_frames.front()?.header().seq;
        if oldest > frame.seq + 1 {
            return None;
        }
        lane.recent_frames.iter().find(|recent| recent.header().seq > frame.seq)
    }
}

impl LaneTopics {
    fn connect(bus: &Bus, frame_bytes: usize, lane: u8) -> Result<Self, BusError> {
        let frames = topics::frames(frame_bytes).in_lane(lane);
        let kept_frames = topics::frames_of_evidence(frames.buffer);
        Ok(Self {
            frames: bus.subscriber(&frames)?,
            runs: bus.newest_only(&topics::RUNS.in_lane(lane))?,
            detections: bus.newest_only(&topics::DETECTIONS.in_lane(lane))?,
            recent_frames: VecDeque::with_capacity(kept_frames),
            kept_frames,
        })
    }

    fn misses_a_writer(&self) -> bool {
        self.frames.misses_a_writer()
            || self.runs.misses_a_writer()
            || self.detections.misses_a_writer()
    }
}

/// The frame of a result, and when the result was sent.
type Sent = (FrameHeader, u64);

impl Topics {
    fn connect(
        instance: &Instance,
        frame_bytes: usize,
        graph: StageGraph,
    ) -> Result<Self, BusError> {
        let bus = Bus::join_as_reader(instance, "supervisor")?;
        let lanes = graph.lanes().map(|lane| LaneTopics::connect(&bus, frame_bytes, lane));
        Ok(Self {
            lanes: lanes.collect::<Result<_, _>>()?,
            world: bus.newest_only(&topics::WORLD)?,
            health: bus.subscriber(&topics::HEALTH)?,
            last_of: StageMap::of_defaults(graph),
            _bus: bus,
        })
    }

    fn misses_a_writer(&self) -> bool {
        self.lanes.iter().any(LaneTopics::misses_a_writer)
            || self.world.misses_a_writer()
            || self.health.misses_a_writer()
    }

    /// Reads new outputs. Ignores impossible frame numbers: no frame comes sooner than its camera
    /// allows, and no result is of a frame that does not exist.
    fn outputs(&mut self, fps: f64, outputs: &mut Vec<Output>) -> Result<(), BusError> {
        let Self { lanes, world, last_of, .. } = self;
        // From the last topic to the first, so that the frame of every result has been seen at the
        // end.
        let mut filtered: Option<Sent> = None;
        while let Some(received) = world.receive()? {
            filtered = received.message().map(|it| (it.frame, it.t_sent_ns)).or(filtered);
        }
        for (number, lane) in (0..).zip(lanes) {
            let mut tracked: Option<Sent> = None;
            while let Some(received) = lane.detections.receive()? {
                tracked = received.message().map(|it| (it.frame, it.t_sent_ns)).or(tracked);
            }
            let mut classified: Option<Sent> = None;
            while let Some(received) = lane.runs.receive()? {
                let header = received.header();
                classified = Some((header.frame, header.t_sent_ns));
            }
            let now_ns = monotonic_ns();
            let mut output = |stage: StageId, frame: &FrameHeader, t_sent_ns: u64| {
                let last = &mut last_of[stage];
                let follows = frame.follows(last.as_ref(), now_ns, fps);
                if follows {
                    *last = Some(*frame);
                    let frame = FrameId { lane: number, seq: frame.seq };
                    outputs.push(Output { t_sent_ns: t_sent_ns.min(now_ns), stage, frame });
                }
                follows
            };
            while let Some(frame) = lane.frames.receive()? {
                let header = frame.header();
                if output(StageId::new(ProcessKind::Grabber, number), header, header.t_sent_ns) {
                    if lane.recent_frames.len() == lane.kept_frames {
                        lane.recent_frames.pop_front();
                    }
                    lane.recent_frames.push_back(frame);
                }
            }
            let newest = lane.recent_frames.back().map(|frame| frame.header().seq);
            let results = [
                (ProcessKind::Classifier, classified),
                (ProcessKind::Tracker, tracked),
                // A `world` is about a frame of the first lane.
                (ProcessKind::Filter, filtered.filter(|_| number == 0)),
            ];
            for (kind, result) in results {
                // Before the first frame, any result is accepted.
                if let Some((frame, t_sent_ns)) = result
                    && newest.is_none_or(|newest| frame.seq <= newest)
                {
                    output(StageId::new(kind, number), &frame, t_sent_ns);
                }
            }
        }
        Ok(())
    }

    fn heartbeats(&self, report: &mut impl FnMut(Beat)) -> Result<(), BusError> {
        while let Some(received) = self.health.receive()? {
            let Some(beat) = received.message() else { continue };
            let stage = StageId::from_number(beat.process);
            let state = ProcessState::from_number(beat.state);
            if let (Some(stage), Some(state)) = (stage, state) {
                report(Beat::Stage(Sign {
                    pid: beat.pid,
                    stage,
                    state,
                    revision: beat.revision,
                    dropped: beat.dropped,
                }));
            } else if beat.process != Attendant::Supervisor as u32 {
                report(Beat::Attendant { pid: beat.pid });
            }
        }
        Ok(())
    }
}

fn failed(reason: impl ToString) -> BusError {
    BusError::Ipc { topic: "all".into(), action: "look at the stages", reason: reason.to_string() }
}
