//! Discovery of GenICam cameras.

use super::formats;
use super::library::library;
use super::objects::{Camera, DiscoveredCamera, discover};
use crate::listing::{CameraDescription, FeatureDescription, FormatDescription};

/// Features that most cameras have and that matter here.
const FEATURES: [&str; 7] = [
    "ExposureTime",
    "ExposureTimeAbs",
    "Gain",
    "AcquisitionFrameRate",
    "AcquisitionFrameRateAbs",
    "Width",
    "Height",
];

/// All cameras that the library finds; takes about a second. An error if there is no library.
pub fn list() -> Result<Vec<CameraDescription>, String> {
    library()?;
    Ok(discover()?.iter().map(describe).collect())
}

fn describe(found: &DiscoveredCamera) -> CameraDescription {
    let mut description = CameraDescription {
        source: format!("genicam:{}", found.id),
        model: format!("{} {}", found.vendor, found.model).trim().to_string(),
        driver: format!("{}, {}", found.protocol, found.address),
        problem: None,
        formats: Vec::new(),
        controls: Vec::new(),
        features: Vec::new(),
    };
    let opened = library()
        .and_then(|library| Camera::open(library, Some(&found.id)).map_err(|error| error.text));
    match opened {
        Ok(camera) => {
            description.formats =
                camera.formats().unwrap_or_default().iter().map(|name| format(name)).collect();
            description.features =
                FEATURES.iter().filter_map(|name| feature(&camera, name)).collect();
        }
        Err(problem) => description.problem = Some(problem),
    }
    description
}

fn format(name: &str) -> FormatDescription {
    FormatDescription {
        name: name.to_string(),
        description: String::new(),
        refused: formats::refusal(name).map(str::to_string),
        sizes: Vec::new(),
    }
}

fn feature(camera: &Camera, name: &str) -> Option<FeatureDescription> {
    let [minimum, maximum, value] = camera.has(name).then(|| camera.range(name))??;
    Some(FeatureDescription { name: name.to_string(), minimum, maximum, value })
}
