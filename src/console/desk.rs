//! Where the thread that reads topics and the tasks that serve clients meet.
//!
//! A task says what it waits for and gets the newest of it at the next round of reading. Nothing is kept for a
//! client: one that is slow misses what came meanwhile. What nobody waits for is not converted, and what nobody
//! has asked for in some time is not even received.

use super::picture::Frame;
use super::scene::Scene;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{Notify, watch};

/// Time for which a topic is received after it was wanted last.
const KEPT: Duration = Duration::from_secs(5);
/// Most bytes of the frames that are kept for stills and pixels, and most frames.
const KEPT_FRAME_BYTES: usize = 48 << 20;
const KEPT_FRAMES: usize = 16;

/// What a client can wait for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(usize)]
pub enum Kind {
    /// Regions, robots, balls and rejected candidates of a frame.
    Detections = 0,
    /// Filtered poses.
    World = 1,
    /// Classified pixels.
    Runs = 2,
    /// The group's report.
    Status = 3,
    /// Events of the group.
    Events = 4,
    /// Pictures.
    Frames = 5,
    /// `world` in the form for other programs.
    Poses = 6,
    /// `world` as in recordings, for viewers.
    RawWorld = 7,
    /// `detections` as in recordings.
    RawDetections = 8,
    /// `runs` as in recordings.
    RawRuns = 9,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 10] = [
        Self::Detections,
        Self::World,
        Self::Runs,
        Self::Status,
        Self::Events,
        Self::Frames,
        Self::Poses,
        Self::RawWorld,
        Self::RawDetections,
        Self::RawRuns,
    ];

    /// Those with a text.
    pub const LIVE: [Self; 5] =
        [Self::Detections, Self::World, Self::Runs, Self::Status, Self::Events];

    /// Name in requests and answers.
    pub fn name(self) -> &'static str {
        match self {
            Self::Detections => "detections",
            Self::World => "world",
            Self::Runs => "runs",
            Self::Status => "status",
            Self::Events => "events",
            Self::Frames => "frames",
            Self::Poses => "poses",
            Self::RawWorld => "raw world",
            Self::RawDetections => "raw detections",
            Self::RawRuns => "raw runs",
        }
    }
}

const KINDS: usize = Kind::ALL.len();

/// The newest of a kind.
#[derive(Debug, Clone)]
pub struct News {
    /// Its number; rises.
    pub seq: u64,
    /// A JSON object.
    pub text: Arc<str>,
}

/// The newest message of a topic, in the form of recordings.
#[derive(Debug, Clone)]
pub struct Raw {
    /// Number of its frame.
    pub seq: u64,
    /// Capture time of its frame, nanoseconds since 1970.
    pub t_wall_ns: u64,
    /// The message.
    pub bytes: Arc<[u8]>,
}

/// The meeting place.
pub struct Desk {
    began: Instant,
    /// Tasks that wait, by kind.
    waiting: [AtomicUsize; KINDS],
    /// When a kind was last waited for, milliseconds since the beginning plus one; 0 for never.
    wanted_ms: [AtomicU64; KINDS],
    newest: Mutex<Newest>,
    rounds: watch::Sender<u64>,
    wake: Notify,
}

#[derive(Default)]
struct Newest {
    news: [Option<News>; KINDS],
    raw: [Option<Raw>; KINDS],
    frames: VecDeque<Arc<Frame>>,
    scene: Option<Arc<Scene>>,
}

impl Desk {
    /// Nobody waits for anything.
    pub fn new() -> Self {
        Self {
            began: Instant::now(),
            waiting: Default::default(),
            wanted_ms: Default::default(),
            newest: Mutex::default(),
            rounds: watch::Sender::new(0),
            wake: Notify::new(),
        }
    }

    /// Waits for these kinds, until the answer is dropped.
    pub fn want(self: &Arc<Self>, kinds: &[Kind]) -> Want {
        for &kind in kinds {
            self.waiting[kind as usize].fetch_add(1, Ordering::Relaxed);
        }
        let rounds = self.rounds.subscribe();
        self.touch(kinds);
        self.wake.notify_one();
        Want { desk: Arc::clone(self), kinds: kinds.to_vec(), rounds }
    }

    fn touch(&self, kinds: &[Kind]) {
        let now_ms = self.began.elapsed().as_millis() as u64 + 1;
        for &kind in kinds {
            self.wanted_ms[kind as usize].store(now_ms, Ordering::Relaxed);
        }
    }

    /// Whether a task waits for this kind now.
    pub fn is_awaited(&self, kind: Kind) -> bool {
        self.waiting[kind as usize].load(Ordering::Relaxed) > 0
    }

    /// Whether a task waits for anything now.
    pub fn is_busy(&self) -> bool {
        Kind::ALL.into_iter().any(|kind| self.is_awaited(kind))
    }

    /// Whether this kind is to be received.
    pub fn is_wanted(&self, kind: Kind) -> bool {
        let wanted_ms = self.wanted_ms[kind as usize].load(Ordering::Relaxed);
        let now_ms = self.began.elapsed().as_millis() as u64 + 1;
        self.is_awaited(kind)
            || wanted_ms > 0 && now_ms.saturating_sub(wanted_ms) < KEPT.as_millis() as u64
    }

    /// The newest of a kind.
    pub fn news(&self, kind: Kind) -> Option<News> {
        self.lock().news[kind as usize].clone()
    }

    /// Replaces the newest of a kind.
    pub fn put(&self, kind: Kind, news: News) {
        self.lock().news[kind as usize] = Some(news);
    }

    /// The newest message of a kind.
    pub fn raw(&self, kind: Kind) -> Option<Raw> {
        self.lock().raw[kind as usize].clone()
    }

    /// Replaces the newest message of a kind.
    pub fn put_raw(&self, kind: Kind, raw: Raw) {
        self.lock().raw[kind as usize] = Some(raw);
    }

    /// Forgets what is no longer received, so that it is not taken for new later.
    pub fn forget(&self, kind: Kind) {
        let mut newest = self.lock();
        newest.news[kind as usize] = None;
        newest.raw[kind as usize] = None;
        if kind == Kind::Frames {
            newest.frames.clear();
        }
    }

    /// The newest frame, or the kept one of this number.
    pub fn frame(&self, seq: Option<u64>) -> Option<Arc<Frame>> {
        let newest = self.lock();
        let is_it = |frame: &&Arc<Frame>| seq.is_none_or(|seq| frame.header.seq == seq);
        newest.frames.iter().rev().find(is_it).cloned()
    }

    /// Adds a frame, and drops the oldest beyond what is kept.
    pub fn put_frame(&self, frame: Arc<Frame>) {
        let mut newest = self.lock();
        let most = (KEPT_FRAME_BYTES / frame.bytes.len().max(1)).clamp(2, KEPT_FRAMES);
        newest.frames.push_back(frame);
        while newest.frames.len() > most {
            newest.frames.pop_front();
        }
    }

    /// The group's configuration, as it is drawn; `None` if it cannot be read.
    pub fn scene(&self) -> Option<Arc<Scene>> {
        self.lock().scene.clone()
    }

    /// Replaces it.
    pub fn put_scene(&self, scene: Arc<Scene>) {
        self.lock().scene = Some(scene);
    }

    /// Ends a round of reading: tasks look whether there is something for them.
    pub fn end_round(&self) {
        self.rounds.send_modify(|round| *round += 1);
    }

    /// Pause of the reading thread: until a task begins to wait, but no longer than `most`.
    pub async fn pause(&self, most: Duration) {
        let _ = tokio::time::timeout(most, self.wake.notified()).await;
    }

    fn lock(&self) -> MutexGuard<'_, Newest> {
        // The lock is never poisoned: a panic ends the process.
        self.newest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A task's wait for some kinds.
pub struct Want {
    desk: Arc<Desk>,
    kinds: Vec<Kind>,
    rounds: watch::Receiver<u64>,
}

impl Want {
    /// Waits until topics have been read once more, but no longer than until `deadline`; whether they have.
    pub async fn round(&mut self, deadline: tokio::time::Instant) -> bool {
        self.desk.touch(&self.kinds);
        matches!(tokio::time::timeout_at(deadline, self.rounds.changed()).await, Ok(Ok(())))
    }
}

impl Drop for Want {
    fn drop(&mut self) {
        for &kind in &self.kinds {
            self.desk.waiting[kind as usize].fetch_sub(1, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kind_is_wanted_for_a_while_and_awaited_only_meanwhile() {
        let desk = Arc::new(Desk::new());
        assert!(!desk.is_wanted(Kind::World) && !desk.is_busy());
        let want = desk.want(&[Kind::World, Kind::Runs]);
        let both = desk.want(&[Kind::World]);
        assert!(desk.is_awaited(Kind::Runs) && !desk.is_awaited(Kind::Frames));
        drop(want);
        assert!(!desk.is_awaited(Kind::Runs) && desk.is_wanted(Kind::Runs));
        assert!(desk.is_busy());
        drop(both);
        assert!(!desk.is_busy());
    }

    #[test]
    fn only_the_newest_frames_are_kept() {
        let desk = Desk::new();
        for seq in 0..100 {
            let header = messages::FrameHeader { seq, ..Default::default() };
            desk.put_frame(Arc::new(Frame { header, bytes: vec![0; 10 << 20] }));
        }
        assert_eq!(desk.frame(None).map(|frame| frame.header.seq), Some(99));
        assert!(desk.frame(Some(96)).is_some() && desk.frame(Some(90)).is_none());
        desk.forget(Kind::Frames);
        assert!(desk.frame(None).is_none());
    }
}
