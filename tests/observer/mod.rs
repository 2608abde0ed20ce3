//! Observers of their own on `frames`, `world` and `events`, for tests of changes in the middle of a match.

// Every test file uses its own part of this.
#![allow(dead_code)]

use client::clock::monotonic_ns;
use client::consumer::{Consumer, Event};
use client::instance::Instance;
use messages::stages::StageId;
use messages::{read_text, topics};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Longest wait before it looks whether it is to stop.
const MAX_WAIT: Duration = Duration::from_millis(50);

/// What an observer of its own sees of a `world`.
#[derive(Debug, Clone)]
pub struct Seen {
    pub seq: u64,
    pub t_capture_ns: u64,
    pub t_sent_ns: u64,
    /// Revisions of classifier, tracker and filter.
    pub revisions: [u32; 3],
    /// Robots in it, by team and number.
    pub robots: Vec<(u32, u32)>,
}

/// Reads `frames` and `world` until it is told to stop.
pub struct Observer {
    stop: Arc<AtomicBool>,
    captured: JoinHandle<BTreeSet<u64>>,
    thread: JoinHandle<Vec<Seen>>,
}

impl Observer {
    /// Begins to read.
    pub fn start(instance: &Instance) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        // On a busy machine the camera itself misses frames, which no stage can be blamed for.
        let (of_frames, to_stop) = (instance.clone(), Arc::clone(&stop));
        let captured = std::thread::spawn(move || {
            let mut frames = Consumer::new(of_frames, "observer", &topics::FRAMES);
            let mut captured = BTreeSet::new();
            while !to_stop.load(Ordering::Relaxed) {
                if let Some(Event::Message(frame)) = frames.next(MAX_WAIT).unwrap() {
                    captured.insert(frame.header().seq);
                }
            }
            captured
        });
        let (instance, to_stop) = (instance.clone(), Arc::clone(&stop));
        let thread = std::thread::spawn(move || {
            let mut world = Consumer::new(instance, "observer", &topics::WORLD);
            let mut seen = Vec::new();
            while !to_stop.load(Ordering::Relaxed) {
                let event = world.next(MAX_WAIT).unwrap();
                let Some(Event::Message(message)) = event else {
                    // Frames missing or repeated are found in the numbers.
                    continue;
                };
                let Some(world) = message.message() else { continue };
                seen.push(Seen {
                    seq: world.frame.seq,
                    t_capture_ns: world.frame.t_capture_ns,
                    t_sent_ns: world.t_sent_ns,
                    revisions: [world.classifier_revision, world.tracker_revision, world.revision],
                    robots: world.robots().iter().map(|it| (it.team, it.robot_id)).collect(),
                });
            }
            seen
        });
        Self { stop, captured, thread }
    }

    /// Ends it, and checks that no captured frame was missing, and none twice or out of order.
    pub fn finish(self) -> Vec<Seen> {
        let (seen, gaps) = self.stop();
        assert!(gaps.is_empty(), "{gaps:?}");
        seen
    }

    /// Ends it. Also returns successive results between which captured frames are missing, or which are not
    /// in order.
    pub fn stop(self) -> (Vec<Seen>, Vec<(Seen, Seen)>) {
        self.stop.store(true, Ordering::Relaxed);
        let (seen, captured) = (self.thread.join().unwrap(), self.captured.join().unwrap());
        let is_gap = |pair: &&[Seen]| {
            pair[1].seq <= pair[0].seq
                || captured.range(pair[0].seq + 1..pair[1].seq).next().is_some()
        };
        let gaps = seen.windows(2).filter(is_gap);
        let gaps = gaps.map(|pair| (pair[0].clone(), pair[1].clone())).collect();
        (seen, gaps)
    }
}

/// Follows the events of a group, which tell what the supervisor did and when.
pub struct Diary {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Vec<Entry>>,
}

/// An event.
#[derive(Debug, Clone)]
pub struct Entry {
    /// On the clock of the frames.
    pub t_ns: u64,
    pub stage: String,
    pub what: String,
}

impl Diary {
    /// Begins to follow them.
    pub fn start(instance: &Instance) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let (instance, to_stop) = (instance.clone(), Arc::clone(&stop));
        // The clocks of the day and of the frames may drift apart by microseconds in a test.
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
        let apart_ns = since_1970.as_nanos() as u64 - monotonic_ns();
        let thread = std::thread::spawn(move || {
            let mut events = Consumer::new(instance, "diary", &topics::EVENTS);
            let mut entries = Vec::new();
            while !to_stop.load(Ordering::Relaxed) {
                let event = events.next(MAX_WAIT).unwrap();
                let Some(Event::Message(message)) = event else { continue };
                let Some(event) = message.message() else { continue };
                let stage = StageId::from_number(event.process);
                entries.push(Entry {
                    t_ns: event.t_wall_ns - apart_ns,
                    stage: stage.map_or("supervisor".into(), |stage| stage.to_string()),
                    what: read_text(&event.what),
                });
            }
            entries
        });
        Self { stop, thread }
    }

    /// Ends it.
    pub fn finish(self) -> Vec<Entry> {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap()
    }
}

/// The events between two times, in milliseconds after the first.
pub fn told(entries: &[Entry], from_ns: u64, until_ns: u64) -> String {
    let is_between = |it: &&Entry| (from_ns..=until_ns).contains(&it.t_ns);
    let line = |it: &Entry| {
        let ms = (it.t_ns - from_ns) as f64 / 1e6;
        format!("{ms:8.1}  {}: {}\n", it.stage, it.what.lines().next().unwrap_or_default())
    };
    entries.iter().filter(is_between).map(line).collect()
}
