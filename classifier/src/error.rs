//! Errors of building a classifier from a configuration.

use geometry::GeometryError;

/// The configuration cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ClassifierError {
    /// Demosaicing needs a neighbour of every colour in both directions.
    #[error("camera picture is {width}×{height}, the smallest possible is 2×2")]
    ImageTooSmall {
        /// Configured value.
        width: u32,
        /// Configured value.
        height: u32,
    },
    /// Runs hold rows and columns in 16 bits.
    #[error("camera picture is {width}×{height}, the largest possible is 65535×65535")]
    ImageTooLarge {
        /// Configured value.
        width: u32,
        /// Configured value.
        height: u32,
    },
    /// The geometry tells where the pitch is in the picture, which correcting the light needs.
    #[error("geometry: {0}")]
    Geometry(#[from] GeometryError),
    /// A table entry has one bit for each colour.
    #[error("{0} colours are configured, at most 32 are possible")]
    TooManyColors(usize),
    /// The lowest value is above the highest.
    #[error("colour \"{color}\": {channel} from {low} to {high} is empty")]
    EmptyRange {
        /// Name of the colour.
        color: String,
        /// Name of the bound.
        channel: &'static str,
        /// Configured value.
        low: f64,
        /// Configured value.
        high: f64,
    },
    /// A bound is infinite or not a number.
    #[error("colour \"{color}\": {channel} from {low} to {high} is not a range of numbers")]
    NotFinite {
        /// Name of the colour.
        color: String,
        /// Name of the bound.
        channel: &'static str,
        /// Configured value.
        low: f64,
        /// Configured value.
        high: f64,
    },
}
