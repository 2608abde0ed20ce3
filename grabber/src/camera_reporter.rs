//! Publication of the camera's state.

use client::bus::{Bus, BusError, Publisher};
use client::clock::monotonic_ns;
use messages::topics;
use messages::{CameraReport, CameraState, DropReason, ProcessState};
use runtime::process::{Process, ProcessError};

/// Maximum time between two reports.
const PERIOD_NS: u64 = 250_000_000;

/// Publishes the camera's state at every change and several times a second, and copies it into the process's
/// heartbeat.
pub struct CameraReporter {
    publisher: Publisher<CameraReport, ()>,
    last: Option<CameraReport>,
}

impl CameraReporter {
    /// Connects to the topic.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        Ok(Self { publisher: bus.publisher(&topics::CAMERA, 1)?, last: None })
    }

    /// Must be called after each poll of the camera.
    pub fn publish(
        &mut self,
        report: &CameraReport,
        process: &mut Process,
    ) -> Result<(), ProcessError> {
        process.counters.dropped[DropReason::Incomplete as usize] = report.incomplete;
        let is_delivering =
            CameraState::from_number(report.state).is_some_and(CameraState::is_delivering);
        let state = if is_delivering { ProcessState::Active } else { ProcessState::Waiting };
        process.is_now(state)?;
        let t_sent_ns = monotonic_ns();
        let is_due = self.last.as_ref().is_none_or(|last| {
            *report != CameraReport { t_sent_ns: 0, ..*last }
                || t_sent_ns - last.t_sent_ns >= PERIOD_NS
        });
        if is_due {
            let report = CameraReport { t_sent_ns, ..*report };
            self.publisher.publish(&report)?;
            self.last = Some(report);
        }
        Ok(())
    }
}
