//! Blur by lens and sensor: every point is spread over a round spot.
//!
//! The spot models the lens, the optical low-pass filter in front of a Bayer mosaic, and the area of a pixel,
//! as a Gaussian. It is realistic, and isotropic: a robot's top can be blurred once, in its own frame, and
//! then be rotated.

use super::light::Light;
use geometry::CameraModel;
use geometry::rolling_shutter::RollingShutter;
use messages::BayerOrder;

/// Standard deviation of the spot of a focused lens.
const SPOT_PX: f64 = 0.6;
/// Radius of the spot in standard deviations; beyond it lies less than a grey level.
pub const SPOT_REACH: f32 = 3.0;

/// The camera model for rendering.
#[derive(Debug, Clone)]
pub struct Optics {
    /// Projection from field to image and back.
    pub model: CameraModel,
    /// Position of the lens in field coordinates.
    pub lens_mm: [f64; 3],
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The colour filter.
    pub order: BayerOrder,
    /// Exposure time.
    pub exposure_s: f64,
    /// Rows are captured one after the other.
    pub shutter: RollingShutter,
    /// Light on the pitch.
    pub light: Light,
    /// Standard deviation of the spot, in pixels.
    pub spot_px: f64,
    /// The spot at edges.
    pub edge: SoftEdge,
}

/// Standard deviation of the spot for a given defocus, in pixels.
pub fn spot_px(defocus_px: f64) -> f64 {
    SPOT_PX.hypot(defocus_px.clamp(0.0, 20.0))
}

/// Part of a spot on the near side of a straight edge.
#[derive(Debug, Clone)]
pub struct SoftEdge(Vec<f32>);

const EDGE_STEPS_PER_SIGMA: f32 = 64.0;

impl SoftEdge {
    /// Computes the table.
    pub fn new() -> Self {
        let steps = (2.0 * SPOT_REACH * EDGE_STEPS_PER_SIGMA) as usize;
        let depth = |step: usize| f64::from(step as f32 / EDGE_STEPS_PER_SIGMA - SPOT_REACH);
        Self((0..=steps).map(|step| normal_cdf(depth(step)) as f32).collect())
    }

    /// The part, for a spot whose middle lies `depth` standard deviations inside the edge.
    pub fn part(&self, depth: f32) -> f32 {
        let step = (depth + SPOT_REACH) * EDGE_STEPS_PER_SIGMA + 0.5;
        // Conversion maps negative numbers and NaN to 0.
        let entry = if step < 1.0 { return 0.0 } else { self.0.get(step as usize) };
        entry.copied().unwrap_or(1.0)
    }
}

/// Samples per pixel.
pub const SAMPLES: usize = 16;
/// Number of different sets of samples.
pub const SAMPLE_SETS: usize = 4;

/// Offsets at which a scene is sampled to blur it by a spot, in standard deviations. Each set is evenly
/// distributed; neighbouring pixels use different sets, so that their errors cancel.
pub fn spot_samples() -> [[[f64; 2]; SAMPLES]; SAMPLE_SETS] {
    let count = (SAMPLES * SAMPLE_SETS) as u32;
    // The middle of each of as many intervals as there are samples.
    let middle = |bits: u32| f64::from(bits) / 2f64.powi(32) + 0.5 / f64::from(count);
    std::array::from_fn(|set| {
        std::array::from_fn(|sample| {
            sobol((set * SAMPLES + sample) as u32).map(|bits| inverse_normal_cdf(middle(bits)))
        })
    })
}

/// Set of a pixel; alternates between pixels of the same colour of the Bayer mosaic.
pub fn sample_set(column: usize, row: usize) -> usize {
    ((column >> 1) + 2 * (row >> 1) + (row >> 2)) & (SAMPLE_SETS - 1)
}

/// Point `index` (below 64) of Sobol's sequence in two dimensions, as fractions of 2³².
fn sobol(index: u32) -> [u32; 2] {
    let mut point = [0u32; 2];
    let mut direction = 1u32;
    for bit in 0..6 {
        if index >> bit & 1 == 1 {
            point[0] ^= 1 << (31 - bit);
            point[1] ^= direction << (31 - bit);
        }
        direction = direction << 1 ^ direction;
    }
    point
}

/// Probability that a standard normal number is below `x`, by its power series; error below 1e-12 for |x| ≤
/// 5.
fn normal_cdf(x: f64) -> f64 {
    let (mut term, mut sum) = (x, x);
    for k in 1..100 {
        term *= x * x / f64::from(2 * k + 1);
        sum += term;
    }
    0.5 + sum * (-x * x / 2.0).exp() / std::f64::consts::TAU.sqrt()
}

fn inverse_normal_cdf(probability: f64) -> f64 {
    let (mut low, mut high) = (-5.0, 5.0);
    for _ in 0..60 {
        let middle = (low + high) / 2.0;
        if normal_cdf(middle) < probability { low = middle } else { high = middle }
    }
    (low + high) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_normal_distribution_has_known_values() {
        for (x, expected) in [(0.0, 0.5), (1.0, 0.841_344_746), (-1.96, 0.024_997_895)] {
            assert!((normal_cdf(x) - expected).abs() < 1e-8);
            assert!((inverse_normal_cdf(expected) - x).abs() < 1e-6);
        }
    }

    #[test]
    fn edges_are_soft() {
        let edge = SoftEdge::new();
        assert_eq!(edge.part(-9.0), 0.0);
        assert!(edge.part(f32::NAN) <= 1.0);
        assert_eq!(edge.part(9.0), 1.0);
        assert!((edge.part(0.0) - 0.5).abs() < 1e-6);
        assert!((edge.part(1.0) + edge.part(-1.0) - 1.0).abs() < 1e-4);
    }

    #[test]
    fn samples_are_distributed_like_the_spot() {
        for set in spot_samples() {
            for axis in 0..2 {
                let mean: f64 = set.iter().map(|sample| sample[axis]).sum::<f64>() / SAMPLES as f64;
                let square: f64 = set.iter().map(|sample| sample[axis] * sample[axis]).sum::<f64>()
                    / SAMPLES as f64;
                assert!(mean.abs() < 0.15, "{mean}");
                assert!((square - 1.0).abs() < 0.25, "{square}");
            }
        }
        let all = spot_samples();
        for axis in 0..2 {
            let mean: f64 = all.iter().flatten().map(|sample| sample[axis]).sum();
            assert!(mean.abs() < 1e-6, "{mean}");
        }
    }

    #[test]
    fn every_bayer_site_meets_every_set() {
        for site in 0..4 {
            let mut seen = [false; SAMPLE_SETS];
            for row in (site / 2..8).step_by(2) {
                for column in (site % 2..8).step_by(2) {
                    seen[sample_set(column, row)] = true;
                }
            }
            assert_eq!(seen, [true; SAMPLE_SETS]);
        }
    }
}
