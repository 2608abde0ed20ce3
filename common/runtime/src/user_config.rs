//! The configuration file of a command.

use config::{Config, ConfigError, check_file};
use std::path::Path;

/// The configuration in a file, or the defaults. Settings that look unintended are reported, but not refused.
pub fn load_config(file: Option<&Path>) -> Result<Config, ConfigError> {
    let Some(path) = file else { return Ok(Config::default()) };
    let (config, warnings) = check_file(path)?;
    if !warnings.list.is_empty() {
        crate::tell!("{warnings}\n");
    }
    Ok(config)
}
