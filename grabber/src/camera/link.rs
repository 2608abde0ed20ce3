//! The link to a real camera: opens it, monitors it, and reopens it after a fault.
//!
//! No fault of a camera ends the grabber; it reports the fault and retries after a pause. Opening may take
//! seconds and happens on a thread of its own, so that the process keeps sending heartbeats.

use super::device::{Arrival, Delivery, Device, Fault, Session, Stream};
use super::numbering::Numbering;
use super::rate_meter::RateMeter;
use super::{Camera, CameraError, Captured, Exposure, FramePool, LastFrame};
use client::clock::{monotonic_ns, wall_ns};
use messages::{CameraReport, CameraState, write_text};
use runtime::process::MAX_WAIT;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

/// Pause before the first retry; doubles with each further failure.
const MIN_PAUSE_NS: u64 = 100_000_000;
/// Longest pause, so that a camera that is plugged in again is found soon.
const MAX_PAUSE_NS: u64 = 1_000_000_000;
/// Time allowed for opening a camera.
const OPEN_TIMEOUT_NS: u64 = 10_000_000_000;
/// Time allowed from start to the first frame.
const FIRST_FRAME_TIMEOUT_NS: u64 = 3_000_000_000;
/// Time allowed between frames, if longer than two and a half frame periods.
const FRAME_TIMEOUT_NS: u64 = 1_000_000_000;
/// Streaming time after which the next failure counts as the first.
const STABLE_NS: u64 = 2_000_000_000;
/// Maximum age of a capture time when its frame arrives; older ones are replaced.
const MAX_CAPTURE_AGE_NS: u64 = 2_000_000_000;

/// A camera that may be unplugged and come back.
pub struct Link {
    device: Arc<dyn Device>,
    fps: f64,
    numbering: Numbering,
    report: CameraReport,
    phase: Phase,
    failures: u32,
    /// Number of incomplete frames when the last whole one arrived.
    incomplete_before: u64,
}

enum Phase {
    Waiting { until_ns: u64 },
    Opening { session: Receiver<Result<Box<dyn Session>, Fault>>, since_ns: u64 },
    Streaming(Running),
}

struct Running {
    stream: Box<dyn Stream>,
    started_ns: u64,
    arrived_ns: Option<u64>,
    rate_meter: RateMeter,
}

impl Link {
    /// A link to a camera with a nominal rate, frames per second. Opening begins at once.
    pub fn new(device: Arc<dyn Device>, fps: f64, last: Option<LastFrame>) -> Self {
        let mut report: CameraReport = bytemuck::Zeroable::zeroed();
        write_text(&mut report.device, &device.name());
        let phase = open_on_thread(&device);
        let numbering = Numbering::new(fps, last);
        Self { device, fps, numbering, report, phase, failures: 0, incomplete_before: 0 }
    }

    /// Performs one step, which takes at most [`MAX_WAIT`].
    fn step(&mut self, pool: &mut FramePool) -> Result<Option<Captured>, Fault> {
        match &mut self.phase {
            Phase::Waiting { until_ns } => {
                let left = Duration::from_nanos(until_ns.saturating_sub(monotonic_ns()));
                std::thread::sleep(left.min(MAX_WAIT));
                if left <= MAX_WAIT {
                    self.phase = open_on_thread(&self.device);
                }
                Ok(None)
            }
            Phase::Opening { session, since_ns } => {
                match session.recv_timeout(MAX_WAIT) {
                    Ok(session) => self.start(session?, pool)?,
                    // Giving up would leave the thread with the device and start another one.
                    Err(RecvTimeoutError::Timeout) => {
                        let waited_ns = monotonic_ns() - *since_ns;
                        if waited_ns > OPEN_TIMEOUT_NS {
                            self.report.state = CameraState::Hung as u32;
                            let problem = "does not answer while it is being opened";
                            write_text(&mut self.report.problem, problem);
                        }
                    }
                    Err(RecvTimeoutError::Disconnected) => {
                        let problem = "the thread that opens the camera has died";
                        return Err(Fault::new(CameraState::Failed, problem));
                    }
                }
                Ok(None)
            }
            Phase::Streaming(_) => self.next_frame(pool),
        }
    }

    fn start(&mut self, session: Box<dyn Session>, pool: &mut FramePool) -> Result<(), Fault> {
        self.report.promised_fps = session.promised_fps().unwrap_or(0.0) as f32;
        let (stream, description) = session.start(pool)?;
        write_text(&mut self.report.description, &description);
        let now_ns = monotonic_ns();
        let rate_meter = RateMeter::new(self.fps, now_ns);
        self.numbering.interrupted();
        self.report.starts += 1;
        self.report.delivered_fps = 0.0;
        self.phase =
            Phase::Streaming(Running { stream, started_ns: now_ns, arrived_ns: None, rate_meter });
        Ok(())
    }

    fn next_frame(&mut self, pool: &mut FramePool) -> Result<Option<Captured>, Fault> {
        let Phase::Streaming(running) = &mut self.phase else { return Ok(None) };
        let arrival = running.stream.next(pool, MAX_WAIT)?;
        let now_ns = monotonic_ns();
        if running.arrived_ns.is_some() && running.rate_meter.measure(now_ns) {
            let fps = running.rate_meter.fps().unwrap_or(0.0);
            self.report.delivered_fps = fps as f32;
            let is_slow = running.rate_meter.is_slow();
            self.report.state =
                if is_slow { CameraState::Slow } else { CameraState::Streaming } as u32;
            let problem = if is_slow {
                too_slow(fps, self.report.promised_fps, self.fps)
            } else {
                String::new()
            };
            write_text(&mut self.report.problem, &problem);
        }
        let Some(arrival) = arrival else {
            return running.check_silence(now_ns, self.fps).map(|()| None);
        };
        if running.arrived_ns.is_none() {
            running.rate_meter = RateMeter::new(self.fps, now_ns);
            self.report.state = CameraState::Streaming as u32;
            write_text(&mut self.report.problem, "");
        }
        running.arrived_ns = Some(now_ns);
        if now_ns - running.started_ns > STABLE_NS {
            self.failures = 0;
        }
        match arrival {
            Arrival::Frame(delivery) => {
                running.rate_meter.arrived();
                Ok(Some(self.number(delivery, now_ns)))
            }
            Arrival::Incomplete => {
                self.report.incomplete += 1;
                Ok(None)
            }
            // The frame appears as a gap in the device's numbers.
            Arrival::NoMemory => Ok(None),
        }
    }

    fn number(&mut self, delivery: Delivery, now_ns: u64) -> Captured {
        let Delivery { frame, picture, device_seq, t_capture_ns } = delivery;
        let age_ns = now_ns.checked_sub(t_capture_ns).filter(|&age_ns| age_ns < MAX_CAPTURE_AGE_NS);
        let t_capture_ns = now_ns - age_ns.unwrap_or(0);
        let numbered = self.numbering.number(device_seq, t_capture_ns);
        let incomplete = self.report.incomplete - self.incomplete_before;
        self.incomplete_before = self.report.incomplete;
        let lost = numbered.lost.saturating_sub(incomplete);
        self.report.lost += lost;
        let exposure = Exposure {
            seq: numbered.seq,
            t_capture_ns,
            t_capture_wall_ns: wall_ns()
                .saturating_sub(monotonic_ns().saturating_sub(t_capture_ns)),
            skipped: lost,
        };
        Captured { frame, exposure, picture }
    }

    /// Reports a fault, releases the camera, and schedules a retry.
    fn give_up(&mut self, fault: &Fault) {
        self.report.state = fault.state as u32;
        write_text(&mut self.report.problem, &fault.problem);
        self.report.delivered_fps = 0.0;
        let pause_ns = (MIN_PAUSE_NS << self.failures.min(10)).min(MAX_PAUSE_NS);
        self.failures += 1;
        self.phase = Phase::Waiting { until_ns: monotonic_ns() + pause_ns };
    }
}

impl Camera for Link {
    fn capture(&mut self, pool: &mut FramePool) -> Result<Option<Captured>, CameraError> {
        Ok(self.step(pool).unwrap_or_else(|fault| {
            self.give_up(&fault);
            None
        }))
    }

    fn report(&self) -> Option<&CameraReport> {
        Some(&self.report)
    }
}

impl Running {
    /// Checks how long the camera has been silent.
    fn check_silence(&self, now_ns: u64, fps: f64) -> Result<(), Fault> {
        let patience_ns = match self.arrived_ns {
            None => FIRST_FRAME_TIMEOUT_NS,
            Some(_) => FRAME_TIMEOUT_NS,
        };
        let patience_ns = patience_ns.max((2.5e9 / fps) as u64);
        let silent_ns = now_ns.saturating_sub(self.arrived_ns.unwrap_or(self.started_ns));
        if silent_ns <= patience_ns {
            return Ok(());
        }
        Err(Fault::new(
            CameraState::Hung,
            format!(
                "no frame for {:.1} s; if it lasts: check the cable, plug it in again",
                silent_ns as f64 / 1e9
            ),
        ))
    }
}

fn too_slow(delivered: f64, promised: f32, configured: f64) -> String {
    let promise =
        if promised > 0.0 { format!("the camera promises {promised:.1}, ") } else { String::new() };
    format!(
        "only {delivered:.1} frames a second come; {promise}configured are {configured} (in the dark, \
         automatic exposure slows many cameras down; so does a bus shared with others)"
    )
}

/// Opens a device on a thread of its own.
fn open_on_thread(device: &Arc<dyn Device>) -> Phase {
    let (sender, session) = channel();
    let device = Arc::clone(device);
    std::thread::spawn(move || {
        // The receiver is gone if the process is ending.
        let _ = sender.send(device.open());
    });
    Phase::Opening { session, since_ns: monotonic_ns() }
}
