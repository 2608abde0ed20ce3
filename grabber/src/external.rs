//! Frames published on `frames` by another program that the configuration permits (`access.publishers`). The
//! grabber only reports whether there are any.

use common::config::Config;
use common::messages::ProcessState;
use common::process::{LOOK_AROUND, Process, ProcessError};
use common::topics;
use std::time::{Duration, Instant};

/// Time without a frame after which the program counts as absent.
const SILENCE: Duration = Duration::from_millis(500);

/// Runs until asked to end.
pub fn stand_by(mut process: Process, config: &Config) -> Result<(), ProcessError> {
    let frames = process.bus.newest_only(&topics::frames(config.camera.frame_bytes()))?;
    if !process.activate()? {
        return Ok(());
    }
    let mut heard: Option<Instant> = None;
    while process.keep_running()? {
        if frames.newest()?.is_some() {
            heard = Some(Instant::now());
        }
        let is_fed = heard.is_some_and(|heard| heard.elapsed() < SILENCE);
        process.is_now(if is_fed { ProcessState::Active } else { ProcessState::Waiting })?;
        std::thread::sleep(LOOK_AROUND);
    }
    Ok(())
}
