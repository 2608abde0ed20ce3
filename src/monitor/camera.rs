//! State of a real camera: for the report, and as events when it changes.

use super::view::GroupView;
use client::bus::{Bus, BusError, Stranger, Subscriber};
use control::Event;
use control::report::CameraDevice;
use messages::topics;
use messages::{CameraReport, CameraState, EventKind, ProcessKind, read_text};

/// Reads the grabber's reports about its camera.
pub struct CameraWatch {
    reports: Subscriber<CameraReport, ()>,
    device: Option<CameraDevice>,
}

impl CameraWatch {
    /// Connects.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        Ok(Self { reports: bus.subscriber(&topics::CAMERA)?, device: None })
    }

    /// Reads new reports; changes of state become events.
    pub fn collect(&mut self, view: &GroupView) -> Result<(), BusError> {
        while let Some(received) = self.reports.receive()? {
            let Some(device) = received.message().and_then(describe) else { continue };
            let before = self.device.as_ref().map(|before| before.state.as_str());
            let is_news = before != Some(&device.state) && device.state != "opening";
            if is_news {
                let about = match device.problem.as_str() {
                    "" => &device.description,
                    problem => problem,
                };
                let what = format!("the camera is {}: {about}", device.state.replace('_', " "));
                let what = what.trim_end_matches([' ', ':']);
                view.log(Event::new(EventKind::Camera, ProcessKind::Grabber.name(), 0, what, ""));
            }
            self.device = Some(device);
        }
        Ok(())
    }

    /// Foreign programs that have published camera reports since the last call.
    pub fn take_strangers(&self) -> Vec<Stranger> {
        self.reports.take_strangers()
    }

    /// The camera, if it is a real one.
    pub fn device(&self) -> Option<CameraDevice> {
        self.device.clone()
    }
}

/// `None` for a message with an invalid state.
fn describe(report: &CameraReport) -> Option<CameraDevice> {
    Some(CameraDevice {
        state: CameraState::from_number(report.state)?.name().into(),
        description: read_text(&report.description),
        problem: read_text(&report.problem),
        promised_fps: finite(report.promised_fps),
        delivered_fps: finite(report.delivered_fps),
        incomplete: report.incomplete,
        lost: report.lost,
        starts: report.starts,
    })
}
/// Replaces non-finite numbers: JSON has none, and one would make the whole report unreadable.
fn finite(number: f32) -> f64 {
    if number.is_finite() { number.into() } else { 0.0 }
}
