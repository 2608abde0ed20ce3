//! Recently recorded inputs, by the names under which outputs refer to them.

use messages::{Commands, CommandsName, DetectionFrame, FrameHeader, WorldFrame};
use recording::Frame;
use std::collections::{BTreeMap, VecDeque};

/// Frames kept: no stage is ever further behind than its buffer of 64 messages, and a prediction is
/// never older than half a second.
const KEPT_FRAMES: usize = 256;
/// Commands kept: some seconds of several strategies.
const KEPT_COMMANDS: usize = 8192;

/// A recorded frame.
pub struct KeptFrame {
    /// Header as published.
    pub header: FrameHeader,
    /// Pixels as published.
    pub pixels: Vec<u8>,
}

/// The newest messages.
#[derive(Default)]
pub struct Inputs {
    frames: BTreeMap<u64, KeptFrame>,
    detections: BTreeMap<u64, Box<DetectionFrame>>,
    worlds: BTreeMap<u64, Box<WorldFrame>>,
    commands: BTreeMap<(u64, u64), Box<Commands>>,
    commands_in_order: VecDeque<(u64, u64)>,
}

impl Inputs {
    /// Keeps a frame.
    pub fn add_frame(&mut self, frame: &Frame) {
        let kept = KeptFrame { header: frame.header, pixels: frame.pixels.to_vec() };
        add(&mut self.frames, frame.header.seq, kept);
    }

    /// Keeps detections.
    pub fn add_detections(&mut self, detections: Box<DetectionFrame>) {
        add(&mut self.detections, detections.frame.seq, detections);
    }

    /// Keeps a world.
    pub fn add_world(&mut self, world: Box<WorldFrame>) {
        add(&mut self.worlds, world.frame.seq, world);
    }

    /// Keeps commands.
    pub fn add_commands(&mut self, commands: Box<Commands>) {
        let name = (commands.t_sent_ns, commands.seq);
        self.commands.insert(name, commands);
        self.commands_in_order.push_back(name);
        if self.commands_in_order.len() > KEPT_COMMANDS
            && let Some(oldest) = self.commands_in_order.pop_front()
        {
            self.commands.remove(&oldest);
        }
    }

    /// The frame with this number.
    pub fn frame(&self, seq: u64) -> Option<&KeptFrame> {
        self.frames.get(&seq)
    }

    /// The detections of this frame.
    pub fn detections(&self, seq: u64) -> Option<&DetectionFrame> {
        self.detections.get(&seq).map(|detections| &**detections)
    }

    /// The world of this frame.
    pub fn world(&self, seq: u64) -> Option<&WorldFrame> {
        self.worlds.get(&seq).map(|world| &**world)
    }

    /// The commands with this name.
    pub fn commands(&self, name: &CommandsName) -> Option<&Commands> {
        self.commands.get(&(name.t_sent_ns, name.seq)).map(|commands| &**commands)
    }
}

fn add<T>(kept: &mut BTreeMap<u64, T>, seq: u64, message: T) {
    kept.insert(seq, message);
    if kept.len() > KEPT_FRAMES {
        kept.pop_first();
    }
}
