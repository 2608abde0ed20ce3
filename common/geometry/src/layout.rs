//! The visible parts of the patches on a robot's top.
//!
//! Patches may overlap: a team square with an identification patch in its corner is a whole square with
//! a small one on top. Recognition depends on the visible part, so the visible area and centroid of
//! each patch are measured once on a fine grid, and no other part of the program needs to know the
//! patches' shapes.

use crate::settings::{Pair, PatchConfig, PatchRole};
use std::f64::consts::FRAC_PI_2;

/// The visible part of a patch.
#[derive(Debug, Clone, PartialEq)]
pub struct VisiblePatch {
    /// Role of the patch.
    pub role: PatchRole,
    /// Visible area.
    pub area_mm2: f64,
    /// Centroid of the visible part in the robot's frame.
    pub centroid_mm: Pair,
}

/// A robot's top, patch by patch in the configured order.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// The patches, bottom first.
    pub patches: Vec<VisiblePatch>,
}

/// Sampling step: fine enough that a 3 mm patch is measured to 1 %.
const STEP_MM: f64 = 0.25;

impl Layout {
    /// Measures the configured patches.
    pub fn new(patches: &(impl AsRef<[PatchConfig]> + ?Sized)) -> Self {
        let configured = patches.as_ref();
        struct Sum {
            samples: u64,
            x: f64,
            y: f64,
        }
        let mut sums: Vec<Sum> =
            configured.iter().map(|_| Sum { samples: 0, x: 0.0, y: 0.0 }).collect();
        let reach = reach_mm(configured);
        let steps = (2.0 * reach / STEP_MM).ceil() as i64;
        let outlines = Outlines::new(configured);
        for row in 0..steps {
            for column in 0..steps {
                let x = -reach + (column as f64 + 0.5) * STEP_MM;
                let y = -reach + (row as f64 + 0.5) * STEP_MM;
                if let Some(top) = outlines.topmost([x, y]) {
                    sums[top].samples += 1;
                    sums[top].x += x;
                    sums[top].y += y;
                }
            }
        }
        let patches = configured
            .iter()
            .zip(&sums)
            .map(|(patch, sum)| {
                let count = sum.samples.max(1) as f64;
                VisiblePatch {
                    role: patch.role,
                    area_mm2: sum.samples as f64 * STEP_MM * STEP_MM,
                    centroid_mm: [sum.x / count, sum.y / count],
                }
            })
            .collect();
        Self { patches }
    }

    /// The team patch.
    pub fn team_patch(&self) -> Option<&VisiblePatch> {
        self.patches.iter().find(|patch| patch.role == PatchRole::Team)
    }

    /// The identification patches, in the order of a robot's colours.
    pub fn identification_patches(&self) -> impl Iterator<Item = &VisiblePatch> {
        self.patches.iter().filter(|patch| patch.role == PatchRole::Identification)
    }
}

/// The outlines of a layout's patches, each with its bounding box, for testing many points.
#[derive(Debug, Clone)]
pub struct Outlines<'a>(Vec<(&'a [Pair], [Pair; 2])>);

impl<'a> Outlines<'a> {
    /// The outlines of a layout.
    pub fn new(patches: &'a [PatchConfig]) -> Self {
        let bounded = |outline: &'a [Pair]| {
            let bound = |start: f64, pick: fn(f64, f64) -> f64| {
                [0, 1].map(|axis: usize| {
                    outline.iter().fold(start, |bound, corner| pick(bound, corner[axis]))
                })
            };
            (outline, [bound(f64::INFINITY, f64::min), bound(f64::NEG_INFINITY, f64::max)])
        };
        Self(patches.iter().map(|patch| bounded(&patch.outline_mm)).collect())
    }

    /// Like [`topmost_patch`].
    pub fn topmost(&self, point: Pair) -> Option<usize> {
        self.0.iter().rposition(|(outline, [low, high])| {
            (0..2).all(|axis| (low[axis]..=high[axis]).contains(&point[axis]))
                && contains(outline, point)
        })
    }
}

/// Index of the patch that shows at a point of the robot's top, if any.
pub fn topmost_patch(patches: &(impl AsRef<[PatchConfig]> + ?Sized), point: Pair) -> Option<usize> {
    patches.as_ref().iter().rposition(|patch| contains(&patch.outline_mm, point))
}

/// Largest distance of the patches from the centre, along x or y.
pub fn reach_mm(patches: &[PatchConfig]) -> f64 {
    let values = patches.iter().flat_map(|patch| patch.outline_mm.iter().flatten());
    values.fold(0.0f64, |reach, &value| reach.max(value.abs()))
}

/// Angle between the robot's body, a square of side `size_mm`, and the frame of its layout, in radians
/// from 0 to π/2.
///
/// The heading is the layout's x axis, and a layout may have a corner of the body ahead. This is
/// recognised when its patches do not fit on a body that faces straight ahead; then the body is turned
/// by the angle at which they fit best.
pub fn body_turn(size_mm: f64, patches: &[PatchConfig]) -> f64 {
    /// Patches may be drawn slightly too large.
    const SLACK_MM: f64 = 1.0;
    const STEPS: u32 = 180;
    let reach = |angle: f64| {
        let (sin, cos) = angle.sin_cos();
        let points = patches.iter().flat_map(|patch| &patch.outline_mm);
        points.fold(0.0f64, |reach, &[x, y]| {
            reach.max((cos * x + sin * y).abs()).max((cos * y - sin * x).abs())
        })
    };
    if reach(0.0) <= size_mm / 2.0 + SLACK_MM {
        return 0.0;
    }
    let angle = |step: u32| f64::from(step) / f64::from(STEPS) * FRAC_PI_2;
    (0..STEPS).map(angle).min_by(|&a, &b| reach(a).total_cmp(&reach(b))).unwrap_or(0.0)
}

/// Whether a point lies in a polygon. Even-odd rule: counts the edges to the right of the point.
pub fn contains(outline: &[Pair], [x, y]: Pair) -> bool {
    let mut inside = false;
    for (index, &[x1, y1]) in outline.iter().enumerate() {
        let [x2, y2] = outline[(index + 1) % outline.len()];
        if (y1 > y) != (y2 > y) && x < x1 + (y - y1) / (y2 - y1) * (x2 - x1) {
            inside = !inside;
        }
    }
    inside
}
