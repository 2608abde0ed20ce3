//! How far each stage has come, read off the topics themselves rather than asked of the stages.

use common::bus::{Bus, BusError, Received, Subscriber};
use common::instance::Instance;
use common::messages::{
    DetectionFrame, FrameHeader, Heartbeat, ProcessKind, ProcessState, Run, RunsHeader, WorldFrame,
};
use common::topics;
use grabber::camera::LastFrame;

/// Connected to every topic with a buffer of one: always holds the newest message of each, and
/// goes on doing so when the writer is dead.
pub struct Progress {
    frames: Subscriber<u8, FrameHeader>,
    runs: Subscriber<Run, RunsHeader>,
    detections: Subscriber<DetectionFrame, ()>,
    world: Subscriber<WorldFrame, ()>,
    health: Subscriber<Heartbeat, ()>,
    last_frame: Option<LastFrame>,
    // Last, so that it outlives the ports.
    _bus: Bus,
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
    /// Inputs it has dropped so far.
    pub dropped: u64,
}

impl Progress {
    /// Connects.
    pub fn new(instance: &Instance) -> Result<Self, BusError> {
        let bus = Bus::join(instance, "supervisor")?;
        Ok(Self {
            frames: bus.subscriber_with_buffer(&topics::FRAMES, 1)?,
            runs: bus.subscriber_with_buffer(&topics::RUNS, 1)?,
            detections: bus.subscriber_with_buffer(&topics::DETECTIONS, 1)?,
            world: bus.subscriber_with_buffer(&topics::WORLD, 1)?,
            health: bus.subscriber(&topics::HEALTH)?,
            last_frame: None,
            _bus: bus,
        })
    }

    /// Calls `report` with each stage's newest output number that is new since the last call.
    pub fn outputs(&mut self, mut report: impl FnMut(ProcessKind, u64)) -> Result<(), BusError> {
        if let Some(frame) = self.frames.newest()? {
            let &FrameHeader { seq, t_capture_ns, .. } = frame.header();
            self.last_frame = Some(LastFrame { seq, t_capture_ns });
            report(ProcessKind::Grabber, seq);
        }
        if let Some(runs) = self.runs.newest()? {
            report(ProcessKind::Classifier, runs.header().frame.seq);
        }
        if let Some(detections) = self.detections.newest()?.as_ref().and_then(Received::message) {
            report(ProcessKind::Tracker, detections.frame.seq);
        }
        if let Some(world) = self.world.newest()?.as_ref().and_then(Received::message) {
            report(ProcessKind::Filter, world.frame.seq);
        }
        Ok(())
    }

    /// Calls `report` with each heartbeat since the last call.
    pub fn heartbeats(&self, mut report: impl FnMut(Sign)) -> Result<(), BusError> {
        while let Some(received) = self.health.receive()? {
            let Some(beat) = received.message() else { continue };
            let kind = ProcessKind::from_number(beat.process);
            let state = ProcessState::from_number(beat.state);
            if let (Some(kind), Some(state)) = (kind, state) {
                let dropped = beat.dropped.iter().fold(0u64, |sum, &count| sum.saturating_add(count));
                report(Sign { pid: beat.pid, kind, state, dropped });
            }
        }
        Ok(())
    }

    /// The newest frame seen, from which a new grabber continues the numbers.
    pub fn last_frame(&self) -> Option<LastFrame> {
        self.last_frame
    }
}
