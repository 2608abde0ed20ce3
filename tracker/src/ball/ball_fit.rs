//! Ball fit: the ball's place to hundredths of a pixel, by a circle of known size through the visible part of
//! its rim in the raw picture.
//!
//! # Model
//!
//! A ball differs from a patch: it is shaded by light from one side, lines, shadow, walls and robots lie
//! beside different parts of its rim, and robots hide some of it. With ρ the distance from the middle of the
//! [outline](crate::ball::sphere) in units of its half axes and φ the direction, a sample of channel c measures
//!
//! I = a + w·b₀ + X·(b₁ cos φ + b₂ sin φ) + Z·b₃,
//!
//! where w, X and Z are 1, ρ and √(1 − ρ²) within the outline, convolved with the point spread function: a
//! constant and the three components of the surface's normal, which describe a dull ball under any number of
//! lamps (Lambert's law). The shading b is one vector for the ball in each channel. The background a is a
//! constant in each of sixteen sectors of the rim and each channel; a prior whose variance is that of the
//! background over the whole rim supports sectors with few samples.
//!
//! # Fit
//!
//! ```text
//! repeat, first with a wider point spread function, until the step is below SETTLED_PX:
//!     sums over the samples of a band at the rim, for each sector and channel   (rim_samples)
//!     WEIGHINGS times:
//!         b = shading by least squares over the weighted sectors                (shading)
//!         for each sector: offset of the rim and its variance, a eliminated
//!         circle through the offsets: x, y, and a radius with a tight prior
//!         weight of each sector = Cauchy's weight of its residual × how well the ball explains it
//! ```
//!
//! Sectors in which something hides the ball explain their samples badly and lose weight. The covariance is
//! the inverse of the circle's normal matrix: where half of the rim is hidden, it is long across the gap.

mod rim_samples;
mod shading;
mod wide;

use super::sphere::Sphere;
use crate::edges::edge_pixels::PSF_SIGMA_PX;
use crate::edges::local_map::{LocalMap, mm_per_px};
use crate::linear::{inverse, times};
use crate::raw::{CHANNELS, RawFrame};
use fearless_simd::{Level, dispatch};
use geometry::{CameraModel, FieldPoint, Pose};
use rim_samples::{RimSamples, TERMS};
use shading::{Block, SHADES, solve};
use wide::{LANES, Number, Wide};

/// Sectors of the rim.
const SECTORS: usize = 16;
/// Groups of sectors that are calculated with together.
const GROUPS: usize = SECTORS / LANES;
const _: () = assert!(SECTORS.is_multiple_of(LANES));
/// Passes over the pixels. Soft passes assume a wide point spread function, because a rim that is two pixels
/// off shows only in a slope of that reach, and one background all around. Free passes use the camera's own
/// function, and each sector has a background of its own.
const SOFT: Pass = Pass { psf_px: 1.3, band_px: 4.0, model_noise: 0.12, is_free: false };
const SHARP: Pass = Pass { psf_px: PSF_SIGMA_PX, band_px: 2.6, model_noise: 0.08, is_free: false };
const FREE: Pass = Pass { model_noise: 0.04, is_free: true, ..SHARP };
const APPROACH: [Pass; 4] = [SOFT, SOFT, SHARP, SHARP];
/// Sigma of the start below which the fit needs no soft passes.
const SURE_PX: f64 = 0.7;
/// Noise of a sample, 1σ in grey levels.
const SAMPLE_NOISE: f64 = 2.0;
/// Prior of b₁, b₂ and b₃ around 0, and least prior of a around the mean background, 1σ in grey levels.
const SHADE_SPREAD: f64 = 80.0;
const BACKGROUND_SPREAD: f64 = 4.0;
/// Deviation of the ball's level in a sector from its shading, 1σ as a fraction of the contrast: the ball's
/// own shadow has an edge, lamps are mirrored, balls are dirty.
const SHADE_NOISE: f64 = 0.08;
/// Prior of the point spread function's size, 1σ as a fraction of it (lenses are out of focus, balls move),
/// and the range that is admitted.
const PSF_NOISE: f64 = 0.3;
const PSF_RANGE_PX: [f32; 2] = [0.42, 1.4];
/// Contrast, as a fraction of the greatest, below which a sector loses weight: the edge there may be the
/// border of the ball's own shade, which lies within the rim.
const DIM: f64 = 0.5;
/// Position error of the rim in a sector, and of the radius, 1σ: point spread functions and balls differ.
const SECTOR_NOISE_PX: f64 = 0.05;
const RADIUS_NOISE_PX: f64 = 0.25;
/// Scale of Cauchy's weights, px. It is the median residual of the usable sectors, within these bounds.
const OUTLIER_PX: f64 = 0.12;
const MOST_OUTLIER_PX: f64 = 0.6;
/// Weight of a sector in which the ball's colour does not show.
const HIDDEN: f64 = 1e-3;
/// Least samples of a sector.
const MIN_SAMPLES: f64 = 5.0;
/// Most free passes over the pixels, and reweightings of the sectors in each pass.
const MAX_ROUNDS: usize = 4;
const WEIGHINGS: usize = 4;
/// Convergence: a step below this ends the fit.
const SETTLED_PX: f64 = 0.1;
/// Largest sigma of the result, in its worst direction.
const MOST_UNSURE_PX: f64 = 0.5;

/// Settings of a pass over the pixels.
#[derive(Debug, Clone, Copy)]
struct Pass {
    /// Standard deviation of the point spread function.
    psf_px: f32,
    /// Half the width of the band at the rim.
    band_px: f32,
    /// Noise of a sample, 1σ as a fraction of the contrast at the rim.
    model_noise: f64,
    /// Whether sectors have backgrounds and levels of their own.
    is_free: bool,
}

/// Start of the fit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Start {
    pub position: FieldPoint,
    /// Sigma of the position.
    pub deviation_mm: f64,
    /// Farthest that the result may lie from `position`.
    pub reach_mm: f64,
}

/// A position with its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Fitted {
    pub position: FieldPoint,
    /// xx, xy, yy in mm².
    pub covariance: [f64; 3],
    /// Samples of the sectors that are not outliers.
    pub samples: u32,
}

/// Fits circles to rims.
#[derive(Debug, Clone)]
pub(crate) struct BallFitter {
    sphere: Sphere,
    samples: RimSamples,
    rim: [Sector; SECTORS],
    level: Level,
    /// Normal equations of the current pass, by group of sectors and channel. They do not depend on the weights.
    blocks: Box<[[Block<Wide>; CHANNELS]; GROUPS]>,
    /// Reused allocation for [`BallFitter::background`].
    residuals: Vec<f32>,
}

/// Measurement of the rim in one sector.
#[derive(Debug, Clone, Copy, Default)]
struct Sector {
    /// Distance of the rim outside the outline, in units of its half axes.
    out: f64,
    /// One over the variance of `out`.
    information: f64,
    samples: f64,
    /// Between the ball and its background, in grey levels.
    contrast: f64,
    /// Expected over actual variance of the residuals, at most 1: low where the ball does not explain them.
    trust: f64,
    /// Outline units in a pixel.
    per_px: f64,
}

/// A step towards the rim, in units of the half axes.
#[derive(Debug, Clone, Copy)]
struct Step {
    by: [f64; 2],
    /// Relative excess of the point spread function's size over the assumed one.
    softer: f64,
    /// xx, xy, yy.
    covariance: [f64; 3],
    samples: f64,
}

impl BallFitter {
    pub fn new(sphere: Sphere) -> Self {
        Self {
            sphere,
            samples: RimSamples::new(),
            rim: [Sector::default(); SECTORS],
            level: Level::new(),
            blocks: Box::new([[Block::default(); CHANNELS]; GROUPS]),
            residuals: Vec::with_capacity(256),
        }
    }

    /// The position near `start` that explains the rim in the picture best; `None` if too little of the rim
    /// is visible or the result is out of reach. `shows` says whether a pixel has the ball's colour; without
    /// it all sectors begin with full weight.
    pub fn fit(
        &mut self,
        camera: &CameraModel,
        frame: &RawFrame,
        start: &Start,
        shows: Option<impl Fn(usize, usize) -> bool>,
    ) -> Option<Fitted> {
        let mut position = start.position;
        let mut psf_px = FREE.psf_px;
        let scale = mm_per_px(camera, position, self.sphere.radius_mm);
        let approach: &[Pass] = if start.deviation_mm > SURE_PX * scale { &APPROACH } else { &[] };
        let last = approach.len() + MAX_ROUNDS - 1;
        for round in 0..=last {
            let mut pass = *approach.get(round).unwrap_or(&FREE);
            if pass.is_free {
                pass.psf_px = psf_px;
            }
            let pass = &pass;
            let outline = self.sphere.outline(position);
            let (sin, cos) = outline.direction.sin_cos();
            let middle = FieldPoint::new(
                position.x_mm + cos * outline.beyond_mm,
                position.y_mm + sin * outline.beyond_mm,
            );
            let pose = Pose { position: middle, orientation: outline.direction };
            let axes = [outline.long_mm, outline.short_mm];
            let nominal = mm_per_px(camera, middle, self.sphere.radius_mm);
            let height_mm = self.sphere.radius_mm;
            let map = LocalMap::new(camera, &pose, height_mm, axes[0], nominal)?;
            let shown = self.samples.sum_up(frame, &map, &outline, pass, shows.as_ref());
            for (sector, &per_px) in self.rim.iter_mut().zip(&self.samples.per_px) {
                sector.per_px = f64::from(per_px);
            }
            let so_far = [start.position.x_mm - position.x_mm, start.position.y_mm - position.y_mm];
            let so_far = [
                (cos * so_far[0] + sin * so_far[1]) / axes[0],
                (cos * so_far[1] - sin * so_far[0]) / axes[1],
            ];
            let prior = axes.map(|axis| (axis / start.deviation_mm).powi(2));
            let Step { by: step, softer, covariance, samples } =
                self.solve(&prior, so_far, &shown, pass)?;
            let [x, y] = [step[0] * axes[0], step[1] * axes[1]];
            position = FieldPoint::new(
                position.x_mm + cos * x - sin * y,
                position.y_mm + sin * x + cos * y,
            );
            if approach.get(round).is_none_or(|pass| pass.psf_px <= PSF_SIGMA_PX) {
                let larger = 1.0 + softer.clamp(-0.25, 0.4) as f32;
                psf_px = (pass.psf_px * larger).clamp(PSF_RANGE_PX[0], PSF_RANGE_PX[1]);
            }
            let off_mm = position.distance(start.position);
            if off_mm.is_nan() || off_mm > start.reach_mm {
                return None;
            }
            let is_settled = x.hypot(y) < SETTLED_PX * nominal && pass.is_free;
            if is_settled || round == last {
                let [xx, xy, yy] = covariance;
                let [xx, xy, yy] =
                    [xx * axes[0] * axes[0], xy * axes[0] * axes[1], yy * axes[1] * axes[1]];
                let most = (xx + yy) / 2.0 + ((xx - yy) / 2.0).hypot(xy);
                if most > (MOST_UNSURE_PX * nominal).powi(2) {
                    return None;
                }
                let covariance = [
                    cos * cos * xx - 2.0 * sin * cos * xy + sin * sin * yy,
                    sin * cos * (xx - yy) + (cos * cos - sin * sin) * xy,
                    sin * sin * xx + 2.0 * sin * cos * xy + cos * cos * yy,
                ];
                return Some(Fitted { position, covariance, samples: samples as u32 });
            }
        }
        None
    }

    /// Robust fit of a circle to the rim's offsets in the sectors. `shown` has the initial weights.
    fn solve(
        &mut self,
        prior: &[f64; 2],
        so_far: [f64; 2],
        shown: &[f64; SECTORS],
        pass: &Pass,
    ) -> Option<Step> {
        self.eliminate_backgrounds(pass);
        let mut weights = *shown;
        let mut weighings = 0;
        loop {
            let softer = self.measure_rim(&weights, pass)?;
            let per_px = self.rim.iter().map(|sector| sector.per_px).sum::<f64>() / SECTORS as f64;
            let radius = (RADIUS_NOISE_PX * per_px).powi(-2);
            let (mut step, mut off_px) = ([0.0; 3], [0.0; SECTORS]);
            let mut covariance = [0.0; 6];
            let mut robust = [1.0; SECTORS];
            let (mut worth, mut samples, mut squares) = (0.0, 0.0, 0.0);
            for _ in 0..3 {
                let mut information = [prior[0], 0.0, 0.0, prior[1], 0.0, radius];
                let mut pull = [prior[0] * so_far[0], prior[1] * so_far[1], 0.0];
                (worth, samples, squares) = (0.0, 0.0, 0.0);
                for (index, sector) in self.rim.iter().enumerate() {
                    let [cos, sin] = self.samples.directions[index];
                    let noise = (SECTOR_NOISE_PX * sector.per_px).powi(2);
                    let weight = shown[index] * robust[index] * sector.information
                        / (1.0 + noise * sector.information);
                    let terms = [cos * cos, cos * sin, cos, sin * sin, sin, 1.0];
                    information.iter_mut().zip(terms).for_each(|(sum, it)| *sum += weight * it);
                    let terms = [cos, sin, 1.0];
                    pull.iter_mut()
                        .zip(terms)
                        .for_each(|(sum, it)| *sum += weight * it * sector.out);
                    worth += weight * noise;
                    squares += weight * (off_px[index] * sector.per_px).powi(2);
                    if robust[index] > 0.5 && weight * noise > 0.2 {
                        samples += sector.samples;
                    }
                }
                covariance = inverse(&information)?;
                step = times(&covariance, &pull);
                for ((off_px, sector), [cos, sin]) in
                    off_px.iter_mut().zip(&self.rim).zip(self.samples.directions)
                {
                    let expected = cos * step[0] + sin * step[1] + step[2];
                    *off_px = (sector.out - expected) / sector.per_px;
                }
                let outlier = self.typical_px(&off_px).clamp(OUTLIER_PX, MOST_OUTLIER_PX);
                for (robust, off_px) in robust.iter_mut().zip(off_px) {
                    *robust = 1.0 / (1.0 + (off_px / outlier).powi(2));
                }
            }
            weighings += 1;
            if weighings == WEIGHINGS {
                let disagreement = (squares / worth.max(1.0)).max(1.0);
                let [xx, xy, _, yy, _, _] = covariance.map(|term| term * disagreement);
                return Some(Step {
                    by: [step[0], step[1]],
                    softer,
                    covariance: [xx, xy, yy],
                    samples,
                });
            }
            for (index, weight) in weights.iter_mut().enumerate() {
                *weight = (shown[index] * robust[index] * self.rim[index].trust).max(HIDDEN);
            }
        }
    }

    /// Median residual of the usable sectors.
    fn typical_px(&self, off_px: &[f64; SECTORS]) -> f64 {
        let mut seen = [0.0; SECTORS];
        let mut count = 0;
        for (sector, off_px) in self.rim.iter().zip(off_px) {
            if sector.information * (SECTOR_NOISE_PX * sector.per_px).powi(2) > 0.2 {
                seen[count] = off_px.abs();
                count += 1;
            }
        }
        match &mut seen[..count] {
            [] => 0.0,
            seen => *seen.select_nth_unstable_by(count / 2, f64::total_cmp).1,
        }
    }

    /// Fills `blocks` from the sums of a pass.
    fn eliminate_backgrounds(&mut self, pass: &Pass) {
        for channel in 0..CHANNELS {
            let (level, variance) = self.background(channel, pass);
            let prior_samples = SAMPLE_NOISE.powi(2) / variance;
            let Self { blocks, samples, .. } = self;
            dispatch!(self.level, _simd => {
                for (group, blocks) in blocks.iter_mut().enumerate() {
                    let sums: [_; LANES] = std::array::from_fn(|lane| {
                        samples.sums(group * LANES + lane, channel)
                    });
                    let mut wide = [[Wide::default(); TERMS]; TERMS];
                    for (row, wide) in wide.iter_mut().enumerate() {
                        for (column, wide) in wide.iter_mut().enumerate() {
                            *wide = Wide(sums.map(|sums| f64::from(sums[row][column])));
                        }
                    }
                    let sum = |row: usize, column: usize| wide[row][column];
                    blocks[channel] = Block::new(sum, level, prior_samples);
                }
            });
        }
    }

    /// Fits the shading to the weighted sectors, then the rim's offset in each sector. Returns the relative
    /// excess of the point spread function's size.
    fn measure_rim(&mut self, weights: &[f64; SECTORS], pass: &Pass) -> Option<f64> {
        dispatch!(self.level, _simd => self.measure_sectors(weights, pass))
    }

    #[inline(always)]
    fn measure_sectors(&mut self, weights: &[f64; SECTORS], pass: &Pass) -> Option<f64> {
        let by_group = weights.as_chunks::<LANES>().0;
        let mut shades = [[0.0; SHADES]; CHANNELS];
        for (channel, shades) in shades.iter_mut().enumerate() {
            let mut normal = [[Wide::default(); SHADES + 1]; SHADES];
            for (blocks, weights) in self.blocks.iter().zip(by_group) {
                let own = blocks[channel].shading.as_flattened();
                for (normal, &own) in normal.as_flattened_mut().iter_mut().zip(own) {
                    *normal = *normal + Wide(*weights) * own;
                }
            }
            let mut normal = normal.map(|row| row.map(Wide::sum));
            for (row, term) in normal.iter_mut().enumerate() {
                term[row] += if row == 0 { 1e-6 } else { (SAMPLE_NOISE / SHADE_SPREAD).powi(2) };
            }
            *shades = solve(normal)?;
        }
        let mut softer = [0.0, PSF_NOISE.powi(-2)];
        for (group, by_channel) in self.blocks.iter().enumerate() {
            let first = group * LANES;
            let direction = [0, 1].map(|axis| {
                Wide(std::array::from_fn(|lane| self.samples.directions[first + lane][axis]))
            });
            let zero = Wide::default();
            let (mut pull, mut information, mut squares, mut greatest) = (zero, zero, zero, zero);
            let (mut softness, mut hardness) = (zero, zero);
            for (block, shades) in by_channel.iter().zip(&shades) {
                let at_rim = Wide::of(shades[0])
                    + direction[0] * Wide::of(shades[1])
                    + direction[1] * Wide::of(shades[2]);
                let contrast = at_rim - block.level(shades);
                let [ee, er, rr, hh, hr] = block.rim(shades, contrast, pass.is_free);
                softness = softness + contrast * hr;
                hardness = hardness + contrast * contrast * hh;
                pull = pull + contrast * er;
                information = information + contrast * contrast * ee;
                squares = squares + rr;
                let strength = contrast.abs();
                greatest = Wide(std::array::from_fn(|lane| greatest.0[lane].max(strength.0[lane])));
            }
            for lane in 0..LANES {
                let sector = first + lane;
                let (pull, information, squares, greatest) =
                    (pull.0[lane], information.0[lane], squares.0[lane], greatest.0[lane]);
                let rim = &mut self.rim[sector];
                rim.samples = self.samples.counts[sector];
                if rim.samples < MIN_SAMPLES || information < 1e-9 {
                    *rim = Sector { per_px: rim.per_px, samples: rim.samples, ..Sector::default() };
                    continue;
                }
                rim.out = pull / information;
                let least = SAMPLE_NOISE.powi(2) + (pass.model_noise * greatest).powi(2);
                let left = (squares - pull * rim.out) / (rim.samples - 4.0).max(1.0);
                rim.information = information / left.max(least);
                rim.trust = least / left.max(least);
                rim.contrast = greatest;
                let weight = weights[sector] / left.max(least);
                softer[0] += weight * softness.0[lane];
                softer[1] += weight * hardness.0[lane];
            }
        }
        let most = self.rim.iter().zip(weights).filter(|(_, weight)| **weight > 0.1);
        let most = most.map(|(rim, _)| rim.contrast).fold(0.0, f64::max);
        for rim in &mut self.rim {
            rim.information *= (rim.contrast / (DIM * most)).min(1.0).powi(4);
        }
        Some(softer[0] / softer[1])
    }

    /// Mean level of the background over the whole rim, and its variance; in a pass that is not free a median
    /// and its absolute deviation, so that lines and robots do not count.
    fn background(&mut self, channel: usize, pass: &Pass) -> (f64, f64) {
        let outer = &mut self.samples.outer[channel];
        let Some(middle) = outer.len().checked_sub(1).map(|last| last / 2) else {
            return (0.0, SHADE_SPREAD.powi(2));
        };
        let (level, variance) = if pass.is_free {
            let count = outer.len() as f64;
            let mean = outer.iter().map(|&value| f64::from(value)).sum::<f64>() / count;
            let squares = outer.iter().map(|&value| (f64::from(value) - mean).powi(2));
            (mean, squares.sum::<f64>() / count)
        } else {
            let level = *outer.select_nth_unstable_by(middle, f32::total_cmp).1;
            self.residuals.clear();
            self.residuals.extend(outer.iter().map(|value| (value - level).abs()));
            let off = *self.residuals.select_nth_unstable_by(middle, f32::total_cmp).1;
            (f64::from(level), (1.5 * f64::from(off)).powi(2))
        };
        (level, variance + BACKGROUND_SPREAD.powi(2))
    }
}
