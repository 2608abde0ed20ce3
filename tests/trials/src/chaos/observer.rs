//! The observer: independent subscribers on a separate thread, which rely on no process's counters.
//!
//! Two kinds of reader watch `world`. The first polls continuously and counts everything. The second
//! reads only at long intervals, as a strategy with a long computation does, so that its unread messages
//! come from several processes of a stage; it checks that such a reader too gets them in order.

use super::tally::{Order, Tally};
use client::bus::{Bus, BusError, Subscriber};
use client::clock::monotonic_ns;
use client::instance::Instance;
use messages::topics;
use messages::{FrameHeader, Heartbeat, WorldFrame};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Polling interval of the first reader: much shorter than the times measured.
const POLL: Duration = Duration::from_micros(500);
/// The second reader never waits longer than this …
const LONGEST_NAP: Duration = Duration::from_millis(250);
/// … nor for more than this many frames: half of its buffer.
const NAP_FRAMES: f64 = 32.0;

/// Observations so far.
#[derive(Debug, Default)]
pub struct Sight {
    /// Counts of the reader that polls continuously.
    pub tally: Tally,
    /// Counts of the reader that reads at long intervals.
    pub napper: Order,
    /// Longest time without a poll, in nanoseconds.
    pub longest_absence_ns: u64,
    /// Error that ended the observation, if any.
    pub failure: Option<String>,
}

/// The running observer.
pub struct Observer {
    /// Heartbeats of the group's processes.
    pub heartbeats: Receiver<Heartbeat>,
    sight: Arc<Mutex<Sight>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Observer {
    /// Connects to a group and starts watching.
    pub fn start(instance: &Instance, fps: f64) -> Result<Self, BusError> {
        let sight = Arc::new(Mutex::new(Sight::default()));
        let stop = Arc::new(AtomicBool::new(false));
        let (beats, heartbeats) = channel();
        let (connected, is_connected) = channel();
        let (instance, shared, stopped) = (instance.clone(), Arc::clone(&sight), Arc::clone(&stop));
        // Ports belong to the thread that creates them.
        let thread = std::thread::spawn(move || match Ports::new(&instance, beats, fps) {
            Ok(mut ports) => {
                let _ = connected.send(Ok(()));
                if let Err(error) = ports.watch(&shared, &stopped) {
                    lock(&shared).failure = Some(error.to_string());
                }
            }
            Err(error) => {
                let _ = connected.send(Err(error));
            }
        });
        // A thread that ends without an answer has panicked, which shows itself.
        is_connected.recv().unwrap_or(Ok(()))?;
        Ok(Self { heartbeats, sight, stop, thread: Some(thread) })
    }

    /// Observations so far.
    pub fn sight(&self) -> MutexGuard<'_, Sight> {
        lock(&self.sight)
    }

    /// Disconnects from the group; the observer leaves nothing in shared memory.
    pub fn finish(mut self) -> Sight {
        self.disconnect();
        std::mem::take(&mut *lock(&self.sight))
    }

    fn disconnect(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Drop for Observer {
    fn drop(&mut self) {
        self.disconnect();
    }
}

struct Ports {
    frames: Subscriber<u8, FrameHeader>,
    world: Subscriber<WorldFrame, ()>,
    napper: Subscriber<WorldFrame, ()>,
    health: Subscriber<Heartbeat, ()>,
    beats: Sender<Heartbeat>,
    nap: Duration,
    nap_ends: Instant,
    worlds: Vec<(u64, u64, u64)>,
    // Last, so that it outlives the ports.
    _bus: Bus,
}

impl Ports {
    fn new(instance: &Instance, beats: Sender<Heartbeat>, fps: f64) -> Result<Self, BusError> {
        let bus = Bus::join(instance, "chaos")?;
        Ok(Self {
            frames: bus.subscriber(&topics::FRAMES)?,
            world: bus.subscriber(&topics::WORLD)?,
            napper: bus.subscriber(&topics::WORLD)?,
            health: bus.subscriber(&topics::HEALTH)?,
            beats,
            nap: Duration::from_secs_f64(NAP_FRAMES / fps).min(LONGEST_NAP),
            nap_ends: Instant::now(),
            worlds: Vec::new(),
            _bus: bus,
        })
    }

    fn watch(&mut self, sight: &Mutex<Sight>, stop: &AtomicBool) -> Result<(), BusError> {
        let mut looked_ns = monotonic_ns();
        loop {
            // Read first, so that messages published before the request are still seen.
            let last_round = stop.load(Ordering::Relaxed);
            let now = monotonic_ns();
            {
                let mut sight = lock(sight);
                sight.longest_absence_ns = sight.longest_absence_ns.max(now - looked_ns);
                self.look(&mut sight.tally)?;
                if last_round || Instant::now() >= self.nap_ends {
                    self.nap_ends = Instant::now() + self.nap;
                    self.wake(&mut sight.napper)?;
                }
            }
            looked_ns = now;
            while let Some(beat) = self.health.receive()? {
                if let Some(&beat) = beat.message() {
                    // At the very end the receiver is gone.
                    let _ = self.beats.send(beat);
                }
            }
            if last_round {
                return Ok(());
            }
            std::thread::sleep(POLL);
        }
    }

    /// `world` is read first and counted last: a frame is published before its `world`, so every frame
    /// of the batch is known when the batch is counted.
    fn look(&mut self, tally: &mut Tally) -> Result<(), BusError> {
        self.worlds.clear();
        while let Some(received) = self.world.receive()? {
            if let Some(world) = received.message() {
                self.worlds.push((world.frame.seq, world.frame.t_capture_ns, monotonic_ns()));
            }
        }
        let mut frames = Vec::new();
        while let Some(received) = self.frames.receive()? {
            let header = received.header();
            frames.push((header.seq, header.t_capture_ns));
        }
        if frames.len() >= topics::FRAMES.buffer {
            tally.frames_may_be_overwritten();
        }
        for (seq, t_capture_ns) in frames {
            tally.captured(seq, t_capture_ns);
        }
        if self.worlds.len() >= topics::WORLD.buffer {
            tally.worlds_may_be_overwritten();
        }
        for &(seq, t_capture_ns, seen_ns) in &self.worlds {
            tally.arrived(seq, t_capture_ns, seen_ns);
        }
        Ok(())
    }

    fn wake(&mut self, order: &mut Order) -> Result<(), BusError> {
        let mut numbers = Vec::new();
        while let Some(received) = self.napper.receive()? {
            numbers.extend(received.message().map(|world| world.frame.seq));
        }
        if numbers.len() >= topics::WORLD.buffer {
            order.blind();
        }
        for seq in numbers {
            order.met(seq);
        }
        Ok(())
    }
}

fn lock(sight: &Mutex<Sight>) -> MutexGuard<'_, Sight> {
    // Every update leaves the counts consistent, so a panic elsewhere does not make them unusable.
    sight.lock().unwrap_or_else(PoisonError::into_inner)
}
