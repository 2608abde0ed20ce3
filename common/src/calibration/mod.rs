//! From points marked in a picture to the geometry of the camera.
//!
//! A camera that sees straight lines straight is a homography of the floor (eight numbers) and the
//! place of its lens (three); together they are any pinhole camera, whatever its tilt, its pixels'
//! shape or its picture's middle. A point at a known height tells of the lens, since it appears
//! where the ray through it meets the floor. Around that comes radial distortion. All of it is fitted
//! to the marked points at once, by the least sum of squared distances in the picture, with only as
//! many of the numbers free as the points can tell. A lens too wide for that is taken for a fisheye.
//!
//! Everything here is pure: points in, geometry or suspicions out.

mod fit;
mod landmarks;
mod least_squares;
mod numbers;
mod perspective;
mod physical;
mod suspects;

use crate::config::PointPair;
use crate::config::{CameraConfig, Config, DistortionConfig, FieldConfig, GeometryConfig, Pair};
use crate::geometry::{CameraModel, FieldPoint, GeometryError, ImagePoint};

pub use landmarks::{Landmark, LandmarkError, landmark_names, resolve_landmark};
pub use suspects::Suspicion;

/// A point of known place, and where it is seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    /// On the pitch: x, y and height above the floor.
    pub field_mm: [f64; 3],
    /// In the picture; the centre of the top-left pixel is (0, 0).
    pub image_px: Pair,
}

/// A place on a line of the pitch, and where the line is seen: only across it, since along it all places look alike.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeMark {
    /// On the floor.
    pub field_mm: Pair,
    /// In the picture.
    pub image_px: Pair,
    /// Across the line in the picture, of length 1.
    pub normal: Pair,
}

/// What is known of the lens' place before the points are looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum KnownLens {
    /// Nothing but where it may be: [x, y, height].
    Guess([f64; 3]),
    /// Its height above the floor was measured.
    HeightMm(f64),
    /// All of it was measured.
    Position([f64; 3]),
}

/// Where the place of the lens comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LensSource {
    /// From points at different heights.
    Points,
    /// Height measured, the rest from points at different heights.
    HeightAndPoints,
    /// Height measured, the rest from the perspective of the floor, for square pixels and a lens
    /// over the middle of the picture.
    HeightAndPerspective,
    /// The floor's perspective, which a fisheye of known projection determines.
    Perspective,
    /// All of it was given.
    Given,
    /// Nobody knows; it is where it was guessed to be.
    Guessed,
}

/// The camera that fits the marked points best.
#[derive(Debug, Clone)]
pub struct Calibration {
    /// Ready for the configuration.
    pub geometry: GeometryConfig,
    /// The same, ready for use.
    pub model: CameraModel,
    /// Where the lens' place comes from.
    pub lens_source: LensSource,
    /// Standard deviation of each coordinate of the lens, as far as the points tell; 0 for what was
    /// given.
    pub lens_sigma_mm: [f64; 3],
    /// For each point, by how much it was marked beside where this camera sees it.
    pub errors_px: Vec<Pair>,
    /// Equations more than unknowns: 0 means that any points would have fitted.
    pub surplus: usize,
    /// Distortion parameters that were fitted: 0, 1 (k1), 2 (k1, k2), 4 (and the centre), or all 5 of a
    /// fisheye.
    pub distortion_parameters: usize,
}

/// Why there is no calibration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// Too few points.
    #[error("{0} points are marked, at least 4 are needed")]
    TooFewPoints(usize),
    /// Too many points.
    #[error("{0} points are marked, at most {MAX_MARKS} are used: leave some out")]
    TooManyPoints(usize),
    /// Numbers that are none.
    #[error("point {}: {what} is not a usable number", point + 1)]
    Number {
        /// Which point, from 0.
        point: usize,
        /// Which of its numbers.
        what: &'static str,
    },
    /// Two points at one place.
    #[error("points {} and {} are the same place on the pitch", .0 + 1, .1 + 1)]
    SamePlace(usize, usize),
    /// Numbers that make a pitch only in another unit.
    #[error(
        "the points' places look like {unit}: with them all within {reach} of the centre, this is not a pitch of \
         {length_mm} × {width_mm} mm; write millimetres, {example}"
    )]
    Unit {
        /// The likely unit.
        unit: &'static str,
        /// The largest number.
        reach: f64,
        /// The configured pitch.
        length_mm: f64,
        /// The configured pitch.
        width_mm: f64,
        /// One of the numbers as it should be.
        example: String,
    },
    /// A height that makes sense in another unit.
    #[error("the camera hangs {0} mm high: is that metres? Write millimetres, {thousand:.0}", thousand = 1000.0 * .0)]
    HeightUnit(f64),
    /// A point that the camera looks up to.
    #[error("point {} is {height_mm} mm high, the camera hangs at {camera_mm} mm", point + 1)]
    AboveCamera {
        /// Which point, from 0.
        point: usize,
        /// Its height.
        height_mm: f64,
        /// The camera's height.
        camera_mm: f64,
    },
    /// The points do not determine the camera.
    #[error(transparent)]
    Geometry(#[from] GeometryError),
    /// The points contradict each other.
    #[error("{0}")]
    Suspicious(Suspicion),
}

/// Most points that are looked at.
pub const MAX_MARKS: usize = 1000;

impl Calibration {
    /// Root mean square distance between the points as marked and as this camera sees them.
    pub fn rms_px(&self) -> f64 {
        let sum: f64 = self.errors_px.iter().map(|[x, y]| x * x + y * y).sum();
        (sum / self.errors_px.len().max(1) as f64).sqrt()
    }

    /// The largest of these distances, and whose it is.
    pub fn worst(&self) -> (usize, f64) {
        let distances = self.errors_px.iter().map(|[x, y]| x.hypot(*y)).enumerate();
        distances.max_by(|(_, a), (_, b)| a.total_cmp(b)).unwrap_or((0, 0.0))
    }
}

/// Fits a camera to marked points.
///
/// No point may be further than `within_px` from where the camera sees it; otherwise, or when the
/// points turn the pitch inside out, the error says which of them are to be suspected.
pub fn calibrate(
    marks: &[Mark],
    known_lens: KnownLens,
    field: &FieldConfig,
    camera: &CameraConfig,
    within_px: f64,
) -> Result<Calibration, CalibrationError> {
    check(marks, known_lens)?;
    check_unit(marks, known_lens, field)?;
    let picture_px = [camera.width, camera.height];
    let task = fit::Task {
        marks,
        mark_weight: 1.0,
        edges: &[],
        known_lens,
        field,
        picture_px,
        is_mirrored: camera.mirrored,
        max_distortion: fit::MAX_DISTORTION,
    };
    let fitted = task.best_fit();
    if let Some(suspicion) = suspects::suspicion(&task, fitted.as_ref().ok(), within_px) {
        return Err(CalibrationError::Suspicious(suspicion));
    }
    finished(&fitted?, marks, field, camera)
}

/// Fits a camera to marked points and, much more, to lines of the pitch that were found in the picture.
pub fn refine(
    marks: &[Mark],
    edges: &[EdgeMark],
    known_lens: KnownLens,
    field: &FieldConfig,
    camera: &CameraConfig,
) -> Result<Calibration, CalibrationError> {
    check(marks, known_lens)?;
    let task = fit::Task {
        marks,
        mark_weight: MARK_BESIDE_EDGES,
        edges,
        known_lens,
        field,
        picture_px: [camera.width, camera.height],
        is_mirrored: camera.mirrored,
        max_distortion: fit::MAX_DISTORTION,
    };
    finished(&task.best_fit()?, marks, field, camera)
}

/// A mark by hand is so much worse than an edge.
const MARK_BESIDE_EDGES: f64 = 0.05;

fn finished(
    fitted: &fit::Fitted,
    marks: &[Mark],
    field: &FieldConfig,
    camera: &CameraConfig,
) -> Result<Calibration, CalibrationError> {
    let (geometry, model) = as_configured(fitted, marks, field, camera)?;
    let seen = |mark: &Mark| {
        let [x, y, height] = mark.field_mm;
        model.image_from_field(FieldPoint::new(x, y), height)
    };
    let errors_px = marks.iter().map(|mark| {
        let seen = seen(mark);
        [mark.image_px[0] - seen.x_px, mark.image_px[1] - seen.y_px]
    });
    Ok(Calibration {
        errors_px: errors_px.collect(),
        geometry,
        lens_source: fitted.lens_source,
        lens_sigma_mm: fitted.lens_sigma_mm,
        surplus: fitted.surplus,
        distortion_parameters: fitted.distortion_parameters,
        model,
    })
}

/// A configuration with the geometry of a calibration.
pub fn calibrated(config: &Config, calibration: &Calibration) -> Config {
    Config { geometry: calibration.geometry.clone(), ..config.clone() }
}

fn check(marks: &[Mark], known_lens: KnownLens) -> Result<(), CalibrationError> {
    if marks.len() < 4 {
        return Err(CalibrationError::TooFewPoints(marks.len()));
    }
    if marks.len() > MAX_MARKS {
        return Err(CalibrationError::TooManyPoints(marks.len()));
    }
    let camera_mm = match known_lens {
        KnownLens::Guess([_, _, height])
        | KnownLens::HeightMm(height)
        | KnownLens::Position([_, _, height]) => height,
    };
    if !(camera_mm > 0.0 && camera_mm < 1e6) {
        return Err(GeometryError::CameraHeight(camera_mm).into());
    }
    for (point, mark) in marks.iter().enumerate() {
        let is_usable = |value: &f64| value.abs() < 1e6;
        if !mark.field_mm.iter().all(is_usable) {
            return Err(CalibrationError::Number { point, what: "its place on the pitch" });
        }
        if !mark.image_px.iter().all(is_usable) {
            return Err(CalibrationError::Number { point, what: "its place in the picture" });
        }
        let [_, _, height_mm] = mark.field_mm;
        if height_mm >= 0.9 * camera_mm {
            return Err(CalibrationError::AboveCamera { point, height_mm, camera_mm });
        }
        let twin = marks[..point].iter().position(|other| other.field_mm == mark.field_mm);
        if let Some(twin) = twin {
            return Err(CalibrationError::SamePlace(twin, point));
        }
    }
    Ok(())
}

/// Metres and centimetres fit as well as millimetres do, and make robots of the wrong size.
fn check_unit(
    marks: &[Mark],
    known_lens: KnownLens,
    field: &FieldConfig,
) -> Result<(), CalibrationError> {
    if let KnownLens::HeightMm(height) | KnownLens::Position([_, _, height]) = known_lens
        && height < LEAST_HEIGHT_MM
    {
        return Err(CalibrationError::HeightUnit(height));
    }
    let Some((unit, factor)) =
        likely_unit(marks.iter().map(|mark| [mark.field_mm[0], mark.field_mm[1]]), field)
    else {
        return Ok(());
    };
    let numbers = || marks.iter().flat_map(|mark| [mark.field_mm[0], mark.field_mm[1]]);
    let reach = numbers().fold(0.0f64, |most, number| most.max(number.abs()));
    let FieldConfig { length_mm, width_mm, .. } = *field;
    let example = format!("{} instead of {reach}", (reach * factor * 1e3).round() / 1e3);
    Err(CalibrationError::Unit { unit, reach, length_mm, width_mm, example })
}

/// No camera hangs as low as this.
const LEAST_HEIGHT_MM: f64 = 20.0;

/// The unit in which these points would be on the pitch and spread over a good part of it, if it is not
/// millimetres; and how many millimetres it has.
pub(crate) fn likely_unit(
    points: impl Iterator<Item = Pair>,
    field: &FieldConfig,
) -> Option<(&'static str, f64)> {
    let half = (field.length_mm / 2.0).hypot(field.width_mm / 2.0);
    let reach = points.fold(0.0f64, |most, [x, y]| most.max(x.hypot(y)));
    let is_likely = |&(_, factor): &(_, f64)| (0.4 * half..1.3 * half).contains(&(reach * factor));
    [("metres", 1000.0), ("centimetres", 10.0)].into_iter().find(is_likely)
}

/// The configuration knows the floor by points of it: those at which the fit sees the corners of
/// the pitch, or, where the lens makes these meaningless, of what is seen.
fn as_configured(
    fitted: &fit::Fitted,
    marks: &[Mark],
    field: &FieldConfig,
    camera: &CameraConfig,
) -> Result<(GeometryConfig, CameraModel), CalibrationError> {
    let model = &fitted.model;
    let corners = corners(field);
    let (right, bottom) = (f64::from(camera.width) - 1.0, f64::from(camera.height) - 1.0);
    let seen = [[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9]].map(|[along, down]| {
        let floor = model.field_from_image(ImagePoint::new(along * right, down * bottom), 0.0);
        [floor.x_mm, floor.y_mm]
    });
    let mut error = GeometryError::Degenerate;
    for floor in [corners, seen] {
        let points = floor.map(|[x, y]| {
            let image = model.image_from_field(FieldPoint::new(x, y), 0.0);
            let field_mm = [x, y].map(|value| (value * 1e3).round() / 1e3);
            PointPair { field_mm, image_px: [image.x_px, image.y_px].map(to_thousandths) }
        });
        let geometry = GeometryConfig {
            camera_mm: fitted.lens_mm.map(|value| (value * 10.0).round() / 10.0),
            points: points.to_vec(),
            distortion: DistortionConfig {
                k1: to_millionths(fitted.distortion.k1),
                k2: to_millionths(fitted.distortion.k2),
                k3: to_millionths(fitted.distortion.k3),
                k4: to_millionths(fitted.distortion.k4),
                focal_px: to_thousandths(fitted.distortion.focal_px),
                center_px: fitted.distortion.center_px.map(to_thousandths),
                model: fitted.distortion.model,
            },
        };
        match CameraModel::new(&geometry, camera.width, camera.height) {
            Ok(configured) if agree(&configured, model, marks) => {
                return Ok((geometry, configured));
            }
            Ok(_) => {}
            Err(refused) => error = refused,
        }
    }
    Err(error.into())
}

/// Corners of the pitch.
pub(crate) fn corners(field: &FieldConfig) -> [Pair; 4] {
    let (x, y) = (field.length_mm / 2.0, field.width_mm / 2.0);
    [[-x, y], [x, y], [x, -y], [-x, -y]]
}

/// Points around the pitch: its corners, and some on each side.
pub(crate) fn outline(field: &FieldConfig) -> impl Iterator<Item = Pair> {
    const STEPS: u32 = 8;
    let corners = corners(field);
    (0..4).flat_map(move |side| {
        let (from, to) = (corners[side], corners[(side + 1) % 4]);
        (0..STEPS).map(move |step| {
            let part = f64::from(step) / f64::from(STEPS);
            [0, 1].map(|axis| from[axis] + part * (to[axis] - from[axis]))
        })
    })
}

fn to_thousandths(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

fn to_millionths(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

/// Whether two cameras see the marked points at the same pixels.
fn agree(a: &CameraModel, b: &CameraModel, marks: &[Mark]) -> bool {
    marks.iter().all(|mark| {
        let [x, y, height] = mark.field_mm;
        let seen = |model: &CameraModel| model.image_from_field(FieldPoint::new(x, y), height);
        let (a, b) = (seen(a), seen(b));
        (a.x_px - b.x_px).hypot(a.y_px - b.y_px) < 0.05
    })
}

#[cfg(test)]
mod tests;
#[cfg(test)]
mod wide_tests;
