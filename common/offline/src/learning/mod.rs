//! Learning colours from pictures: from labels, or from robots that label themselves.
//!
//! [`from_labels`] learns from the marks of a person, [`without_labels`] from the robots that the stages find
//! with better and better colours ([`auto`]).
//!
//! * [`lessons`]: the pictures as the classifier sees them.
//! * [`labels`]: marked contents of pictures.
//! * [`samples`]: pixels of known colour, from labelled pictures.
//! * [`scene`]: camera, pitch and robots, prepared for many pictures.
//! * [`separate`]: from samples to the bounds of colours.
//! * [`confusion`]: separation of samples by given bounds.
//! * [`palette`]: initial colours without samples.
//! * [`candidates`]: patches guessed from pictures without labels.
//! * [`blobs`]: connected pixels of one class.
//! * [`passing`]: cost of colours in the classifier.
//! * [`summary`]: the report about learned colours.

pub mod auto;
pub mod blobs;
pub mod candidates;
pub mod confusion;
mod error;
mod floor;
pub mod labels;
pub mod lessons;
pub mod palette;
pub mod passing;
pub mod picture;
pub mod samples;
pub mod scene;
pub mod separate;
pub mod summary;
#[cfg(test)]
mod tests;
mod unevenness;

pub use error::LearnError;

use config::{ColorConfig, Config};
use labels::ImageLabels;
use lessons::Lessons;
use samples::Samples;
use separate::Objective;

/// The configuration with colours learned from labels.
pub fn from_labels(
    configured: &Config,
    lessons: &Lessons,
    labels: &[ImageLabels],
    fixed_light: bool,
) -> Result<Config, LearnError> {
    let mut config = with_light(configured, lessons, fixed_light)?;
    if let Some(unevenness) = measured_unevenness(&config, lessons, labels)? {
        config.light.unevenness = unevenness;
    }
    let lit = lessons.under_light(&config)?;
    let samples = lessons.gather(&config, &lit, labels)?;
    warn_of_unlabelled_colors(&config, &samples)?;
    let colors = learn_from(&config, &samples);
    Ok(Config { colors, ..config })
}

/// The configuration with colours learned from robots that label themselves, and these labels.
pub fn without_labels(
    configured: &Config,
    lessons: &Lessons,
    fixed_light: bool,
) -> Result<(Config, Vec<ImageLabels>), LearnError> {
    let mut config = with_light(configured, lessons, fixed_light)?;
    let mut found = auto::learn(configured, &config, lessons)?;
    // Robots show how uneven the light is, and are found better once that is known.
    if let Some(unevenness) = measured_unevenness(&config, lessons, &found.labels)? {
        config.light.unevenness = unevenness;
        found = auto::improve(found, &config, lessons)?;
    }
    Ok((found.config, found.labels))
}

/// The configuration with the light of the pictures, for which colours are learned.
fn with_light(
    configured: &Config,
    lessons: &Lessons,
    fixed_light: bool,
) -> Result<Config, LearnError> {
    let mut config = configured.clone();
    config.light.pitch_rgb = match fixed_light || !config.light.follow {
        true => None,
        false => lessons.pitch_color(&config)?,
    };
    Ok(config)
}

/// The share of the pitch's unevenness that patches have, if it can be measured and differs from the
/// configured one.
fn measured_unevenness(
    config: &Config,
    lessons: &Lessons,
    labels: &[ImageLabels],
) -> Result<Option<f64>, LearnError> {
    if config.light.pitch_rgb.is_none() {
        return Ok(None);
    }
    let measured = unevenness::measure(config, lessons, labels)?;
    Ok(measured.filter(|&unevenness| unevenness != config.light.unevenness))
}

/// Bounds for the colours in the samples. Colours that robots have but that no sample shows keep their
/// bounds, and come last.
fn learn_from(config: &Config, samples: &Samples) -> Vec<ColorConfig> {
    let mut learned = separate::learn(&config.colors, samples, &Objective::default());
    for color in &config.colors {
        let is_known = learned.iter().any(|known| known.name == color.name);
        if !is_known && is_worn(config, &color.name) {
            learned.push(color.clone());
        }
    }
    learned
}

/// Reports colours that keep their bounds because no label shows them.
fn warn_of_unlabelled_colors(config: &Config, samples: &Samples) -> Result<(), LearnError> {
    if samples.pixels.is_empty() {
        return Err(LearnError::NothingLabelled);
    }
    for (class, color) in config.colors.iter().enumerate() {
        let is_shown = samples.pixels.iter().any(|sample| usize::from(sample.class) == class);
        if !is_shown && is_worn(config, &color.name) {
            runtime::tell!(
                "touchline: nothing labelled shows the colour \"{}\": it keeps its configured bounds",
                color.name
            );
        }
    }
    Ok(())
}

/// Whether a robot or the ball has a colour.
pub fn is_worn(config: &Config, name: &str) -> bool {
    config.teams.yellow.color == name
        || config.teams.blue.color == name
        || config.ball.color == name
        || config.robots.identities.iter().any(|identity| identity.colors.iter().any(|c| c == name))
}
