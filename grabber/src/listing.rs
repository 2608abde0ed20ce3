//! What cameras there are, and what they can do.

use crate::v4l2::controls::Control;
use crate::{genicam, v4l2};
use serde::Serialize;

/// The cameras of this machine.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Listing {
    /// Each that was found, those that cannot be used included.
    pub cameras: Vec<CameraDescription>,
    /// What could not be looked for, and why.
    pub notes: Vec<String>,
}

/// Looks for cameras; takes about a second where GenICam cameras can be looked for.
pub fn list() -> Listing {
    let mut listing = Listing { cameras: v4l2::list(), notes: Vec::new() };
    match genicam::list() {
        Ok(cameras) => listing.cameras.extend(cameras),
        Err(note) => listing.notes.push(note),
    }
    listing
}

/// A camera as it describes itself.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraDescription {
    /// What to write after `--source`.
    pub source: String,
    /// Its model.
    pub model: String,
    /// Who drives it, and over which bus.
    pub driver: String,
    /// Why it cannot be looked at.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
    /// What it delivers.
    pub formats: Vec<FormatDescription>,
    /// What can be set, of a camera of Video for Linux.
    pub controls: Vec<Control>,
    /// Some of what can be set, of a GenICam camera.
    pub features: Vec<FeatureDescription>,
}

/// A format that a camera offers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FormatDescription {
    /// What to write as `format` in the configuration.
    pub name: String,
    /// The driver's words for it.
    pub description: String,
    /// Why it cannot be used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
    /// Sizes and rates.
    pub sizes: Vec<SizeDescription>,
}

/// A size in which a format comes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SizeDescription {
    /// "640×480", or a range.
    pub size: String,
    /// Frames a second, fastest first; of a range, at its largest size.
    pub fps: Vec<f64>,
}

/// A feature of a GenICam camera that is a number.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FeatureDescription {
    /// Its name in configurations.
    pub name: String,
    /// Lowest value.
    pub minimum: f64,
    /// Highest value.
    pub maximum: f64,
    /// Value now.
    pub value: f64,
}
