//! The thread that sends what one topic brings.

use super::Worker;
use super::convert::{Scene, seconds};
use super::sender::{OwnPorts, Sender};
use super::table::{Frame, Protocol, TABLE};
use client::bus::{Bus, BusError};
use client::clock::{monotonic_ns, wall_ns};
use client::instance::Instance;
use config::PublishedTopic;
use messages::Message;
use messages::topics::{self, Topic};
use messages::{Attendant, DetectionFrame, FrameHeader, WorldFrame};
use protocols::ONE_FRAME_BYTES;
use runtime::process::MAX_WAIT;
use std::net::SocketAddrV4;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Interval of what is sent besides frames, and between looks at the interfaces.
const SECOND_NS: u64 = 1_000_000_000;

/// A protocol that is sent, with its counters.
pub struct Line {
    /// Its place in the table.
    index: usize,
    /// Packets handed to the system.
    pub sent: AtomicU64,
    /// Packets refused.
    pub failed: AtomicU64,
    /// Packets larger than one Ethernet frame.
    pub large: AtomicU64,
    frames: AtomicU64,
    newest: AtomicU64,
    problem: Mutex<String>,
}

impl Line {
    /// The protocol at this place in the table.
    pub fn new(index: usize) -> Self {
        let (sent, failed, large, frames, newest, problem) = Default::default();
        Self { index, sent, failed, large, frames, newest, problem }
    }

    /// Its row.
    pub fn protocol(&self) -> &'static Protocol {
        &TABLE[self.index]
    }

    /// Frames handled.
    pub fn frames(&self) -> u64 {
        self.frames.load(Ordering::Relaxed)
    }

    /// Number of the newest frame.
    pub fn newest(&self) -> u64 {
        self.newest.load(Ordering::Relaxed)
    }

    /// What is wrong at the moment; empty when nothing is.
    pub fn problem(&self) -> String {
        self.problem.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn send(&self, sender: &mut Sender, receivers: &[SocketAddrV4], packet: &[u8]) {
        if packet.len() > ONE_FRAME_BYTES {
            self.large.fetch_add(1, Ordering::Relaxed);
        }
        for &to in receivers {
            let outcome = sender.send(to, packet);
            self.sent.fetch_add(outcome.sent, Ordering::Relaxed);
            self.failed.fetch_add(outcome.failed, Ordering::Relaxed);
        }
    }

    fn set_problem(&self, problem: String) {
        *self.problem.lock().unwrap_or_else(PoisonError::into_inner) = problem;
    }
}

/// What a worker does.
pub struct Job {
    /// The topic it reads.
    pub topic: PublishedTopic,
    /// The protocols made from it.
    pub lines: Vec<Arc<Line>>,
    /// For conversions.
    pub scene: Arc<Scene>,
    /// Where it enters the ports of its sockets.
    pub own: Arc<OwnPorts>,
}

impl Job {
    /// Name of its topic.
    pub fn topic_name(&self) -> &'static str {
        match self.topic {
            PublishedTopic::Detections => topics::DETECTIONS.name.base(),
            PublishedTopic::World => topics::WORLD.name.base(),
        }
    }

    /// Starts the thread.
    pub fn start(self, instance: &Instance, stop: Arc<AtomicBool>) -> Worker {
        let job = Arc::new(self);
        let round_ns = Arc::new(AtomicU64::new(monotonic_ns()));
        let thread = {
            let (job, round_ns, instance) = (job.clone(), round_ns.clone(), instance.clone());
            std::thread::spawn(move || match job.topic {
                PublishedTopic::Detections => {
                    job.work(&instance, &topics::DETECTIONS, &round_ns, &stop)
                }
                PublishedTopic::World => job.work(&instance, &topics::WORLD, &round_ns, &stop),
            })
        };
        Worker { job, round_ns, thread }
    }

    fn work<E: Publishable>(
        &self,
        instance: &Instance,
        topic: &Topic<E>,
        round_ns: &AtomicU64,
        stop: &AtomicBool,
    ) -> Result<(), BusError> {
        let bus = Bus::join(instance, Attendant::Publisher.name())?;
        let messages = bus.subscriber(topic)?;
        let mut wake_up = bus.wake_up(topic)?;
        let config = self.scene.config();
        let mut outputs: Vec<Output> =
            self.lines.iter().map(|line| Output::new(line, &self.scene)).collect();
        let mut last: Option<FrameHeader> = None;
        let mut second_ns = 0;
        while !stop.load(Ordering::Relaxed) {
            let now_ns = monotonic_ns();
            if now_ns.saturating_sub(second_ns) >= SECOND_NS {
                second_ns = now_ns;
                outputs.iter_mut().for_each(|output| output.every_second(&self.scene, &self.own));
            }
            while let Some(received) = messages.receive()? {
                let Some(message) = received.message() else { continue };
                // Skip a message that is repeated after a hand-over, or impossible.
                if message.header().follows(last.as_ref(), monotonic_ns(), config.camera.fps) {
                    last = Some(*message.header());
                    for output in &mut outputs {
                        output.frame(&self.scene, message.header().seq, message.frame());
                    }
                }
            }
            if messages.misses_a_writer() {
                // The next process connects again.
                return Ok(());
            }
            round_ns.store(monotonic_ns(), Ordering::Relaxed);
            wake_up.wait(MAX_WAIT);
        }
        Ok(())
    }
}

/// A message that can be published.
trait Publishable: Message {
    /// The frame it is about.
    fn header(&self) -> &FrameHeader;
    /// It, as protocols take it.
    fn frame(&self) -> Frame<'_>;
}

impl Publishable for DetectionFrame {
    fn header(&self) -> &FrameHeader {
        &self.frame
    }

    fn frame(&self) -> Frame<'_> {
        Frame::Detections(self)
    }
}

impl Publishable for WorldFrame {
    fn header(&self) -> &FrameHeader {
        &self.frame
    }

    fn frame(&self) -> Frame<'_> {
        Frame::World(self)
    }
}

/// A protocol with its receivers and sockets.
struct Output {
    line: Arc<Line>,
    receivers: Vec<SocketAddrV4>,
    sender: Sender,
}

impl Output {
    fn new(line: &Arc<Line>, scene: &Scene) -> Self {
        let publish = &scene.config().publish;
        let receivers = publish.outputs()[line.index].receivers();
        Self { line: Arc::clone(line), receivers, sender: Sender::new(publish) }
    }

    fn frame(&mut self, scene: &Scene, seq: u64, frame: Frame) {
        let Some(packet) = (self.line.protocol().packet)(scene, frame, seconds(wall_ns())) else {
            return;
        };
        self.line.send(&mut self.sender, &self.receivers, &packet);
        self.line.frames.fetch_add(1, Ordering::Relaxed);
        self.line.newest.store(seq, Ordering::Relaxed);
    }

    fn every_second(&mut self, scene: &Scene, own: &OwnPorts) {
        self.sender.refresh(own);
        if let Some(packet) = (self.line.protocol().every_second)(scene) {
            self.line.send(&mut self.sender, &self.receivers, &packet);
        }
        self.line.set_problem(self.sender.trouble());
    }
}
