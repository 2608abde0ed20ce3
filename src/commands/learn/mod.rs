//! `touchline learn`: learns colours from pictures.

mod auto;
mod floor;
pub mod lessons;
mod summary;
#[cfg(test)]
mod tests;
mod unevenness;

use super::output::Rule;
use super::{CommandError, load_config};
use crate::cli::LearnArgs;
use config::{ColorConfig, Config, LightConfig, commented_toml};
use grabber::pictures::list_pictures;
use lessons::Lessons;
use setup::learning::labels::{ImageLabels, Labels};
use setup::learning::samples::Samples;
use setup::learning::separate::{self, Objective};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Learns, prints how well the colours are separated, and writes the configuration.
pub fn learn(args: LearnArgs) -> Result<ExitCode, CommandError> {
    let configured = load_config(args.config.as_deref())?;
    let inputs: Vec<&Path> =
        [&args.config, &args.samples].into_iter().flatten().map(|path| &**path).collect();
    let rule = Rule { inputs: &inputs, force: args.force };
    args.output.as_deref().map_or(Ok(()), |path| rule.check(path))?;
    let labels = match &args.samples {
        Some(samples) => labelled(&Labels::load(samples)?, &args.pictures)?,
        None => unlabelled(&args.pictures)?,
    };
    let lessons = Lessons::load(&configured, labels.iter().map(|labels| labels.file.clone()))?;
    let (learned, labels) = match args.auto {
        true => without_labels(&configured, &lessons, args.fixed_light)?,
        false => (from_labels(&configured, &lessons, &labels, args.fixed_light)?, labels),
    };
    runtime::tell!("{}", summary::text(&learned, &lessons, &labels)?);
    match &args.output {
        None => _ = say!("{}", fragment(&learned))?,
        Some(path) => {
            rule.write(path, commented_toml(&learned).as_bytes())?;
            say_line!("{path}: written", path = path.display())?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// The configuration with colours learned from labels.
fn from_labels(
    configured: &Config,
    lessons: &Lessons,
    labels: &[ImageLabels],
    fixed_light: bool,
) -> Result<Config, CommandError> {
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
fn without_labels(
    configured: &Config,
    lessons: &Lessons,
    fixed_light: bool,
) -> Result<(Config, Vec<ImageLabels>), CommandError> {
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
) -> Result<Config, CommandError> {
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
) -> Result<Option<f64>, CommandError> {
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
fn warn_of_unlabelled_colors(config: &Config, samples: &Samples) -> Result<(), CommandError> {
    if samples.pixels.is_empty() {
        return Err(
            "nothing that is labelled shows a colour: label robots, a ball, or places under \
                    \"samples\""
                .into(),
        );
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

/// Pictures without labels.
fn unlabelled(arguments: &[PathBuf]) -> Result<Vec<ImageLabels>, CommandError> {
    let mut all = Vec::new();
    for argument in arguments {
        let files = list_pictures(argument)?.into_iter();
        all.extend(files.map(|file| ImageLabels {
            file,
            robots: None,
            ball: None,
            samples: Vec::new(),
        }));
    }
    Ok(all)
}

/// The labelled pictures, or those among them that are named.
fn labelled(labels: &Labels, pictures: &[PathBuf]) -> Result<Vec<ImageLabels>, CommandError> {
    let mut chosen: Vec<ImageLabels> = Vec::new();
    for argument in pictures {
        for path in list_pictures(argument)? {
            let is_it = |image: &&ImageLabels| is_same_file(&image.file, &path);
            let image = labels.images.iter().find(is_it).cloned();
            chosen.push(image.ok_or_else(|| {
                format!("{}: nothing is labelled in this picture", path.display())
            })?);
        }
    }
    if pictures.is_empty() {
        chosen.extend(labels.images.iter().cloned());
    }
    if chosen.is_empty() {
        return Err("there is no labelled picture to learn from".into());
    }
    Ok(chosen)
}

fn is_same_file(a: &Path, b: &Path) -> bool {
    match (a.canonicalize(), b.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => a == b,
    }
}

/// Whether a robot or the ball has a colour.
fn is_worn(config: &Config, name: &str) -> bool {
    config.teams.yellow.color == name
        || config.teams.blue.color == name
        || config.ball.color == name
        || config.robots.identities.iter().any(|identity| identity.colors.iter().any(|c| c == name))
}

/// The part of the configuration that was learned.
fn fragment(config: &Config) -> String {
    let mut text = String::new();
    if let Some(rgb) = config.light.pitch_rgb {
        let LightConfig { brightness, unevenness, glare, .. } = config.light;
        text += &format!(
            "[light]\npitch_rgb = {rgb:?}\nbrightness = {brightness}\nunevenness = {unevenness}\n\
             glare = {glare}\n\n"
        );
    }
    for color in &config.colors {
        let ColorConfig { name, red, green, blue, looks, .. } = color;
        text += &format!("[[colors]]\nname = {name:?}\nred = {red:?}\ngreen = {green:?}\n");
        text += &format!("blue = {blue:?}\n");
        if let Some(hue_deg) = color.hue_deg {
            text += &format!("hue_deg = {hue_deg:?}\n");
        }
        if let Some(saturation) = color.saturation {
            text += &format!("saturation = {saturation:?}\n");
        }
        text += &format!("looks = {looks:?}\n\n");
    }
    text
}
