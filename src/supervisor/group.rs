//! A running group: passes events to the rules ([`policy`](super::policy)) and carries out their decisions.

mod acting;
mod adoption;
mod ending;
mod reload;
mod upkeep;

use super::attendants::Attendants;
use super::children::{Launch, Process};
use super::configuration::Configuration;
use super::drops::Drops;
use super::janitor::Janitor;
use super::notify::Notifier;
use super::policy::{Event, MemberId, Policy, Settings};
use super::premises::Premises;
use super::progress::{Beat, Output, Progress};
use super::requests::RequestSocket;
use super::reserve::{Reserve, raise_limit};
use super::signals::Signals;
use super::sys::{self, Call};
use super::takeover::Inheritance;
use super::troubles::Troubles;
use super::{SupervisorError, Until};
use crate::monitor::GroupView;
use client::clock::monotonic_ns;
use config::Config;
use control::Event as LogEvent;
use control::{Answer, Done, Request};
use messages::stages::{FrameId, Numbers, StageGraph, StageId, StageMap};
use messages::{EventKind, ProcessKind, ProcessState};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::process::Signal;
use std::cell::Cell;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
use upkeep::PREMISES;

/// Longest time between two looks at topics and heartbeats; a due stall makes it shorter. All
/// messages carry the time they were sent, so they need not be seen at once.
const TICK: Duration = Duration::from_millis(20);
/// The same while the next step of a start or of a hand-over is expected.
const EAGER_TICK: Duration = Duration::from_millis(3);
/// Looks per stall deadline.
const TICKS_PER_STALL: u32 = 2;
/// Shortest sleep. A stall that is due but excused must not turn the loop into a busy one.
const SHORTEST_WAIT: Duration = Duration::from_millis(1);
/// Longest wait for results after the last output.
const LAST_RESULTS: Duration = Duration::from_secs(2);

/// A running group.
pub struct Group<'a> {
    launch: Launch,
    configuration: Configuration,
    policy: Policy,
    processes: HashMap<MemberId, Process>,
    progress: Progress,
    /// Newest frames in each stage's output.
    outputs: StageMap<Numbers>,
    skip_after: HashMap<StageId, FrameId>,
    drops: Drops,
    states: HashMap<u32, ProcessState>,
    restarts: BTreeMap<StageId, u64>,
    start_failures: u32,
    ever_complete: bool,
    /// Grabbers that have captured all requested frames.
    finished: BTreeSet<StageId>,
    last_output: Instant,
    tick: Duration,
    notifier: Notifier,
    view: Arc<GroupView>,
    signals: Signals,
    premises: &'a mut Premises,
    /// Failed operations that are retried.
    troubles: Troubles,
    reserve: Reserve,
    /// Signals that could not be sent.
    unsent: Vec<(MemberId, Signal)>,
    /// The group has changed since the record was written.
    record_is_due: Cell<bool>,
    record_after: Instant,
    janitor: Janitor,
    attendants: Attendants,
    settings: Settings,
}

/// Reason for which the supervisor stops supervising.
pub enum Ending {
    /// The group is to end.
    Over,
    /// The group goes on, supervised by this program.
    Upgrade(PathBuf),
}

/// Events that ended the supervisor's sleep.
struct Woken {
    /// A signal has asked the group to end.
    to_stop: bool,
    /// Processes that have probably ended.
    ended: Vec<MemberId>,
}

impl<'a> Group<'a> {
    /// A group without processes, with the record of an earlier supervisor if there was one. If its
    /// processes are alive, failures here are reported and retried; a new group is not started
    /// after a failure.
    pub fn new(
        launch: Launch,
        configuration: Configuration,
        view: Arc<GroupView>,
        signals: Signals,
        premises: &'a mut Premises,
        inheritance: &Inheritance,
        attendants: Attendants,
    ) -> Result<Self, SupervisorError> {
        let config = &configuration.snapshot().config;
        let (record, lives) = (&inheritance.record, inheritance.lives());
        if lives {
            sys::arm();
        }
        let mut troubles = Troubles::default();
        let mut begin = |what: &str, error: String| {
            if let Some(said) = troubles.note(what, Err(error), monotonic_ns()) {
                runtime::tell!("touchline: {said}");
            }
        };
        match premises.restore() {
            Err(error) if lives => begin(PREMISES, error.to_string()),
            restored => drop(restored.map_err(|source| SupervisorError::System {
                action: "set up the runtime directory".into(),
                source,
            })?),
        }
        let graph = StageGraph::SINGLE;
        let progress = match Progress::new(&launch.instance, config, graph) {
            Err(error) if lives => {
                begin(SIGHT, error.to_string());
                Progress::unconnected(&launch.instance, config, graph)
            }
            progress => progress?,
        };
        let restarts = record
            .restarts
            .iter()
            .filter_map(|(stage, &count)| Some((StageId::from_name(stage)?, count)))
            .collect();
        view.remember(record.events.clone());
        view.update_config(configuration.snapshot().revision.number, config);
        let settings = settings(config, graph);
        Ok(Self {
            progress,
            janitor: Janitor::start(&launch.instance),
            launch,
            configuration,
            tick: tick(&settings),
            policy: Policy::new(settings.clone()),
            processes: HashMap::new(),
            outputs: StageMap::of_defaults(graph),
            skip_after: HashMap::new(),
            drops: Drops::default(),
            states: HashMap::new(),
            restarts,
            start_failures: 0,
            ever_complete: false,
            finished: BTreeSet::new(),
            last_output: Instant::now(),
            notifier: Notifier::from_environment(),
            view,
            signals,
            premises,
            troubles,
            reserve: Reserve::new(),
            unsent: Vec::new(),
            record_is_due: Cell::new(true),
            record_after: Instant::now(),
            attendants,
            settings,
        })
    }

    /// Supervises the group until it is to end. `meanwhile` is called every round.
    pub fn watch(
        &mut self,
        until: Until,
        meanwhile: &mut dyn FnMut(),
    ) -> Result<Ending, SupervisorError> {
        loop {
            let woken = self.wait();
            if woken.to_stop {
                return Ok(Ending::Over);
            }
            // Outputs before deaths: a replacement needs to know the dead process's last output and
            // the input it died on.
            self.look();
            self.reap(&woken.ended)?;
            self.excuse_starved();
            self.judge_configuration();
            // Before actions are carried out: a process that is retired at once has not failed to
            // start.
            if self.policy.is_complete() && !self.ever_complete {
                self.ever_complete = true;
                self.notifier.ready();
                sys::arm();
            }
            for action in self.policy.tick(monotonic_ns()) {
                self.act(action)?;
            }
            self.send_again();
            self.tend_attendants();
            self.tend_itself();
            self.notifier.alive(Instant::now());
            let upgrade = self.serve_requests();
            self.publish_view();
            self.keep_record();
            meanwhile();
            if let Some(program) = upgrade {
                return Ok(Ending::Upgrade(program));
            }
            let is_time = self.launch.ends_at_ns.is_some_and(|end| monotonic_ns() >= end);
            let has_finished =
                until == Until::Finished && self.has_finished() && self.results_are_out();
            if is_time || has_finished {
                return Ok(Ending::Over);
            }
        }
    }

    /// Sleeps until a process ends, a signal or a request arrives, or the next look is due.
    fn wait(&mut self) -> Woken {
        let now_ns = monotonic_ns();
        let tick = if self.policy.is_eager(now_ns) { EAGER_TICK.min(self.tick) } else { self.tick };
        let due_in = self.policy.stall_due_in_ns(now_ns).map(Duration::from_nanos);
        let timeout = due_in.map_or(tick, |due| due.clamp(SHORTEST_WAIT, tick));
        let (ids, mut fds): (Vec<MemberId>, Vec<_>) = self
            .processes
            .iter()
            .map(|(&id, process)| (id, PollFd::new(&process.pidfd, PollFlags::IN)))
            .unzip();
        let (signals, control) =
            (self.signals.fd(), self.premises.control().map(RequestSocket::fd));
        fds.push(PollFd::new(&signals, PollFlags::IN));
        fds.extend(control.iter().map(|fd| PollFd::new(fd, PollFlags::IN)));
        let time = Timespec { tv_sec: 0, tv_nsec: timeout.as_nanos() as _ };
        let waited = sys::ask(Call::WaitForEvents, || match poll(&mut fds, Some(&time)) {
            Err(Errno::INTR) => Ok(0),
            waited => Ok(waited?),
        });
        let happened = |fd: &PollFd| !fd.revents().is_empty();
        let ended = match &waited {
            Ok(_) => {
                let ended = ids.iter().zip(&fds).filter(|(_, fd)| happened(fd));
                ended.map(|(&id, _)| id).collect()
            }
            // Check all of them. The processes may outnumber the descriptors this process may have.
            Err(_) => {
                raise_limit();
                std::thread::sleep(timeout);
                ids
            }
        };
        drop(fds);
        self.attempted(WAITING, waited.map(drop));
        let asked = self.signals.take();
        if asked.hung_up {
            self.leave_terminal();
        }
        Woken { to_stop: asked.to_stop, ended }
    }

    /// Serves requests. Returns the program of an upgrade request.
    fn serve_requests(&mut self) -> Option<PathBuf> {
        let mut upgrade = None;
        while let Some((request, sender)) = self.premises.control().and_then(RequestSocket::next) {
            let answer = match &request {
                Request::Restart(stages) => self.restart(stages),
                Request::Upgrade(program) => check_program(program),
                Request::Reload { file, base } => self.reload(file, *base),
                Request::Rollback => self.roll_back("by request"),
                Request::Mark(words) => self.mark(words),
            };
            if let Some(control) = self.premises.control() {
                control.answer(&sender, &answer);
            }
            if let (Request::Upgrade(program), Ok(_)) = (request, answer) {
                upgrade = Some(program);
            }
        }
        upgrade
    }

    /// Replaces the processes of the named stages and attendants; none of them if one name is
    /// unknown.
    fn restart(&mut self, names: &[String]) -> Answer {
        let (attendants, stages): (Vec<_>, Vec<_>) =
            names.iter().partition(|name| self.attendants.has(name));
        let id = |name: &String| match name.parse() {
            Ok(stage) if self.settings.graph.has(stage) => Ok(stage),
            _ => Err(format!("the group has no process {name:?} that could be replaced")),
        };
        let stages = stages.into_iter().map(id).collect::<Result<BTreeSet<StageId>, _>>()?;
        for stage in stages {
            self.policy.renew_stage(stage, monotonic_ns());
        }
        for name in attendants {
            self.attendants.restart(name, monotonic_ns());
        }
        Ok(Done::default())
    }

    fn reap(&mut self, ended: &[MemberId]) -> Result<(), SupervisorError> {
        let now = monotonic_ns();
        for &id in ended {
            let Some(end) = self.processes.get_mut(&id).and_then(Process::reap) else { continue };
            let Some(process) = self.processes.remove(&id) else { continue };
            // A configuration on trial is blamed before the frame.
            let is_blamed = end.failed && self.blame(process.stage.kind(), process.revision);
            self.policy.note(Event::Exited { id, crashed: end.crashed && !is_blamed }, now);
            self.states.remove(&process.pid);
            if let Some(notice) = self.drops.forget(process.pid) {
                self.log(EventKind::Dropped, notice.stage, notice.pid, &notice.what, "");
            }
            *self.restarts.entry(process.stage).or_default() += 1;
            self.log(EventKind::Ended, process.stage, process.pid, &end.how, &end.last_words);
            let reason = if end.last_words.is_empty() { end.how } else { end.last_words };
            self.failed_to_start(process.stage, reason)?;
        }
        Ok(())
    }

    /// Reads topics, pages and heartbeats.
    fn look(&mut self) {
        let now = monotonic_ns();
        let Self { progress, policy, outputs, last_output, .. } = self;
        let (new, seen) = progress.outputs();
        for &Output { stage, frame, t_sent_ns } in new {
            outputs[stage].raise(frame);
            *last_output = Instant::now();
            policy.note(Event::Output(stage, frame), t_sent_ns);
        }
        for stage in self.settings.graph.stages() {
            let at_ns = progress.pages().checked_in_ns(stage);
            policy.note(Event::CheckedIn(stage, at_ns), now);
        }
        let Self { progress, policy, processes, states, drops, finished, configuration, .. } = self;
        let (record_is_due, attendants) = (&self.record_is_due, &mut self.attendants);
        let heard = progress.heartbeats(|beat| {
            let sign = match beat {
                Beat::Stage(sign) => sign,
                Beat::Attendant { pid } => return attendants.heard(pid, now),
            };
            // Ignore heartbeats of foreign or dead processes.
            let Some((&id, process)) =
                processes.iter_mut().find(|(_, process)| process.pid == sign.pid)
            else {
                return;
            };
            process.revision = Some(sign.revision);
            if sign.revision < configuration.snapshot().needed(sign.stage.kind()) {
                policy.outdate(id, now);
            }
            let before = states.insert(sign.pid, sign.state);
            if before.is_none() {
                policy.note(Event::Ready(id), now);
            }
            if before != Some(sign.state) {
                record_is_due.set(true);
            }
            if drops.note(sign.stage, sign.pid, sign.dropped) {
                policy.note(Event::Dropped(sign.stage), now);
            }
            // A grabber whose camera is away reports it; a new grabber would not find the camera
            // either.
            if sign.stage.is_grabber() && sign.state == ProcessState::Waiting {
                policy.note(Event::CameraIsAway(sign.stage), now);
            }
            if sign.stage.is_grabber() && sign.state == ProcessState::Finished {
                policy.note(Event::Finished(sign.stage), now);
                finished.insert(sign.stage);
            }
        });
        for notice in self.drops.tell(now) {
            self.log(EventKind::Dropped, notice.stage, notice.pid, &notice.what, "");
        }
        // No news while unconnected does not count as a success.
        if seen.is_err() || heard.is_err() || self.progress.is_connected() {
            self.attempted(SIGHT, seen.and(heard).map_err(std::io::Error::other));
        }
    }

    /// Excuses late stages for time in which they got no processor. That is no stall: a replacement
    /// would get no processor either.
    fn excuse_starved(&mut self) {
        for stage in self.settings.graph.stages() {
            let now_ns = monotonic_ns();
            let late = self.policy.late(stage, now_ns);
            let Self { processes, reserve, .. } = self;
            if let Some(process) = late.and_then(|id| processes.get_mut(&id)) {
                // A failure means that it has died, which `wait` reports.
                let times = reserve.lend(|| process.processor_times()).ok();
                let waited_ns = times.map_or(0, |times| process.newly_waited_ns(times, now_ns));
                self.policy.note(Event::Waited(stage, waited_ns), now_ns);
            }
        }
    }

    fn results_are_out(&self) -> bool {
        let results = self.outputs[StageId::FILTER];
        let is_out = |lane: u8| {
            let frames = self.outputs[StageId::new(ProcessKind::Grabber, lane)];
            results.of(lane) >= frames.of(lane)
        };
        self.settings.graph.lanes().all(is_out) || self.last_output.elapsed() > LAST_RESULTS
    }

    /// Whether every grabber has captured all requested frames.
    fn has_finished(&self) -> bool {
        self.finished.len() == self.settings.graph.lanes().count()
    }

    fn log(&self, event: EventKind, stage: StageId, pid: u32, what: &str, evidence: &str) {
        self.record_is_due.set(true);
        self.view.log(LogEvent::new(event, &stage.to_string(), pid, what, evidence));
    }
}

// Names of operations that can fail for a while, as reported.
const WAITING: &str = "wait for the group's processes";
const SIGHT: &str = "see what the stages do";

fn tick(settings: &Settings) -> Duration {
    let stall = Duration::from_nanos(settings.stall_ns);
    TICK.min(stall / TICKS_PER_STALL).max(Duration::from_millis(1))
}

fn settings(config: &Config, graph: StageGraph) -> Settings {
    let supervisor = &config.supervisor;
    let ns = |ms: f64| (ms * 1e6) as u64;
    let stall_ms =
        (supervisor.stall_frames * 1000.0 / config.camera.fps).max(supervisor.stall_min_ms);
    Settings {
        stall_ns: ns(stall_ms),
        grabber_stall_ns: ns(stall_ms.max(2000.0)),
        grabber_stuck_ns: ns(supervisor.stall_min_ms.max(100.0)),
        ready_timeout_ns: ns(supervisor.ready_timeout_ms),
        backoff_ns: ns(supervisor.backoff_ms),
        backoff_max_ns: ns(supervisor.backoff_max_ms),
        graph,
        spares: supervisor.spares.iter().map(|&stage| stage.into()).collect(),
    }
}

/// Whether a file can be run at all. The client has checked before that it fits the group.
fn check_program(program: &Path) -> Answer {
    use std::os::unix::fs::PermissionsExt;
    let data =
        std::fs::metadata(program).map_err(|error| format!("{}: {error}", program.display()))?;
    match program.is_absolute() && data.is_file() && data.permissions().mode() & 0o111 != 0 {
        true => Ok(Done::default()),
        false => Err(format!("{} is not a program", program.display())),
    }
}
