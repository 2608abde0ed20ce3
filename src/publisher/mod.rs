//! The publisher: sends poses in the leagues' protocols over UDP, and receives commands of FIRASim's
//! clients.
//!
//! It reads topics like any consumer: if a network is dead or slow, it loses its own packets and nobody else
//! notices. Nothing is sent or received unless `[publish]` says so.
//!
//! [`table`] lists the protocols, [`convert`] makes their packets from our messages, [`worker`] is the thread
//! that sends what one topic brings, through a [`sender`] on the [`interfaces`] of the machine. [`intake`]
//! reads commands, [`listening`] receives them, and [`rivals`] looks for other publishers on the same
//! addresses. This file is the process.

mod clock;
pub mod convert;
mod intake;
pub mod interfaces;
mod listening;
mod rivals;
mod sender;
pub mod table;
mod worker;

use crate::attendants::Row;
use client::bus::{BusError, Publisher};
use client::clock::monotonic_ns;
use client::instance::Instance;
use config::{Config, PublishedTopic};
use convert::Scene;
use geometry::GeometryError;
use listening::CommandListener;
use messages::topics;
use messages::{
    Attendant, DropReason, Heartbeat, MAX_OUTPUTS, OutputReport, PublisherReport, write_text,
};
use rivals::RivalWatch;
use runtime::attendant::AttendantProcess;
use runtime::process::{MAX_WAIT, ProcessError};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use sender::OwnPorts;
use std::collections::BTreeMap;
use std::fs;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;
use worker::{Job, Line};

/// Interval between reports.
const REPORT_NS: u64 = 250_000_000;
/// Interval between looks at interfaces, sockets and other publishers.
const LOOK_NS: u64 = 1_000_000_000;
/// Longest round of a worker, which then counts as stuck; it normally makes at least twenty rounds a second.
const LONGEST_ROUND_NS: u64 = 2_000_000_000;
/// Most lines in the log.
const MOST_LINES: u32 = 200;
/// Said when nothing keeps the clock right.
const UNSYNCHRONISED: &str = "the clock of this computer is not synchronised, and receivers compare times: run \
                              chrony or systemd-timesyncd";
/// Distance between our camera model and the published pinhole above which the user is told.
const NOTICED_PX: f64 = 1.0;

/// Reason for which the publisher cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum PublisherError {
    /// Nothing is to be published.
    #[error("nothing is enabled in [publish]")]
    NotConfigured,
    /// The camera's geometry cannot be used.
    #[error("geometry: {0}")]
    Geometry(#[from] GeometryError),
    /// Shared memory failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Its process failed.
    #[error(transparent)]
    Process(#[from] ProcessError),
    /// Waiting failed.
    #[error("wait for packets: {0}")]
    Wait(std::io::Error),
    /// A thread has ended, or is stuck.
    #[error("the thread that sends what `{0}` brings {1}")]
    Stuck(&'static str, &'static str),
}

/// The publisher's row in the table of attendants.
pub const ROW: Row = Row {
    attendant: Attendant::Publisher,
    about: "The publisher alone: poses in the leagues' protocols over UDP, as [publish] says",
    prepare: |_, config| Ok(prepare(config)?),
    run: |instance, config, supervised| Ok(run(instance, config, supervised)?),
    reads: &["field", "camera", "geometry", "ball", "robots", "publish"],
    remove: |_| Ok(()),
};

/// Whether anything is to be published; says what receivers will not get.
fn prepare(config: &Config) -> Result<bool, PublisherError> {
    if !config.publish.is_used() {
        return Ok(false);
    }
    let scene = Scene::new(config, "")?;
    if config.publish.ssl.enabled && config.publish.ssl.geometry {
        match &scene.pinhole {
            Ok(pinhole) if pinhole.worst_px > NOTICED_PX => runtime::tell!(
                "touchline: the published calibration is a pinhole camera that differs from ours by up to {:.1} \
                 pixels ({:.1} on average)",
                pinhole.worst_px,
                pinhole.rms_px
            ),
            Ok(_) => {}
            Err(error) => runtime::tell!("touchline: no calibration is published: {error}"),
        }
    }
    Ok(true)
}

/// Runs until it is told to end, or its group is gone.
fn run(instance: &Instance, config: &Config, supervised: bool) -> Result<(), PublisherError> {
    if !config.publish.is_used() {
        return Err(PublisherError::NotConfigured);
    }
    let process = AttendantProcess::start(Attendant::Publisher, instance, config, supervised)?;
    let stop = process.stop();
    let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let scene = Arc::new(Scene::new(config, &format!("{} on {}", instance.name(), host.trim()))?);
    let own = Arc::new(OwnPorts::default());
    let lines: Vec<Arc<Line>> =
        enabled(config).map(|(index, _)| Arc::new(Line::new(index))).collect();
    let mut workers = vec![];
    for topic in [PublishedTopic::Detections, PublishedTopic::World] {
        let of_topic = |line: &&Arc<Line>| (line.protocol().topic)(&config.publish) == topic;
        let lines: Vec<_> = lines.iter().filter(of_topic).cloned().collect();
        if !lines.is_empty() {
            workers.push(
                Job { topic, lines, scene: scene.clone(), own: own.clone() }
                    .start(instance, Arc::clone(&stop)),
            );
        }
    }
    let ssl =
        enabled(config).filter(|(index, _)| ["ssl", "vss"].contains(&table::TABLE[*index].name));
    let rivals = RivalWatch::new(ssl.flat_map(|(_, receivers)| receivers), scene.camera_id(0));
    let mut desk = Desk {
        commands: CommandListener::new(&config.publish.commands),
        reports: process.bus.publisher(&topics::PUBLISHER, 1)?,
        publisher: process.bus.publisher(&topics::COMMANDS, 1)?,
        lines,
        rivals,
        own,
        wanted: config.publish.interfaces.clone(),
        clock_is_right: true,
        report_ns: 0,
        look_ns: 0,
        told: BTreeMap::new(),
        lines_left: MOST_LINES,
    };
    let outcome = desk.tend(process, &workers);
    stop.store(true, Ordering::Relaxed);
    match outcome {
        // A stuck thread cannot be joined, and ends with the process.
        Err(PublisherError::Stuck(..)) => outcome,
        outcome => workers.into_iter().fold(outcome, |outcome, worker| worker.join().and(outcome)),
    }
}

/// Enabled protocols: index in the table, and receivers.
fn enabled(config: &Config) -> impl Iterator<Item = (usize, Vec<std::net::SocketAddrV4>)> {
    let outputs = config.publish.outputs().into_iter().enumerate();
    outputs.filter(|(_, output)| output.enabled).map(|(index, output)| (index, output.receivers()))
}

/// A running worker.
struct Worker {
    job: Arc<Job>,
    round_ns: Arc<std::sync::atomic::AtomicU64>,
    thread: JoinHandle<Result<(), BusError>>,
}

impl Worker {
    fn check(&self) -> Result<(), PublisherError> {
        let topic = self.job.topic_name();
        if self.thread.is_finished() {
            return Err(PublisherError::Stuck(topic, "has ended"));
        }
        let silent_ns = monotonic_ns().saturating_sub(self.round_ns.load(Ordering::Relaxed));
        if silent_ns > LONGEST_ROUND_NS {
            return Err(PublisherError::Stuck(topic, "does not get on"));
        }
        Ok(())
    }

    fn join(self) -> Result<(), PublisherError> {
        let topic = self.job.topic_name();
        match self.thread.join() {
            Ok(outcome) => Ok(outcome?),
            Err(_) => Err(PublisherError::Stuck(topic, "has panicked")),
        }
    }
}

/// The main thread's work: commands, other publishers, and reports.
struct Desk {
    commands: CommandListener,
    reports: Publisher<PublisherReport, ()>,
    publisher: Publisher<messages::Commands, ()>,
    lines: Vec<Arc<Line>>,
    rivals: RivalWatch,
    own: Arc<OwnPorts>,
    wanted: Vec<String>,
    clock_is_right: bool,
    report_ns: u64,
    look_ns: u64,
    /// The problems last written to the log.
    told: BTreeMap<&'static str, String>,
    lines_left: u32,
}

impl Desk {
    fn tend(
        &mut self,
        mut process: AttendantProcess,
        workers: &[Worker],
    ) -> Result<(), PublisherError> {
        while process.keep_running(|beat| self.count(beat))? {
            for worker in workers {
                // A thread that was told to end may do so before this one.
                if !process.stop().load(Ordering::Relaxed) {
                    worker.check()?;
                }
            }
            let now_ns = monotonic_ns();
            if now_ns.saturating_sub(self.look_ns) > LOOK_NS {
                self.look_ns = now_ns;
                self.commands.refresh();
                self.clock_is_right = self.lines.is_empty() || clock::is_synchronised();
                let all = interfaces::list().unwrap_or_default();
                self.rivals.refresh(&interfaces::choose(&all, &self.wanted).0);
            }
            for rival in self.rivals.look(&self.own, now_ns) {
                self.say(rival_words(&rival));
            }
            self.commands.receive(now_ns, &mut self.publisher)?;
            if now_ns.saturating_sub(self.report_ns) > REPORT_NS {
                self.report_ns = now_ns;
                let report = self.report(now_ns);
                self.reports.publish(&report)?;
            }
            self.wait()?;
        }
        Ok(())
    }

    fn wait(&self) -> Result<(), PublisherError> {
        let patience = Timespec { tv_sec: 0, tv_nsec: MAX_WAIT.as_nanos() as _ };
        let mut sockets: Vec<PollFd> = self
            .commands
            .socket()
            .map(|socket| PollFd::new(socket, PollFlags::IN))
            .into_iter()
            .collect();
        match poll(&mut sockets, Some(&patience)) {
            Ok(_) | Err(Errno::INTR) => Ok(()),
            Err(error) => Err(PublisherError::Wait(error.into())),
        }
    }

    fn report(&mut self, now_ns: u64) -> PublisherReport {
        let counts = self.commands.counts;
        let mut report = PublisherReport {
            t_sent_ns: now_ns,
            commands: counts.taken,
            malformed: counts.malformed,
            not_allowed: counts.not_allowed,
            too_many: counts.too_many,
            rivals: self.rivals.present().len() as u32,
            ..bytemuck::Zeroable::zeroed()
        };
        for (index, line) in self.lines.clone().iter().take(MAX_OUTPUTS).enumerate() {
            let output = &mut report.outputs[index];
            let problem = line.problem();
            *output = OutputReport {
                sent: line.sent.load(Ordering::Relaxed),
                failed: line.failed.load(Ordering::Relaxed),
                large: line.large.load(Ordering::Relaxed),
                ..bytemuck::Zeroable::zeroed()
            };
            write_text(&mut output.name, line.protocol().name);
            write_text(&mut output.problem, &problem);
            self.tell_change(line.protocol().name, problem);
        }
        report.output_count = self.lines.len().min(MAX_OUTPUTS) as u32;
        let rivals = self.rivals.present().map(rival_words);
        let clock = (!self.clock_is_right).then(|| UNSYNCHRONISED.to_string());
        let problems: Vec<String> =
            rivals.chain(self.commands.problem.clone()).chain(clock).collect();
        write_text(&mut report.problem, &problems.join("; "));
        report
    }

    /// Writes a line when a protocol's problem is new or over.
    fn tell_change(&mut self, name: &'static str, problem: String) {
        let before = self.told.insert(name, problem.clone()).unwrap_or_default();
        match (before.is_empty(), problem.is_empty()) {
            (false, true) => self.say(format!("{name} is sent again")),
            (_, false) if before != problem => self.say(format!("{name} is not sent: {problem}")),
            _ => {}
        }
    }

    fn say(&mut self, what: String) {
        if self.lines_left > 0 {
            self.lines_left -= 1;
            runtime::tell!("{}: {what}", Attendant::Publisher.name());
        }
    }

    /// Writes the counters into a heartbeat.
    fn count(&self, beat: &mut Heartbeat) {
        let total = |counter: fn(&Line) -> u64| self.lines.iter().map(|it| counter(it)).sum();
        beat.frames_in = self.lines.iter().map(|it| it.frames()).max().unwrap_or(0);
        beat.frames_out = total(|line| line.sent.load(Ordering::Relaxed));
        beat.frames_missed = total(|line| line.failed.load(Ordering::Relaxed));
        if beat.frames_in > 0 {
            beat.seq_in = self.lines.iter().map(|it| it.newest()).max().unwrap_or(u64::MAX);
            beat.seq_out = beat.seq_in;
        }
        let counts = self.commands.counts;
        beat.dropped[DropReason::BadHeader as usize] = counts.malformed;
        beat.dropped[DropReason::NotPermitted as usize] = counts.not_allowed;
        beat.dropped[DropReason::Late as usize] = counts.too_many;
    }
}

fn rival_words(rival: &rivals::Rival) -> String {
    format!("{} also sends to {}: {}; stop one of the two", rival.from, rival.to, rival.source)
}
