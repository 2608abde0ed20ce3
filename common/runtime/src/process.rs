//! The frame of every stage process: arguments, signals, heartbeat, and promotion from spare to active.
//!
//! A process connects to all its topics first and reports itself as a spare. Started as a spare, it
//! then sleeps until SIGUSR1 promotes it; otherwise it continues at once. SIGTERM asks any process to
//! end after the message it is working on; SIGUSR2 makes it panic, for rehearsals. A process whose
//! supervisor is gone keeps working for the configured time, so that a match outlives a crash of the
//! supervisor, and then ends, so that nothing is left running for ever.

use crate::memory_rank::{self, MemoryRank};
use crate::orphan::OrphanTimer;
use crate::scheduling;
use crate::stage_page::StagePage;
use client::bus::{Bus, BusError, KeptTopic, Publisher};
use client::clock::monotonic_ns;
use client::instance::{Instance, InstanceError};
use client::wake_up::Strategy;
use client::wake_up::WakeUp;
use config::Config;
use messages::stages::StageId;
use messages::topics::{self, Topic};
use messages::{
    DropReason, FrameHeader, GroupEvent, Heartbeat, ProcessKind, ProcessState, Revision,
    StatusHeader,
};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Sequence number before the first frame.
pub const NO_SEQ: u64 = u64::MAX;
/// Time between heartbeats.
pub const HEARTBEAT: Duration = Duration::from_millis(100);
/// Time between heartbeats of a process that drops its input: well below the stall deadline.
const HEARTBEAT_AFTER_DROP: Duration = Duration::from_millis(10);
/// Longest sleep between two calls of [`Process::keep_running`], which sends heartbeats and sees
/// requests to end.
pub const MAX_WAIT: Duration = Duration::from_millis(50);

/// For tests and rehearsals: `STAGE@NUMBER` makes that stage, or the `monitor`, panic when it receives
/// that frame, `STAGE@rNUMBER` whenever it works with that revision of the configuration. Several are separated
/// by semicolons.
pub const FAULT_VARIABLE: &str = "TOUCHLINE_FAULT";

/// Start options of a process.
#[derive(Debug, Clone)]
pub struct ProcessOptions {
    /// The group it belongs to.
    pub instance: Instance,
    /// The lane whose frames the process works on.
    pub lane: u8,
    /// Revision of the configuration it was started with.
    pub revision: Revision,
    /// Start as a spare and wait for promotion.
    pub spare: bool,
    /// The process belongs to a supervisor, and ends some time after the supervisor is gone.
    pub supervised: bool,
}

/// Reason why a process cannot continue.
#[derive(Debug, thiserror::Error)]
pub enum ProcessError {
    /// Shared memory failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The runtime directory is unusable.
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// Setting up signals, or waiting, failed.
    #[error("{action}: {source}")]
    System {
        /// The attempted action.
        action: &'static str,
        /// The system's answer.
        source: std::io::Error,
    },
    /// The stage could not be built, or its source of frames is gone.
    #[error("{0}")]
    Stage(String),
}

/// A stage process, from its start to its end.
pub struct Process {
    /// The process's membership in the group.
    pub bus: Bus,
    /// Counters so far; sent with every heartbeat.
    pub counters: Heartbeat,
    /// Topics known otherwise only to the supervisor, which may be killed and started again at any
    /// time.
    _kept: (KeptTopic<u8, StatusHeader>, KeptTopic<GroupEvent, ()>),
    page: StagePage,
    health: Publisher<Heartbeat, ()>,
    stage: StageId,
    revision: Revision,
    stop: Arc<AtomicBool>,
    panic: Arc<AtomicBool>,
    promotion: UnixStream,
    spare: bool,
    supervised: bool,
    orphan_timer: OrphanTimer,
    /// Promoted, or started as the active process.
    is_at_work: bool,
    fault: Option<u64>,
    has_faulty_revision: bool,
    skip_next: bool,
    wake_up: Strategy,
    lock_memory: bool,
    done_by_predecessor: Option<u64>,
    /// Header of the last accepted input; `None` before the first.
    accepted: Option<FrameHeader>,
    fps: f64,
    beat_ns: u64,
    beat_dropped: [u64; DropReason::ALL.len()],
}

impl Process {
    /// Joins the group, and handles signals from here on.
    pub fn start(
        kind: ProcessKind,
        options: &ProcessOptions,
        config: &Config,
    ) -> Result<Self, ProcessError> {
        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
            signal_hook::flag::register(signal, Arc::clone(&stop))
                .map_err(system("handle signals"))?;
        }
        let panic = Arc::new(AtomicBool::new(false));
        signal_hook::flag::register(signal_hook::consts::SIGUSR2, Arc::clone(&panic))
            .map_err(system("handle signals"))?;
        let (promotion, promoter) = UnixStream::pair().map_err(system("make a socket pair"))?;
        signal_hook::low_level::pipe::register(signal_hook::consts::SIGUSR1, promoter)
            .map_err(system("handle signals"))?;

        let stage = StageId::new(kind, options.lane);
        for complaint in scheduling::set_up(&config.scheduling, kind) {
            crate::tell!("{stage}: {complaint}");
        }
        let rank = if options.spare { MemoryRank::Spare } else { MemoryRank::Needed };
        let _ = memory_rank::set(rank);
        let bus = Bus::join(&options.instance, &stage.to_string())?;
        bus.enter_roster();
        let health = bus.publisher(&topics::HEALTH, 1)?;
        let kept = (bus.keep(&topics::STATUS)?, bus.keep(&topics::EVENTS)?);
        let revision = options.revision;
        let mut counters = Heartbeat::new(stage.number(), ProcessState::Spare);
        counters.revision = revision.number;
        Ok(Self {
            bus,
            counters,
            _kept: kept,
            page: StagePage::open(&options.instance, stage)
                .map_err(system("map the page of the stage"))?,
            health,
            stage,
            revision,
            stop,
            panic,
            promotion,
            fault: fault_from_environment(&stage.to_string()),
            has_faulty_revision: is_faulty_revision(&stage.to_string(), revision),
            skip_next: false,
            spare: options.spare,
            supervised: options.supervised,
            orphan_timer: OrphanTimer::new(&options.instance, config, options.supervised),
            is_at_work: false,
            wake_up: scheduling::wake_up_strategy(&config.scheduling),
            lock_memory: config.scheduling.lock_memory,
            done_by_predecessor: None,
            accepted: None,
            fps: config.camera.fps,
            beat_ns: 0,
            beat_dropped: [0; DropReason::ALL.len()],
        })
    }

    /// Revision of the configuration, to be named in every output.
    pub fn revision(&self) -> Revision {
        self.revision
    }

    /// A wake-up for a topic, of the configured kind.
    pub fn wake_up<E, H>(&self, topic: &Topic<E, H>) -> Result<WakeUp, ProcessError> {
        Ok(self.bus.wake_up_by(topic, self.wake_up)?)
    }

    /// To be called when all topics are connected. Returns when the process is to work: at once, or,
    /// for a spare, on promotion. `false` means that the process is to end instead.
    pub fn activate(&mut self) -> Result<bool, ProcessError> {
        if self.lock_memory
            && let Some(complaint) = scheduling::lock_memory()
        {
            crate::tell!("{}: {complaint}", self.stage);
        }
        self.beat(ProcessState::Spare)?;
        if self.spare {
            // Signals wake it; meanwhile a spare only sends heartbeats.
            while self.keep_running()? && !self.promoted_within(HEARTBEAT)? {}
        }
        if !self.keep_running()? {
            return Ok(false);
        }
        if self.supervised
            && let Some(handover) = self.page.note()
        {
            self.counters.seq_in = handover.resume_after;
            self.counters.seq_out = handover.resume_after;
            self.done_by_predecessor = Some(handover.resume_after);
            self.skip_next = handover.skip_next;
        }
        if self.supervised {
            // A new supervisor may not have seen the last outputs of a process that died before it
            // started.
            self.resume_after_seen(self.page.newest());
        }
        self.is_at_work = true;
        let _ = memory_rank::set(MemoryRank::Needed);
        self.beat(ProcessState::Active)?;
        Ok(true)
    }

    /// Sends the heartbeat when it is due, and returns whether to continue. To be called at least every
    /// [`MAX_WAIT`] and once per message.
    pub fn keep_running(&mut self) -> Result<bool, ProcessError> {
        let now = monotonic_ns();
        if self.stop.load(Ordering::Relaxed) {
            // The last heartbeat completes the counters of a process that ends in order.
            self.publish_heartbeat(now)?;
            return Ok(false);
        }
        if self.panic.load(Ordering::Relaxed) {
            panic!("asked to panic by SIGUSR2");
        }
        if self.is_at_work {
            self.page.check_in(now);
        }
        // A drop is progress without an output, so it is reported without delay.
        let since_beat = Duration::from_nanos(now.saturating_sub(self.beat_ns));
        let has_dropped = self.counters.dropped != self.beat_dropped;
        if since_beat < if has_dropped { HEARTBEAT_AFTER_DROP } else { HEARTBEAT } {
            return Ok(true);
        }
        self.publish_heartbeat(now)?;
        Ok(self.orphan_timer.may_continue(now))
    }

    /// Reports a change of state at once.
    pub fn beat(&mut self, state: ProcessState) -> Result<(), ProcessError> {
        self.counters.state = state as u32;
        self.publish_heartbeat(monotonic_ns())
    }

    /// Reports a state, at once if it has changed.
    pub fn is_now(&mut self, state: ProcessState) -> Result<(), ProcessError> {
        if self.counters.state == state as u32 { Ok(()) } else { self.beat(state) }
    }

    fn publish_heartbeat(&mut self, now: u64) -> Result<(), ProcessError> {
        self.beat_ns = now;
        self.beat_dropped = self.counters.dropped;
        self.counters.t_sent_ns = now;
        self.health.publish(&self.counters)?;
        let stands_by = self.spare && !self.is_at_work;
        Ok(self.bus.refresh(stands_by)?)
    }

    fn promoted_within(&self, timeout: Duration) -> Result<bool, ProcessError> {
        let timeout = Timespec { tv_sec: 0, tv_nsec: timeout.as_nanos() as _ };
        match poll(&mut [PollFd::new(&self.promotion, PollFlags::IN)], Some(&timeout)) {
            Ok(ready) => Ok(ready > 0),
            Err(rustix::io::Errno::INTR) => Ok(false),
            Err(error) => Err(system("wait for promotion")(error.into())),
        }
    }
}

/// Counts the inputs and outputs of a stage.
impl Process {
    /// Decides whether to work on an input. `false`, and counted as a drop, if its number is not above
    /// the last one's, or if it killed two predecessors. Gaps are counted too.
    ///
    /// A number that the camera cannot have reached since the last frame is rejected: accepting it
    /// would make every later frame look old.
    pub fn accept(&mut self, frame: &FrameHeader) -> bool {
        let seq = frame.seq;
        let counters = &mut self.counters;
        if counters.seq_in != NO_SEQ {
            if seq <= counters.seq_in {
                self.drop_input(DropReason::OutOfOrder);
                return false;
            }
            let is_reachable = |last: FrameHeader| {
                frame.is_reachable(last.seq, last.t_capture_ns, monotonic_ns(), self.fps)
            };
            if !self.accepted.is_none_or(is_reachable) {
                self.drop_input(DropReason::BadHeader);
                return false;
            }
            counters.frames_missed += seq - counters.seq_in - 1;
        }
        self.accepted = Some(*frame);
        counters.seq_in = seq;
        counters.frames_in += 1;
        if std::mem::take(&mut self.skip_next) {
            self.drop_input(DropReason::Poisonous);
            return false;
        }
        if self.has_faulty_revision {
            panic!("asked to panic with revision {} by {FAULT_VARIABLE}", self.revision);
        }
        if self.fault == Some(seq) {
            panic!("asked to panic at {seq} by {FAULT_VARIABLE}");
        }
        true
    }

    /// Continues after the newest output of this stage that the process itself has seen: a supervisor
    /// that has only just taken over may not have seen it. To be called after
    /// [`activate`](Self::activate).
    pub fn resume_after_seen(&mut self, seen: Option<u64>) {
        if seen > self.done_by_predecessor {
            self.done_by_predecessor = seen;
            self.counters.seq_in = seen.unwrap_or(NO_SEQ);
            self.counters.seq_out = self.counters.seq_in;
            self.skip_next = false;
        }
    }

    /// The last output of this process's predecessors; `None` when there were none.
    pub fn resumes_after(&self) -> Option<u64> {
        self.done_by_predecessor
    }

    /// Whether a predecessor of this process has handled the input. A spare's buffer is full of such
    /// inputs when it is promoted; they are skipped without work, and do not count as drops.
    pub fn is_done_by_predecessor(&self, seq: u64) -> bool {
        self.done_by_predecessor >= Some(seq)
    }

    /// Counts an output.
    pub fn sent(&mut self, seq: u64) {
        self.counters.seq_out = seq;
        self.counters.frames_out += 1;
        self.page.set_newest(seq);
    }

    /// Counts a dropped input.
    pub fn drop_input(&mut self, reason: DropReason) {
        self.counters.dropped[reason as usize] += 1;
    }
}

/// The frame at which the named part of the group must panic, from [`FAULT_VARIABLE`].
pub fn fault_from_environment(name: &str) -> Option<u64> {
    faults_of(name).iter().find_map(|fault| fault.parse().ok())
}

/// Whether the named stage must panic with this revision, according to [`FAULT_VARIABLE`].
fn is_faulty_revision(name: &str, revision: Revision) -> bool {
    faults_of(name).iter().any(|fault| *fault == format!("r{}", revision.number))
}

fn faults_of(name: &str) -> Vec<String> {
    let faults = std::env::var(FAULT_VARIABLE).unwrap_or_default();
    let of_stage = |fault: &str| {
        let (stage, what) = fault.rsplit_once('@')?;
        (stage == name).then(|| what.to_string())
    };
    faults.split(';').filter_map(of_stage).collect()
}

pub(crate) fn system(action: &'static str) -> impl FnOnce(std::io::Error) -> ProcessError {
    move |source| ProcessError::System { action, source }
}
