//! The writing thread: compresses and writes, and never lets more than a fraction of a tenth of a
//! second wait in memory. A third thread brings what was written to the disk once a second.

use super::RecorderError;
use super::files::Names;
use super::queue::{Entrance, Exit, Job, Recorded, Totals, queue};
use super::room::{free_bytes, index_bytes};
use common::config::Config;
use common::messages::WorldFrame;
use recording::{
    Channel, RecordingError, Setup, Writer, ball_pose, decode_message, field_scene, robot_poses,
    world_scene,
};
use std::fs::File;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A message waits no longer than this before its chunk is written: with the time of reading and
/// compressing, less than 100 ms are lost when the recorder is killed.
const CHUNK_TIME: Duration = Duration::from_millis(40);
/// How often the system is asked to bring the file to the disk: so much is lost with the power.
const SYNC_PERIOD: Duration = Duration::from_secs(1);
/// After so many bytes it is looked whether the disk has room for more.
const LOOK_BYTES: u64 = 1 << 20;
/// Compressing has time; the group's processes do not.
const NICENESS: i32 = 5;

/// When a file is full.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Bytes in one file.
    pub file_bytes: Option<u64>,
    /// Files to keep, the newest.
    pub keep_files: Option<usize>,
    /// What is to stay free on the disk.
    pub keep_free_bytes: u64,
}

/// What became of a recording.
pub struct Written {
    /// For the files to come.
    pub names: Names,
    /// It ended because more would not have fit onto the disk.
    pub is_disk_full: bool,
}

/// The reading thread's side of the writing thread.
pub struct Disk {
    entrance: Entrance,
    thread: JoinHandle<Result<Written, RecorderError>>,
}

impl Disk {
    /// Begins a file and starts to wait for messages.
    pub fn start(
        names: Names,
        channels: Vec<Channel>,
        limits: Limits,
        setup: (Setup, Config),
        totals: Arc<Totals>,
    ) -> Result<Self, RecordingError> {
        let (entrance, exit) = queue(Arc::clone(&totals));
        let (to_sync, sync_jobs) = channel();
        std::thread::spawn(move || sync(&sync_jobs));
        let mut writing = Writing {
            names,
            channels,
            limits,
            setup,
            totals,
            to_sync,
            writer: None,
            unseen_bytes: 0,
        };
        // In this thread, so that whoever started the recording learns at once if it is impossible.
        writing.next_file()?;
        let thread = std::thread::spawn(move || writing.run(exit));
        Ok(Self { entrance, thread })
    }

    /// Hands a message over.
    pub fn put(&mut self, message: Recorded<'_>) {
        self.entrance.put(message);
    }

    /// The group's configuration has changed.
    pub fn put_setup(&mut self, setup: (Setup, Config)) {
        self.entrance.put_job(Job::Setup(Box::new(setup)));
    }

    /// What follows belongs into another file.
    pub fn next_file(&mut self, setup: (Setup, Config)) {
        self.entrance.put_job(Job::NextFile(Box::new(setup)));
    }

    /// Whether writing has ended, because of an error or of the end of the disk, which
    /// [`finish`](Self::finish) tells.
    pub fn has_ended(&self) -> bool {
        self.thread.is_finished()
    }

    /// Writes what is waiting and completes the file.
    pub fn finish(self) -> Result<Written, RecorderError> {
        drop(self.entrance);
        // A panic of the other thread ends the process.
        self.thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}

struct Writing {
    names: Names,
    channels: Vec<Channel>,
    limits: Limits,
    setup: (Setup, Config),
    totals: Arc<Totals>,
    to_sync: Sender<File>,
    writer: Option<Writer>,
    /// Written since it was last looked how much room there is.
    unseen_bytes: u64,
}

impl Writing {
    fn run(mut self, mut exit: Exit) -> Result<Written, RecorderError> {
        // Without the right to be nice it is written all the same.
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
            match exit.take(if is_pending { left } else { CHUNK_TIME }) {
                Ok(job) => {
                    if !is_pending {
                        begun = Instant::now();
                    }
                    if let Some(buffer) = self.carry_out(job)? {
                        exit.give_back(buffer);
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

    /// Whether what waits in memory and the index still leave free what is to stay free.
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
            Job::Message { channel, t_sent_ns, t_about_ns, data } => {
                let (setup, config) = &self.setup;
                let (t_sent_ns, t_about_ns) = (setup.wall_ns(t_sent_ns), setup.wall_ns(t_about_ns));
                let Some(writer) = &mut self.writer else { return Ok(Some(data)) };
                self.unseen_bytes += data.len() as u64;
                if self.channels.contains(&channel) {
                    writer.write(channel, t_sent_ns, t_about_ns, &data)?;
                    self.totals.count_written(channel);
                }
                if channel == Channel::World {
                    draw(writer, &self.channels, config, &data, t_sent_ns, t_about_ns)?;
                }
                return Ok(Some(data));
            }
            Job::Setup(setup) => {
                self.setup = *setup;
                self.write_setup()?;
            }
            Job::NextFile(setup) => {
                self.setup = *setup;
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
            // Whoever has removed it before us has spared us the work.
            let _ = std::fs::remove_file(surplus);
        }
        self.write_setup()
    }

    fn write_setup(&mut self) -> Result<(), RecordingError> {
        let Some(writer) = &mut self.writer else { return Ok(()) };
        let (setup, config) = &self.setup;
        let now_ns = setup.wall_ns(common::clock::monotonic_ns());
        writer.write(Channel::Setup, now_ns, now_ns, &setup.encode())?;
        let pitch = field_scene(&config.field, now_ns);
        writer.write(Channel::Scene, now_ns, now_ns, &pitch)
    }
}

/// Adds what viewers draw.
fn draw(
    writer: &mut Writer,
    channels: &[Channel],
    config: &Config,
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

/// Brings the newest file to the disk again and again, until there are no more files to come.
fn sync(files: &Receiver<File>) {
    let mut newest: Option<File> = None;
    loop {
        match files.recv_timeout(SYNC_PERIOD) {
            Ok(file) => newest = Some(file),
            Err(RecvTimeoutError::Timeout) => {
                if let Some(file) = &newest {
                    // The writing thread meets the same disk, and says what is wrong with it.
                    let _ = file.sync_data();
                }
            }
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}
