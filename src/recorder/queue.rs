//! Queue from the reading to the writing thread: bounded in bytes, with reused buffers.

use super::configurations::{Configuration, Revisions};
use recording::Channel;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Most bytes in the queue: four seconds of raw frames from a camera of 640×480 pixels and 80
/// frames a second.
const MAX_BYTES: usize = 128 << 20;
/// Most bytes at which frames are still accepted; the last quarter is for results, which are small
/// and worth more.
const MAX_BYTES_WITH_FRAMES: usize = MAX_BYTES / 4 * 3;
/// Most buffers kept for reuse. Each grows to the largest message it has held, a frame; more are under
/// way only while the disk is slow, and are freed afterwards.
const MAX_SPARE: usize = 6;

/// Writes a message to a buffer. Returns the time it was sent and the time it is about, both on the
/// monotonic clock; `None` if it is empty.
pub type Encode<'a> = dyn FnMut(&mut Vec<u8>) -> Option<(u64, u64)> + 'a;

/// A message to record, still in shared memory.
pub struct Recorded<'a> {
    /// Its channel.
    pub channel: Channel,
    /// Revisions that it names.
    pub revisions: Revisions,
    /// Approximate size in bytes.
    pub size_hint: usize,
    /// Its content.
    pub encode: &'a mut Encode<'a>,
}

/// A job for the writing thread.
pub enum Job {
    /// Write a message.
    Message {
        /// Its channel.
        channel: Channel,
        /// Revisions that it names.
        revisions: Revisions,
        /// Time it was sent, monotonic clock.
        t_sent_ns: u64,
        /// Time it is about, monotonic clock.
        t_about_ns: u64,
        /// Its recorded bytes.
        data: Vec<u8>,
    },
    /// Write a configuration.
    Setup(Box<Configuration>),
    /// Start another file, of another group.
    NextFile(Box<Configuration>),
}

/// Counts shared by both threads.
#[derive(Debug, Default)]
pub struct Totals {
    counts: Mutex<Counts>,
}

#[derive(Debug, Default)]
struct Counts {
    files: Vec<PathBuf>,
    written: BTreeMap<Channel, u64>,
    dropped: BTreeMap<Channel, u64>,
}

impl Totals {
    fn counts(&self) -> MutexGuard<'_, Counts> {
        // Every update leaves the counts consistent.
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts a message as written.
    pub fn count_written(&self, channel: Channel) {
        *self.counts().written.entry(channel).or_default() += 1;
    }

    fn count_dropped(&self, channel: Channel) {
        *self.counts().dropped.entry(channel).or_default() += 1;
    }

    /// Adds a new file; if there are more than `keep` now, returns those to remove.
    pub fn add_file(&self, path: PathBuf, keep: Option<usize>) -> Vec<PathBuf> {
        let files = &mut self.counts().files;
        files.push(path);
        let surplus = files.len().saturating_sub(keep.unwrap_or(usize::MAX).max(1));
        files.drain(..surplus).collect()
    }

    /// All files.
    pub fn files(&self) -> Vec<PathBuf> {
        self.counts().files.clone()
    }

    /// Messages written.
    pub fn written(&self) -> BTreeMap<Channel, u64> {
        self.counts().written.clone()
    }

    /// Messages dropped because too many were waiting.
    pub fn dropped(&self) -> BTreeMap<Channel, u64> {
        self.counts().dropped.clone()
    }
}

/// Sending end, for the reading thread.
pub struct QueueSender {
    jobs: Sender<Job>,
    spare: Receiver<Vec<u8>>,
    waiting_bytes: Arc<AtomicUsize>,
    totals: Arc<Totals>,
}

/// Receiving end, for the writing thread.
pub struct QueueReceiver {
    jobs: Receiver<Job>,
    spare: SyncSender<Vec<u8>>,
    waiting_bytes: Arc<AtomicUsize>,
}

/// Creates a queue.
pub fn queue(totals: Arc<Totals>) -> (QueueSender, QueueReceiver) {
    let (job_sender, job_receiver) = channel();
    let (spare_sender, spare_receiver) = sync_channel(MAX_SPARE);
    let waiting_bytes = Arc::new(AtomicUsize::new(0));
    let sender = QueueSender {
        jobs: job_sender,
        spare: spare_receiver,
        waiting_bytes: Arc::clone(&waiting_bytes),
        totals,
    };
    (sender, QueueReceiver { jobs: job_receiver, spare: spare_sender, waiting_bytes })
}

impl QueueSender {
    /// Queues a message; drops and counts it if the queue is full.
    pub fn put(&mut self, message: Recorded<'_>) {
        let waiting = self.waiting_bytes.load(Ordering::Relaxed);
        let is_frame = message.channel == Channel::Frames;
        let room = if is_frame { MAX_BYTES_WITH_FRAMES } else { MAX_BYTES };
        if waiting + message.size_hint > room {
            self.totals.count_dropped(message.channel);
            return;
        }
        let mut data = self.spare.try_recv().unwrap_or_default();
        let Some((t_sent_ns, t_about_ns)) = (message.encode)(&mut data) else { return };
        self.waiting_bytes.fetch_add(data.len(), Ordering::Relaxed);
        let (channel, revisions) = (message.channel, message.revisions);
        // Ignore failures: the caller checks whether the other thread has ended.
        let _ = self.jobs.send(Job::Message { channel, revisions, t_sent_ns, t_about_ns, data });
    }

    /// Queues a job that is not a message; never dropped.
    pub fn put_job(&mut self, job: Job) {
        let _ = self.jobs.send(job);
    }
}

impl QueueReceiver {
    /// The next job; waits at most `timeout`.
    pub fn take(&mut self, timeout: Duration) -> Result<Job, RecvTimeoutError> {
        let job = self.jobs.recv_timeout(timeout)?;
        if let Job::Message { data, .. } = &job {
            self.waiting_bytes.fetch_sub(data.len(), Ordering::Relaxed);
        }
        Ok(job)
    }

    /// Returns a buffer for reuse.
    pub fn give_back(&mut self, data: Vec<u8>) {
        // If enough are kept already, it is freed.
        let _ = self.spare.try_send(data);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_that_do_not_fit_are_dropped_and_counted() {
        let totals = Arc::new(Totals::default());
        let (mut sender, mut receiver) = queue(Arc::clone(&totals));
        let size = MAX_BYTES / 4 + 1;
        let put = |sender: &mut QueueSender, channel| {
            sender.put(Recorded {
                channel,
                revisions: Revisions::default(),
                size_hint: size,
                encode: &mut |out| {
                    out.resize(size, 0);
                    Some((1, 2))
                },
            });
        };
        for _ in 0..3 {
            put(&mut sender, Channel::Frames);
        }
        assert_eq!(totals.dropped().get(&Channel::Frames), Some(&1));
        put(&mut sender, Channel::World);
        assert_eq!(totals.dropped().get(&Channel::World), None, "there is room left for results");
        put(&mut sender, Channel::World);
        assert_eq!(totals.dropped().get(&Channel::World), Some(&1));
        assert!(matches!(receiver.take(Duration::ZERO), Ok(Job::Message { t_sent_ns: 1, .. })));
        put(&mut sender, Channel::World);
        assert_eq!(totals.dropped().get(&Channel::World), Some(&1), "there was room again");
    }

    /// Memory of this process that no other one shares, in bytes.
    fn private_bytes() -> u64 {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).unwrap();
        line.trim().trim_end_matches(" kB").parse::<u64>().unwrap() << 10
    }

    #[test]
    fn a_queue_that_was_full_once_gives_its_memory_back() {
        runtime::heap::return_large_blocks();
        let (mut sender, mut receiver) = queue(Arc::default());
        let frame = 640 * 480;
        // Small blocks between the frames, as in a recorder, keep a heap from shrinking.
        let mut small = Vec::new();
        let mut fill = |sender: &mut QueueSender, frames: usize| {
            for _ in 0..frames {
                sender.put(Recorded {
                    channel: Channel::Frames,
                    revisions: Revisions::default(),
                    size_hint: frame,
                    encode: &mut |out| {
                        out.clear();
                        out.resize(frame, 7);
                        Some((1, 2))
                    },
                });
                small.push(vec![0u8; 1000]);
            }
        };
        let empty = |receiver: &mut QueueReceiver| {
            while let Ok(Job::Message { data, .. }) = receiver.take(Duration::ZERO) {
                receiver.give_back(data);
            }
        };
        for _ in 0..100 {
            fill(&mut sender, 1);
            empty(&mut receiver);
        }
        let before = private_bytes();
        fill(&mut sender, 300);
        assert!(private_bytes() > before + (60 << 20));
        empty(&mut receiver);
        // Other tests of this program may hold memory for a while.
        let is_given_back = (0..600).any(|_| {
            let is_small = private_bytes() < before + (16 << 20);
            if !is_small {
                std::thread::sleep(Duration::from_millis(50));
            }
            is_small
        });
        assert!(is_given_back, "{} MB before, {} MB after", before >> 20, private_bytes() >> 20);
        drop(small);
    }

    #[test]
    fn the_oldest_files_are_surplus() {
        let totals = Totals::default();
        assert!(totals.add_file("1".into(), Some(2)).is_empty());
        assert!(totals.add_file("2".into(), Some(2)).is_empty());
        assert_eq!(totals.add_file("3".into(), Some(2)), [PathBuf::from("1")]);
        assert_eq!(totals.files(), [PathBuf::from("2"), PathBuf::from("3")]);
    }
}
