//! The grabber's process: a camera in, frames out. It never waits for anybody but the camera.

use crate::camera::LastFrame;
use crate::source::{Source, open};
use common::clock::monotonic_ns;
use common::config::Config;
use common::messages::{DropReason, FrameHeader, PixelFormat, ProcessKind, ProcessState};
use common::process::{LOOK_AROUND, Process, ProcessError, ProcessOptions};
use common::topics;

/// What the grabber needs beside the group's options.
#[derive(Debug, Clone)]
pub struct GrabberOptions {
    /// Where frames come from.
    pub source: Source,
    /// End after the frame of this number (exclusive); endless when absent.
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
    let frame_bytes = config.camera.width as usize * config.camera.height as usize;
    let mut frames = process.bus.publisher(&topics::FRAMES, frame_bytes)?;
    let mut truth = process.bus.publisher(&topics::TRUTH, 1)?;
    let mut commands = process.bus.publisher(&topics::COMMANDS, 1)?;
    let stage_error = |error: crate::camera::CameraError| ProcessError::Stage(error.to_string());
    // Opened before reporting ready: loading pictures and painting the pitch take their time.
    let open_camera = open(&grabber.source, config).map_err(stage_error)?;
    if !process.activate()? {
        return Ok(());
    }

    let mut camera = open_camera(grabber.resume_after);
    let end = grabber.frames.unwrap_or(u64::MAX);
    let mut next_seq = grabber.resume_after.map_or(0, |last| last.seq + 1);
    while process.keep_running()? && next_seq < end {
        let mut output = match frames.loan(frame_bytes) {
            Ok(output) => output,
            // All of the topic's memory is in readers' hands: possible only if a reader breaks the
            // rules. The camera goes on.
            Err(_) => {
                process.drop_input(DropReason::NotPublished);
                std::thread::sleep(std::time::Duration::from_millis(1));
                continue;
            }
        };
        let (pixels, header) = output.parts();
        let exposure = camera.expose(pixels).map_err(stage_error)?;
        if exposure.seq >= end {
            break;
        }
        next_seq = exposure.seq + 1;
        process.counters.dropped[DropReason::Late as usize] += exposure.skipped;
        process.accept(exposure.seq);
        // Truth and commands go first, so that they are there when the frame's results come.
        if let Some((frame_truth, frame_commands)) = camera.truth() {
            let mut frame_truth = *frame_truth;
            (frame_truth.seq, frame_truth.t_capture_ns) = (exposure.seq, exposure.t_capture_ns);
            truth.publish(&frame_truth)?;
            let mut frame_commands = *frame_commands;
            (frame_commands.seq, frame_commands.t_sent_ns) = (exposure.seq, exposure.t_capture_ns);
            commands.publish(&frame_commands)?;
        }
        *header = FrameHeader {
            seq: exposure.seq,
            t_capture_ns: exposure.t_capture_ns,
            t_capture_wall_ns: exposure.t_capture_wall_ns,
            t_sent_ns: monotonic_ns(),
            camera_id: 0,
            width: config.camera.width,
            height: config.camera.height,
            stride: config.camera.width,
            pixel_format: PixelFormat::Bayer8 as u32,
            bayer_order: config.camera.bayer_order as u32,
            exposure_us: config.camera.exposure_us,
            reserved: 0,
        };
        output.send()?;
        process.sent(exposure.seq);
    }

    // A bounded run is over, but the publisher must outlive its frames' readers.
    process.beat(ProcessState::Finished)?;
    while process.keep_running()? {
        std::thread::sleep(LOOK_AROUND);
    }
    Ok(())
}
