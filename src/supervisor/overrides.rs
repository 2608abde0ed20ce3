//! What the command line changes in the configuration file.

use config::Config;
use config::painted_light::{follow_painted_light, is_other_light};
use grabber::source::Source;
use serde::{Deserialize, Serialize};

/// What the command line of `touchline run` changes in the configuration file.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Overrides {
    /// Frame rate.
    pub fps: Option<f64>,
    /// Protocols to publish.
    pub publish: Vec<String>,
    /// No console.
    pub no_console: bool,
    /// The group was started for its console, by `touchline console`, not for a match.
    pub for_console: bool,
}

/// The configuration of a group whose file says `config`, with what its command line changes.
pub fn as_run(mut config: Config, overrides: &Overrides, source: &Source) -> Config {
    for protocol in &overrides.publish {
        config.publish.enable(protocol);
    }
    if overrides.no_console {
        config.console.enabled = false;
    }
    if let Some(fps) = overrides.fps {
        config.camera.fps = fps;
    }
    if matches!(source, Source::Synthetic) && is_other_light(&config) {
        follow_painted_light(&mut config);
    }
    config
}
