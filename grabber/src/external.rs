//! Frames published on `frames` by another program that the configuration permits (`access.publishers`). The
//! grabber only reports whether there are any.

use config::Config;
use messages::ProcessState;
use messages::topics;
use runtime::process::{MAX_WAIT, Process, ProcessError};
use std::time::{Duration, Instant};

/// Time without a frame after which the program counts as absent.
const SILENCE: Duration = Duration::from_millis(500);

/// Runs until asked to end.
pub fn stand_by(mut process: Process, lane: u8, config: &Config) -> Result<(), ProcessError> {
    let topic = topics::frames(config.camera.frame_bytes()).in_lane(lane);
    let frames = process.bus.newest_only(&topic)?;
    if !process.activate()? {
        return Ok(());
    }
    let mut last_frame: Option<Instant> = None;
    while process.keep_running()? {
        if frames.newest()?.is_some() {
            last_frame = Some(Instant::now());
        }
        let has_frames = last_frame.is_some_and(|t| t.elapsed() < SILENCE);
        process.is_now(if has_frames { ProcessState::Active } else { ProcessState::Waiting })?;
        std::thread::sleep(MAX_WAIT);
    }
    Ok(())
}
