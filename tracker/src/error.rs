//! Errors of a configuration.

use geometry::GeometryError;
use messages::{MAX_PATCHES, Team};

/// Why a configuration cannot be tracked with.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrackerError {
    /// The geometry is unusable.
    #[error("geometry: {0}")]
    Geometry(#[from] GeometryError),
    /// A colour is named that is not configured.
    #[error("{user} wears the colour \"{color}\", which is not among the configured colors")]
    UnknownColor {
        /// Robot or ball that wears it.
        user: String,
        /// Its name.
        color: String,
    },
    /// More colours than a class number can tell apart.
    #[error("{0} colors are configured, at most 32 are possible")]
    TooManyColors(usize),
    /// The layout must have exactly one team patch.
    #[error("robots.patches has {0} team patches, it must have exactly one")]
    TeamPatches(usize),
    /// Without an identification patch there is neither identity nor heading.
    #[error("robots.patches has {0} identification patches, it must have 1 to {max}", max = MAX_PATCHES - 1)]
    IdentificationPatches(usize),
    /// A patch is hidden, or its corners are absurd.
    #[error("robots.patches[{0}]: nothing of the patch shows within the robot")]
    InvisiblePatch(usize),
    /// Two patches whose centroids coincide give no heading.
    #[error("robots.patches[{0}] and [{1}] show the same centroid, which leaves the heading open")]
    ConcentricPatches(usize, usize),
    /// The colours of an identity must be as many as the identification patches.
    #[error("{team} {id} has {got} identification colors, the layout has {expected} patches for them", team = team.name())]
    ColorCount {
        /// The robot's team.
        team: Team,
        /// The robot's number.
        id: u32,
        /// Colours given.
        got: usize,
        /// Identification patches in the layout.
        expected: usize,
    },
    /// Two robots with one name.
    #[error("{team} {id} is listed twice in robots.identities", team = team.name())]
    DuplicateIdentity {
        /// The robot's team.
        team: Team,
        /// The robot's number.
        id: u32,
    },
    /// A number that makes no sense.
    #[error("{key} = {value} is not usable: it must be {must}")]
    Value {
        /// Its key in the configuration.
        key: &'static str,
        /// The configured value.
        value: f64,
        /// The condition that it violates.
        must: &'static str,
    },
}
