//! A living group: carries events to the rules and the rules' decisions to the processes.

mod adoption;
mod ending;

use super::children::{Launch, Process};
use super::control::{Answer, Control, Request};
use super::drops::Drops;
use super::evidence;
use super::gateway::Gateway;
use super::janitor::Janitor;
use super::notify::Notifier;
use super::policy::{Action, Cause, Event, MemberId, Policy, Settings};
use super::progress::{Beat, Output, Progress};
use super::record::{Member, Record};
use super::{SupervisorError, Until};
use crate::monitor::{Event as LogEvent, GroupView, ProcessView};
use common::clock::monotonic_ns;
use common::config::Config;
use common::handover::Handover;
use common::messages::{EventKind, ProcessKind, ProcessState};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::Signal;
use std::cell::Cell;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How often topics and heartbeats are looked at, at least; between, when a stall is due. All that
/// stages send says when it was sent, so it need not be seen at once.
const TICK: Duration = Duration::from_millis(20);
/// Looks at a stage that is behind, before it counts as stalled.
const TICKS_PER_STALL: u32 = 2;
/// A stall that is due but excused does not keep the supervisor from sleeping.
const SHORTEST_WAIT: Duration = Duration::from_millis(1);
/// How long after the camera's last frame results are waited for.
const LAST_RESULTS: Duration = Duration::from_secs(2);
/// So many failures before anything ever worked mean that it never will.
const HOPELESS_STARTS: u32 = 3;

/// A group while it lives.
pub struct Group {
    launch: Launch,
    policy: Policy,
    processes: HashMap<MemberId, Process>,
    progress: Progress,
    outputs: [Option<u64>; ProcessKind::ALL.len()],
    skip_after: HashMap<ProcessKind, u64>,
    drops: Drops,
    states: HashMap<u32, ProcessState>,
    restarts: BTreeMap<ProcessKind, u64>,
    start_failures: u32,
    ever_complete: bool,
    finished: bool,
    last_output: Instant,
    tick: Duration,
    notifier: Notifier,
    view: Arc<GroupView>,
    stop: UnixStream,
    control: Control,
    /// Something has changed that the record does not say yet.
    record_is_due: Cell<bool>,
    janitor: Janitor,
    /// Lets other users in, where that is configured.
    gateway: Option<Gateway>,
    settings: Settings,
}

/// Why nobody watches a group any longer.
pub enum Ending {
    /// It is to end.
    Over,
    /// It goes on under this program.
    Upgrade(PathBuf),
}

/// Why the supervisor has stopped sleeping, if not because it is time to look.
struct Woken {
    /// A signal has asked for the end.
    to_stop: bool,
    /// Processes that have ended, it seems.
    ended: Vec<MemberId>,
}

impl Group {
    /// A group without processes, with the memories of an earlier supervisor, if there was one.
    pub fn new(
        launch: Launch,
        config: &Config,
        view: Arc<GroupView>,
        stop: UnixStream,
        record: Record,
        gateway: Option<Gateway>,
    ) -> Result<Self, SupervisorError> {
        let control = Control::open(&launch.instance).map_err(|source| {
            SupervisorError::System { action: "open the socket for requests".into(), source }
        })?;
        let janitor = Janitor::start(&launch.instance);
        let restarts = record
            .restarts
            .iter()
            .filter_map(|(stage, &count)| Some((ProcessKind::from_name(stage)?, count)))
            .collect();
        view.remember(record.events);
        let settings = settings(config);
        Ok(Self {
            progress: Progress::new(&launch.instance, config)?,
            launch,
            tick: tick(&settings),
            policy: Policy::new(settings.clone()),
            processes: HashMap::new(),
            outputs: [None; ProcessKind::ALL.len()],
            skip_after: HashMap::new(),
            drops: Drops::default(),
            states: HashMap::new(),
            restarts,
            start_failures: 0,
            ever_complete: false,
            finished: false,
            last_output: Instant::now(),
            notifier: Notifier::from_environment(),
            view,
            stop,
            control,
            record_is_due: Cell::new(true),
            janitor,
            gateway,
            settings,
        })
    }

    /// Looks after the group until it is to end.
    pub fn watch(&mut self, until: Until) -> Result<Ending, SupervisorError> {
        loop {
            let woken = self.wait()?;
            if woken.to_stop {
                return Ok(Ending::Over);
            }
            // In this order: what the dead have published is known when they are replaced, and which
            // input they died of.
            self.look()?;
            self.reap(&woken.ended)?;
            self.excuse_the_starved();
            // Before anything is done about it: who is asked to end at once, to be replaced, has not
            // failed to start.
            if self.policy.is_complete() {
                self.ever_complete = true;
                self.notifier.ready();
            }
            for action in self.policy.tick(monotonic_ns()) {
                self.act(action)?;
            }
            self.tend_gateway();
            self.notifier.alive(Instant::now());
            let upgrade = self.serve_requests();
            self.publish_view();
            self.keep_record();
            if let Some(program) = upgrade {
                return Ok(Ending::Upgrade(program));
            }
            if until == Until::Finished && self.finished && self.results_are_out() {
                return Ok(Ending::Over);
            }
        }
    }

    /// Sleeps until a process ends, a signal or a request comes, or it is time to look.
    fn wait(&self) -> Result<Woken, SupervisorError> {
        let (stop, control) = (self.stop.as_fd(), self.control.fd());
        let (ids, mut fds): (Vec<MemberId>, Vec<_>) = self
            .processes
            .iter()
            .map(|(&id, process)| (id, PollFd::new(&process.pidfd, PollFlags::IN)))
            .unzip();
        fds.extend([&stop, &control].map(|fd| PollFd::new(fd, PollFlags::IN)));
        let due_in = self.policy.stall_due_in_ns(monotonic_ns()).map(Duration::from_nanos);
        let timeout = due_in.map_or(self.tick, |due| due.clamp(SHORTEST_WAIT, self.tick));
        let timeout = Timespec { tv_sec: 0, tv_nsec: timeout.as_nanos() as _ };
        match poll(&mut fds, Some(&timeout)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => {
                let happened = |fd: &PollFd| !fd.revents().is_empty();
                let to_stop = happened(&fds[ids.len()]);
                let ended = ids.into_iter().zip(&fds).filter(|(_, fd)| happened(fd));
                Ok(Woken { to_stop, ended: ended.map(|(id, _)| id).collect() })
            }
            Err(error) => Err(SupervisorError::System {
                action: "wait for processes".into(),
                source: error.into(),
            }),
        }
    }

    /// Does what is asked for; returns the program that is to take over, if that is asked for.
    fn serve_requests(&mut self) -> Option<PathBuf> {
        let mut upgrade = None;
        while let Some((request, sender)) = self.control.next() {
            let answer = match &request {
                Request::Restart(stages) => self.restart(stages),
                Request::Upgrade(program) => check_program(program),
            };
            self.control.answer(&sender, &answer);
            if let (Request::Upgrade(program), Ok(())) = (request, answer) {
                upgrade = Some(program);
            }
        }
        upgrade
    }

    fn restart(&mut self, stages: &[String]) -> Answer {
        let kind_of = |stage: &String| {
            ProcessKind::from_name(stage).ok_or_else(|| format!("there is no stage {stage:?}"))
        };
        let kinds = stages.iter().map(kind_of).collect::<Result<BTreeSet<_>, _>>()?;
        for &kind in &kinds {
            self.policy.renew_stage(kind, monotonic_ns());
        }
        Ok(())
    }

    fn reap(&mut self, ended: &[MemberId]) -> Result<(), SupervisorError> {
        let now = monotonic_ns();
        for &id in ended {
            let Some(end) = self.processes.get_mut(&id).and_then(Process::reap) else { continue };
            let Some(process) = self.processes.remove(&id) else { continue };
            self.policy.note(Event::Exited { id, crashed: end.crashed }, now);
            self.states.remove(&process.pid);
            if let Some(tale) = self.drops.forget(process.pid) {
                self.log(EventKind::Dropped, tale.kind, tale.pid, &tale.what, "");
            }
            *self.restarts.entry(process.kind).or_default() += 1;
            self.log(EventKind::Ended, process.kind, process.pid, &end.how, &end.last_words);
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
        for &Output { kind, seq, t_sent_ns } in progress.outputs()? {
            outputs[kind as usize] = outputs[kind as usize].max(Some(seq));
            *last_output = Instant::now();
            policy.note(Event::Output(kind, seq), t_sent_ns);
        }
        let Self { progress, policy, processes, states, drops, finished, .. } = self;
        let (record_is_due, gateway) = (&self.record_is_due, &mut self.gateway);
        progress.heartbeats(|beat| {
            let sign = match beat {
                Beat::Stage(sign) => sign,
                Beat::Gateway { pid } => {
                    return gateway.iter_mut().for_each(|it| it.heard(pid, now));
                }
            };
            // Heartbeats of processes that are not ours, or no longer alive, say nothing.
            let Some((&id, _)) = processes.iter().find(|(_, process)| process.pid == sign.pid)
            else {
                return;
            };
            let before = states.insert(sign.pid, sign.state);
            if before.is_none() {
                policy.note(Event::Ready(id), now);
            }
            if before != Some(sign.state) {
                record_is_due.set(true);
            }
            if drops.note(sign.kind, sign.pid, sign.dropped) {
                policy.note(Event::Dropped(sign.kind), now);
            }
            // A grabber whose camera is away says so; a new one would not find it either.
            if sign.kind == ProcessKind::Grabber && sign.state == ProcessState::Waiting {
                policy.note(Event::Dropped(sign.kind), now);
            }
            if sign.kind == ProcessKind::Grabber && sign.state == ProcessState::Finished {
                policy.note(Event::Finished, now);
                *finished = true;
            }
        })?;
        for tale in self.drops.tell(now) {
            self.log(EventKind::Dropped, tale.kind, tale.pid, &tale.what, "");
        }
        Ok(())
    }

    /// On a busy machine a stage may be late because it gets no processor. That is no stall: a
    /// replacement would get none either.
    fn excuse_the_starved(&mut self) {
        for kind in ProcessKind::ALL {
            let now_ns = monotonic_ns();
            let late = self.policy.late(kind, now_ns);
            if let Some(process) = late.and_then(|id| self.processes.get_mut(&id)) {
                let waited_ns = process.newly_waited_ns(now_ns);
                self.policy.note(Event::Waited(kind, waited_ns), now_ns);
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
                    self.log(EventKind::Promoted, kind, process.pid, "promoted from spare", "");
                }
            }
            Action::Kill { id, kind, cause } => {
                if let Some(process) = self.processes.get(&id) {
                    let (event, what) = match cause {
                        Cause::Stalled => {
                            (EventKind::Stalled, "killed: it has input but gives no output")
                        }
                        Cause::NotReady => {
                            (EventKind::Killed, "killed: it did not get ready in time")
                        }
                        Cause::DoesNotEnd => {
                            (EventKind::Killed, "killed: it did not end when asked to")
                        }
                    };
                    self.log(event, kind, process.pid, what, "");
                    process.signal(Signal::KILL);
                }
            }
            Action::Retire { id, kind } => {
                if let Some(process) = self.processes.get(&id) {
                    let what = "asked to end: its successor is ready";
                    self.log(EventKind::Retired, kind, process.pid, what, "");
                    process.signal(Signal::TERM);
                }
            }
            Action::Skip { kind, after } => self.skip(kind, after),
            Action::CleanUp => self.janitor.call(),
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
        self.log(EventKind::Poisonous, kind, 0, &what, "");
    }

    fn results_are_out(&self) -> bool {
        let of = |kind: ProcessKind| self.outputs[kind as usize];
        of(ProcessKind::Filter) >= of(ProcessKind::Grabber)
            || self.last_output.elapsed() > LAST_RESULTS
    }

    fn log(&self, event: EventKind, kind: ProcessKind, pid: u32, what: &str, evidence: &str) {
        self.record_is_due.set(true);
        self.view.log(LogEvent::new(event, kind.name(), pid, what, evidence));
    }

    /// Begins when the group is complete: other users come after the match.
    fn tend_gateway(&mut self) {
        let Some(gateway) = self.gateway.as_mut().filter(|_| self.ever_complete) else { return };
        if let Some(it) = gateway.tend(&self.settings, monotonic_ns()) {
            self.record_is_due.set(true);
            let stage = crate::gateway::NAME;
            self.view.log(LogEvent::new(it.kind, stage, it.pid, &it.what, &it.evidence));
        }
    }

    /// Writes down what a successor needs to know. Comes last in a round: whoever waits for a spare
    /// does not wait for the disk.
    fn keep_record(&self) {
        if !self.record_is_due.replace(false) {
            return;
        }
        let by_name = |(kind, &count): (&ProcessKind, &u64)| (kind.name().to_string(), count);
        let member = |process: &Process| {
            // One that has not said its first word is still starting.
            let state = self.states.get(&process.pid)?;
            Some(Member {
                stage: process.kind.name().into(),
                pid: process.pid,
                spare: *state == ProcessState::Spare,
            })
        };
        let record = Record {
            members: self.processes.values().filter_map(member).collect(),
            restarts: self.restarts.iter().map(by_name).collect(),
            events: self.view.events(),
            ..Record::new(&self.launch)
        };
        // It is a help for a successor, who can do without.
        let _ = record.write(&self.launch.instance);
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
        if let Some(gateway) = &self.gateway {
            self.view.update_gateway(gateway.view());
        }
    }
}

fn tick(settings: &Settings) -> Duration {
    let stall = Duration::from_nanos(settings.stall_ns);
    TICK.min(stall / TICKS_PER_STALL).max(Duration::from_millis(1))
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

/// Whether a file can be run at all; whether it fits is for whoever asks to find out first.
fn check_program(program: &Path) -> Answer {
    use std::os::unix::fs::PermissionsExt;
    let data =
        std::fs::metadata(program).map_err(|error| format!("{}: {error}", program.display()))?;
    match program.is_absolute() && data.is_file() && data.permissions().mode() & 0o111 != 0 {
        true => Ok(()),
        false => Err(format!("{} is not a program", program.display())),
    }
}
