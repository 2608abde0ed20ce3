//! Shares of the parts of a robot's top in a blurred pixel, as tables: one for each standard deviation of the
//! blur, made by box filters from the sharp top.

use super::{BODY, FLOOR, PARTS, Parts};
use crate::pattern::Top;
use crate::pattern::cell_grid::CellGrid;
use config::PatchConfig;
use geometry::layout::{reach_mm, topmost_patch};

/// Standard deviations of the blurs that have tables, as multiples of the robot's size.
pub(super) const SIGMAS: [f64; 5] = [0.035, 0.055, 0.085, 0.125, 0.18];
/// Cells across a robot's size on the grid from which the tables are made.
const CELLS_PER_SIZE: f64 = 48.0;
/// Cells of a table in one standard deviation of its blur: coarse tables stay in the nearest caches.
const CELLS_PER_SIGMA: f64 = 2.0;
/// Share of a part that fills a cell.
pub(super) const WHOLE: f32 = 255.0;
/// Reach of a table beyond the robot, in standard deviations of the widest blur.
const REACH: f64 = 2.5;

/// The shares of all parts at every place of a top under one blur.
#[derive(Debug, Clone)]
pub(super) struct Table {
    pub grid: CellGrid,
    /// Share of each part in 255ths; sixteen bits leave room for the sum over the points of a motion.
    pub cells: Vec<[u16; PARTS]>,
}

/// The tables of all blurs for robots of this size with these patches on their top.
pub(super) fn all(patches: &[PatchConfig], top: &Top, size_mm: f64) -> Vec<Table> {
    let cell_mm = size_mm / CELLS_PER_SIZE;
    let robot_mm = robot_reach_mm(patches, top);
    let largest_mm = REACH * SIGMAS[SIGMAS.len() - 1] * size_mm;
    let columns = (2.0 * (robot_mm + largest_mm) / cell_mm).ceil() as usize;
    let middle = columns as f64 / 2.0;
    let place = |index: usize| (index as f64 + 0.5 - middle) * cell_mm;
    let mut cells = vec![Parts::default(); columns * columns];
    for (index, cell) in cells.iter_mut().enumerate() {
        let point = [place(index % columns), place(index / columns)];
        let is_near = point[0].hypot(point[1]) <= robot_mm;
        let patch = is_near.then(|| topmost_patch(patches, point)).flatten();
        let is_body = is_near && top.body.contains(point);
        cell[patch.unwrap_or(if is_body { BODY } else { FLOOR })] = 1.0;
    }
    let mut tables = Vec::with_capacity(SIGMAS.len());
    let mut variance = 0.0;
    for sigma in SIGMAS {
        // Blurs the grid of the sigma before it by the difference of the variances.
        let sigma = sigma * size_mm / cell_mm;
        variance += blur(&mut cells, columns, sigma * sigma - variance);
        let step = ((sigma / CELLS_PER_SIGMA) as usize).max(1);
        tables.push(Table::new(&cells, columns, step, cell_mm));
    }
    tables
}

/// Distance from a robot's centre to the farthest point of its body or patches.
pub(super) fn robot_reach_mm(patches: &[PatchConfig], top: &Top) -> f64 {
    top.body.reach_mm().max(reach_mm(patches))
}

impl Table {
    /// A table whose cells are the means of squares of `step` × `step` cells.
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
        let cells_per_mm = (1.0 / (cell_mm * step as f64)) as f32;
        let origin = (columns as f64 / 2.0 / step as f64) as f32 - 0.5;
        Self {
            grid: CellGrid::new(across, cells_per_mm, origin),
            cells: (0..across * across).map(mean).collect(),
        }
    }
}

/// Blurs cells by about `variance` (square cells) with three box filters, which is close to a Gaussian;
/// returns the variance reached.
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
                    // Cells beyond the table are as those at its border.
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
