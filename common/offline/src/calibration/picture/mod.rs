//! Calibration of the camera on a picture: from points that a person has marked ([`points`]), refined on the lines of
//! the pitch if there is a picture ([`lines`]), or from the lines alone ([`mod@find`]). [`words`] describes the result.

mod brightness;
mod edges;
pub mod find;
pub mod lines;
mod pitch;
pub mod points;
pub mod words;

use crate::calibration::{Calibration, CalibrationError, KnownLens, Mark, calibrate};
use config::Config;
use find::{FoundPitch, NotFound, find};
use image::RgbImage;
use lines::{LinesFound, NotRefined};

/// Factor by which the error limit of points is raised if lines will refine the fit.
const ROUGHLY: f64 = 3.0;

/// A calibration, and the result of the search for the lines of the pitch.
pub struct Fit {
    /// The camera.
    pub calibration: Calibration,
    /// The lines found, or why they were not used; `None` without a picture.
    pub lines: Option<Result<LinesFound, NotRefined>>,
}

/// How exactly points were marked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Marking {
    /// By hand: off by at most so many pixels, and as well as they fit each other.
    Within(f64),
    /// Off by so many pixels, however well they fit each other.
    Roughly(f64),
}

/// The camera fitted to the points, refined on the pitch's lines if there is a picture. Points that are off by
/// more than they may be are an error unless the lines explain them.
pub fn fit(
    config: &Config,
    marks: &[Mark],
    marking: Marking,
    lens: KnownLens,
    picture: Option<&RgbImage>,
) -> Result<Fit, CalibrationError> {
    let (field, camera) = (&config.field, &config.camera);
    let (Marking::Within(within_px) | Marking::Roughly(within_px)) = marking;
    let by_points = calibrate(marks, lens, field, camera, within_px);
    let Some(picture) = picture else {
        return by_points.map(|calibration| Fit { calibration, lines: None });
    };
    // Roughly marked points are good enough to start the search for lines.
    let rough = match &by_points {
        Ok(calibration) => Ok(calibration.clone()),
        Err(_) => calibrate(marks, lens, field, camera, ROUGHLY * within_px),
    };
    let Ok(rough) = rough else {
        return by_points.map(|calibration| Fit { calibration, lines: None });
    };
    let may_move_px = match marking {
        Marking::Within(_) => lines::marking_error_px(&rough),
        Marking::Roughly(px) => px,
    };
    match lines::refined(picture, config, marks, lens, &rough, may_move_px) {
        Ok((calibration, lines)) => Ok(Fit { calibration, lines: Some(Ok(lines)) }),
        Err(why) => by_points.map(|calibration| Fit { calibration, lines: Some(Err(why)) }),
    }
}

/// Distance from its place, in shares of the picture's width, at which a pitch may be found.
pub const FOUND_WITHIN: f64 = 0.015;
/// Smallest share of the places searched at which a line of the pitch must be when nobody has marked the pitch.
const LEAST_SHARE: f64 = 0.5;

/// A picture does not show where its camera is.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum NotCalibrated {
    #[error(transparent)]
    NotFound(#[from] NotFound),
    #[error("the pitch was found, but does not determine the camera: {0}; mark its corners")]
    Undetermined(#[from] CalibrationError),
    #[error("the pitch was found roughly, but not its lines: {0}; mark its corners")]
    NotRefined(#[from] NotRefined),
}

/// The camera, from the pitch's lines alone, and the marks by which the search for them began.
pub fn fit_without_marks(
    config: &Config,
    lens: KnownLens,
    picture: &RgbImage,
) -> Result<(Fit, FoundPitch), NotCalibrated> {
    let pitch = find(picture, &config.field, config.camera.mirrored)?;
    let within_px = FOUND_WITHIN * f64::from(picture.width());
    let fit = fit(config, &pitch.marks, Marking::Roughly(within_px), lens, Some(picture))?;
    match fit.lines {
        Some(Ok(LinesFound { found, wanted, .. }))
            if (found as f64) < LEAST_SHARE * wanted as f64 =>
        {
            Err(NotRefined::TooFew { found, wanted }.into())
        }
        Some(Err(why)) => Err(why.into()),
        _ => Ok((fit, pitch)),
    }
}
