//! The recorder: a consumer that writes the messages of a group's topics to a file.
//!
//! [`ports`] copies messages out of shared memory without wake-ups and without blocking; a bounded
//! [`queue`] hands them to the thread of [`disk`], which compresses and writes. When the disk is too
//! slow the queue fills up, and messages are dropped and counted here; the group never notices.

mod configurations;
mod disk;
mod files;
mod ports;
mod queue;
mod room;

use client::bus::BusError;
use client::consumer::is_there;
use client::instance::Instance;
use configurations::Configurations;
use disk::{Disk, Limits};
use files::Names;
use ports::Ports;
use queue::{Recorded, Totals};
use recording::{Channel, RecordingError};
use room::{bytes_per_second, free_bytes};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

pub use files::recover_family;

/// Time between two rounds of reading: the topics' buffers hold 64 messages.
const POLL: Duration = Duration::from_millis(2);
/// Time between two checks of free space and configuration, and between two progress reports.
const LOOK: Duration = Duration::from_millis(500);
/// Silence after which the recorder checks whether the group is still there.
const SILENCE: Duration = Duration::from_secs(1);

/// Options of a recording.
#[derive(Debug, Clone)]
pub struct Options {
    /// The group.
    pub instance: Instance,
    /// The first file; further files have a number added.
    pub path: PathBuf,
    /// Channels to record.
    pub channels: Vec<Channel>,
    /// Duration of the recording.
    pub duration: Option<Duration>,
    /// Size at which a new file is started.
    pub file_bytes: Option<u64>,
    /// Number of files to keep, the newest.
    pub keep_files: Option<usize>,
    /// Stop when less than this is free on the disk.
    pub keep_free_bytes: u64,
}

/// Reason for which a recording fails.
#[derive(Debug, thiserror::Error)]
pub enum RecorderError {
    /// Shared memory failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The file failed.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The size limit holds less than a second, so that files would be started all the time.
    #[error(
        "--max-size {} kB is too small: a second of this group's recording may take {} kB, and no file is \
         begun more often",
        file_bytes.div_ceil(1000), second_bytes.div_ceil(1000)
    )]
    SmallFiles {
        /// The requested size.
        file_bytes: u64,
        /// Bytes per second of recording.
        second_bytes: u64,
    },
    /// The system refused something.
    #[error("{action}: {source}")]
    System {
        /// The attempted action.
        action: String,
        /// The system's answer.
        source: std::io::Error,
    },
}

/// Reason for which a recording has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// It was stopped.
    Stopped,
    /// Its duration is over.
    TimeIsOver,
    /// The disk is nearly full.
    DiskNearlyFull,
}

/// Progress or outcome of a recording.
#[derive(Debug, Clone)]
pub struct Progress {
    /// The newest file.
    pub path: PathBuf,
    /// All files of this recording that still exist.
    pub files: Vec<PathBuf>,
    /// Time since the first message.
    pub elapsed: Duration,
    /// Bytes in all files.
    pub bytes: u64,
    /// Messages written, by channel.
    pub written: BTreeMap<Channel, u64>,
    /// Messages dropped because the disk was too slow, by channel.
    pub dropped: BTreeMap<Channel, u64>,
    /// Frame numbers never received, by channel.
    pub missed: BTreeMap<Channel, u64>,
    /// Bytes free on the disk.
    pub free_bytes: u64,
    /// The group does not run (yet).
    pub is_waiting: bool,
}

/// Records until told to stop, or a limit is reached. `tell` is called now and then.
pub fn record(
    options: &Options,
    stop: &Arc<AtomicBool>,
    mut tell: impl FnMut(&Progress),
) -> Result<(End, Progress), RecorderError> {
    // While the disk is slow, hundreds of frames wait in memory.
    runtime::heap::return_large_blocks();
    let mut recorder = Recorder {
        options,
        stop,
        names: Names::new(&options.path),
        totals: Arc::new(Totals::default()),
        missed: BTreeMap::new(),
        began: None,
        is_waiting: true,
    };
    let end = loop {
        if let Some(end) = recorder.is_over()? {
            break end;
        }
        if is_there(&options.instance) {
            recorder.is_waiting = false;
            if let Some(end) = recorder.follow_group(&mut tell)? {
                break end;
            }
            recorder.is_waiting = true;
        }
        tell(&recorder.progress()?);
        std::thread::sleep(Duration::from_millis(100));
    };
    let progress = recorder.progress()?;
    Ok((end, progress))
}

struct Recorder<'a> {
    options: &'a Options,
    stop: &'a AtomicBool,
    names: Names,
    totals: Arc<Totals>,
    missed: BTreeMap<Channel, u64>,
    began: Option<Instant>,
    is_waiting: bool,
}

impl Recorder<'_> {
    fn is_over(&self) -> Result<Option<End>, RecorderError> {
        let is_late = |began: Instant| {
            self.options.duration.is_some_and(|duration| began.elapsed() >= duration)
        };
        Ok(if self.stop.load(Ordering::Relaxed) {
            Some(End::Stopped)
        } else if self.began.is_some_and(is_late) {
            Some(End::TimeIsOver)
        } else {
            None
        })
    }

    /// Records a group until it ends (`None`) or the recording does.
    fn follow_group(
        &mut self,
        tell: &mut impl FnMut(&Progress),
    ) -> Result<Option<End>, RecorderError> {
        let mut ports = Ports::connect(&self.options.instance, &self.options.channels)?;
        let mut configurations = self.configurations()?;
        if free_bytes(&self.options.path)? < self.options.keep_free_bytes {
            return Ok(Some(End::DiskNearlyFull));
        }
        let limits = Limits {
            file_bytes: self.options.file_bytes,
            keep_files: self.options.keep_files,
            keep_free_bytes: self.options.keep_free_bytes,
        };
        let mut disk = Disk::start(
            self.names.clone(),
            self.options.channels.clone(),
            limits,
            configurations.newest().clone(),
            Arc::clone(&self.totals),
        )?;
        self.began.get_or_insert_with(Instant::now);
        let (mut looked, mut heard) = (Instant::now(), Instant::now());
        let end = loop {
            let taken = ports.take(|message| put(&mut disk, &mut configurations, message))?;
            if taken.is_anew {
                // Frame numbers have restarted: a new group, so a new file.
                configurations = self.configurations()?;
                disk.next_file(configurations.newest().clone());
            }
            if taken.messages > 0 {
                heard = Instant::now();
            }
            // `finish` says why.
            if disk.has_ended() {
                break None;
            }
            if let Some(end) = self.is_over()? {
                break Some(end);
            }
            if looked.elapsed() >= LOOK {
                looked = Instant::now();
                // Not all of them concern a stage.
                configurations.look().into_iter().for_each(|it| disk.put_setup(it));
                self.missed = ports.missed();
                tell(&self.progress()?);
            }
            if heard.elapsed() > SILENCE {
                heard = Instant::now();
                if !is_there(&self.options.instance) {
                    break None;
                }
            }
            std::thread::sleep(POLL);
        };
        ports.take(|message| put(&mut disk, &mut configurations, message))?;
        self.missed = ports.missed();
        let written = disk.finish()?;
        self.names = written.names;
        Ok(if written.is_disk_full { Some(End::DiskNearlyFull) } else { end })
    }

    /// The configurations of a group that is met now. Refuses a file size that holds less than a second of it.
    fn configurations(&self) -> Result<Configurations, RecorderError> {
        // Read once per group, so that a clock change during a match does not disturb the order of its
        // messages.
        let it = Configurations::new(&self.options.instance, wall_minus_monotonic_ns());
        let config = &it.newest().snapshot.config;
        let second_bytes = bytes_per_second(config, &self.options.channels);
        match self.options.file_bytes {
            Some(file_bytes) if file_bytes < second_bytes => {
                Err(RecorderError::SmallFiles { file_bytes, second_bytes })
            }
            _ => Ok(it),
        }
    }

    fn progress(&self) -> Result<Progress, RecorderError> {
        let files = self.totals.files();
        let bytes = files.iter().map(|path| path.metadata().map_or(0, |data| data.len())).sum();
        Ok(Progress {
            path: files.last().cloned().unwrap_or_else(|| self.options.path.clone()),
            files,
            elapsed: self.began.map_or(Duration::ZERO, |began| began.elapsed()),
            bytes,
            written: self.totals.written(),
            dropped: self.totals.dropped(),
            missed: self.missed.clone(),
            free_bytes: free_bytes(&self.options.path)?,
            is_waiting: self.is_waiting,
        })
    }
}

/// Queues a message, after the configurations that it is the first to name.
fn put(disk: &mut Disk, configurations: &mut Configurations, message: Recorded<'_>) {
    for configuration in configurations.of_output(&message.revisions) {
        disk.put_setup(configuration);
    }
    disk.put(message);
}

fn wall_minus_monotonic_ns() -> i64 {
    let now_ns = client::clock::monotonic_ns();
    client::clock::wall_ns() as i64 - now_ns as i64
}
