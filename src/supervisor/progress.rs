//! How far each stage has come, read off the topics themselves rather than asked of the stages.

use super::drops::Dropped;
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

/// Connected to the topics: always has the newest message of each, also when the writer is dead.
pub struct Progress {
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
    /// Kept for its memory.
    outputs: Vec<Output>,
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
        let bus = Bus::join(instance, "supervisor")?;
        let frames = topics::frames(config.camera.frame_bytes());
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
            outputs: Vec::new(),
            _bus: bus,
        })
    }

    /// What is new on the stages' topics, in the order in which it was sent: each frame, and the newest
    /// output of the other stages.
    pub fn outputs(&mut self) -> Result<&[Output], BusError> {
        self.outputs.clear();
        let now_ns = monotonic_ns();
        while let Some(frame) = self.frames.receive()? {
            let &FrameHeader { seq, t_sent_ns, .. } = frame.header();
            let last = self.recent_frames.back().map(|last| last.header());
            if !frame.header().follows(last, now_ns) {
                continue;
            }
            if self.recent_frames.len() == self.kept_frames {
                self.recent_frames.pop_front();
            }
            self.recent_frames.push_back(frame);
            let t_sent_ns = t_sent_ns.min(now_ns);
            self.outputs.push(Output { t_sent_ns, kind: ProcessKind::Grabber, seq });
        }
        let Self { runs, detections, world, last_of, outputs, .. } = self;
        let mut output = |kind: ProcessKind, frame: &FrameHeader, t_sent_ns: u64| {
            let last = &mut last_of[kind as usize];
            // Other programs can publish on these topics too, rubbish included.
            if frame.follows(last.as_ref(), now_ns) {
                *last = Some(*frame);
                let t_sent_ns = t_sent_ns.min(now_ns);
                outputs.push(Output { t_sent_ns, kind, seq: frame.seq });
            }
        };
        while let Some(runs) = runs.receive()? {
            output(ProcessKind::Classifier, &runs.header().frame, runs.header().t_sent_ns);
        }
        while let Some(detections) = detections.receive()? {
            if let Some(detections) = detections.message() {
                output(ProcessKind::Tracker, &detections.frame, detections.t_sent_ns);
            }
        }
        while let Some(world) = world.receive()? {
            if let Some(world) = world.message() {
                output(ProcessKind::Filter, &world.frame, world.t_sent_ns);
            }
        }
        outputs.sort_unstable();
        Ok(outputs)
    }

    /// Calls `report` with each heartbeat since the last call.
    pub fn heartbeats(&self, mut report: impl FnMut(Beat)) -> Result<(), BusError> {
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

    /// The newest frame seen, from which a new grabber continues the numbers.
    pub fn last_frame(&self) -> Option<LastFrame> {
        let &FrameHeader { seq, t_capture_ns, .. } = self.recent_frames.back()?.header();
        Some(LastFrame { seq, t_capture_ns })
    }

    /// The first frame after this number, if it is still at hand.
    pub fn first_frame_after(&self, seq: u64) -> Option<&Received<u8, FrameHeader>> {
        let oldest = self.recent_frames.front()?.header().seq;
        if oldest > seq + 1 {
            return None;
        }
        self.recent_frames.iter().find(|frame| frame.header().seq > seq)
    }
}
