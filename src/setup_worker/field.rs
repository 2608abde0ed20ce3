//! The camera's geometry.

use super::SetupError;
use super::input::{assumed, frames};
use crate::live_frames::median;
use client::instance::Instance;
use config::{Config, FieldConfig};
use geometry::{CameraModel, FieldPoint};
use image::RgbImage;
use offline::calibration::picture::find::{FoundPitch, find};
use offline::calibration::picture::lines::{LinesFound, NotRefined};
use offline::calibration::picture::{FOUND_WITHIN, Fit, Marking, fit, words};
use offline::calibration::{KnownLens, Mark, calibrated, landmark_names};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::f64::consts::TAU;
use std::time::Duration;

/// Frames for the picture to look at, and the time between two: what moves vanishes from their median.
const FRAMES: usize = 5;
const APART: Duration = Duration::from_millis(80);
/// Distance of points along a drawn line.
const STEPS: u32 = 24;

/// Finds the pitch by its lines.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FindField {
    /// Assumed changes.
    #[serde(default)]
    set: Map<String, Value>,
}

/// Where the pitch is seen.
#[derive(Debug, Serialize)]
pub struct FieldFound {
    /// Whether it was found; if not, the points are where they would be if the pitch filled the picture.
    found: bool,
    /// The share of its lines on edges of the picture.
    agreement: f64,
    /// Reason for which it was not found.
    why: Option<String>,
    /// Its corners and points between them: the first four are the corners, from the top left one clockwise.
    points: Vec<Point>,
    /// Places that can be marked besides.
    landmarks: Vec<Landmark>,
}

/// A place of the pitch and its pixel.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Point {
    px: [f64; 2],
    /// x and y on the floor; the height above it comes third, if it is not 0.
    mm: Place,
}

#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[serde(untagged)]
enum Place {
    Floor([f64; 2]),
    Above([f64; 3]),
}

#[derive(Debug, Serialize)]
struct Landmark {
    name: String,
    mm: [f64; 2],
}

/// Finds the pitch.
pub fn find_field(request: &FindField, instance: &Instance) -> Result<FieldFound, SetupError> {
    let config = assumed(instance, &request.set)?;
    let picture = picture(instance, &config)?;
    let (found, agreement, why, points) =
        match find(&picture, &config.field, config.camera.mirrored) {
            Ok(FoundPitch { marks, agreement }) => (true, agreement, None, marks),
            Err(why) => {
                (false, why.agreement, Some(why.to_string()), as_large_as(&picture, &config))
            }
        };
    let point = |mark: &Mark| {
        let [x, y, _] = mark.field_mm;
        Point { px: mark.image_px, mm: Place::Floor([x, y]) }
    };
    let landmarks = landmark_names(&config.field).into_iter().map(|landmark| {
        let [x, y] = landmark.field_mm;
        Landmark { name: landmark.name, mm: [x, y] }
    });
    Ok(FieldFound {
        found,
        agreement,
        why,
        points: points.iter().map(point).collect(),
        landmarks: landmarks.collect(),
    })
}

/// The corners of a pitch that fills most of the picture.
fn as_large_as(picture: &RgbImage, config: &Config) -> Vec<Mark> {
    const SHARE: f64 = 0.8;
    let FieldConfig { length_mm, width_mm, .. } = config.field;
    let [width, height] = [picture.width(), picture.height()].map(f64::from);
    let px_per_mm = SHARE * f64::min(width / length_mm, height / width_mm);
    let up = if config.camera.mirrored { 1.0 } else { -1.0 };
    let mark = |[x, y]: [f64; 2]| Mark {
        field_mm: [x, y, 0.0],
        image_px: [width / 2.0 + x * px_per_mm, height / 2.0 + up * y * px_per_mm],
    };
    config.field.corners().map(mark).to_vec()
}

/// Fits the camera to points.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibrate {
    /// Assumed changes.
    #[serde(default)]
    set: Map<String, Value>,
    /// At least four.
    points: Vec<Point>,
    /// Height of the lens above the floor, if it was measured.
    camera_height_mm: Option<f64>,
    /// Whether to look for the lines of the pitch, which are more exact than marks.
    #[serde(default = "yes")]
    use_lines: bool,
    /// Largest error of a point.
    #[serde(default = "usual_px")]
    within_px: f64,
    /// Whether the points are those that were found, which fit each other better than they are exact.
    #[serde(default)]
    as_found: bool,
}

fn yes() -> bool {
    true
}

fn usual_px() -> f64 {
    3.0
}

/// The fitted camera.
#[derive(Debug, Serialize)]
pub struct Calibrated {
    set: Map<String, Value>,
    /// Root mean square and largest error of the points, and the index of the point that has it.
    rms_px: f64,
    worst_px: f64,
    worst: usize,
    /// Of each point: mark less camera.
    errors_px: Vec<[f64; 2]>,
    /// The result of the search for the lines; `null` if they were not looked for.
    lines: Option<Lines>,
    lens: String,
    camera: String,
    hints: Vec<&'static str>,
    /// Border, centre line, centre circle and goals in the picture.
    drawn_px: Vec<Vec<[f64; 2]>>,
}

#[derive(Debug, Serialize)]
struct Lines {
    used: bool,
    text: String,
    /// The share of the places searched at which a line was.
    share: Option<f64>,
    rms_px: Option<f64>,
}

/// Fits the camera.
pub fn calibrate(request: &Calibrate, instance: &Instance) -> Result<Calibrated, SetupError> {
    let config = assumed(instance, &request.set)?;
    let lens = match request.camera_height_mm {
        Some(height) => KnownLens::HeightMm(height),
        None => KnownLens::Guess(config.geometry.camera_mm),
    };
    let marks: Vec<Mark> = request.points.iter().map(Point::mark).collect();
    let picture = match request.use_lines {
        true => Some(picture(instance, &config)?),
        false => None,
    };
    let marking = match request.as_found {
        true => Marking::Roughly(FOUND_WITHIN * f64::from(config.camera.width)),
        false => Marking::Within(request.within_px),
    };
    let Fit { calibration, lines } = fit(&config, &marks, marking, lens, picture.as_ref())?;
    let fitted = calibrated(&config, &calibration);
    if let Some(problem) = fitted.problems().first() {
        return Err(problem.to_string().into());
    }
    let (worst, worst_px) = calibration.worst();
    Ok(Calibrated {
        set: geometry_of(&fitted)?,
        rms_px: calibration.rms_px(),
        worst_px,
        worst,
        errors_px: calibration.errors_px.clone(),
        lines: lines.map(Lines::from),
        lens: words::lens(&calibration),
        camera: words::camera(&calibration),
        hints: words::hints(&calibration),
        drawn_px: drawn(&calibration.model, &config.field),
    })
}

impl Point {
    fn mark(&self) -> Mark {
        let field_mm = match self.mm {
            Place::Floor([x, y]) => [x, y, 0.0],
            Place::Above(place) => place,
        };
        Mark { field_mm, image_px: self.px }
    }
}

impl From<Result<LinesFound, NotRefined>> for Lines {
    fn from(outcome: Result<LinesFound, NotRefined>) -> Self {
        match outcome {
            Ok(found) => Self {
                used: true,
                text: found.text(),
                share: Some(found.found as f64 / found.wanted as f64),
                rms_px: Some(found.rms_px),
            },
            Err(why) => Self { used: false, text: why.to_string(), share: None, rms_px: None },
        }
    }
}

/// The keys of the geometry.
fn geometry_of(config: &Config) -> Result<Map<String, Value>, SetupError> {
    let Value::Object(keys) = json!(config.geometry) else {
        return Err("the geometry has no keys".into());
    };
    Ok(keys.into_iter().map(|(key, value)| (format!("geometry.{key}"), value)).collect())
}

/// The lines of a pitch as the camera sees them.
fn drawn(model: &CameraModel, field: &FieldConfig) -> Vec<Vec<[f64; 2]>> {
    let (x, y) = (field.length_mm / 2.0, field.width_mm / 2.0);
    let (goal, back) = (field.goal_width_mm / 2.0, x + field.goal_depth_mm);
    let [a, b, c, d] = field.corners();
    let circle = (0..=STEPS).map(|step| {
        let (sin, cos) = (TAU * f64::from(step) / f64::from(STEPS)).sin_cos();
        [field.center_circle_radius_mm * cos, field.center_circle_radius_mm * sin]
    });
    let mut paths = vec![vec![a, b, c, d, a], vec![[0.0, y], [0.0, -y]], circle.collect()];
    for side in [-1.0, 1.0] {
        let mouth = [[x, goal], [back, goal], [back, -goal], [x, -goal]];
        paths.push(mouth.map(|[x, y]| [side * x, y]).to_vec());
    }
    let seen = |[x, y]: [f64; 2]| {
        let seen = model.image_from_field(FieldPoint::new(x, y), 0.0);
        [seen.x_px, seen.y_px]
    };
    // A lens bends straight lines.
    let bent = |path: Vec<[f64; 2]>| {
        let pieces = path.windows(2).flat_map(|ends| {
            let ([x0, y0], [x1, y1]) = (ends[0], ends[1]);
            (0..STEPS).map(move |step| {
                let part = f64::from(step) / f64::from(STEPS);
                [x0 + part * (x1 - x0), y0 + part * (y1 - y0)]
            })
        });
        pieces.chain(path.last().copied()).map(seen).collect()
    };
    paths.into_iter().map(bent).collect()
}

fn picture(instance: &Instance, config: &Config) -> Result<RgbImage, SetupError> {
    let frames = frames(instance, config, FRAMES, APART)?;
    median(&frames).ok_or_else(|| "the frames have different sizes".into())
}
