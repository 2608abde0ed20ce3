//! Linear unmixing of a blurred robot: each pixel as a mixture of the colours of the patches around it.
//!
//! Out of focus, or moving while the shutter is open, a small patch has no pixel of its own colour left, and
//! no colour class finds it. Its light is still in the picture, mixed with that of its neighbours. The
//! mixture follows from layout, pose and blur:
//!
//! I = Σₖ sₖ·Lₖ,
//!
//! where sₖ is the share of part k (a patch, the body or the floor) in a pixel ([`tables`]), and Lₖ the
//! part's level in each colour channel. For a given pose and blur the levels follow by least squares (linear
//! spectral unmixing: Keshava and Mustard, Spectral unmixing, 2002). A prior of the deviation
//! [`COLOR_DEVIATION`] ties them to the colours Cₖ that a robot wears, times one brightness g:
//!
//! cost = Σ |I − Σₖ sₖ·Lₖ|² + λ·Σₖ |Lₖ − g·Cₖ|².
//!
//! Levels and g enter linearly and are eliminated. With N = Σ s·sᵀ + λ, R = N⁻¹ and L⁰ = R·Σ s·I,
//!
//! cost(C) = left + λ·(g²·(CᵀC − λ·CᵀR·C) − 2·g·CᵀL⁰),   g = CᵀL⁰ / (CᵀC − λ·CᵀR·C),
//!
//! so the costs of all robots of a team at a pose come from the same sums. The difference between the costs
//! of two robots, divided by twice the variance of a sample, is the logarithm of their likelihood ratio.

mod samples;
mod sums;
mod tables;
mod unmixed;

use crate::pattern::Top;
use crate::raw::CHANNELS;
use config::PatchConfig;
use fearless_simd::{Level, dispatch};
use geometry::Pose;
use messages::MAX_PATCHES;
pub(crate) use samples::{Samples, has_hue};
use tables::Table;
pub(crate) use unmixed::{Look, Match, Unmixed};

/// Patches, body and floor.
const PARTS: usize = MAX_PATCHES + 2;
const BODY: usize = MAX_PATCHES;
const FLOOR: usize = MAX_PATCHES + 1;
type Parts = [f32; PARTS];

/// Deviation of a level from the configured colour (paint, light), and of a sample from the model (noise,
/// blur that is not quite a Gaussian), 1σ in grey levels.
const COLOR_DEVIATION: f64 = 12.0;
const SAMPLE_DEVIATION: f64 = 6.0;
const LAMBDA: f64 = (SAMPLE_DEVIATION / COLOR_DEVIATION) * (SAMPLE_DEVIATION / COLOR_DEVIATION);
/// Samples that are worked on together: the lanes of a register.
const LANES: usize = 8;
/// Points along a motion at which shares are taken: so many before and behind the middle.
const PLACES: i32 = 2;
const MOST_PLACES: usize = 2 * PLACES as usize + 1;

/// Blur of a robot: a Gaussian and a motion.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Blur {
    /// Index into [`tables::SIGMAS`].
    pub sigma: usize,
    /// Half of the way that the robot moves during the exposure, on the field.
    pub way_mm: [f64; 2],
}

/// A robot's top under all blurs, by which pixels are unmixed.
#[derive(Debug, Clone)]
pub(crate) struct Mixture {
    level: Level,
    tables: Vec<Table>,
    /// Number of patches, and the parts that this top has: these patches, body and floor.
    patch_count: usize,
    parts: [usize; PARTS],
    reach_mm: f64,
}

/// The colours that a robot wears, by patch and channel.
pub(crate) type Colors = [[f64; CHANNELS]; MAX_PATCHES];

impl Mixture {
    /// The tables for robots of this size with these patches on their top.
    pub fn new(patches: &[PatchConfig], top: &Top, size_mm: f64) -> Self {
        let patch_count = top.patches.len().min(MAX_PATCHES);
        let mut parts = [BODY; PARTS];
        (0..patch_count).for_each(|patch| parts[patch] = patch);
        parts[patch_count + 1] = FLOOR;
        Self {
            level: Level::new(),
            tables: tables::all(patches, top, size_mm),
            patch_count,
            parts,
            reach_mm: tables::robot_reach_mm(patches, top),
        }
    }

    /// Number of Gaussian blurs.
    pub const SIGMA_COUNT: usize = tables::SIGMAS.len();

    /// Farthest distance of a sample from the team patch around which samples are taken.
    pub fn sample_reach_mm(&self, top: &Top) -> f64 {
        let [x_mm, y_mm] = top.patches[top.team_patch].centroid_mm;
        self.reach_mm + x_mm.hypot(y_mm)
    }

    /// Unmixes the samples for a robot at `pose`; `None` if the normal matrix is singular, as without
    /// samples.
    pub fn unmix(&self, samples: &mut Samples, pose: &Pose, blur: &Blur) -> Option<Unmixed> {
        let sums = dispatch!(self.level, simd => self.sum_up(simd, samples, pose, blur));
        self.solve(samples, &sums)
    }
}
