//! The tops of robots: patches, their visible parts, and the tables made of them.

use super::Kind;
use super::footprint::Footprints;
use super::shares::Shares;
use crate::error::TrackerError;
use config::{self, Config, Pair, PatchConfig, PatchRole};
use geometry::body::Body;
use geometry::layout::{Layout, topmost_patch};
use messages::MAX_PATCHES;

/// Size of a core as a fraction of the body.
const CORE_FRACTION: f64 = 0.8;

/// The top of a robot: its patches and its height.
#[derive(Debug, Clone)]
pub(crate) struct Top {
    /// In the configured order.
    pub patches: Vec<ExpectedPatch>,
    /// Between the visible centroids of any two patches.
    distances_mm: [[f64; MAX_PATCHES]; MAX_PATCHES],
    /// Index of the team patch.
    pub team_patch: usize,
    /// Above the floor.
    pub height_mm: f64,
    /// Index into [`heights_mm`](super::Pattern::heights_mm).
    pub height: usize,
    /// The body below it.
    pub body: Body,
    /// The body shrunk to [`CORE_FRACTION`]: cores of two robots do not overlap even where poses are measured
    /// badly.
    pub core: Body,
    /// Points of the top that may belong to each patch.
    pub footprints: Footprints,
    /// Share of each patch at every point of the top.
    pub shares: Shares,
}

/// The visible part of a patch, in the robot's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ExpectedPatch {
    pub area_mm2: f64,
    pub centroid_mm: Pair,
    /// Covariance [xx, xy, yy] of the patch's points.
    pub covariance: [f64; 3],
    /// Standard deviation along the longer principal axis.
    pub major_mm: f64,
    /// Standard deviation along the shorter principal axis; a square of side s has s/√12.
    pub minor_mm: f64,
    /// Distance from the centroid to the farthest point.
    pub reach_mm: f64,
}

/// Collects tops, each once.
#[derive(Default)]
pub(super) struct Tops<'a> {
    pub list: Vec<Top>,
    configured: Vec<config::Top<'a>>,
    pub heights_mm: Vec<f64>,
}

impl<'a> Tops<'a> {
    /// Index of a top, which is added if it is new.
    pub fn index_of(
        &mut self,
        config: &Config,
        top: config::Top<'a>,
    ) -> Result<usize, TrackerError> {
        if let Some(known) = self.configured.iter().position(|known| *known == top) {
            return Ok(known);
        }
        if !(top.height_mm >= 0.0 && top.height_mm < config.geometry.camera_mm[2]) {
            return Err(TrackerError::Value {
                key: "robots.height_mm",
                value: top.height_mm,
                must: "at least 0 and below the camera",
            });
        }
        let height = self.heights_mm.iter().position(|&height_mm| height_mm == top.height_mm);
        let height = height.unwrap_or_else(|| {
            self.heights_mm.push(top.height_mm);
            self.heights_mm.len() - 1
        });
        self.list.push(Top::new(config, top, height)?);
        self.configured.push(top);
        Ok(self.list.len() - 1)
    }

    /// Whether two kinds have the same candidates.
    pub fn are_alike(&self, a: &Kind, b: &Kind) -> bool {
        let (top_a, top_b) = (&self.list[a.top], &self.list[b.top]);
        a.class == b.class
            && top_a.height == top_b.height
            && top_a.patches[a.patch].is_congruent(&top_b.patches[b.patch])
    }
}

impl Top {
    fn new(config: &Config, top: config::Top, height: usize) -> Result<Self, TrackerError> {
        let size_mm = config.robots.size_mm;
        let patches = expected_patches(size_mm, top.patches)?;
        let mut distances_mm = [[0.0; MAX_PATCHES]; MAX_PATCHES];
        for (row, a) in distances_mm.iter_mut().zip(&patches) {
            for (distance, b) in row.iter_mut().zip(&patches) {
                let ([ax, ay], [bx, by]) = (a.centroid_mm, b.centroid_mm);
                *distance = (ax - bx).hypot(ay - by);
            }
        }
        let is_team = |patch: &PatchConfig| patch.role == PatchRole::Team;
        let team_patch =
            top.patches.iter().position(is_team).ok_or(TrackerError::TeamPatches(0))?;
        let body = config.robots.body(top.patches);
        Ok(Self {
            patches,
            distances_mm,
            team_patch,
            height_mm: top.height_mm,
            height,
            body,
            core: body.scaled(CORE_FRACTION),
            footprints: Footprints::new(top.patches),
            shares: Shares::new(top.patches),
        })
    }

    /// Distance between the visible centroids of two patches.
    pub fn distance_mm(&self, a: usize, b: usize) -> f64 {
        self.distances_mm[a][b]
    }

    /// d₁ of eq. (4): team patches of two robots of a team are at least ¾·d₁ apart.
    pub fn team_patch_size_mm(&self) -> f64 {
        self.patches[self.team_patch].size_mm()
    }
}

impl ExpectedPatch {
    /// The patch size d₁ of eqs. (4) and (5): the side of a square. For any other shape it is the smaller of
    /// the sides of the squares with the same area and with the same minor deviation, because elongated
    /// patches can come close to each other side by side.
    pub fn size_mm(&self) -> f64 {
        self.area_mm2.sqrt().min(12f64.sqrt() * self.minor_mm)
    }

    /// Whether two patches have the same size and form, to 2 %.
    fn is_congruent(&self, other: &Self) -> bool {
        const SAME: f64 = 0.02;
        let is_same = |a: f64, b: f64| (a - b).abs() <= SAME * a.max(b);
        is_same(self.area_mm2, other.area_mm2)
            && is_same(self.major_mm, other.major_mm)
            && is_same(self.minor_mm, other.minor_mm)
            && is_same(self.reach_mm, other.reach_mm)
    }

    /// Area over 12·major·minor: 1 for rectangles, 1.05 for discs, 0.87 for triangles, small for rings and
    /// bent strips.
    pub fn compactness(&self) -> f64 {
        self.area_mm2 / (12.0 * self.major_mm * self.minor_mm)
    }
}

/// The visible parts of the patches of a top; an error if they cannot be tracked.
fn expected_patches(
    size_mm: f64,
    configured: &[PatchConfig],
) -> Result<Vec<ExpectedPatch>, TrackerError> {
    let count = configured.len();
    let team_patches = configured.iter().filter(|patch| patch.role == PatchRole::Team).count();
    if team_patches != 1 {
        return Err(TrackerError::TeamPatches(team_patches));
    }
    if !(2..=MAX_PATCHES).contains(&count) {
        return Err(TrackerError::IdentificationPatches(count - 1));
    }
    for (index, patch) in configured.iter().enumerate() {
        // Also keeps the grid of `spreads` within bounds.
        let is_absurd = |value: &f64| value.is_nan() || value.abs() > size_mm;
        if patch.outline_mm.iter().flatten().any(is_absurd) {
            return Err(TrackerError::InvisiblePatch(index));
        }
    }
    let layout = Layout::new(configured);
    let patches: Vec<ExpectedPatch> = layout
        .patches
        .iter()
        .zip(spreads(size_mm, configured, &layout))
        .map(|(visible, spread)| ExpectedPatch {
            area_mm2: visible.area_mm2,
            centroid_mm: visible.centroid_mm,
            ..spread
        })
        .collect();
    for (index, patch) in patches.iter().enumerate() {
        if !(patch.area_mm2 > 0.0 && patch.minor_mm > 0.0) {
            return Err(TrackerError::InvisiblePatch(index));
        }
    }
    for a in 0..count {
        for b in a + 1..count {
            let ([ax, ay], [bx, by]) = (patches[a].centroid_mm, patches[b].centroid_mm);
            if (ax - bx).hypot(ay - by) < 1.0 {
                return Err(TrackerError::ConcentricPatches(a, b));
            }
        }
    }
    Ok(patches)
}

/// Covariance, deviations and reach of the visible part of each patch, measured on a grid; area and centroid
/// stay 0.
fn spreads(size_mm: f64, configured: &[PatchConfig], layout: &Layout) -> Vec<ExpectedPatch> {
    #[derive(Clone, Copy, Default)]
    struct Sum {
        count: f64,
        covariance: [f64; 3],
        reach: f64,
    }
    const STEPS: i32 = 300;
    let step = size_mm / f64::from(STEPS);
    let mut sums = vec![Sum::default(); layout.patches.len()];
    for row in -STEPS..STEPS {
        for column in -STEPS..STEPS {
            let x = (f64::from(column) + 0.5) * step;
            let y = (f64::from(row) + 0.5) * step;
            let Some(patch) = topmost_patch(configured, [x, y]) else { continue };
            let [cx, cy] = layout.patches[patch].centroid_mm;
            let (dx, dy) = (x - cx, y - cy);
            let sum = &mut sums[patch];
            sum.count += 1.0;
            // The variance of the grid cell around the sample.
            let cell = step * step / 12.0;
            let own = [dx * dx + cell, dx * dy, dy * dy + cell];
            sum.covariance.iter_mut().zip(own).for_each(|(sum, own)| *sum += own);
            sum.reach = sum.reach.max(dx.hypot(dy));
        }
    }
    sums.iter()
        .map(|sum| {
            let covariance = sum.covariance.map(|value| value / sum.count.max(1.0));
            let [major_mm, minor_mm] = principal_deviations(covariance);
            ExpectedPatch {
                area_mm2: 0.0,
                centroid_mm: [0.0; 2],
                covariance,
                major_mm,
                minor_mm,
                reach_mm: sum.reach,
            }
        })
        .collect()
}

/// Standard deviations along the longer and the shorter principal axis of a covariance [xx, xy, yy].
pub(crate) fn principal_deviations([xx, xy, yy]: [f64; 3]) -> [f64; 2] {
    let mean = (xx + yy) / 2.0;
    let half_difference = (xx - yy) / 2.0;
    let offset = (half_difference * half_difference + xy * xy).sqrt();
    [(mean + offset).max(0.0).sqrt(), (mean - offset).max(0.0).sqrt()]
}
