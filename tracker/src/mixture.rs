//! What a blurred robot looks like: each pixel as a mixture of the colours of the patches around it.
//!
//! Out of focus, or moving while the shutter is open, a small patch has no pixel of its own colour
//! left, and no colour class finds it. Its light is all there, though, mixed with that of what lies
//! beside it. How it is mixed follows from the layout, the pose and the blur:
//!
//! I = Σₖ sₖ·Lₖ,
//!
//! with sₖ the share of patch k (or of the body, or of the floor) in a pixel, and Lₖ its level, in each
//! colour channel. For any pose and blur the levels are found by least squares: the mixture is undone.
//! They are held, as if measured to within [`COLOR_DEVIATION`], at the colours that a robot wears,
//! brighter or darker by one factor g for all of them:
//!
//! cost = Σ |I − Σₖ sₖ·Lₖ|² + λ·Σₖ |Lₖ − g·Cₖ|².
//!
//! Levels and g enter linearly and are eliminated, so the cost of every robot of a team at a pose comes
//! from the same sums. The difference between the costs of two robots, in units of what a pixel is off
//! by, is the logarithm of a likelihood ratio.

use crate::pattern::Top;
use crate::raw::{CHANNELS, RawFrame};
use common::config::PatchConfig;
use common::geometry::{CameraModel, FieldPoint, ImagePoint, Pose};
use common::layout::{reach_mm, topmost_patch};
use common::messages::MAX_PATCHES;
use fearless_simd::{Level, dispatch};

/// Patches, body and floor.
const PARTS: usize = MAX_PATCHES + 2;
const BODY: usize = MAX_PATCHES;
const FLOOR: usize = MAX_PATCHES + 1;
type Parts = [f32; PARTS];

/// What a level is off by from the colour it is said to have, and what a sample is off by, in grey
/// levels: paint, light, and a model that is not quite right.
const COLOR_DEVIATION: f64 = 12.0;
const SAMPLE_DEVIATION: f64 = 6.0;
const LAMBDA: f64 = (SAMPLE_DEVIATION / COLOR_DEVIATION) * (SAMPLE_DEVIATION / COLOR_DEVIATION);
/// How much darker or brighter than configured all colours of a robot may be.
const BRIGHTNESS: [f64; 2] = [0.2, 2.5];
/// About so many samples are made of the pixels around a robot.
const SAMPLES: f64 = 180.0;
/// Lines are brighter than the ground by so many grey levels, in the darkest channel at least this part of
/// what they are in the brightest.
const LINE_LEVEL: f32 = 25.0;
const GREYNESS: f32 = 0.7;
/// At most. A mosaic takes an even number of pixels each way, so it may be some more.
const MOST_SAMPLES: usize = 512;
/// Samples are worked on in groups of so many: a register full.
const LANES: usize = 8;
const _: () = assert!(MOST_SAMPLES.is_multiple_of(LANES));
/// Weight of a floor sample relative to one of the robot: lines and other robots may lie there.
const FLOOR_WEIGHT: f32 = 0.3;
/// Deviations of the blurs that there are tables for, as multiples of the robot's size.
const SIGMAS: [f64; 5] = [0.035, 0.055, 0.085, 0.125, 0.18];
/// Cells across a robot's size that the tables are made on, and cells of a table in a deviation of its
/// blur: small tables stay in the processor's nearest memories.
const CELLS_PER_SIZE: f64 = 48.0;
const CELLS_PER_SIGMA: f64 = 2.0;
/// The whole of a cell.
const WHOLE: f32 = 255.0;
/// A table reaches so many of its deviations beyond the robot.
const REACH: f64 = 2.5;
/// Places along a motion that are looked at.
const PLACES: i32 = 2;
const MOST_PLACES: usize = 2 * PLACES as usize + 1;

/// How light is spread.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Blur {
    /// Index of the table.
    pub sigma: usize,
    /// Half of the way that is covered meanwhile, on the field.
    pub way_mm: [f64; 2],
}

/// The robots' tops, blurred.
#[derive(Debug, Clone)]
pub(crate) struct Mixture {
    level: Level,
    tables: Vec<Table>,
    patch_count: usize,
    reach_mm: f64,
}

#[derive(Debug, Clone)]
struct Table {
    per_cell: f32,
    middle: f32,
    columns: usize,
    /// The share of each part, in 255ths; sixteen bits, so that shares can be summed as they are.
    cells: Vec<[u16; PARTS]>,
}

/// The pixels around a robot, a few put together to one sample each.
#[derive(Debug, Clone)]
pub(crate) struct Samples {
    origin: FieldPoint,
    count: usize,
    x_mm: [f32; MOST_SAMPLES],
    y_mm: [f32; MOST_SAMPLES],
    levels: [[f32; MOST_SAMPLES]; CHANNELS],
    /// Cell of the table for each place along the way, at the pose that is being tried.
    cells: [[u32; MOST_SAMPLES]; MOST_PLACES],
    /// The shares, by part.
    shares: [[f32; MOST_SAMPLES]; PARTS],
    /// The same, weighted.
    weighted: [[f32; MOST_SAMPLES]; PARTS],
}

/// The colours that a robot wears: of each patch, in each channel.
pub(crate) type Colors = [[f64; CHANNELS]; MAX_PATCHES];

/// Products of the weighted shares of all samples with the shares and with the levels, and the squares of
/// these.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    products: [[f32; PARTS]; PARTS],
    levels: [[f32; PARTS]; CHANNELS],
    squares: [f32; CHANNELS],
}

/// The mixture undone at a pose.
#[derive(Debug, Clone)]
pub(crate) struct Unmixed {
    patch_count: usize,
    /// Levels of the patches without regard to what they should be, but for λ.
    levels: Colors,
    /// Inverse of the normal matrix of the weights, patch by patch.
    inverse: [[f64; MAX_PATCHES]; MAX_PATCHES],
    /// What is left without any colours, and how much there is to be explained.
    left: f64,
    variation: f64,
    /// Costs are what they would be if all samples had a weight of 1.
    scale: f64,
}

/// A robot's colours held against levels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Match {
    pub cost: f64,
    /// Which part of what varies around the robot is explained.
    pub explained: f64,
    /// How bright the colours are.
    pub brightness: f64,
}

impl Mixture {
    /// For robots of this size with these patches on their top.
    pub fn new(patches: &[PatchConfig], top: &Top, size_mm: f64) -> Self {
        let cell_mm = size_mm / CELLS_PER_SIZE;
        let robot_mm = top.body.reach_mm().max(reach_mm(patches));
        let largest_mm = REACH * SIGMAS[SIGMAS.len() - 1] * size_mm;
        let columns = (2.0 * (robot_mm + largest_mm) / cell_mm).ceil() as usize;
        let middle = columns as f64 / 2.0;
        let place = |index: usize| (index as f64 + 0.5 - middle) * cell_mm;
        let mut sharp = vec![Parts::default(); columns * columns];
        for (index, cell) in sharp.iter_mut().enumerate() {
            let point = [place(index % columns), place(index / columns)];
            let is_near = point[0].hypot(point[1]) <= robot_mm;
            let patch = is_near.then(|| topmost_patch(patches, point)).flatten();
            let is_body = is_near && top.body.contains(point);
            cell[patch.unwrap_or(if is_body { BODY } else { FLOOR })] = 1.0;
        }
        let mut tables = Vec::with_capacity(SIGMAS.len());
        let (mut cells, mut variance) = (sharp, 0.0);
        for sigma in SIGMAS {
            // Goes on from the one before it.
            let sigma = sigma * size_mm / cell_mm;
            variance += blur(&mut cells, columns, sigma * sigma - variance);
            let step = ((sigma / CELLS_PER_SIGMA) as usize).max(1);
            tables.push(Table::new(&cells, columns, step, cell_mm));
        }
        Self {
            level: Level::new(),
            tables,
            patch_count: top.patches.len().min(MAX_PATCHES),
            reach_mm: robot_mm,
        }
    }

    /// Deviations to choose from.
    pub const SIGMA_COUNT: usize = SIGMAS.len();

    /// The mixture undone for a robot at `pose`; `None` if there is nothing to be undone.
    pub fn unmix(&self, samples: &mut Samples, pose: &Pose, blur: &Blur) -> Option<Unmixed> {
        let sums = dispatch!(self.level, _simd => self.sum_up(samples, pose, blur));
        self.solve(samples, &sums)
    }

    #[inline(always)]
    fn sum_up(&self, samples: &mut Samples, pose: &Pose, blur: &Blur) -> Sums {
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
        let Samples { x_mm, y_mm, levels, cells, shares, weighted, count, .. } = samples;
        let whole = count.next_multiple_of(LANES);
        for (place, cells) in (-places..=places).zip(cells.iter_mut()) {
            // Evenly spread over the way, the ends at half a step.
            let part = 2.0 * place as f32 * per_place;
            let offset = [part * way[0] - turned_center[0], part * way[1] - turned_center[1]];
            let points = x_mm[..whole].iter().zip(&y_mm[..whole]);
            for (cell, (&x, &y)) in cells[..whole].iter_mut().zip(points) {
                let [x, y] = turned(x, y);
                *cell = table.cell_at(x + offset[0], y + offset[1]);
            }
        }
        let cells = &cells[..2 * places as usize + 1];
        let scale = per_place * (1.0 / WHOLE);
        for index in 0..whole {
            let mut sum = [0; PARTS];
            // Samples beyond the last one have no share in anything.
            if index < *count {
                for cells in cells {
                    let cell = &table.cells[cells[index] as usize];
                    sum.iter_mut().zip(cell).for_each(|(sum, share)| *sum += share);
                }
            }
            let share = sum.map(|sum: u16| scale * f32::from(sum));
            // The floor tells little about the robot.
            let weight = 1.0 - (1.0 - FLOOR_WEIGHT) * share[FLOOR];
            for part in 0..PARTS {
                shares[part][index] = share[part];
                weighted[part][index] = weight * share[part];
            }
        }
        let mut sums = Sums::default();
        let used = |part: usize| part < self.patch_count || part == BODY || part == FLOOR;
        for row in (0..PARTS).filter(|&row| used(row)) {
            let weighted = &weighted[row][..whole];
            for column in (0..=row).filter(|&column| used(column)) {
                let product = dot(weighted, &shares[column][..whole]);
                (sums.products[row][column], sums.products[column][row]) = (product, product);
            }
            for (sums, levels) in sums.levels.iter_mut().zip(levels.iter()) {
                sums[row] = dot(weighted, &levels[..whole]);
            }
            for (sum, levels) in sums.squares.iter_mut().zip(levels.iter()) {
                *sum += dot_of_squares(weighted, &levels[..whole]);
            }
        }
        sums
    }

    fn solve(&self, samples: &Samples, sums: &Sums) -> Option<Unmixed> {
        // The parts that there are, side by side.
        let patches = self.patch_count;
        let part_of = |row: usize| if row < patches { row } else { BODY + row - patches };
        let rows = patches + 2;
        let mut matrix = Square::default();
        for (row, column) in (0..rows).flat_map(|row| (0..rows).map(move |column| (row, column))) {
            matrix[row][column] = f64::from(sums.products[part_of(row)][part_of(column)]);
        }
        // All shares of a sample together are 1.
        let weight: f64 = matrix.iter().flatten().sum();
        for (row, terms) in matrix.iter_mut().enumerate().take(rows) {
            // Body and floor may have any colour.
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

impl Unmixed {
    /// How well these colours explain the picture.
    pub fn hold(&self, colors: &Colors) -> Match {
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
        // Quadratic in the brightness.
        let curvature = squares - LAMBDA * explained;
        let [least, most] = BRIGHTNESS;
        let brightness =
            if curvature > 0.0 { (along / curvature).clamp(least, most) } else { least };
        let cost =
            self.left + LAMBDA * (brightness * brightness * curvature - 2.0 * brightness * along);
        let explained = 1.0 - cost / self.variation.max(1.0);
        Match { cost: self.scale * cost, explained, brightness }
    }

    /// How far the levels are from these colours, at the brightness that fits them best, in grey levels of
    /// that brightness.
    pub fn distance(&self, colors: &Colors) -> f64 {
        let brightness = self.hold(colors).brightness;
        let mut squares = 0.0;
        for (patch, color) in colors.iter().enumerate().take(self.patch_count) {
            // Undoes the shrinkage of the levels that λ causes.
            let held = (1.0 - LAMBDA * self.inverse[patch][patch]).max(0.05);
            for (level, color) in self.levels[patch].iter().zip(color) {
                squares += (level / (held * brightness) - color).powi(2);
            }
        }
        squares.sqrt()
    }

    /// The levels of a patch once they are held at these colours.
    pub fn level(&self, colors: &Colors, brightness: f64, patch: usize) -> [f64; CHANNELS] {
        std::array::from_fn(|channel| {
            let pull = colors.iter().enumerate().take(self.patch_count);
            let pull = pull.map(|(other, color)| self.inverse[patch][other] * color[channel]);
            self.levels[patch][channel] + LAMBDA * brightness * pull.sum::<f64>()
        })
    }
}

impl Table {
    /// Mean of each square of so many cells.
    fn new(cells: &[Parts], columns: usize, step: usize, cell_mm: f64) -> Self {
        let across = columns / step;
        let mean = |index: usize| {
            let (left, top) = (index % across * step, index / across * step);
            let inside = (0..step * step).map(|i| (top + i / step) * columns + left + i % step);
            let mut sum = Parts::default();
            for cell in inside {
                sum.iter_mut().zip(&cells[cell]).for_each(|(sum, part)| *sum += part);
            }
            sum.map(|sum| (WHOLE * sum / (step * step) as f32).round() as u16)
        };
        Self {
            per_cell: (1.0 / (cell_mm * step as f64)) as f32,
            middle: (columns as f64 / 2.0 / step as f64) as f32,
            columns: across,
            cells: (0..across * across).map(mean).collect(),
        }
    }

    /// The cell in which a point lies; the nearest one for a point outside.
    #[inline(always)]
    fn cell_at(&self, x: f32, y: f32) -> u32 {
        // Added to a small number, this leaves its nearest whole one in the lowest bits: a conversion
        // that a processor can do for many numbers at once, other than the language's own.
        const WHOLE_BITS: f32 = (1 << 23) as f32;
        let last = (self.columns - 1) as f32;
        // `max` makes NaN 0.
        let index = |at: f32| {
            let place = (at * self.per_cell + (self.middle - 0.5)).max(0.0).min(last);
            (place + WHOLE_BITS).to_bits() & ((1 << 23) - 1)
        };
        index(y) * self.columns as u32 + index(x)
    }
}

impl Samples {
    /// Takes what is around `place` on the plane of the robots' tops, without what is of others.
    pub fn take(
        &mut self,
        mixture: &Mixture,
        top: &Top,
        camera: &CameraModel,
        frame: &RawFrame,
        place: FieldPoint,
        is_other: impl Fn(FieldPoint) -> bool,
    ) {
        self.count = 0;
        let height_mm = top.height_mm;
        let center = camera.image_from_field(place, height_mm);
        let mm_per_px = camera.pixel_area_mm2(center, height_mm).sqrt();
        let [x_mm, y_mm] = top.patches[top.team_patch].centroid_mm;
        let reach_mm = mixture.reach_mm + x_mm.hypot(y_mm);
        let reach_px = reach_mm / mm_per_px;
        let is_usable = center.x_px.is_finite() && center.y_px.is_finite() && reach_px < 1e4;
        if !is_usable || reach_px < 1.0 {
            return;
        }
        // Even, so that each sample has all colours of a Bayer mosaic.
        let step = (std::f64::consts::PI * reach_px * reach_px / SAMPLES).sqrt();
        let step = (2.0 * (step / 2.0).round()).max(2.0) as i64;
        let at = |x: f64, y: f64| camera.field_from_image(ImagePoint::new(x, y), height_mm);
        let first = |center: f64| ((center - reach_px) as i64 / step * step).max(0);
        let (left, top) = (first(center.x_px), first(center.y_px));
        let last = |center: f64, end: usize| ((center + reach_px) as i64).min(end as i64 - step);
        self.origin = place;
        // The map from pixels to millimetres is as good as linear over a robot.
        let here = at(center.x_px, center.y_px);
        let (right, down) =
            (at(center.x_px + 1.0, center.y_px), at(center.x_px, center.y_px + 1.0));
        let right = [right.x_mm - here.x_mm, right.y_mm - here.y_mm];
        let down = [down.x_mm - here.x_mm, down.y_mm - here.y_mm];
        for row in (top..=last(center.y_px, frame.height)).step_by(step as usize) {
            for column in (left..=last(center.x_px, frame.width)).step_by(step as usize) {
                let middle = (step - 1) as f64 / 2.0;
                let dx = column as f64 + middle - center.x_px;
                let dy = row as f64 + middle - center.y_px;
                let offset = [0, 1].map(|axis| dx * right[axis] + dy * down[axis]);
                let there = FieldPoint::new(place.x_mm + offset[0], place.y_mm + offset[1]);
                if offset[0].hypot(offset[1]) > reach_mm || is_other(there) {
                    continue;
                }
                let levels = frame.mean(row as usize, column as usize, step as usize);
                if self.count == MOST_SAMPLES {
                    return;
                }
                [self.x_mm[self.count], self.y_mm[self.count]] = offset.map(|value| value as f32);
                for (all, level) in self.levels.iter_mut().zip(levels) {
                    all[self.count] = level;
                }
                self.count += 1;
            }
        }
    }

    pub fn count(&self) -> usize {
        self.count
    }

    /// Leaves out what is white or grey beside what is mostly there: lines and walls, which are none of
    /// the patches if all of these have a hue.
    pub fn drop_lines(&mut self) {
        let count = self.count;
        if count == 0 {
            return;
        }
        let ground: [f32; CHANNELS] = std::array::from_fn(|channel| {
            // Not used before the first trial.
            let sorted = &mut self.shares[0][..count];
            sorted.copy_from_slice(&self.levels[channel][..count]);
            *sorted.select_nth_unstable_by(count / 2, f32::total_cmp).1
        });
        self.count = 0;
        for index in 0..count {
            let levels = self.levels.map(|levels| levels[index]);
            let above: [f32; CHANNELS] =
                std::array::from_fn(|channel| levels[channel] - ground[channel]);
            let least = above.iter().copied().fold(f32::INFINITY, f32::min);
            let most = above.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            if most < LINE_LEVEL || least < GREYNESS * most {
                self.x_mm[self.count] = self.x_mm[index];
                self.y_mm[self.count] = self.y_mm[index];
                for (all, level) in self.levels.iter_mut().zip(levels) {
                    all[self.count] = level;
                }
                self.count += 1;
            }
        }
    }
}

/// Whether a colour has a hue.
pub(crate) fn has_hue(color: &[f64; CHANNELS]) -> bool {
    let least = color.iter().copied().fold(f64::INFINITY, f64::min);
    let most = color.iter().copied().fold(0.0, f64::max);
    least < f64::from(GREYNESS) * most
}

impl Default for Samples {
    fn default() -> Self {
        Self {
            origin: FieldPoint::default(),
            count: 0,
            x_mm: [0.0; MOST_SAMPLES],
            y_mm: [0.0; MOST_SAMPLES],
            levels: [[0.0; MOST_SAMPLES]; CHANNELS],
            cells: [[0; MOST_SAMPLES]; MOST_PLACES],
            shares: [[0.0; MOST_SAMPLES]; PARTS],
            weighted: [[0.0; MOST_SAMPLES]; PARTS],
        }
    }
}

/// Products of two rows of numbers, whole registers of them.
#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0; LANES];
    for (a, b) in a.chunks_exact(LANES).zip(b.chunks_exact(LANES)) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    sums.iter().sum()
}

/// The same with the squares of the second.
#[inline(always)]
fn dot_of_squares(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0; LANES];
    for (a, b) in a.chunks_exact(LANES).zip(b.chunks_exact(LANES)) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * (b[lane] * b[lane]);
        }
    }
    sums.iter().sum()
}

/// Blurs cells by about a variance in square cells, with three boxes; returns the variance it was.
fn blur(cells: &mut [Parts], columns: usize, variance: f64) -> f64 {
    let mut left = variance;
    for boxes in [3.0, 2.0, 1.0] {
        let half = (((12.0 * left / boxes + 1.0).max(1.0).sqrt() - 1.0) / 2.0).round() as usize;
        left -= ((2 * half + 1).pow(2) - 1) as f64 / 12.0;
        for vertical in [false, true] {
            let before = cells.to_vec();
            for line in 0..columns {
                let index = |place: usize| {
                    if vertical { place * columns + line } else { line * columns + place }
                };
                for place in 0..columns {
                    let mut sum = Parts::default();
                    // Beyond the table it goes on as at its border.
                    for offset in 0..=2 * half {
                        let other = (place + offset).saturating_sub(half).min(columns - 1);
                        let cell = &before[index(other)];
                        sum.iter_mut().zip(cell).for_each(|(sum, part)| *sum += part);
                    }
                    cells[index(place)] = sum.map(|sum| sum / (2 * half + 1) as f32);
                }
            }
        }
    }
    variance - left
}

type Square = [[f64; PARTS]; PARTS];

/// A positive definite matrix as the product of a lower triangle with its transpose (Cholesky).
struct Factor {
    rows: usize,
    lower: Square,
    /// One over the diagonal of the triangle.
    inverse: [f64; PARTS],
}

impl Factor {
    /// Factorises the first `rows` rows and columns; `None` if they are not positive definite.
    fn new(matrix: &Square, rows: usize) -> Option<Self> {
        let mut factor = Self { rows, lower: Square::default(), inverse: [0.0; PARTS] };
        for (row, terms) in matrix.iter().enumerate().take(rows) {
            for column in 0..=row {
                let (own, other) = (&factor.lower[row], &factor.lower[column]);
                let known = own[..column].iter().zip(&other[..column]).map(|(a, b)| a * b);
                let left = terms[column] - known.sum::<f64>();
                if row != column {
                    factor.lower[row][column] = left * factor.inverse[column];
                } else if left > 1e-9 && left.is_finite() {
                    factor.lower[row][row] = left.sqrt();
                    factor.inverse[row] = 1.0 / factor.lower[row][row];
                } else {
                    return None;
                }
            }
        }
        Some(factor)
    }

    /// The vector that the matrix takes to `right`.
    fn solve(&self, right: [f64; PARTS]) -> [f64; PARTS] {
        let mut x = right;
        for row in 0..self.rows {
            let known = (0..row).map(|k| self.lower[row][k] * x[k]).sum::<f64>();
            x[row] = (x[row] - known) * self.inverse[row];
        }
        for row in (0..self.rows).rev() {
            let known = (row + 1..self.rows).map(|k| self.lower[k][row] * x[k]).sum::<f64>();
            x[row] = (x[row] - known) * self.inverse[row];
        }
        x
    }
}
