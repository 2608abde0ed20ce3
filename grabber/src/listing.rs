//! Discovery of cameras and their abilities.

use crate::v4l2::controls::Control;
use crate::{genicam, v4l2};
use serde::Serialize;

/// The cameras of this machine.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Listing {
    /// All cameras found, including those that cannot be used.
    pub cameras: Vec<CameraDescription>,
    /// Kinds of camera that could not be searched for, and why.
    pub notes: Vec<String>,
}

/// Discovers cameras; takes about a second if the library for GenICam is present.
pub fn list() -> Listing {
    let mut listing = Listing { cameras: v4l2::list(), notes: Vec::new() };
    match genicam::list() {
        Ok(cameras) => listing.cameras.extend(cameras),
        Err(note) => listing.notes.push(note),
    }
    listing
}

/// A camera's description of itself.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraDescription {
    /// Argument of `--source`.
    pub source: String,
    /// Its model.
    pub model: String,
    /// Its driver and bus.
    pub driver: String,
    /// Reason for which it cannot be queried.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
    /// Formats it delivers.
    pub formats: Vec<FormatDescription>,
    /// Controls; only for Video for Linux.
    pub controls: Vec<Control>,
    /// Some features; only for GenICam.
    pub features: Vec<FeatureDescription>,
}

/// A format that a camera offers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FormatDescription {
    /// Value of `format` in the configuration.
    pub name: String,
    /// The driver's name for it.
    pub description: String,
    /// Reason for which it cannot be used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
    /// Sizes and rates.
    pub sizes: Vec<SizeDescription>,
}

/// A size in which a format is available.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SizeDescription {
    /// "640×480", or a range.
    pub size: String,
    /// Frames per second, fastest first; for a range, at its largest size.
    pub fps: Vec<f64>,
}

/// A numeric feature of a GenICam camera.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FeatureDescription {
    /// Its name in configurations.
    pub name: String,
    /// Lowest value.
    pub minimum: f64,
    /// Highest value.
    pub maximum: f64,
    /// Present value.
    pub value: f64,
}
