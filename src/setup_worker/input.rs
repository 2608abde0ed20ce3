//! What every request works on: the group's configuration, and pictures.

use super::SetupError;
use crate::live_frames::{self, LiveFrame, Request};
use client::instance::Instance;
use config::Config;
use config::edit::with_pairs;
use config::snapshot::Snapshot;
use serde_json::{Map, Value};
use std::time::Duration;

/// Most frames of a request.
pub const MOST_FRAMES: usize = 60;
/// Time until the last frame.
const TIME_LIMIT: Duration = Duration::from_secs(30);

/// The newest accepted configuration of the group with the changes that a request assumes.
pub fn assumed(instance: &Instance, set: &Map<String, Value>) -> Result<Config, SetupError> {
    let now = Snapshot::load(&instance.config_path())?;
    Ok(with_pairs(&now.config, pairs(set)?)?)
}

/// JSON as values of the configuration; `null` has no such value.
fn pairs(set: &Map<String, Value>) -> Result<Vec<(String, toml::Value)>, SetupError> {
    let pair = |(key, value): (&String, &Value)| {
        let value = toml::Value::try_from(value).map_err(|error| format!("{key}: {error}"))?;
        Ok((key.clone(), value))
    };
    set.iter().map(pair).collect()
}

/// Frames of the group, so far apart that robots have moved in between.
pub fn frames(
    instance: &Instance,
    config: &Config,
    frames: usize,
    apart: Duration,
) -> Result<Vec<LiveFrame>, SetupError> {
    if !(1..=MOST_FRAMES).contains(&frames) {
        return Err(format!("frames: from 1 to {MOST_FRAMES}").into());
    }
    let request = Request { frames, apart, time_limit: TIME_LIMIT };
    Ok(live_frames::take(instance, &config.camera, &request)?)
}
