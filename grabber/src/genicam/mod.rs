//! GigE Vision and USB3 Vision cameras, by way of the library Aravis.
//!
//! `library` loads it, and `objects` and `stream` make its functions safe. This file opens a camera,
//! configures it, and has the library write pictures straight into shared memory.

mod formats;
// Names are the library's, and documented there.
#[allow(missing_docs)]
mod library;
mod listing;
mod objects;
mod stream;

pub use listing::list;

use crate::camera::{
    Arrival, Delivery, Device, DeviceClock, Fault, FramePool, Picture, Session, Stream, WallClock,
};
use client::clock::{monotonic_ns, wall_ns};
use config::{CameraConfig, SettingValue};
use messages::CameraState;
use objects::{AravisError, Camera, error_code};
use std::time::Duration;
use stream::Received;

/// Name prefix of the library's simulated cameras.
const SIMULATED: &str = "Fake_";
/// Packet size that every network supports.
const DEFAULT_PACKET_BYTES: u32 = 1500;
/// Silence after which a camera may not answer requests either.
const SILENCE_NS: u64 = 500_000_000;
/// Packet size on this machine's loopback network.
const LOOPBACK_PACKET_BYTES: u32 = 8000;

/// A GenICam camera, by its name or address; without one, the first that is found.
pub struct GenicamDevice {
    id: Option<String>,
    config: CameraConfig,
}

impl GenicamDevice {
    /// The camera of this name (as in `touchline cameras`) or network address, and its configuration.
    pub fn new(id: Option<String>, config: &CameraConfig) -> Self {
        Self { id, config: config.clone() }
    }

    fn wanted(&self) -> String {
        match &self.id {
            Some(id) => format!("the camera {id}"),
            None => "a GigE Vision or USB3 Vision camera".into(),
        }
    }

    /// The fault for an error of opening the camera.
    fn refusal(&self, error: &AravisError) -> Fault {
        let wanted = self.wanted();
        match error.code {
            // Known earlier, but gone: requests to it time out.
            error_code::NOT_FOUND | error_code::NOT_CONNECTED | error_code::TIMEOUT => Fault::new(
                CameraState::Missing,
                format!(
                    "{wanted} is not there: is it connected, switched on, and in this machine's \
                     network? `touchline cameras` lists what is"
                ),
            ),
            error_code::NOT_CONTROLLER | error_code::ACCESS_DENIED | error_code::BUSY => {
                Fault::new(
                    CameraState::Busy,
                    format!("{wanted} is in use by another program ({})", error.text),
                )
            }
            _ if error.text.contains("ermission") => Fault::new(
                CameraState::NoRights,
                format!(
                    "no rights to open {wanted} ({}): USB cameras need a udev rule, which comes with \
                     the package libaravis-0.8-0",
                    error.text
                ),
            ),
            _ => Fault::new(CameraState::Failed, format!("{wanted}: {}", error.text)),
        }
    }

    fn set_format(&self, camera: &Camera) -> Result<String, Fault> {
        let wrong = |problem: String| Fault::new(CameraState::WrongFormat, problem);
        let CameraConfig { width, height, genicam, .. } = &self.config;
        let offered = camera.formats().map_err(|error| self.refusal(&error))?;
        let format = match genicam.format.as_str() {
            "auto" => formats::best(&offered).cloned(),
            name => {
                if let Some(reason) = formats::refusal(name) {
                    return Err(wrong(format!("{name} {reason}")));
                }
                offered.iter().find(|offered| *offered == name).cloned()
            }
        };
        let format = format.ok_or_else(|| {
            wrong(format!("{} has no usable format; it has {}", self.wanted(), offered.join(", ")))
        })?;
        camera
            .set_format(&format)
            .map_err(|error| wrong(format!("format {format}: {}", error.text)))?;
        let got = camera
            .set_size(*width, *height)
            .map_err(|error| wrong(format!("size {width}×{height}: {}", error.text)))?;
        if got != (*width, *height) {
            let problem =
                format!("{} gives {}×{} instead of {width}×{height}", self.wanted(), got.0, got.1);
            return Err(wrong(problem));
        }
        Ok(format)
    }

    /// Sets the configured features. Switches and enumerations go first, since an automatic must be off
    /// before the values that it controls can be set.
    fn set_features(&self, camera: &Camera) -> Result<(), Fault> {
        let wrong = |problem: String| Fault::new(CameraState::WrongSetting, problem);
        let mut features: Vec<(&String, &SettingValue)> =
            self.config.genicam.features.iter().collect();
        features.sort_by_key(|(_, value)| matches!(value, SettingValue::Number(_)));
        for (name, value) in features {
            if !camera.has(name) {
                let problem = format!("{} has no feature {name} that can be set", self.wanted());
                return Err(wrong(problem));
            }
            if let (SettingValue::Number(number), Some([low, high, _])) =
                (value, camera.range(name))
                && !(low..=high).contains(number)
            {
                let problem = format!("feature {name} = {value}: allowed are {low} to {high}");
                return Err(wrong(problem));
            }
            camera.set_feature(name, &value.to_string()).map_err(|error| {
                wrong(format!("feature {name} = {value}: the camera says: {}", error.text))
            })?;
        }
        Ok(())
    }

    fn set_network(&self, camera: &Camera) -> Result<(), Fault> {
        let genicam = &self.config.genicam;
        let is_near = || {
            let id = self.id.as_deref().unwrap_or_default();
            let found = objects::discover().unwrap_or_default();
            let it = found.iter().find(|it| id.is_empty() || it.id == id || it.address == id);
            it.map_or(id, |it| it.address.as_str()).starts_with("127.")
        };
        let bytes = match genicam.packet_size {
            0 if is_near() => LOOPBACK_PACKET_BYTES,
            0 => DEFAULT_PACKET_BYTES,
            bytes => bytes,
        };
        camera.set_packets(bytes, genicam.packet_socket).map_err(|error| {
            let problem = format!("packet_size = {bytes}: {}", error.text);
            Fault::new(CameraState::WrongSetting, problem)
        })
    }
}

impl Device for GenicamDevice {
    fn name(&self) -> String {
        match &self.id {
            Some(id) => format!("genicam:{id}"),
            None => "genicam".into(),
        }
    }

    fn open(&self) -> Result<Box<dyn Session>, Fault> {
        let no_library = |problem: String| Fault::new(CameraState::NoLibrary, problem);
        let library = library::library().map_err(no_library)?;
        if self.id.as_ref().is_some_and(|id| id.starts_with(SIMULATED)) {
            objects::enable_fake().map_err(no_library)?;
        }
        let failed = |error: AravisError| self.refusal(&error);
        let camera = Camera::open(library, self.id.as_deref()).map_err(failed)?;
        let format = self.set_format(&camera)?;
        self.set_features(&camera)?;
        let promised_fps = camera.set_rate(self.config.fps).map_err(failed)?;
        let is_gige = camera.is_gige();
        if is_gige {
            self.set_network(&camera)?;
        }
        let told_us = camera.exposure_us().map(|exposure_us| exposure_us as u32);
        let payload = camera.payload().map_err(failed)?;
        Ok(Box::new(Opened {
            model: camera.model(),
            camera,
            config: self.config.clone(),
            format,
            promised_fps,
            exposure_us: told_us.unwrap_or(self.config.exposure_us),
            payload,
            is_gige,
        }))
    }
}

struct Opened {
    camera: Camera,
    config: CameraConfig,
    model: String,
    format: String,
    promised_fps: Option<f64>,
    exposure_us: u32,
    payload: usize,
    is_gige: bool,
}

impl Session for Opened {
    fn promised_fps(&self) -> Option<f64> {
        self.promised_fps
    }

    fn start(self: Box<Self>, pool: &mut FramePool) -> Result<(Box<dyn Stream>, String), Fault> {
        let failed =
            |what: &str, why: String| Fault::new(CameraState::Failed, format!("{what}: {why}"));
        let genicam = &self.config.genicam;
        let mut stream = self
            .camera
            .create_stream()
            .map_err(|error| failed("receiving from the camera", error.text))?;
        if self.is_gige {
            let timeout = Duration::from_millis(genicam.frame_timeout_ms.into());
            stream.set_network(genicam.socket_buffer_bytes, genicam.packet_resend, timeout);
        }
        for _ in 0..genicam.buffers {
            // Fewer buffers suffice, if there are any.
            if let Ok(frame) = pool.loan(self.payload) {
                stream.add(frame);
            }
        }
        if let Err(error) = self.camera.start() {
            let ended = stream.end();
            std::thread::spawn(move || drop((ended, self.camera)));
            return Err(failed("starting the camera", error.text));
        }
        let CameraConfig { width, height, .. } = self.config;
        let description = format!(
            "{}, {} {width}×{height}, straight into shared memory",
            self.model, self.format
        );
        let stream = GenicamStream {
            stream: Some(stream),
            camera: Some(self.camera),
            width,
            height,
            exposure_us: self.exposure_us,
            payload: self.payload,
            clock: DeviceClock::default(),
            wall_clock: WallClock::default(),
            frame_id: None,
            device_seq: 0,
            arrived_ns: monotonic_ns(),
        };
        Ok((Box::new(stream), description))
    }
}

struct GenicamStream {
    // Both are `None` only while `self` is being dropped.
    stream: Option<stream::Stream>,
    camera: Option<Camera>,
    width: u32,
    height: u32,
    exposure_us: u32,
    payload: usize,
    clock: DeviceClock,
    /// The clock of Aravis' arrival times.
    wall_clock: WallClock,
    frame_id: Option<u64>,
    device_seq: u64,
    /// Time of the last arrival.
    arrived_ns: u64,
}

impl GenicamStream {
    /// Extends the camera's number to one that never wraps.
    fn count(&mut self, frame_id: u64) -> u64 {
        let step = self.frame_id.map_or(0, |last| formats::step(last, frame_id));
        self.frame_id = Some(frame_id);
        self.device_seq = self.device_seq.wrapping_add(step);
        self.device_seq
    }

    fn picture(&self, received: &Received) -> Result<Picture, Fault> {
        let &Received { width, height, format, .. } = received;
        let wrong = |problem: String| Fault::new(CameraState::WrongFormat, problem);
        let (pixel_format, bayer_order) = formats::of_number(format)
            .ok_or_else(|| wrong(format!("the camera sends pictures of format {format:#010x}")))?;
        if (width, height) != (self.width, self.height) {
            return Err(wrong(format!("the camera sends pictures of {width}×{height}")));
        }
        let stride = pixel_format.row_bytes(width) as u32;
        let exposure_us = self.exposure_us;
        Ok(Picture { width, height, stride, pixel_format, bayer_order, exposure_us })
    }

    /// The middle of the exposure: the camera begins to send when the exposure ends.
    fn capture_time(&mut self, received: &Received) -> u64 {
        let now_ns = monotonic_ns();
        let age_ns = match received.arrived_wall_ns {
            0 => 0,
            arrived_ns => self.wall_clock.age_ns(arrived_ns, wall_ns(), now_ns),
        };
        let arrived_ns = now_ns.saturating_sub(age_ns);
        let local_ns = self.clock.local_ns(received.device_ns, arrived_ns);
        local_ns.saturating_sub(u64::from(self.exposure_us) * 500)
    }
}

impl Stream for GenicamStream {
    fn next(&mut self, pool: &mut FramePool, timeout: Duration) -> Result<Option<Arrival>, Fault> {
        let Some(stream) = &mut self.stream else { return Ok(None) };
        let Some(received) = stream.receive(timeout) else { return Ok(None) };
        self.arrived_ns = monotonic_ns();
        if !received.is_complete {
            stream.give(received.index, received.frame);
            return Ok(Some(Arrival::Incomplete));
        }
        match pool.loan(self.payload) {
            Ok(fresh) => stream.give(received.index, fresh),
            Err(_) => {
                stream.give(received.index, received.frame);
                return Ok(Some(Arrival::NoMemory));
            }
        }
        let picture = self.picture(&received)?;
        let t_capture_ns = self.capture_time(&received);
        let device_seq = self.count(received.frame_id);
        let frame = received.frame;
        Ok(Some(Arrival::Frame(Delivery { frame, picture, device_seq, t_capture_ns })))
    }
}

impl Drop for GenicamStream {
    fn drop(&mut self) {
        let (Some(camera), Some(stream)) = (self.camera.take(), self.stream.take()) else { return };
        let is_answering = monotonic_ns() - self.arrived_ns < SILENCE_NS;
        if is_answering {
            camera.stop();
        }
        let ended = stream.end();
        if is_answering {
            return;
        }
        // Closing a camera that does not answer takes seconds, in which the process could send no heartbeat.
        std::thread::spawn(move || drop((ended, camera)));
    }
}
