//! The writing thread: compresses and writes, and keeps less than a tenth of a second in memory. A third
//! thread syncs the file to the disk once a second.

use super::RecorderError;
use super::configurations::{Configuration, Coverage, Revisions};
use super::files::Names;
use super::queue::{Job, QueueReceiver, QueueSender, Recorded, Totals, queue};
use super::room::{free_bytes, index_bytes};
use messages::WorldFrame;
use recording::{
    Channel, RecordingError, Writer, ball_pose, decode_message, field_scene, robot_poses,
    world_scene,
};
use std::collections::BTreeMap;
use std::fs::File;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest time before a chunk is written: with the time of reading and compressing, less than 100
/// ms are lost when the recorder is killed.
const CHUNK_TIME: Duration = Duration::from_millis(40);
/// Time between two syncs of the file: at most this much is lost in a power failure.
const SYNC_PERIOD: Duration = Duration::from_secs(1);
/// Bytes written between two checks of the free space.
const LOOK_BYTES: u64 = 1 << 20;
/// Most configurations kept for the beginnings of further files.
const MOST_KEPT: usize = 64;
/// Niceness of the writing thread: compression can wait, the group's processes cannot.
const NICENESS: i32 = 5;

/// Limits of files and disk.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Bytes in one file.
    pub file_bytes: Option<u64>,
    /// Number of files to keep, the newest.
    pub keep_files: Option<usize>,
    /// Bytes to leave free on the disk.
    pub keep_free_bytes: u64,
}

/// Outcome of a recording.
pub struct Written {
    /// Names for further files.
    pub names: Names,
    /// It ended because the disk is nearly full.
    pub is_disk_full: bool,
}

/// The reading thread's handle of the writing thread.
pub struct Disk {
    sender: QueueSender,
    thread: JoinHandle<Result<Written, RecorderError>>,
}

impl Disk {
    /// Opens a file and starts the thread.
    pub fn start(
        names: Names,
        channels: Vec<Channel>,
        limits: Limits,
        newest: Configuration,
        totals: Arc<Totals>,
    ) -> Result<Self, RecordingError> {
        let (sender, receiver) = queue(Arc::clone(&totals));
        let (to_sync, sync_jobs) = channel();
        std::thread::spawn(move || sync(&sync_jobs));
        let mut writing = Writing {
            names,
            channels,
            limits,
            kept: BTreeMap::new(),
            coverage: Coverage::default(),
            newest,
            last_sent_ns: None,
            began_wall_ns: 0,
            totals,
            to_sync,
            writer: None,
            unseen_bytes: 0,
        };
        // In this thread, so that the caller learns at once if it fails.
        writing.next_file()?;
        let thread = std::thread::spawn(move || writing.run(receiver));
        Ok(Self { sender, thread })
    }

    /// Queues a message.
    pub fn put(&mut self, message: Recorded<'_>) {
        self.sender.put(message);
    }

    /// Queues a configuration of the group, to be written before all further messages.
    pub fn put_setup(&mut self, configuration: Configuration) {
        self.sender.put_job(Job::Setup(Box::new(configuration)));
    }

    /// Starts another file for all further messages, which are of another group.
    pub fn next_file(&mut self, configuration: Configuration) {
        self.sender.put_job(Job::NextFile(Box::new(configuration)));
    }

    /// Whether writing has ended, because of an error or a nearly full disk;
    /// [`finish`](Self::finish) says which.
    pub fn has_ended(&self) -> bool {
        self.thread.is_finished()
    }

    /// Writes the queued messages and completes the file.
    pub fn finish(self) -> Result<Written, RecorderError> {
        drop(self.sender);
        // A panic of the other thread ends the process.
        self.thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}

struct Writing {
    names: Names,
    channels: Vec<Channel>,
    limits: Limits,
    newest: Configuration,
    /// Configurations of this group by revision: outputs may name them in the next file too.
    kept: BTreeMap<u32, Configuration>,
    /// Configurations in the present file.
    coverage: Coverage,
    /// When the last message was sent, nanoseconds since 1970.
    last_sent_ns: Option<u64>,
    /// Time of the first message of the present file.
    began_wall_ns: u64,
    totals: Arc<Totals>,
    to_sync: Sender<File>,
    writer: Option<Writer>,
    /// Bytes written since the free space was last checked.
    unseen_bytes: u64,
}

impl Writing {
    fn run(mut self, mut receiver: QueueReceiver) -> Result<Written, RecorderError> {
        // Ignore failures: niceness is optional.
        let _ = rustix::process::nice(NICENESS);
        let mut begun = Instant::now();
        loop {
            let is_pending = self.writer.as_ref().is_some_and(Writer::is_pending);
            let left = CHUNK_TIME.saturating_sub(begun.elapsed());
            if (is_pending && left.is_zero()) || self.unseen_bytes >= LOOK_BYTES {
                if !self.has_room()? {
                    return self.finish(true);
                }
                self.unseen_bytes = 0;
                self.flush()?;
                continue;
            }
            match receiver.take(if is_pending { left } else { CHUNK_TIME }) {
                Ok(job) => {
                    if !is_pending {
                        begun = Instant::now();
                    }
                    if let Some(buffer) = self.carry_out(job)? {
                        receiver.give_back(buffer);
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    let is_disk_full = !self.has_room()?;
                    return self.finish(is_disk_full);
                }
            }
        }
    }

    /// Whether the queued messages and the index still fit above the bytes to leave free.
    fn has_room(&self) -> Result<bool, RecorderError> {
        let Some(writer) = &self.writer else { return Ok(true) };
        let wanted = self.limits.keep_free_bytes.saturating_add(self.unseen_bytes);
        Ok(free_bytes(writer.path())? >= wanted.saturating_add(index_bytes(writer.bytes())))
    }

    fn finish(mut self, is_disk_full: bool) -> Result<Written, RecorderError> {
        if let Some(writer) = self.writer.take() {
            writer.finish()?;
        }
        Ok(Written { names: self.names, is_disk_full })
    }

    fn carry_out(&mut self, job: Job) -> Result<Option<Vec<u8>>, RecordingError> {
        match job {
            Job::Message { channel, revisions, t_sent_ns, t_about_ns, data } => {
                self.write_lacking(&revisions)?;
                let Configuration { setup, snapshot } = &self.newest;
                let (t_sent_ns, t_about_ns) = (setup.wall_ns(t_sent_ns), setup.wall_ns(t_about_ns));
                self.last_sent_ns = Some(t_sent_ns);
                let Some(writer) = &mut self.writer else { return Ok(Some(data)) };
                self.unseen_bytes += data.len() as u64;
                if self.channels.contains(&channel) {
                    writer.write(channel, t_sent_ns, t_about_ns, &data)?;
                    self.totals.count_written(channel);
                }
                if channel == Channel::World {
                    let config = &snapshot.config;
                    draw(writer, &self.channels, config, &data, t_sent_ns, t_about_ns)?;
                }
                return Ok(Some(data));
            }
            Job::Setup(configuration) => self.take_configuration(*configuration)?,
            Job::NextFile(configuration) => {
                self.newest = *configuration;
                self.kept.clear();
                self.next_file()?;
            }
        }
        Ok(None)
    }

    fn flush(&mut self) -> Result<(), RecordingError> {
        let Some(writer) = &mut self.writer else { return Ok(()) };
        writer.flush()?;
        if self.limits.file_bytes.is_some_and(|limit| writer.bytes() >= limit) {
            self.next_file()?;
        }
        Ok(())
    }

    fn next_file(&mut self) -> Result<(), RecordingError> {
        if let Some(writer) = self.writer.take() {
            writer.finish()?;
        }
        let path = self.names.next_free();
        let mut channels = self.channels.clone();
        channels.push(Channel::Setup);
        let writer = Writer::create(&path, &channels)?;
        if let Some(file) = writer.sync_handle() {
            let _ = self.to_sync.send(file);
        }
        self.writer = Some(writer);
        for surplus in self.totals.add_file(path, self.limits.keep_files) {
            // Ignore failures: it may have been removed already.
            let _ = std::fs::remove_file(surplus);
        }
        self.coverage = Coverage::default();
        let newest = self.newest.clone();
        self.write_setup(&newest)
    }

    fn take_configuration(&mut self, it: Configuration) -> Result<(), RecordingError> {
        let number = it.setup.revision;
        self.write_setup(&it)?;
        if number == 0 || number > self.newest.setup.revision {
            let before = std::mem::replace(&mut self.newest, it);
            self.keep(before);
        } else {
            self.keep(it);
        }
        Ok(())
    }

    fn keep(&mut self, it: Configuration) {
        self.kept.insert(it.setup.revision, it);
        if self.kept.len() > MOST_KEPT {
            self.kept.pop_first();
        }
    }

    /// Writes the configurations that an output names and that the file still lacks.
    fn write_lacking(&mut self, revisions: &Revisions) -> Result<(), RecordingError> {
        for number in self.coverage.lacks(revisions) {
            if let Some(it) = self.kept.get(&number).cloned() {
                self.write_setup(&it)?;
            }
        }
        Ok(())
    }

    /// Writes a configuration, and with the newest one a drawing of the pitch.
    ///
    /// Its time is that of its acceptance, which precedes its outputs, whenever it is written; in a file that
    /// begins later, that of the message before.
    fn write_setup(&mut self, it: &Configuration) -> Result<(), RecordingError> {
        let Some(writer) = &mut self.writer else { return Ok(()) };
        let Configuration { setup, snapshot } = it;
        let is_first = self.coverage.is_empty();
        let before_ns = match self.last_sent_ns {
            Some(sent_ns) if is_first => sent_ns,
            _ => setup.wall_ns(client::clock::monotonic_ns()),
        };
        let t_ns = match setup.accepted_wall_ns {
            accepted_ns if is_first || accepted_ns == 0 => before_ns,
            accepted_ns => accepted_ns.clamp(self.began_wall_ns, before_ns.max(self.began_wall_ns)),
        };
        if is_first {
            self.began_wall_ns = t_ns;
        }
        writer.write(Channel::Setup, t_ns, t_ns, &setup.encode())?;
        self.coverage.add(snapshot);
        if setup.revision >= self.newest.setup.revision {
            let pitch = field_scene(&snapshot.config.field, t_ns);
            writer.write(Channel::Scene, t_ns, t_ns, &pitch)?;
        }
        Ok(())
    }
}

/// Adds the drawings for viewers.
fn draw(
    writer: &mut Writer,
    channels: &[Channel],
    config: &config::Config,
    world: &[u8],
    t_sent_ns: u64,
    t_about_ns: u64,
) -> Result<(), RecordingError> {
    if !channels.iter().any(|channel| channel.is_derived()) {
        return Ok(());
    }
    let Some(world) = decode_message::<WorldFrame>(world) else { return Ok(()) };
    let scene = world_scene(&world, config.robots.size_mm, config.ball.diameter_mm);
    writer.write(Channel::Scene, t_sent_ns, t_about_ns, &scene)?;
    writer.write(Channel::Robots, t_sent_ns, t_about_ns, &robot_poses(&world))?;
    if let Some(ball) = ball_pose(&world) {
        writer.write(Channel::Ball, t_sent_ns, t_about_ns, &ball)?;
    }
    Ok(())
}

/// Syncs the newest file to the disk again and again, until there are no more files.
fn sync(files: &Receiver<File>) {
    let mut newest: Option<File> = None;
    loop {
        match files.recv_timeout(SYNC_PERIOD) {
            Ok(file) => newest = Some(file),
            Err(RecvTimeoutError::Timeout) => {
                if let Some(file) = &newest {
                    // The writing thread meets the same error, and reports it.
                    let _ = file.sync_data();
                }
            }
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}
