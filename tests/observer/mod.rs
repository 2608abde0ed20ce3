//! An observer of its own on `world`, for tests of changes in the middle of a match.

// Every test file uses its own part of this.
#![allow(dead_code)]

use client::consumer::{Consumer, Event};
use client::instance::Instance;
use messages::topics;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

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

/// Reads `world` until it is told to stop.
pub struct Observer {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Vec<Seen>>,
}

impl Observer {
    /// Begins to read.
    pub fn start(instance: &Instance) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let (instance, to_stop) = (instance.clone(), Arc::clone(&stop));
        let thread = std::thread::spawn(move || {
            let mut world = Consumer::new(instance, "observer", &topics::WORLD);
            let mut seen = Vec::new();
            while !to_stop.load(Ordering::Relaxed) {
                let event = world.next(Duration::from_millis(50)).unwrap();
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
        Self { stop, thread }
    }

    /// Ends it, and checks that no frame was missing, twice or out of order.
    pub fn finish(self) -> Vec<Seen> {
        self.stop.store(true, Ordering::Relaxed);
        let seen = self.thread.join().unwrap();
        for pair in seen.windows(2) {
            assert_eq!(pair[1].seq, pair[0].seq + 1, "{pair:?}");
        }
        seen
    }
}
