//! Reads topics for the page, like any consumer. A topic is received only while a client wants it, and of each
//! only the newest message: what nobody waits for is overwritten unread.

use super::desk::{Desk, Kind, News, Raw};
use super::picture::Frame;
use super::scene::{Scene, messages};
use ::messages::stages::StageId;
use ::messages::topics::{self, Topic};
use ::messages::{
    Attendant, ClearStale, DetectionFrame, EventKind, FrameHeader, GroupEvent, Header,
    LightCorrection, LightReport, Message, Run, RunsHeader, StatusHeader, WorldFrame, read_text,
};
use client::bus::{Bus, BusError, Received, Subscriber};
use client::instance::Instance;
use config::snapshot::Snapshot;
use recording::{encode_list, encode_message};
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::fs::{self, Metadata};
use std::os::unix::fs::MetadataExt;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time between two looks at the configuration.
const LOOK: Duration = Duration::from_millis(100);
/// Events kept for clients.
const KEPT_EVENTS: usize = 50;

/// A topic that is received while it is wanted.
struct Intake<E: Message, H: Header> {
    topic: Topic<E, H>,
    kinds: &'static [Kind],
    port: Option<Subscriber<E, H>>,
    /// Of a topic with history, the history too.
    with_history: bool,
}

impl<E: Message, H: Header> Intake<E, H> {
    fn new(topic: Topic<E, H>, kinds: &'static [Kind], with_history: bool) -> Self {
        Self { topic, kinds, port: None, with_history }
    }

    /// Connects or disconnects as wanted. The port, if a client waits at this moment.
    fn open(&mut self, bus: &Bus, desk: &Desk) -> Result<Option<&Subscriber<E, H>>, BusError> {
        if !self.kinds.iter().any(|&kind| desk.is_wanted(kind)) {
            if self.port.take().is_some() {
                self.kinds.iter().for_each(|&kind| desk.forget(kind));
            }
            return Ok(None);
        }
        // iceoryx2 never connects to a writer again for which there was no room at first.
        if self.port.as_ref().is_none_or(Subscriber::misses_a_writer) {
            self.port = None;
            let port = match self.with_history {
                true => bus.subscriber_with_history(&self.topic),
                false => bus.newest_only(&self.topic),
            };
            self.port = Some(port?);
        }
        let is_awaited = self.kinds.iter().any(|&kind| desk.is_awaited(kind));
        Ok(self.port.as_ref().filter(|_| is_awaited))
    }

    fn newest(&mut self, bus: &Bus, desk: &Desk) -> Result<Option<Received<E, H>>, BusError> {
        self.open(bus, desk)?.map_or(Ok(None), Subscriber::newest)
    }
}

/// The reader.
pub struct Reading {
    instance: Instance,
    detections: Intake<DetectionFrame, ()>,
    world: Intake<WorldFrame, ()>,
    runs: Intake<Run, RunsHeader>,
    status: Intake<u8, StatusHeader>,
    events: Intake<GroupEvent, ()>,
    light: Intake<LightReport, ()>,
    frames: Option<Intake<u8, FrameHeader>>,
    /// The newest correction of the light, for the detections; reported when it changes and now and then.
    newest_light: Option<LightCorrection>,
    kept_events: VecDeque<Value>,
    event_count: u64,
    status_count: u64,
    /// The configuration's file when it was read last.
    stamp: Option<(u64, i64, i64)>,
    looked: Option<Instant>,
    scene: Option<Arc<Scene>>,
}

impl Reading {
    /// Receives nothing yet.
    pub fn new(instance: &Instance) -> Self {
        Self {
            instance: instance.clone(),
            detections: Intake::new(
                topics::DETECTIONS,
                &[Kind::Detections, Kind::RawDetections],
                false,
            ),
            world: Intake::new(topics::WORLD, &[Kind::World, Kind::Poses, Kind::RawWorld], false),
            runs: Intake::new(topics::RUNS, &[Kind::Runs, Kind::RawRuns], false),
            status: Intake::new(topics::STATUS, &[Kind::Status], false),
            events: Intake::new(topics::EVENTS, &[Kind::Events], true),
            light: Intake::new(topics::LIGHT, &[Kind::Detections], false),
            frames: None,
            newest_light: None,
            kept_events: VecDeque::new(),
            event_count: 0,
            status_count: 0,
            stamp: None,
            looked: None,
            scene: None,
        }
    }

    /// One round: what clients wait for is read, converted and put on the desk.
    pub fn round(&mut self, bus: &Bus, desk: &Desk) -> Result<(), BusError> {
        self.look_at_configuration(desk);
        if let Some(scene) = self.scene.clone() {
            self.read_frames(bus, desk, &scene)?;
            if let Some(received) = self.light.newest(bus, desk)?
                && let Some(report) = received.message()
            {
                self.newest_light = Some(report.correction);
            }
            if let Some(received) = self.detections.newest(bus, desk)?
                && let Some(seen) = received.message()
            {
                if desk.is_awaited(Kind::Detections) {
                    let mut found = scene.detections(seen);
                    found["light"] = self.newest_light.map_or(Value::Null, light_json);
                    put(desk, Kind::Detections, seen.frame.seq, &found);
                }
                put_raw(desk, Kind::RawDetections, &seen.frame, seen);
            }
            if let Some(received) = self.world.newest(bus, desk)?
                && let Some(world) = received.message()
            {
                put_raw(desk, Kind::RawWorld, &world.frame, world);
                if desk.is_awaited(Kind::World) {
                    put(desk, Kind::World, world.frame.seq, &scene.world(world));
                }
                if desk.is_awaited(Kind::Poses) {
                    let text = String::from_utf8(crate::publisher::convert::json(world, now_s()));
                    let text = text.unwrap_or_default().into();
                    desk.put(Kind::Poses, News { seq: world.frame.seq, text });
                }
            }
        }
        if let Some(received) = self.runs.newest(bus, desk)? {
            let header = received.header();
            let seq = header.frame.seq;
            let runs = header.valid(received.elements());
            if desk.is_awaited(Kind::Runs) {
                let text = messages::runs(seq, header.revision, runs);
                desk.put(Kind::Runs, News { seq, text: text.into() });
            }
            if desk.is_awaited(Kind::RawRuns) {
                let mut bytes = Vec::new();
                encode_list(header, runs, &mut bytes);
                let t_wall_ns = header.frame.t_capture_wall_ns;
                desk.put_raw(Kind::RawRuns, Raw { seq, t_wall_ns, bytes: bytes.into() });
            }
        }
        if let Some(received) = self.status.newest(bus, desk)? {
            let length = received.header().bytes as usize;
            let bytes = received.elements();
            let text = String::from_utf8_lossy(&bytes[..length.min(bytes.len())]);
            self.status_count += 1;
            desk.put(Kind::Status, News { seq: self.status_count, text: text.as_ref().into() });
        }
        self.read_events(bus, desk)?;
        desk.end_round();
        Ok(())
    }

    fn read_frames(&mut self, bus: &Bus, desk: &Desk, scene: &Scene) -> Result<(), BusError> {
        let camera = &scene.config.camera;
        // Its size never changes in the life of a group.
        let intake = self.frames.get_or_insert_with(|| {
            Intake::new(topics::frames(camera.frame_bytes()), &[Kind::Frames], false)
        });
        let Some(received) = intake.newest(bus, desk)? else { return Ok(()) };
        let frame = Frame::copy(received.header(), received.elements(), camera.picture_px());
        if let Some(frame) = frame {
            desk.put_frame(Arc::new(frame));
        }
        Ok(())
    }

    fn read_events(&mut self, bus: &Bus, desk: &Desk) -> Result<(), BusError> {
        if !desk.is_wanted(Kind::Events) {
            self.kept_events.clear();
        }
        let Some(port) = self.events.open(bus, desk)? else { return Ok(()) };
        let mut has_news = false;
        while let Some(received) = port.receive()? {
            let Some(event) = received.message() else { continue };
            self.kept_events.push_back(event_json(event));
            self.event_count += 1;
            has_news = true;
            if self.kept_events.len() > KEPT_EVENTS {
                self.kept_events.pop_front();
            }
        }
        if has_news {
            let events = json!({ "seq": self.event_count, "events": self.kept_events });
            put(desk, Kind::Events, self.event_count, &events);
        }
        Ok(())
    }

    /// Reads the group's configuration when it was replaced.
    fn look_at_configuration(&mut self, desk: &Desk) {
        if self.looked.is_some_and(|looked| looked.elapsed() < LOOK) || !desk.is_busy() {
            return;
        }
        self.looked = Some(Instant::now());
        let stamp = |data: Metadata| (data.ino(), data.mtime(), data.mtime_nsec());
        let now = fs::metadata(self.instance.config_path()).ok().map(stamp);
        if now.is_none() || now == self.stamp {
            return;
        }
        // A file that cannot be read at this moment is tried again.
        let Ok(snapshot) = Snapshot::load(&self.instance.config_path()) else { return };
        let Some(scene) = Scene::new(&snapshot) else { return };
        let scene = Arc::new(scene);
        self.stamp = now;
        self.scene = Some(Arc::clone(&scene));
        desk.put_scene(scene);
    }
}

fn put(desk: &Desk, kind: Kind, seq: u64, value: &Value) {
    desk.put(kind, News { seq, text: value.to_string().into() });
}

/// Puts a message on the desk as recordings have it.
fn put_raw<T: Message + ClearStale>(desk: &Desk, kind: Kind, frame: &FrameHeader, message: &T) {
    if !desk.is_awaited(kind) {
        return;
    }
    // A third of a megabyte, which is too much for the stack.
    let mut copy = bytemuck::allocation::zeroed_box::<T>();
    bytemuck::bytes_of_mut(&mut *copy).copy_from_slice(bytemuck::bytes_of(message));
    copy.clear_stale();
    let mut bytes = Vec::new();
    encode_message(&*copy, &mut bytes);
    let (seq, t_wall_ns) = (frame.seq, frame.t_capture_wall_ns);
    desk.put_raw(kind, Raw { seq, t_wall_ns, bytes: bytes.into() });
}

/// How pictures are corrected before their colours are told apart.
fn light_json(it: LightCorrection) -> Value {
    json!({ "followed": it.has(LightCorrection::FOLLOWED), "gains": it.gains })
}

/// An event in the terms of a page.
pub fn event_json(event: &GroupEvent) -> Value {
    let kind = EventKind::from_number(event.kind).unwrap_or_default();
    let attendant = Attendant::ALL.into_iter().find(|&it| it as u32 == event.process);
    let stage = || StageId::from_number(event.process).map(|stage| stage.to_string());
    let process = attendant.map(|it| it.name().to_string()).or_else(stage);
    json!({
        "time_s": event.t_wall_ns as f64 * 1e-9, "number": event.number, "kind": kind,
        "stage": process, "pid": event.pid,
        "what": read_text(&event.what), "evidence": read_text(&event.evidence),
    })
}

/// Seconds since 1970.
fn now_s() -> f64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.unwrap_or_default().as_secs_f64()
}
