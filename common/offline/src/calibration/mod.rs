//! Calibration: the camera's geometry from points marked in a picture.
//!
//! A pinhole camera, with any tilt, pixel shape and principal point, is a homography of the floor
//! (eight parameters) and the position of its lens (three). A point at a known height determines the
//! lens, since it appears where the ray through it meets the floor. To this radial distortion is added.
//! All parameters are fitted to the marked points at once by least squares of the distances in the
//! picture, with only as many free as the points can determine (`fit.rs`). For a lens too wide for this
//! model, cameras with square pixels and a fisheye lens are tried as well (`physical.rs`). If the
//! points do not fit together, the wrong ones are searched for (`suspects.rs`).
//!
//! All of this is pure: points in, geometry or suspicions out. [`picture`] finds points and lines in pictures.

mod fit;
mod landmarks;
mod least_squares;
mod parameters;
mod perspective;
mod physical;
pub mod picture;
mod pinhole;
mod suspects;

use config::PointPair;
use config::{CameraConfig, Config, DistortionConfig, FieldConfig, GeometryConfig, Pair};
use geometry::{CameraModel, FieldPoint, GeometryError, ImagePoint};

pub use landmarks::{Landmark, LandmarkError, landmark_names, resolve_landmark};
pub use pinhole::{Pinhole, PinholeError};
pub use suspects::Suspicion;

/// A point of known position, and its pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    /// Position on the pitch: x, y and height above the floor.
    pub field_mm: [f64; 3],
    /// Position in the picture; the centre of the top-left pixel is (0, 0).
    pub image_px: Pair,
}

/// A point of a line on the pitch, and its pixel. It counts only across the line, since the points
/// along a line look alike.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeMark {
    /// Position on the floor.
    pub field_mm: Pair,
    /// Position in the picture.
    pub image_px: Pair,
    /// Unit vector across the line in the picture.
    pub normal: Pair,
}

/// Prior knowledge of the lens position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum KnownLens {
    /// A guess only: [x, y, height].
    Guess([f64; 3]),
    /// The height above the floor was measured.
    HeightMm(f64),
    /// All three coordinates were measured.
    Position([f64; 3]),
}

/// Source of the lens position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LensSource {
    /// Points at different heights.
    Points,
    /// Measured height; the rest from points at different heights.
    HeightAndPoints,
    /// Measured height; the rest from the perspective of the floor, for square pixels and a lens axis
    /// through the middle of the picture.
    HeightAndPerspective,
    /// Perspective of the floor, which suffices for a fisheye of known projection.
    Perspective,
    /// Measured position.
    Given,
    /// A guess; the points do not determine it.
    Guessed,
}

/// The camera that fits the marked points best.
#[derive(Debug, Clone)]
pub struct Calibration {
    /// Geometry for the configuration.
    pub geometry: GeometryConfig,
    /// The same geometry as a camera model.
    pub model: CameraModel,
    /// Source of the lens position.
    pub lens_source: LensSource,
    /// Standard deviation of each lens coordinate as determined by the points; 0 for given ones.
    pub lens_sigma_mm: [f64; 3],
    /// For each point, its mark minus its position as seen by this camera.
    pub errors_px: Vec<Pair>,
    /// Number of equations minus number of parameters: 0 means that any points would have fitted.
    pub surplus: usize,
    /// Number of fitted distortion parameters: 0, 1 (k1), 2 (k1, k2), 4 (and the centre), or all 5 of a
    /// fisheye.
    pub distortion_parameters: usize,
}

/// Reason why there is no calibration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// Too few points.
    #[error("{0} points are marked, at least 4 are needed")]
    TooFewPoints(usize),
    /// Too many points.
    #[error("{0} points are marked, at most {MAX_MARKS} are used: leave some out")]
    TooManyPoints(usize),
    /// A coordinate is not a finite number of reasonable size.
    #[error("point {}: {what} is not a usable number", point + 1)]
    Number {
        /// Index of the point, from 0.
        point: usize,
        /// Which coordinate.
        what: &'static str,
    },
    /// Two points have the same position.
    #[error("points {} and {} are the same place on the pitch", .0 + 1, .1 + 1)]
    SamePlace(usize, usize),
    /// The coordinates fit the pitch only in another unit.
    #[error(
        "the points' places look like {unit}: with them all within {reach} of the centre, this is not a pitch of \
         {length_mm} × {width_mm} mm; write millimetres, {example}"
    )]
    Unit {
        /// The assumed unit.
        unit: &'static str,
        /// The largest coordinate.
        reach: f64,
        /// Length of the configured pitch.
        length_mm: f64,
        /// Width of the configured pitch.
        width_mm: f64,
        /// Largest coordinate converted to millimetres, as text.
        example: String,
    },
    /// The height makes sense only in another unit.
    #[error("the camera hangs {0} mm high: is that metres? Write millimetres, {thousand:.0}", thousand = 1000.0 * .0)]
    HeightUnit(f64),
    /// A point is nearly as high as the camera, or higher.
    #[error("point {} is {height_mm} mm high, the camera hangs at {camera_mm} mm", point + 1)]
    AboveCamera {
        /// Index of the point, from 0.
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

/// Most points accepted.
pub const MAX_MARKS: usize = 1000;

impl Calibration {
    /// Root mean square distance between the points' marks and their positions as seen by this camera.
    pub fn rms_px(&self) -> f64 {
        let sum: f64 = self.errors_px.iter().map(|[x, y]| x * x + y * y).sum();
        (sum / self.errors_px.len().max(1) as f64).sqrt()
    }

    /// The largest of these distances, with the index of its point.
    pub fn worst(&self) -> (usize, f64) {
        let distances = self.errors_px.iter().map(|[x, y]| x.hypot(*y)).enumerate();
        distances.max_by(|(_, a), (_, b)| a.total_cmp(b)).unwrap_or((0, 0.0))
    }
}

/// Fits a camera to marked points.
///
/// Every point must lie within `within_px` of its mark. Otherwise, or if the points turn the pitch
/// inside out, the error names the points to suspect.
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

/// Fits a camera to marked points and, with far more weight, to lines of the pitch found in the
/// picture.
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

/// Weight of a point marked by hand relative to an edge.
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

/// The configuration with the geometry of a calibration.
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

/// Rejects metres and centimetres: they fit equally well, but make robots of the wrong size.
fn check_unit(
    marks: &[Mark],
    known_lens: KnownLens,
    field: &FieldConfig,
) -> Result<(), CalibrationError> {
    if let KnownLens::HeightMm(height) | KnownLens::Position([_, _, height]) = known_lens
        && height < MIN_HEIGHT_MM
    {
        return Err(CalibrationError::HeightUnit(height));
    }
    let Some((unit, factor)) =
        field.likely_unit(marks.iter().map(|mark| [mark.field_mm[0], mark.field_mm[1]]))
    else {
        return Ok(());
    };
    let coordinates = || marks.iter().flat_map(|mark| [mark.field_mm[0], mark.field_mm[1]]);
    let reach = coordinates().fold(0.0f64, |most, number| most.max(number.abs()));
    let FieldConfig { length_mm, width_mm, .. } = *field;
    let example = format!("{} instead of {reach}", (reach * factor * 1e3).round() / 1e3);
    Err(CalibrationError::Unit { unit, reach, length_mm, width_mm, example })
}

/// Lowest plausible height of a camera.
const MIN_HEIGHT_MM: f64 = 20.0;

/// The geometry in the form of the configuration, which describes the floor by points: the fitted
/// positions of the pitch's corners or, where the lens makes these meaningless, of four points of the
/// visible floor.
fn as_configured(
    fitted: &fit::Fitted,
    marks: &[Mark],
    field: &FieldConfig,
    camera: &CameraConfig,
) -> Result<(GeometryConfig, CameraModel), CalibrationError> {
    let model = &fitted.model;
    let corners = field.corners();
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
