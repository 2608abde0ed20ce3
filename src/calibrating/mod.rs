//! Calibration of the camera on a picture: from points that a person has marked ([`points`]), refined on the
//! lines of the pitch if there is a picture ([`lines`]). [`overlay`] draws the result for a person to check.

mod brightness;
pub mod lines;
pub mod overlay;
mod pitch;
pub mod points;

use config::Config;
use image::RgbImage;
use lines::{LinesFound, NotRefined};
use setup::calibration::{Calibration, CalibrationError, KnownLens, Mark, calibrate};

/// Factor by which the error limit of points is raised if lines will refine the fit.
const ROUGHLY: f64 = 3.0;

/// A calibration, and what the lines of the pitch contributed.
pub struct Fit {
    /// The camera.
    pub calibration: Calibration,
    /// What was found of the lines; `None` without a picture.
    pub lines: Option<Result<LinesFound, NotRefined>>,
}

/// The camera fitted to the points, refined on the pitch's lines if there is a picture. Points that are off by
/// more than `within_px` are an error unless the lines explain them.
pub fn fit(
    config: &Config,
    marks: &[Mark],
    lens: KnownLens,
    within_px: f64,
    picture: Option<&RgbImage>,
) -> Result<Fit, CalibrationError> {
    let (field, camera) = (&config.field, &config.camera);
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
    match lines::refined(picture, config, marks, lens, &rough) {
        Ok((calibration, lines)) => Ok(Fit { calibration, lines: Some(Ok(lines)) }),
        Err(why) => by_points.map(|calibration| Fit { calibration, lines: Some(Err(why)) }),
    }
}
