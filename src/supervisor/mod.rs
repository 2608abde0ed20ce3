//! The supervisor: starts the group, watches it, replaces what fails, and cleans up at the end.
//!
//! [`policy`] decides, [`children`] does, [`progress`] looks, [`takeover`] deals with what an earlier
//! supervisor has left, [`evidence`] keeps what a bug report needs; this file ties them together.

mod children;
mod evidence;
mod notify;
mod policy;
mod progress;
mod takeover;

pub use children::Launch;

use crate::monitor::{Event as LogEvent, GroupView, Monitor, ProcessView};
use children::Process;
use common::bus::{Bus, BusError};
use common::clock::monotonic_ns;
use common::config::Config;
use common::handover::Handover;
use common::instance::InstanceError;
use common::messages::{ProcessKind, ProcessState};
use notify::Notifier;
use policy::{Action, Cause, Event, MemberId, Policy, Settings};
use progress::Progress;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::Signal;
use std::collections::{BTreeMap, HashMap};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::time::{Duration, Instant};
use takeover::Inherited;

/// Why a group could not be run.
#[derive(Debug, thiserror::Error)]
pub enum SupervisorError {
    /// Shared memory.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Runtime directory.
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// Somebody else supervises it.
    #[error(
        "the group {0:?} is running already; look at it with `touchline status --instance {0}`, end \
         it with `touchline stop --instance {0}`, or give this one another name with --instance"
    )]
    AlreadyRunning(String),
    /// Stages of a dead supervisor that do not go away.
    #[error("processes {0:?} of an earlier group {1:?} do not end; end them by hand")]
    Undead(Vec<u32>, String),
    /// The operating system.
    #[error("{action}: {source}")]
    System {
        /// What was tried.
        action: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// A stage keeps failing at the start of the run.
    #[error("the {stage} does not start: {reason}")]
    NoStart {
        /// Which.
        stage: &'static str,
        /// What it said last.
        reason: String,
    },
}

/// How often topics and heartbeats are looked at.
const TICK: Duration = Duration::from_millis(5);
/// How long processes have to end in order before they are killed.
const GRACE: Duration = Duration::from_secs(2);
/// How long the last results may take when the group is told to end.
const DRAIN: Duration = Duration::from_millis(100);
/// How long after the camera's last frame results are waited for.
const LAST_RESULTS: Duration = Duration::from_secs(2);
/// Processes give a sign of life ten times a second.
const FIRST_WORD: Duration = Duration::from_millis(600);
/// So many failures before anything ever worked mean that it never will.
const HOPELESS_STARTS: u32 = 3;

/// How long a group runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Until {
    /// Somebody ends it.
    Stopped,
    /// The grabber has captured its frames, and their results are out.
    Finished,
}

/// Runs a group until it is done or told to stop.
pub struct Supervisor {
    launch: Launch,
    policy: Policy,
    processes: HashMap<MemberId, Process>,
    progress: Progress,
    outputs: [Option<u64>; ProcessKind::ALL.len()],
    skip_after: HashMap<ProcessKind, u64>,
    dropped: HashMap<u32, u64>,
    states: HashMap<u32, ProcessState>,
    restarts: BTreeMap<ProcessKind, u64>,
    start_failures: u32,
    ever_complete: bool,
    finished: bool,
    last_output: Instant,
    notifier: Notifier,
    view: Arc<GroupView>,
    stop: UnixStream,
}

/// Runs the group. Returns when it has ended and nothing of it is left, neither a process nor
/// shared memory; what the run was like is in the monitor's report.
pub fn run(
    launch: Launch,
    config: &Config,
    until: Until,
    start_monitor: impl FnOnce(Arc<GroupView>) -> Result<Monitor, BusError>,
) -> Result<crate::monitor::Report, SupervisorError> {
    let instance = launch.instance.clone();
    instance.create_directory()?;
    let Some(lock) = instance.lock()? else {
        return Err(SupervisorError::AlreadyRunning(instance.name().into()));
    };
    let stop = stop_signals()?;
    let inherited = takeover::prepare(&launch, config)?;

    let view = Arc::new(GroupView::new(std::process::id()));
    let outcome =
        supervise(launch, config, until, Arc::clone(&view), stop, &inherited, start_monitor);

    // Also after an error: nothing is left behind.
    takeover::tidy_up(&instance)?;
    drop(lock);
    outcome
}

fn supervise(
    launch: Launch,
    config: &Config,
    until: Until,
    view: Arc<GroupView>,
    stop: UnixStream,
    inherited: &[Inherited],
    start_monitor: impl FnOnce(Arc<GroupView>) -> Result<Monitor, BusError>,
) -> Result<crate::monitor::Report, SupervisorError> {
    let progress = Progress::new(&launch.instance)?;
    let monitor = start_monitor(Arc::clone(&view))?;
    let mut supervisor = Supervisor {
        launch,
        policy: Policy::new(settings(config)),
        processes: HashMap::new(),
        progress,
        outputs: [None; ProcessKind::ALL.len()],
        skip_after: HashMap::new(),
        dropped: HashMap::new(),
        states: HashMap::new(),
        restarts: BTreeMap::new(),
        start_failures: 0,
        // What is taken over has worked before.
        ever_complete: !inherited.is_empty(),
        finished: false,
        last_output: Instant::now(),
        notifier: Notifier::from_environment(),
        view,
        stop,
    };
    let outcome = supervisor.adopt(inherited).and_then(|()| supervisor.watch(until));
    supervisor.end_all();
    // The monitor ends last, when every counter has its final value.
    let report = monitor.finish();
    outcome.map(|()| report)
}

impl Supervisor {
    /// Takes over processes of an earlier supervisor. They say themselves what they are, several
    /// times a second; one that says nothing is stuck.
    fn adopt(&mut self, inherited: &[Inherited]) -> Result<(), SupervisorError> {
        let mut silent: BTreeMap<u32, ProcessKind> =
            inherited.iter().map(|process| (process.pid, process.kind)).collect();
        let deadline = Instant::now() + FIRST_WORD;
        while !silent.is_empty() && Instant::now() < deadline {
            let mut signs = Vec::new();
            self.progress.heartbeats(|sign| signs.push(sign))?;
            for sign in signs {
                if silent.remove(&sign.pid).is_none() {
                    continue;
                }
                let is_spare = sign.state == ProcessState::Spare;
                self.take_in(sign.kind, sign.pid, is_spare)?;
                self.states.insert(sign.pid, sign.state);
            }
            std::thread::sleep(TICK);
        }
        for (pid, kind) in silent {
            self.log(kind, pid, "killed: it did not answer the new supervisor", "");
            takeover::kill(pid);
        }
        if !inherited.is_empty() {
            self.act(Action::CleanUp)?;
        }
        Ok(())
    }

    fn take_in(&mut self, kind: ProcessKind, pid: u32, spare: bool) -> Result<(), SupervisorError> {
        // It may just have ended.
        let Ok(process) = Process::adopt(kind, pid) else { return Ok(()) };
        match self.policy.adopt(kind, spare, false, monotonic_ns()) {
            Some(id) => {
                self.log(kind, pid, "taken over", "");
                self.processes.insert(id, process);
            }
            None => {
                self.log(kind, pid, "killed: there is another one", "");
                process.signal(Signal::KILL);
            }
        }
        Ok(())
    }

    fn watch(&mut self, until: Until) -> Result<(), SupervisorError> {
        loop {
            if self.wait()? {
                return Ok(());
            }
            self.reap()?;
            self.look()?;
            self.excuse_the_starved();
            for action in self.policy.tick(monotonic_ns()) {
                self.act(action)?;
            }
            if self.policy.is_complete() {
                self.ever_complete = true;
                self.notifier.ready();
            }
            self.notifier.alive(Instant::now());
            self.publish_view();
            if until == Until::Finished && self.finished && self.results_are_out() {
                return Ok(());
            }
        }
    }

    /// Sleeps until a process ends, a signal comes or it is time to look; `true` on a request to
    /// stop.
    fn wait(&self) -> Result<bool, SupervisorError> {
        let mut fds = vec![PollFd::new(&self.stop, PollFlags::IN)];
        fds.extend(
            self.processes.values().map(|process| PollFd::new(&process.pidfd, PollFlags::IN)),
        );
        let timeout = Timespec { tv_sec: 0, tv_nsec: TICK.as_nanos() as _ };
        match poll(&mut fds, Some(&timeout)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => Ok(!fds[0].revents().is_empty()),
            Err(error) => Err(SupervisorError::System {
                action: "wait for processes".into(),
                source: error.into(),
            }),
        }
    }

    fn reap(&mut self) -> Result<(), SupervisorError> {
        let now = monotonic_ns();
        let ended: Vec<(MemberId, children::End)> = self
            .processes
            .iter_mut()
            .filter_map(|(&id, process)| process.reap().map(|end| (id, end)))
            .collect();
        for (id, end) in ended {
            let Some(process) = self.processes.remove(&id) else { continue };
            self.policy.note(Event::Exited { id, crashed: end.crashed }, now);
            self.states.remove(&process.pid);
            self.dropped.remove(&process.pid);
            *self.restarts.entry(process.kind).or_default() += 1;
            self.log(process.kind, process.pid, &end.how, &end.last_words);
            if !self.ever_complete {
                self.start_failures += 1;
                if self.start_failures >= HOPELESS_STARTS {
                    let reason = if end.last_words.is_empty() { end.how } else { end.last_words };
                    return Err(SupervisorError::NoStart { stage: process.kind.name(), reason });
                }
            }
        }
        Ok(())
    }

    /// Takes in what topics and heartbeats say.
    fn look(&mut self) -> Result<(), SupervisorError> {
        let now = monotonic_ns();
        let Self { progress, policy, outputs, last_output, .. } = self;
        progress.outputs(|kind, seq| {
            outputs[kind as usize] = outputs[kind as usize].max(Some(seq));
            *last_output = Instant::now();
            policy.note(Event::Output(kind, seq), now);
        })?;
        let Self { progress, policy, processes, states, dropped, finished, .. } = self;
        progress.heartbeats(|sign| {
            // Heartbeats of processes that are not ours, or no longer alive, say nothing.
            let Some((&id, _)) = processes.iter().find(|(_, process)| process.pid == sign.pid)
            else {
                return;
            };
            if states.insert(sign.pid, sign.state).is_none() {
                policy.note(Event::Ready(id), now);
            }
            if dropped.insert(sign.pid, sign.dropped) != Some(sign.dropped) {
                policy.note(Event::Dropped(sign.kind), now);
            }
            if sign.kind == ProcessKind::Grabber && sign.state == ProcessState::Finished {
                policy.note(Event::Finished, now);
                *finished = true;
            }
        })?;
        Ok(())
    }

    /// On a busy machine a stage may be late because it gets no processor. That is no stall: a
    /// replacement would get none either.
    fn excuse_the_starved(&mut self) {
        for kind in ProcessKind::ALL {
            let behind = self.policy.behind(kind);
            if let Some(process) = behind.and_then(|id| self.processes.get_mut(&id)) {
                let waited_ns = process.newly_waited_ns();
                self.policy.note(Event::Waited(kind, waited_ns), monotonic_ns());
            }
        }
    }

    fn act(&mut self, action: Action) -> Result<(), SupervisorError> {
        match action {
            Action::Start { id, kind, spare } => {
                if !spare {
                    self.hand_over(kind)?;
                }
                let last_frame = self.progress.last_frame();
                let process = Process::start(&self.launch, id, kind, spare, last_frame).map_err(
                    |source| SupervisorError::System {
                        action: format!("start the {}", kind.name()),
                        source,
                    },
                )?;
                self.processes.insert(id, process);
            }
            Action::Promote { id, kind } => {
                self.hand_over(kind)?;
                if let Some(process) = self.processes.get(&id) {
                    process.signal(Signal::USR1);
                    self.log(kind, process.pid, "promoted from spare", "");
                }
            }
            Action::Kill { id, kind, cause } => {
                if let Some(process) = self.processes.get(&id) {
                    let what = match cause {
                        Cause::Stalled => "killed: it has input but gives no output",
                        Cause::NotReady => "killed: it did not get ready in time",
                        Cause::DoesNotEnd => "killed: it did not end when asked to",
                    };
                    self.log(kind, process.pid, what, "");
                    process.signal(Signal::KILL);
                }
            }
            Action::Retire { id, kind } => {
                if let Some(process) = self.processes.get(&id) {
                    self.log(kind, process.pid, "asked to end: its successor is ready", "");
                    process.signal(Signal::TERM);
                }
            }
            Action::Skip { kind, after } => self.skip(kind, after),
            Action::CleanUp => {
                // Takes tens of milliseconds; meanwhile deaths must be noticed.
                let instance = self.launch.instance.clone();
                std::thread::spawn(move || {
                    if let Err(error) = Bus::clean_up_dead(&instance) {
                        eprintln!("touchline: clean-up after a dead process: {error}");
                    }
                });
            }
        }
        Ok(())
    }

    /// Tells the process of a stage that is about to work how far the last one came. That one is
    /// confirmed dead, and all it has published was looked at since.
    fn hand_over(&mut self, kind: ProcessKind) -> Result<(), SupervisorError> {
        let Some(resume_after) = self.outputs[kind as usize] else { return Ok(()) };
        let skip_next = self.skip_after.remove(&kind) == Some(resume_after);
        Handover { resume_after, skip_next }.write(&self.launch.instance, kind).map_err(|source| {
            SupervisorError::System { action: "write how far a stage came".into(), source }
        })
    }

    /// Has the next process of a stage skip the input that has killed two, and keeps the frame.
    fn skip(&mut self, kind: ProcessKind, after: u64) {
        self.skip_after.insert(kind, after);
        let what = match self.progress.first_frame_after(after) {
            Some(frame) => {
                let path = evidence::save_frame(&self.launch.instance, frame);
                let seq = frame.header().seq;
                format!(
                    "frame {seq} has killed two processes and is skipped; kept in {}",
                    path.display()
                )
            }
            None => format!("the frame after {after} has killed two processes and is skipped"),
        };
        self.log(kind, 0, &what, "");
    }

    fn results_are_out(&self) -> bool {
        let of = |kind: ProcessKind| self.outputs[kind as usize];
        of(ProcessKind::Filter) >= of(ProcessKind::Grabber)
            || self.last_output.elapsed() > LAST_RESULTS
    }

    /// Ends the camera, lets the last frame's results come out, and ends everybody else.
    fn end_all(&mut self) {
        self.notifier.stopping();
        for process in
            self.processes.values().filter(|process| process.kind == ProcessKind::Grabber)
        {
            process.signal(Signal::TERM);
        }
        let deadline = Instant::now() + DRAIN;
        let is_capturing = |processes: &HashMap<MemberId, Process>| {
            processes.values().any(|process| process.kind == ProcessKind::Grabber)
        };
        while Instant::now() < deadline
            && (is_capturing(&self.processes) || !self.results_are_out())
        {
            std::thread::sleep(TICK);
            let _ = self.look();
            self.processes.retain(|_, process| process.reap().is_none());
        }
        let deadline = Instant::now() + GRACE;
        for process in self.processes.values() {
            // A stopped process cannot hear; a continued one that was not stopped does not care.
            process.signal(Signal::TERM);
            process.signal(Signal::CONT);
        }
        while !self.processes.is_empty() {
            if Instant::now() > deadline {
                for process in self.processes.values() {
                    process.signal(Signal::KILL);
                }
            }
            let _ = self.wait();
            let _ = self.look();
            self.processes.retain(|_, process| process.reap().is_none());
        }
    }

    fn log(&self, kind: ProcessKind, pid: u32, what: &str, evidence: &str) {
        self.view.log(LogEvent::new(kind, pid, what, evidence));
    }

    fn publish_view(&self) {
        let mut processes: Vec<ProcessView> = self
            .processes
            .values()
            .map(|process| ProcessView {
                kind: process.kind,
                pid: process.pid,
                state: self.states.get(&process.pid).copied(),
            })
            .collect();
        processes.sort_by_key(|process| (process.kind, process.pid));
        self.view.update(processes, self.restarts.clone());
    }
}

fn settings(config: &Config) -> Settings {
    let supervisor = &config.supervisor;
    let ns = |ms: f64| (ms * 1e6) as u64;
    let stall_ms =
        (supervisor.stall_frames * 1000.0 / config.camera.fps).max(supervisor.stall_min_ms);
    Settings {
        stall_ns: ns(stall_ms),
        grabber_stall_ns: ns(stall_ms.max(2000.0)),
        ready_timeout_ns: ns(supervisor.ready_timeout_ms),
        backoff_ns: ns(supervisor.backoff_ms),
        backoff_max_ns: ns(supervisor.backoff_max_ms),
        spares: supervisor.spares.iter().map(|&stage| stage.into()).collect(),
    }
}

fn stop_signals() -> Result<UnixStream, SupervisorError> {
    let system = |source| SupervisorError::System { action: "handle signals".into(), source };
    let (stop, sender) = UnixStream::pair().map_err(system)?;
    for signal in
        [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM, signal_hook::consts::SIGHUP]
    {
        let sender = sender.try_clone().map_err(system)?;
        signal_hook::low_level::pipe::register(signal, sender).map_err(system)?;
    }
    Ok(stop)
}
