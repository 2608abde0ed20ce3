//! A calibration in words, for a person.

use crate::calibration::{Calibration, LensSource};
use config::{DistortionConfig, DistortionModel};
use std::fmt::Write as _;

/// The lens' distortion.
pub fn lens(calibration: &Calibration) -> String {
    let DistortionConfig { model, focal_px, k1, k2, k3, k4, center_px: [x, y] } =
        calibration.geometry.distortion;
    if calibration.distortion_parameters == 0 {
        return "no distortion that these points could tell".into();
    }
    let mut text = match model {
        DistortionModel::Polynomial => "polynomial".to_string(),
        DistortionModel::Fisheye => format!("fisheye, focal length {focal_px:.1} px"),
    };
    for (name, term) in [("k1", k1), ("k2", k2), ("k3", k3), ("k4", k4)] {
        if term != 0.0 {
            let _ = write!(text, ", {name} = {term}");
        }
    }
    let _ = write!(text, ", around ({x:.1}, {y:.1}) px");
    text
}

/// Where the camera hangs, and how that is known.
pub fn camera(calibration: &Calibration) -> String {
    let place = calibration.geometry.camera_mm;
    let sigma = calibration.lens_sigma_mm;
    let coordinate = |axis: usize| match sigma[axis] {
        0.0 => format!("{:.0}", place[axis]),
        sigma => format!("{:.0} ± {sigma:.0}", place[axis]),
    };
    let source = match calibration.lens_source {
        LensSource::Points => "from points of different heights",
        LensSource::HeightAndPoints => "height as measured, the rest from points above the floor",
        LensSource::HeightAndPerspective => "height as measured, the rest from the perspective",
        LensSource::Perspective => "from the perspective; its height is uncertain",
        LensSource::Given => "as given",
        LensSource::Guessed => "as configured, not measured",
    };
    format!("{} mm high, at x {}, y {} mm ({source})", coordinate(2), coordinate(0), coordinate(1))
}

/// Advice on how to improve the calibration.
pub fn hints(calibration: &Calibration) -> Vec<&'static str> {
    let mut hints = Vec::new();
    if calibration.surplus == 0 {
        hints.push(
            "so few points fit whatever they are; mark more to have them checked, and the lens'\n      \
             distortion found: points along walls and lines, and in the middle",
        );
    }
    if matches!(calibration.lens_source, LensSource::Guessed | LensSource::Perspective) {
        hints.push(
            "how high the camera hangs cannot be told from points of one height; it matters for\n      \
             where robots stand. Mark the upper edge of the wall (\"wall top left\" …, with\n      \
             --wall-height-mm), or measure the height (--camera-height-mm)",
        );
    }
    if calibration.lens_source == LensSource::HeightAndPerspective {
        hints.push(
            "points at the upper edge of the wall (\"wall top left\" …) would tell better above\n      \
             which place the camera hangs",
        );
    }
    hints
}
