//! `touchline learn`: learns colours from pictures.

use super::CommandError;
use super::from_group::SourceGroup;
use crate::cli::LearnArgs;
use config::{ColorConfig, Config, LightConfig, commented_toml};
use grabber::pictures::list_pictures;
use offline::learning::labels::{ImageLabels, Labels};
use offline::learning::lessons::Lessons;
use offline::learning::{from_labels, summary, without_labels};
use runtime::output::Rule;
use runtime::user_config::load_config;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;
use touchline::live_frames::named_bayer;

/// Frames taken of a running group, and the least time between two: robots move on meanwhile.
const LIVE_FRAMES: u16 = 20;
const APART: Duration = Duration::from_millis(250);

/// Learns, prints how well the colours are separated, and writes the configuration.
pub fn learn(args: LearnArgs) -> Result<ExitCode, CommandError> {
    let group = SourceGroup::open(&args.from_group, LIVE_FRAMES)?;
    let configured = match (&group, &args.config) {
        (Some(group), None) => group.config()?,
        (_, file) => load_config(file.as_deref())?,
    };
    let inputs: Vec<&Path> =
        [&args.config, &args.samples].into_iter().flatten().map(|path| &**path).collect();
    let rule = Rule { inputs: &inputs, force: args.force };
    args.output.as_deref().map_or(Ok(()), |path| rule.check(path))?;
    let labels = match &args.samples {
        Some(samples) => labelled(&Labels::load(samples)?, &args.pictures)?,
        None => unlabelled(&args.pictures)?,
    };
    let lessons = match &group {
        Some(group) => {
            let frames = group.frames(&configured, APART)?;
            Lessons::from_frames(&configured, named_bayer(&frames, &configured))?
        }
        None => Lessons::load(&configured, labels.iter().map(|labels| labels.file.clone()))?,
    };
    let (learned, labels) = match args.auto {
        true => without_labels(&configured, &lessons, args.fixed_light)?,
        false => (from_labels(&configured, &lessons, &labels, args.fixed_light)?, labels),
    };
    runtime::tell!("{}", summary::text(&learned, &lessons, &labels)?);
    match &args.output {
        None if args.from_group.apply => {}
        None => _ = runtime::say!("{}", fragment(&learned))?,
        Some(path) => {
            rule.write(path, commented_toml(&learned).as_bytes())?;
            runtime::say_line!("{path}: written", path = path.display())?;
        }
    }
    let Some(group) = group else { return Ok(ExitCode::SUCCESS) };
    group.apply(args.output.is_some(), |config| {
        (config.colors, config.light) = (learned.colors, learned.light);
    })
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
