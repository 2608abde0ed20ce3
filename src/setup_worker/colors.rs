//! Colours.

use super::SetupError;
use super::input::{assumed, frames};
use crate::live_frames::named_bayer;
use client::instance::Instance;
use config::{ColorConfig, Config};
use offline::learning::labels::{ImageLabels, SampleArea, SampleLabel};
use offline::learning::lessons::{Lesson, Lessons};
use offline::learning::{LearnError, from_labels, summary, without_labels};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use std::time::Duration;

/// Time between two frames: robots have moved.
const APART: Duration = Duration::from_millis(250);
/// Radius of a marked place that names none.
const RADIUS_PX: f64 = 2.0;

/// Learns colours from robots that label themselves, and from places that a person has marked.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Learn {
    /// Assumed changes.
    #[serde(default)]
    set: Map<String, Value>,
    /// Frames to learn from.
    #[serde(default = "usual_frames")]
    frames: usize,
    /// Marked places. They are looked at in every frame: what is marked must not move meanwhile.
    #[serde(default)]
    samples: Vec<Sample>,
    /// Whether robots label themselves; false: marked places alone.
    #[serde(default = "yes")]
    auto: bool,
}

/// A place of the picture that shows a colour, or the background.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sample {
    /// Name of the colour, or "background".
    color: String,
    px: [f64; 2],
    #[serde(default = "usual_radius")]
    radius_px: f64,
}

fn usual_frames() -> usize {
    6
}

fn usual_radius() -> f64 {
    RADIUS_PX
}

fn yes() -> bool {
    true
}

/// The learned colours.
#[derive(Debug, Serialize)]
pub struct Learned {
    set: Map<String, Value>,
    colors: Vec<Color>,
    /// Robots that label themselves, in all frames, and how many there would be if all were in the picture.
    robots: usize,
    of_robots: usize,
    /// Frames with a ball.
    balls: usize,
    frames: usize,
    /// How well the colours are separated, as a table for a person, with warnings.
    summary: String,
}

#[derive(Debug, Serialize)]
struct Color {
    name: String,
    looks: [u8; 3],
}

/// Learns.
pub fn learn(request: &Learn, instance: &Instance) -> Result<Learned, SetupError> {
    let config = assumed(instance, &request.set)?;
    let lessons = lessons(request, instance, &config)?;
    let found = match request.auto {
        true => without_labels(&config, &lessons, false),
        false => Err(LearnError::NoRobot),
    };
    let (learned, labels) = match found {
        Ok((learned, labels)) if request.samples.is_empty() => (learned, labels),
        Ok((_, labels)) => with_samples(request, &config, &lessons, labels)?,
        Err(LearnError::NoRobot) if !request.samples.is_empty() => {
            let none = |lesson: &Lesson| ImageLabels {
                file: lesson.file.clone(),
                robots: None,
                ball: None,
                samples: Vec::new(),
            };
            let labels = lessons.list.iter().map(none).collect();
            with_samples(request, &config, &lessons, labels)?
        }
        Err(why) => return Err(why.into()),
    };
    let robots = labels.iter().flat_map(|labels| labels.robots.iter().flatten());
    let clear = |robot: &&offline::learning::labels::RobotLabel| {
        robot.quality == offline::learning::labels::Quality::Clear
    };
    Ok(Learned {
        set: keys(&config, &learned),
        colors: learned
            .colors
            .iter()
            .map(|ColorConfig { name, looks, .. }| Color { name: name.clone(), looks: *looks })
            .collect(),
        robots: robots.filter(clear).count(),
        of_robots: config.robots.identities.len() * lessons.list.len(),
        balls: labels.iter().filter(|labels| matches!(labels.ball, Some(Some(_)))).count(),
        frames: lessons.list.len(),
        summary: summary::text(&learned, &lessons, &labels)?,
    })
}

/// Learns from what robots and marked places show.
fn with_samples(
    request: &Learn,
    config: &Config,
    lessons: &Lessons,
    mut labels: Vec<ImageLabels>,
) -> Result<(Config, Vec<ImageLabels>), SetupError> {
    let sample = |Sample { color, px: [x_px, y_px], radius_px }: &Sample| SampleLabel {
        color: color.clone(),
        area: SampleArea::Disc { x_px: *x_px, y_px: *y_px, radius_px: *radius_px },
    };
    for labels in &mut labels {
        labels.samples = request.samples.iter().map(sample).collect();
    }
    Ok((from_labels(config, lessons, &labels, false)?, labels))
}

fn lessons(request: &Learn, instance: &Instance, config: &Config) -> Result<Lessons, SetupError> {
    let frames = frames(instance, config, request.frames, APART)?;
    Ok(Lessons::from_frames(config, named_bayer(&frames, config))?)
}

/// The keys that were learned, as far as they differ.
fn keys(before: &Config, learned: &Config) -> Map<String, Value> {
    let mut set = Map::new();
    if learned.colors != before.colors {
        set.insert("colors".into(), json!(learned.colors));
    }
    if let (Some(rgb), true) =
        (learned.light.pitch_rgb, learned.light.pitch_rgb != before.light.pitch_rgb)
    {
        set.insert("light.pitch_rgb".into(), json!(rgb));
    }
    if learned.light.unevenness != before.light.unevenness {
        set.insert("light.unevenness".into(), json!(learned.light.unevenness));
    }
    set
}
