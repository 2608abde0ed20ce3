//! Pictures from a running group for `learn` and `calibrate`, and results back to it.

use super::CommandError;
use super::group::running;
use super::reload::go_over;
use crate::cli::{FromGroupArgs, InstanceArgs};
use client::instance::Instance;
use config::Config;
use config::snapshot::Snapshot;
use std::process::ExitCode;
use std::time::Duration;
use touchline::live_frames::{LiveFrame, Request, take};

/// A camera that is away for a moment is back within this time.
const PATIENCE: Duration = Duration::from_secs(10);

/// The group from which a command takes its pictures.
pub struct SourceGroup {
    instance: Instance,
    frames: u16,
    is_to_apply: bool,
}

impl SourceGroup {
    /// The group named by the arguments; `None` if they name none. `frames` is the default number.
    pub fn open(args: &FromGroupArgs, frames: u16) -> Result<Option<Self>, CommandError> {
        let Some(name) = &args.from_group else { return Ok(None) };
        let instance = running(&InstanceArgs { instance: name.clone() })?;
        let frames = args.frames.unwrap_or(frames);
        Ok(Some(Self { instance, frames, is_to_apply: args.apply }))
    }

    /// The configuration that the group runs with.
    pub fn config(&self) -> Result<Config, CommandError> {
        Ok(Snapshot::load(&self.instance.config_path())?.config)
    }

    /// Frames at least so far `apart`, for pictures of the configured camera.
    pub fn frames(&self, config: &Config, apart: Duration) -> Result<Vec<LiveFrame>, CommandError> {
        let frames = usize::from(self.frames);
        let time_limit = PATIENCE + apart * u32::from(self.frames);
        let name = self.instance.name();
        runtime::tell!("touchline: taking {frames} frames of the group {name:?}");
        Ok(take(&self.instance, &config.camera, &Request { frames, apart, time_limit })?)
    }

    /// Has the group go over to its newest configuration with this change, if that was requested.
    /// `is_written`: the result is in a file as well.
    pub fn apply(
        &self,
        is_written: bool,
        change: impl FnOnce(&mut Config),
    ) -> Result<ExitCode, CommandError> {
        if !self.is_to_apply {
            return Ok(ExitCode::SUCCESS);
        }
        // It may have been changed while the result was computed.
        let now = Snapshot::load(&self.instance.config_path())?;
        let mut wanted = now.config.clone();
        change(&mut wanted);
        let code = go_over(&self.instance, &now, &wanted, false)?;
        if !is_written {
            runtime::say_line!("it holds until the group ends; -o FILE also writes it to a file")?;
        }
        Ok(code)
    }
}
