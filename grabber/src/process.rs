//! The grabber's process: a camera in, frames out. It never waits for anything but the camera.

use crate::camera::{CameraError, FramePool, LastFrame};
use crate::camera_reporter::CameraReporter;
use crate::external;
use crate::playback::Pacer;
use crate::source::{Source, open};
use client::clock::monotonic_ns;
use config::Config;
use messages::topics;
use messages::{DropReason, ProcessKind, ProcessState};
use runtime::process::{MAX_WAIT, Process, ProcessError, ProcessOptions};

/// Rounds in which commands are read before a frame: bounded, so that a flood of them cannot delay the
/// camera.
const COMMAND_ROUNDS: usize = 4;

/// The grabber's own options.
#[derive(Debug, Clone)]
pub struct GrabberOptions {
    /// The source of frames.
    pub source: Source,
    /// Number of the frame before which to end; endless if absent.
    pub frames: Option<u64>,
    /// The last frame of a predecessor.
    pub resume_after: Option<LastFrame>,
}

/// Runs until asked to end.
pub fn run(
    options: &ProcessOptions,
    grabber: &GrabberOptions,
    config: &Config,
) -> Result<(), ProcessError> {
    let mut process = Process::start(ProcessKind::Grabber, options, config)?;
    if grabber.source == Source::External {
        return external::stand_by(process, options.lane, config);
    }
    let capacity = grabber.source.frame_capacity(&config.camera);
    let mut pool = FramePool::new(&process.bus, &config.camera, options.lane, capacity)?;
    let mut truth = process.bus.publisher(&topics::TRUTH, 1)?;
    let mut commands = process.bus.publisher(&topics::COMMANDS, 1)?;
    let command_subscriber = process.bus.subscriber(&topics::COMMANDS)?;
    let mut camera_reporter = CameraReporter::new(&process.bus)?;
    let stage_error = |error: CameraError| ProcessError::Stage(error.to_string());
    // Opened before reporting ready, since loading pictures and rendering the pitch take time.
    let open_camera = open(&grabber.source, config).map_err(stage_error)?;
    let mut pacer = Pacer::new(&process, &options.instance, &grabber.source)?;
    if !process.activate()? {
        return Ok(());
    }

    // Without the supervisor's information, or if it is older than the last frames, the predecessor's entry
    // in the stage page gives the number, and its capture time cannot be long ago.
    let last = grabber.resume_after.filter(|last| Some(last.seq) >= process.resumes_after());
    let last = last.or_else(|| {
        let seq = process.resumes_after()?;
        Some(LastFrame { seq, t_capture_ns: monotonic_ns() })
    });
    let mut camera = open_camera(last).map_err(stage_error)?;
    let end = grabber.frames.unwrap_or(u64::MAX);
    let mut next_seq = last.map_or(0, |last| last.seq + 1);
    while process.keep_running()? && next_seq < end && !camera.is_over() {
        command_subscriber.receive_fairly(COMMAND_ROUNDS, |received| {
            if let Some(message) = received.message()
                && !commands.has_sent(received)
            {
                camera.obey(message);
            }
        })?;
        if let Some(pacer) = &mut pacer
            && !pacer.may_show()?
        {
            if pacer.is_waiting_for_person() {
                process.is_now(ProcessState::Waiting)?;
            }
            continue;
        }
        let captured = camera.capture(&mut pool);
        match camera.report() {
            Some(report) => camera_reporter.publish(report, &mut process)?,
            None if camera.is_waiting() => process.is_now(ProcessState::Waiting)?,
            None => process.is_now(ProcessState::Active)?,
        }
        let mut captured = match captured {
            Ok(Some(captured)) => captured,
            Ok(None) => continue,
            // The camera runs on.
            Err(CameraError::NoMemory(_)) => {
                process.drop_input(DropReason::NotPublished);
                std::thread::sleep(std::time::Duration::from_millis(1));
                continue;
            }
            Err(error) => return Err(stage_error(error)),
        };
        let exposure = captured.exposure;
        if exposure.seq >= end {
            break;
        }
        next_seq = exposure.seq + 1;
        process.counters.dropped[DropReason::Late as usize] += exposure.skipped;
        process.accept(&captured.header(monotonic_ns()));
        // Truth and commands are sent first, so that they are available when the frame's results arrive.
        if let Some(frame_truth) = camera.truth() {
            truth.publish(frame_truth)?;
        }
        for message in camera.commands() {
            commands.publish(message)?;
        }
        let mut header = captured.header(monotonic_ns());
        header.revision = process.revision().number;
        *captured.frame.parts().1 = header;
        captured.frame.send()?;
        process.sent(exposure.seq);
        if let Some(pacer) = &mut pacer {
            pacer.shown(exposure.seq);
        }
    }

    // A bounded run is over, but the publisher must outlive the readers of its frames.
    process.beat(ProcessState::Finished)?;
    while process.keep_running()? {
        std::thread::sleep(MAX_WAIT);
    }
    Ok(())
}
