//! Reads all topics and builds the report.

mod configuration;

use super::Outlets;
use super::accuracy::{ReportedRobot, Scorer};
use super::camera::CameraWatch;
use super::commanders::CommanderWatch;
use super::flow::{Flow, Sight};
use super::gateway::GatewayWatch;
use super::latency::LatencyMeter;
use super::publisher::PublisherWatch;
use super::strangers::StrangerWatch;
use super::unknown::UnknownScorer;
use super::usage::{Usage, proportional_bytes, usage_of};
use super::view::{AttendantView, GroupView};
use crate::colorless::{COLORLESS, has_color};
use crate::top_scale::TopScale;
use client::bus::{Bus, BusError, Subscriber};
use client::clock::monotonic_ns;
use client::instance::Instance;
use config::Config;
use control::Event;
use control::report::{
    Accuracy, AttendantState, Camera, Found, Light, Process, Rate, Report, Resources, Stage, Tops,
};
use messages::stages::{StageGraph, StageId};
use messages::topics;
use messages::*;
use messages::{Header, Message};
use runtime::process::{FAULT_VARIABLE, fault_from_environment};
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::Arc;

/// Frames of truth kept: more than any result is behind.
const KEPT_TRUTH: usize = 512;
/// Period over which rates and processor shares are measured.
const RATE_PERIOD_NS: u64 = 1_000_000_000;

/// Time between two attempts to connect to a writer.
const RECONNECT_NS: u64 = 1_000_000_000;

/// Time between two looks at a frame in which no robot is identified, and before the first.
const LOOK_PERIOD_NS: u64 = 2_000_000_000;

/// Time between two memory measurements, and before the first.
const MEMORY_PERIOD_NS: u64 = 30_000_000_000;
const MEMORY_FIRST_NS: u64 = 1_500_000_000;

/// The monitor's subscribers and counts.
pub struct Collector {
    frames: Subscriber<u8, FrameHeader>,
    detections: Subscriber<DetectionFrame, ()>,
    world: Subscriber<WorldFrame, ()>,
    truth: Subscriber<TruthFrame, ()>,
    health: Subscriber<Heartbeat, ()>,
    camera: CameraWatch,
    publisher: PublisherWatch,
    strangers: StrangerWatch,
    commanders: CommanderWatch,
    view: Arc<GroupView>,
    /// The configuration in use, and its revision; 0 for that of the start.
    config: (u32, Arc<Config>),
    base: Report,
    started_ns: u64,
    flow: Flow,
    /// Capacity of the buffer of `frames`.
    kept_frames: usize,
    frame_bytes: usize,
    /// Frames read in one round. Reused allocation.
    new_frames: Vec<FrameHeader>,
    /// Frames may have been published that were not seen.
    frames_lost_from_sight: bool,
    world_lost_from_sight: bool,
    connect_after_ns: u64,
    /// Time from which the next frame without robots is examined.
    look_after_ns: u64,
    /// For tests: panics at this frame.
    fault: Option<u64>,
    last_frame: Option<FrameHeader>,
    last_world: Option<FrameHeader>,
    known_truth: VecDeque<TruthFrame>,
    detection_scorer: Scorer,
    world_scorer: Scorer,
    unknown_scorer: UnknownScorer,
    latency: LatencyMeter,
    tops: Option<TopScale>,
    rejected: BTreeMap<String, u64>,
    processes: HashMap<u32, ProcessRecord>,
    light: Subscriber<LightReport, ()>,
    gateway: GatewayWatch,
    rate: RateMeter,
    /// Processor time of this process before the run.
    supervisor_cpu_before: f64,
    memory_bytes: u64,
    memory_due_ns: u64,
    // Last, so that it outlives the ports.
    bus: Bus,
}

/// Latest state and counters of a process, kept after its end.
#[derive(Default)]
struct ProcessRecord {
    beat: Option<Heartbeat>,
    usage: Usage,
}

#[derive(Default)]
struct RateMeter {
    since_ns: u64,
    frames: Rate,
    counted: (u64, u64),
    cpu_seconds: BTreeMap<StageId, f64>,
    cpu_percent: BTreeMap<StageId, f64>,
    supervisor_cpu: (f64, f64),
}

impl Collector {
    /// Connects. Also returns the ports for publishing the report and the events.
    pub fn new(
        instance: &Instance,
        source: String,
        config: &Config,
        view: Arc<GroupView>,
    ) -> Result<(Self, Outlets), BusError> {
        let bus = Bus::join_as_reader(instance, "monitor")?;
        bus.enter_roster();
        let outlets = Outlets {
            status: bus.publisher(&topics::STATUS, MAX_STATUS_BYTES)?,
            events: bus.publisher(&topics::EVENTS, 1)?,
            health: bus.publisher(&topics::HEALTH, 1)?,
            requests: control::requests(&bus),
        };
        let base = Report {
            version: env!("CARGO_PKG_VERSION").into(),
            instance: instance.name().into(),
            source,
            camera: Camera {
                width: config.camera.width,
                height: config.camera.height,
                fps: config.camera.fps,
                device: None,
            },
            supervisor_pid: view.supervisor_pid,
            found: Found {
                robots_configured: config.robots.identities.len() as u32,
                ..Found::default()
            },
            ..Report::default()
        };
        let collector = Self {
            // From the last topic to the first: no frame is seen without its results.
            world: bus.subscriber(&topics::WORLD)?,
            detections: bus.subscriber(&topics::DETECTIONS)?,
            frames: bus.subscriber(&topics::frames(config.camera.frame_bytes()))?,
            truth: bus.subscriber(&topics::TRUTH)?,
            health: bus.subscriber(&topics::HEALTH)?,
            camera: CameraWatch::new(&bus)?,
            commanders: CommanderWatch::new(instance, config, &bus)?,
            publisher: PublisherWatch::new(&bus, &config.publish)?,
            strangers: StrangerWatch::new(instance, &config.access.publishers, &bus)?,
            view,
            config: (0, Arc::new(config.clone())),
            base,
            started_ns: monotonic_ns(),
            flow: Flow::default(),
            kept_frames: topics::frames(config.camera.frame_bytes()).buffer,
            frame_bytes: config.camera.frame_bytes(),
            new_frames: Vec::new(),
            frames_lost_from_sight: false,
            world_lost_from_sight: false,
            connect_after_ns: 0,
            look_after_ns: monotonic_ns() + LOOK_PERIOD_NS,
            fault: fault_from_environment("monitor"),
            last_frame: None,
            last_world: None,
            known_truth: VecDeque::with_capacity(KEPT_TRUTH),
            detection_scorer: Scorer::default(),
            world_scorer: Scorer::default(),
            unknown_scorer: UnknownScorer::new(config),
            latency: LatencyMeter::default(),
            // An invalid geometry is reported where it is used.
            tops: TopScale::new(config).ok(),
            rejected: BTreeMap::new(),
            processes: HashMap::new(),
            light: bus.subscriber(&topics::LIGHT)?,
            gateway: GatewayWatch::new(&bus, instance, config)?,
            rate: RateMeter::default(),
            supervisor_cpu_before: own_cpu_seconds(),
            memory_bytes: 0,
            memory_due_ns: monotonic_ns() + MEMORY_FIRST_NS,
            bus,
        };
        Ok((collector, outlets))
    }

    /// Reads everything published since the last call.
    pub fn collect(&mut self) -> Result<(), BusError> {
        self.use_newest_config();
        self.see_again();
        let mut received_frames = 0;
        while let Some(frame) = self.frames.receive()? {
            received_frames += 1;
            let header = frame.header();
            // Invalid frames of foreign programs; the classifier counts them by reason.
            let Camera { width, height, .. } = self.base.camera;
            if header.check(width, height, frame.elements().len()).is_err()
                || !header.follows(self.last_frame.as_ref(), monotonic_ns(), self.base.camera.fps)
            {
                continue;
            }
            self.last_frame = Some(*header);
            self.new_frames.push(*header);
            // Where robots are identified, there are colours; elsewhere a look now and then costs nothing.
            let now_ns = monotonic_ns();
            if self.base.found.robots > 0 {
                self.base.pictures = None;
            } else if now_ns >= self.look_after_ns {
                self.look_after_ns = now_ns + LOOK_PERIOD_NS;
                let is_bayer = header.pixel_format == PixelFormat::Bayer8 as u32;
                let (width, stride) = (header.width as usize, header.stride as usize);
                let is_colorless = is_bayer && !has_color(frame.elements(), width, stride);
                self.base.pictures = is_colorless.then(|| COLORLESS.into());
            }
        }
        // A nearly full buffer may have been full, and its oldest messages overwritten.
        let was_away = received_frames * 8 >= self.kept_frames * 7;
        self.world_lost_from_sight |= was_away;
        let is_broken = was_away || self.frames_lost_from_sight;
        let sight = if is_broken { Sight::Broken } else { Sight::Whole };
        for header in &self.new_frames {
            if self.fault == Some(header.seq) {
                panic!("asked to panic at {} by {FAULT_VARIABLE}", header.seq);
            }
            self.flow.captured(header.seq, sight);
            self.latency.frame(header);
            self.frames_lost_from_sight = false;
        }
        self.new_frames.clear();
        while let Some(received) = self.detections.receive()? {
            if let Some(detection) = received.message() {
                self.take_detection(detection)?;
            }
        }
        while let Some(received) = self.world.receive()? {
            if let Some(world) = received.message() {
                self.take_world(world)?;
            }
        }
        self.camera.collect(&self.view)?;
        self.publisher.collect(&self.view)?;
        while let Some(received) = self.health.receive()? {
            if let Some(beat) = received.message() {
                // Only processes of the group: foreign pids would pile up.
                let is_of_group = self.processes.contains_key(&beat.pid)
                    || self.view.processes().0.iter().any(|process| process.pid == beat.pid);
                if is_of_group {
                    self.processes.entry(beat.pid).or_default().beat = Some(*beat);
                }
            }
        }
        while let Some(received) = self.light.receive()? {
            if let Some(report) = received.message() {
                self.base.light = Some(Light::from(&report.correction));
            }
        }
        self.gateway.collect()?;
        self.commanders.collect(&self.view)?;
        let met = [
            (topics::FRAMES.name, self.frames.take_strangers()),
            (topics::DETECTIONS.name, self.detections.take_strangers()),
            (topics::WORLD.name, self.world.take_strangers()),
            (topics::TRUTH.name, self.truth.take_strangers()),
            (topics::HEALTH.name, self.health.take_strangers()),
            (topics::CAMERA.name, self.camera.take_strangers()),
            (topics::PUBLISHER.name, self.publisher.take_strangers()),
            (topics::LIGHT.name, self.light.take_strangers()),
            (topics::GATEWAY.name, self.gateway.take_strangers()),
        ];
        self.strangers.collect(&self.bus, &self.view, met)
    }

    /// Whether it misses a writer, for lack of descriptors or memory.
    fn is_blind(&self) -> bool {
        self.frames.misses_a_writer()
            || self.detections.misses_a_writer()
            || self.world.misses_a_writer()
            || self.truth.misses_a_writer()
            || self.health.misses_a_writer()
    }

    /// Reconnects to topics of which it misses a writer. Until that succeeds, it keeps the old
    /// connections.
    fn see_again(&mut self) {
        if !self.is_blind() {
            return;
        }
        self.frames_lost_from_sight |= self.frames.misses_a_writer();
        self.world_lost_from_sight |= self.world.misses_a_writer();
        let now_ns = monotonic_ns();
        if now_ns < self.connect_after_ns {
            return;
        }
        self.connect_after_ns = now_ns + RECONNECT_NS;
        let Self { frames, detections, world, truth, health, bus, .. } = self;
        let topic = topics::frames(self.frame_bytes);
        connect_again(frames, || bus.subscriber(&topic));
        connect_again(detections, || bus.subscriber(&topics::DETECTIONS));
        connect_again(world, || bus.subscriber(&topics::WORLD));
        connect_again(truth, || bus.subscriber(&topics::TRUTH));
        connect_again(health, || bus.subscriber(&topics::HEALTH));
    }

    /// Drops connections to readers and writers that have ended.
    pub fn refresh(&self) -> Result<(), BusError> {
        self.bus.refresh(false)
    }

    /// Events not returned before.
    pub fn take_new_events(&self) -> Vec<Event> {
        self.view.take_new_events()
    }

    /// The supervisor's heartbeat, if the supervisor is alive.
    pub fn heartbeat(&self) -> Option<Heartbeat> {
        let now_ns = monotonic_ns();
        self.view.is_watched(now_ns).then(|| self.view.heartbeat(now_ns))
    }

    fn take_detection(&mut self, detection: &DetectionFrame) -> Result<(), BusError> {
        if !detection.frame.is_present(monotonic_ns()) {
            return Ok(());
        }
        self.base.found = Found {
            robots: detection.robots().iter().filter(|it| it.is_identified()).count() as u32,
            ball: !detection.balls().is_empty(),
            regions: detection.region_count,
            ..self.base.found
        };
        if let Some(tops) = &mut self.tops {
            tops.add(detection);
        }
        for rejected in detection.rejected() {
            if let Some(reason) = RejectReason::from_number(rejected.reason) {
                *self.rejected.entry(reason.text().into()).or_default() += 1;
            }
        }
        if let Some(truth) = self.truth_of(detection.frame.seq)? {
            let robots: Vec<ReportedRobot> = detection
                .robots()
                .iter()
                .filter_map(|robot| {
                    Some(ReportedRobot {
                        team: robot.team,
                        robot_id: robot.robot_id.number()?,
                        x_mm: robot.x_mm.into(),
                        y_mm: robot.y_mm.into(),
                        orientation: robot.orientation.into(),
                    })
                })
                .collect();
            let ball = detection.balls().first().map(|ball| [ball.x_mm.into(), ball.y_mm.into()]);
            let truth = self.unknown_scorer.named_only(&truth);
            self.detection_scorer.score(&truth, &robots, ball);
        }
        Ok(())
    }

    fn take_world(&mut self, world: &WorldFrame) -> Result<(), BusError> {
        let (frame, now_ns) = (world.frame, monotonic_ns());
        let is_repeated = self.last_world.is_some_and(|last| frame.seq <= last.seq);
        // Invalid results of foreign programs must not count.
        if !frame.is_present(now_ns)
            || !is_repeated
                && !frame.follows(self.last_world.as_ref(), now_ns, self.base.camera.fps)
        {
            return Ok(());
        }
        if !is_repeated {
            self.last_world = Some(frame);
        }
        let before = self.flow.frames(0, false).duplicates_in_world;
        // Unseen messages of a topic precede the next one seen.
        let is_broken = std::mem::take(&mut self.world_lost_from_sight);
        let sight = if is_broken { Sight::Broken } else { Sight::Whole };
        self.flow.arrived(world.frame.seq, sight);
        if self.flow.frames(0, false).duplicates_in_world > before {
            return Ok(());
        }
        self.latency.world(world);
        self.base.found.unknown_robots = world.unknown_robots().len() as u32;
        if let Some(truth) = self.truth_of(world.frame.seq)? {
            let present = |status: u32| status != TrackStatus::Absent as u32;
            let robots: Vec<ReportedRobot> = world
                .robots()
                .iter()
                .filter(|robot| present(robot.status))
                .map(|robot| ReportedRobot {
                    team: robot.team,
                    robot_id: robot.robot_id,
                    x_mm: robot.x_mm,
                    y_mm: robot.y_mm,
                    orientation: robot.orientation,
                })
                .collect();
            let ball = &world.ball;
            let ball = present(ball.status).then_some([ball.x_mm, ball.y_mm]);
            self.unknown_scorer.score(&truth, world);
            let truth = self.unknown_scorer.named_only(&truth);
            self.world_scorer.score(&truth, &robots, ball);
        }
        Ok(())
    }

    /// Truth of a frame. It is published before the frame, so it has arrived by now.
    fn truth_of(&mut self, seq: u64) -> Result<Option<TruthFrame>, BusError> {
        while let Some(received) = self.truth.receive()? {
            if let Some(truth) = received.message() {
                if self.known_truth.len() == KEPT_TRUTH {
                    self.known_truth.pop_front();
                }
                self.known_truth.push_back(*truth);
            }
        }
        Ok(self.known_truth.iter().rev().find(|truth| truth.seq == seq).copied())
    }

    /// The report; `complete` at the end of the run.
    pub fn report(&mut self, complete: bool) -> Report {
        let now = monotonic_ns();
        let (views, restarts) = self.view.processes();
        let pids: Vec<u32> = views.iter().map(|process| process.pid).collect();
        for process in &views {
            // A process that has ended keeps its last figures.
            let record = self.processes.entry(process.pid).or_default();
            record.usage = usage_of(process.pid).unwrap_or(record.usage);
        }
        let graph = StageGraph::SINGLE;
        let mut stages: BTreeMap<StageId, Stage> =
            graph.stages().map(|id| (id, Stage::default())).collect();
        for record in self.processes.values() {
            let Some(beat) = &record.beat else { continue };
            let Some(id) = StageId::from_number(beat.process) else { continue };
            let stage = stages.entry(id).or_default();
            stage.frames_in = stage.frames_in.saturating_add(beat.frames_in);
            stage.frames_out = stage.frames_out.saturating_add(beat.frames_out);
            stage.frames_missed = stage.frames_missed.saturating_add(beat.frames_missed);
            stage.cpu_seconds += record.usage.cpu_seconds;
            for (reason, &count) in DropReason::ALL.iter().zip(&beat.dropped) {
                if count > 0 {
                    *stage.dropped.entry(reason.name().into()).or_default() += count;
                }
            }
        }
        for process in views {
            let stage = stages.entry(process.stage).or_default();
            stage.rss_bytes +=
                self.processes.get(&process.pid).map_or(0, |record| record.usage.rss_bytes);
            let state = match process.state {
                None => "starting",
                Some(ProcessState::Spare) => "spare",
                Some(ProcessState::Active) => "active",
                Some(ProcessState::Finished) => "finished",
                Some(ProcessState::Waiting) => "waiting",
            };
            stage.processes.push(Process { pid: process.pid, state: state.into() });
        }
        for (id, stage) in &mut stages {
            stage.restarts = restarts.get(id).copied().unwrap_or(0);
        }

        let grabber = &stages[&StageId::from(ProcessKind::Grabber)];
        let dropped_by_grabber = grabber.dropped.values().sum();
        let frames = self.flow.frames(dropped_by_grabber, complete);
        let supervisor_cpu_seconds = own_cpu_seconds() - self.supervisor_cpu_before;
        let counted = (frames.captured, frames.world);
        self.rate.measure(now, counted, supervisor_cpu_seconds, &mut stages);
        let supervisor_cpu_percent = self.rate.supervisor_cpu.1;
        let of_stages: f64 = stages
            .iter()
            .filter(|(id, _)| !id.is_grabber())
            .map(|(_, stage)| stage.cpu_percent)
            .sum();
        if now >= self.memory_due_ns && !complete {
            self.memory_due_ns = now + MEMORY_PERIOD_NS;
            let pids = pids.into_iter().chain([self.view.supervisor_pid]);
            self.memory_bytes = pids.filter_map(proportional_bytes).sum();
        }
        let resources = Resources {
            supervisor_cpu_seconds,
            supervisor_cpu_percent,
            pipeline_cpu_percent: supervisor_cpu_percent + of_stages,
            memory_bytes: self.memory_bytes,
        };
        let working =
            |stage: &Stage| stage.processes.iter().any(|process| process.state == "active");
        let accuracy = match (self.detection_scorer.errors(), self.world_scorer.errors()) {
            (Some(detections), Some(world)) => {
                Some(Accuracy { detections, world, unknown: self.unknown_scorer.errors() })
            }
            _ => None,
        };
        let mut degraded = self.view.lacks();
        if self.is_blind() {
            degraded
                .push("count: a process's messages cannot be seen, and count as not seen".into());
        }
        let camera = Camera { device: self.camera.device(), ..self.base.camera.clone() };
        let state = |view: AttendantView| {
            (view.name.into(), AttendantState { pid: view.pid, restarts: view.restarts })
        };
        let attendants: BTreeMap<_, _> = self.view.attendants().into_iter().map(state).collect();
        Report {
            camera,
            elapsed_s: ((now - self.started_ns) as f64 / 1e7).round() / 100.0,
            complete: stages.values().all(working),
            degraded,
            frames,
            rate: self.rate.frames.clone(),
            latency_us: self.latency.report(),
            resources,
            stages: stages.into_iter().map(|(id, stage)| (id.to_string(), stage)).collect(),
            rejected: self.rejected.clone(),
            tops: self.tops.as_ref().and_then(TopScale::measured).map(Tops::from),
            accuracy,
            gateway: self.gateway.report(&attendants),
            publisher: self.publisher.report(&attendants),
            attendants,
            commanders: self.commanders.report(),
            strangers: self.strangers.report(),
            events: self.view.events(),
            configuration: self.view.configured(),
            ..self.base.clone()
        }
    }
}

impl RateMeter {
    /// Measures the rates once a period, and writes the processor shares into the stages.
    fn measure(
        &mut self,
        now_ns: u64,
        counted: (u64, u64),
        supervisor_cpu_seconds: f64,
        stages: &mut BTreeMap<StageId, Stage>,
    ) {
        let elapsed_ns = now_ns.saturating_sub(self.since_ns);
        if elapsed_ns >= RATE_PERIOD_NS {
            let seconds = elapsed_ns as f64 / 1e9;
            let rate = |new: u64, old: u64| {
                (new.saturating_sub(old) as f64 / seconds * 10.0).round() / 10.0
            };
            let first = self.since_ns == 0;
            if !first {
                self.frames = Rate {
                    captured: rate(counted.0, self.counted.0),
                    world: rate(counted.1, self.counted.1),
                };
            }
            for (&id, stage) in stages.iter() {
                let used = stage.cpu_seconds - self.cpu_seconds.get(&id).copied().unwrap_or(0.0);
                if !first {
                    self.cpu_percent.insert(id, (used.max(0.0) / seconds * 1000.0).round() / 10.0);
                }
                self.cpu_seconds.insert(id, stage.cpu_seconds);
            }
            let (used, percent) = &mut self.supervisor_cpu;
            if !first {
                *percent = ((supervisor_cpu_seconds - *used) / seconds * 1000.0).round() / 10.0;
            }
            *used = supervisor_cpu_seconds;
            self.since_ns = now_ns;
            self.counted = counted;
        }
        for (id, stage) in stages.iter_mut() {
            stage.cpu_percent = self.cpu_percent.get(id).copied().unwrap_or(0.0);
        }
    }
}

fn connect_again<E: Message, H: Header>(
    subscriber: &mut Subscriber<E, H>,
    connect: impl FnOnce() -> Result<Subscriber<E, H>, BusError>,
) {
    if subscriber.misses_a_writer()
        && let Ok(new) = connect()
    {
        *subscriber = new;
    }
}

fn own_cpu_seconds() -> f64 {
    usage_of(std::process::id()).map_or(0.0, |usage| usage.cpu_seconds)
}
