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

mod cholesky;
mod samples;
mod tables;

use crate::pattern::Top;
use crate::raw::CHANNELS;
use cholesky::{Factor, Square};
use config::PatchConfig;
use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x8};
use geometry::Pose;
use messages::MAX_PATCHES;
pub(crate) use samples::{Samples, has_hue};
use tables::{Table, WHOLE};

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
/// Least and greatest brightness of a robot's colours, relative to the configured ones.
const BRIGHTNESS: [f64; 2] = [0.2, 2.5];
/// Samples that are worked on together: the lanes of a register.
const LANES: usize = 8;
/// Samples that are summed up before the sum is added to the total, which keeps rounding errors small.
const BLOCK: usize = 32;
/// Weight of a floor sample relative to one of the robot: lines and other robots may lie there.
const FLOOR_WEIGHT: f32 = 0.3;
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
    patch_count: usize,
    reach_mm: f64,
}

/// The colours that a robot wears, by patch and channel.
pub(crate) type Colors = [[f64; CHANNELS]; MAX_PATCHES];

/// Weighted sums over all samples: the normal equations.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    /// Shares times shares.
    products: [[f32; PARTS]; PARTS],
    /// Shares times levels.
    levels: [[f32; PARTS]; CHANNELS],
    /// Shares times the squares of the levels, all channels together.
    squares: Parts,
}

/// The unmixed levels at a pose, to which any robot's colours can be compared.
#[derive(Debug, Clone)]
pub(crate) struct Unmixed {
    patch_count: usize,
    /// L⁰: levels of the patches for colours 0.
    levels: Colors,
    /// R: inverse of the normal matrix, the rows and columns of the patches.
    inverse: [[f64; MAX_PATCHES]; MAX_PATCHES],
    /// Cost for colours 0.
    left: f64,
    /// Sum of the squared differences of the levels from their mean.
    variation: f64,
    /// Turns weighted costs into those of samples of weight 1.
    scale: f64,
}

/// Comparison of a robot's colours with unmixed levels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Match {
    pub cost: f64,
    /// Fraction of the variation around the robot that is explained (R²).
    pub explained: f64,
    /// g: brightness relative to the configured colours.
    pub brightness: f64,
}

impl Mixture {
    /// The tables for robots of this size with these patches on their top.
    pub fn new(patches: &[PatchConfig], top: &Top, size_mm: f64) -> Self {
        Self {
            level: Level::new(),
            tables: tables::all(patches, top, size_mm),
            patch_count: top.patches.len().min(MAX_PATCHES),
            reach_mm: tables::robot_reach_mm(patches, top),
        }
    }

    /// Number of Gaussian blurs.
    pub const SIGMA_COUNT: usize = tables::SIGMAS.len();

    /// Unmixes the samples for a robot at `pose`; `None` if the normal matrix is singular, as without
    /// samples.
    pub fn unmix(&self, samples: &mut Samples, pose: &Pose, blur: &Blur) -> Option<Unmixed> {
        let sums = dispatch!(self.level, simd => self.sum_up(simd, samples, pose, blur));
        self.solve(samples, &sums)
    }

    #[inline(always)]
    fn sum_up<S: Simd>(&self, simd: S, samples: &mut Samples, pose: &Pose, blur: &Blur) -> Sums {
        let table = &self.tables[blur.sigma.min(self.tables.len() - 1)];
        let (sin, cos) = pose.orientation.sin_cos();
        let (sin, cos) = (sin as f32, cos as f32);
        let turned = |x: f32, y: f32| [cos * x + sin * y, cos * y - sin * x];
        let turned_center = turned(
            (pose.position.x_mm - samples.origin.x_mm) as f32,
            (pose.position.y_mm - samples.origin.y_mm) as f32,
        );
        let way = turned(blur.way_mm[0] as f32, blur.way_mm[1] as f32);
        let places = if blur.way_mm == [0.0; 2] { 0 } else { PLACES };
        let per_place = 1.0 / (2 * places + 1) as f32;
        let Samples { x_mm, y_mm, levels, cells, count, .. } = samples;
        let whole = count.next_multiple_of(LANES);
        let grid = table.grid;
        for (place, cells) in (-places..=places).zip(cells.iter_mut()) {
            // Evenly spread over the way, half a step from its ends.
            let part = 2.0 * place as f32 * per_place;
            let offset = [part * way[0] - turned_center[0], part * way[1] - turned_center[1]];
            let points = x_mm[..whole].iter().zip(&y_mm[..whole]);
            for (cell, (&x, &y)) in cells[..whole].iter_mut().zip(points) {
                let [x, y] = turned(x, y);
                *cell = grid.cell_at(x + offset[0], y + offset[1]);
            }
        }
        let cells = &cells[..2 * places as usize + 1];
        let scale = per_place * (1.0 / WHOLE);
        let mut sums = Sums::default();
        for begin in (0..*count).step_by(BLOCK) {
            let mut block = BlockSums::new(simd);
            for index in begin..(*count).min(begin + BLOCK) {
                let mut sum = [0u16; PARTS];
                for cells in cells {
                    let cell = &table.cells[cells[index] as usize];
                    for part in 0..PARTS {
                        sum[part] += cell[part];
                    }
                }
                let mut share = Parts::default();
                for part in 0..PARTS {
                    share[part] = scale * f32::from(sum[part]);
                }
                // Floor samples weigh less, see FLOOR_WEIGHT.
                let weight = 1.0 - (1.0 - FLOOR_WEIGHT) * share[FLOOR];
                block.add(simd, &share, weight, levels.each_ref().map(|levels| levels[index]));
            }
            block.add_to(&mut sums);
        }
        sums
    }

    fn solve(&self, samples: &Samples, sums: &Sums) -> Option<Unmixed> {
        // Rows of the matrix: the patches of this top, body, floor.
        let patches = self.patch_count;
        let part_of = |row: usize| if row < patches { row } else { BODY + row - patches };
        let rows = patches + 2;
        let mut matrix = Square::default();
        for (row, column) in (0..rows).flat_map(|row| (0..rows).map(move |column| (row, column))) {
            matrix[row][column] = f64::from(sums.products[part_of(row)][part_of(column)]);
        }
        // The shares of a sample add up to 1, so the sum of all products is the sum of the weights.
        let weight: f64 = matrix.iter().flatten().sum();
        for (row, terms) in matrix.iter_mut().enumerate().take(rows) {
            // Body and floor have no prior, only what keeps the matrix regular.
            terms[row] += if row < patches { LAMBDA } else { 1e-3 };
        }
        let factor = Factor::new(&matrix, rows)?;
        let squares: f64 = sums.squares.iter().map(|&sum| f64::from(sum)).sum();
        let means = sums.levels.map(|sums| f64::from(sums.iter().sum::<f32>()));
        let variation = squares - means.iter().map(|sum| sum * sum / weight).sum::<f64>();
        let mut unmixed = Unmixed {
            patch_count: patches,
            levels: Colors::default(),
            inverse: [[0.0; MAX_PATCHES]; MAX_PATCHES],
            left: squares,
            variation,
            scale: samples.count as f64 / weight,
        };
        for (channel, sums) in sums.levels.iter().enumerate() {
            let mut right = [0.0; PARTS];
            for (row, right) in right.iter_mut().enumerate().take(rows) {
                *right = f64::from(sums[part_of(row)]);
            }
            let levels = factor.solve(right);
            unmixed.left -= levels.iter().zip(right).map(|(level, sum)| level * sum).sum::<f64>();
            for (patch, level) in levels.iter().enumerate().take(patches) {
                unmixed.levels[patch][channel] = *level;
            }
        }
        for patch in 0..patches {
            let mut unit = [0.0; PARTS];
            unit[patch] = 1.0;
            let column = factor.solve(unit);
            unmixed.inverse[patch][..patches].copy_from_slice(&column[..patches]);
        }
        Some(unmixed)
    }
}

/// Sums over a block of samples, in registers.
struct BlockSums<S: Simd> {
    products: [f32x8<S>; PARTS],
    levels: [f32x8<S>; CHANNELS],
    squares: f32x8<S>,
}

impl<S: Simd> BlockSums<S> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        let zero = f32x8::splat(simd, 0.0);
        Self { products: [zero; PARTS], levels: [zero; CHANNELS], squares: zero }
    }

    /// Adds a sample.
    #[inline(always)]
    fn add(&mut self, simd: S, share: &Parts, weight: f32, levels: [f32; CHANNELS]) {
        let shares = f32x8::simd_from(simd, *share);
        let weighted = shares * f32x8::splat(simd, weight);
        for (row, &share) in self.products.iter_mut().zip(share) {
            *row += weighted * f32x8::splat(simd, share);
        }
        let mut square = 0.0;
        for (sum, level) in self.levels.iter_mut().zip(levels) {
            *sum += weighted * f32x8::splat(simd, level);
            square += level * level;
        }
        self.squares += weighted * f32x8::splat(simd, square);
    }

    #[inline(always)]
    fn add_to(self, sums: &mut Sums) {
        let rows = sums.products.iter_mut().chain(&mut sums.levels).chain([&mut sums.squares]);
        let own = self.products.into_iter().chain(self.levels).chain([self.squares]);
        for (row, own) in rows.zip(own) {
            for (sum, &own) in row.iter_mut().zip(own.iter()) {
                *sum += own;
            }
        }
    }
}

impl Unmixed {
    /// Cost and brightness of the best explanation of the picture by these colours.
    pub fn compare(&self, colors: &Colors) -> Match {
        let (mut along, mut squares, mut explained) = (0.0, 0.0, 0.0);
        for channel in 0..CHANNELS {
            for (patch, color) in colors.iter().enumerate().take(self.patch_count) {
                let color = color[channel];
                along += color * self.levels[patch][channel];
                squares += color * color;
                for (other, reference) in colors.iter().enumerate().take(self.patch_count) {
                    explained += color * self.inverse[patch][other] * reference[channel];
                }
            }
        }
        // The cost is quadratic in the brightness.
        let curvature = squares - LAMBDA * explained;
        let [least, most] = BRIGHTNESS;
        let brightness =
            if curvature > 0.0 { (along / curvature).clamp(least, most) } else { least };
        let cost =
            self.left + LAMBDA * (brightness * brightness * curvature - 2.0 * brightness * along);
        let explained = 1.0 - cost / self.variation.max(1.0);
        Match { cost: self.scale * cost, explained, brightness }
    }

    /// Distance of the levels from these colours at the best brightness, in grey levels at brightness 1.
    pub fn distance(&self, colors: &Colors) -> f64 {
        let brightness = self.compare(colors).brightness;
        let mut squares = 0.0;
        for (patch, color) in colors.iter().enumerate().take(self.patch_count) {
            // Undoes the shrinkage of the levels towards 0 that λ causes.
            let held = (1.0 - LAMBDA * self.inverse[patch][patch]).max(0.05);
            for (level, color) in self.levels[patch].iter().zip(color) {
                squares += (level / (held * brightness) - color).powi(2);
            }
        }
        squares.sqrt()
    }

    /// The levels of a patch under the prior of these colours.
    pub fn level(&self, colors: &Colors, brightness: f64, patch: usize) -> [f64; CHANNELS] {
        std::array::from_fn(|channel| {
            let pull = colors.iter().enumerate().take(self.patch_count);
            let pull = pull.map(|(other, color)| self.inverse[patch][other] * color[channel]);
            self.levels[patch][channel] + LAMBDA * brightness * pull.sum::<f64>()
        })
    }
}
