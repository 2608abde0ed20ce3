//! Shares: the layout as a table of each patch's share at every point of a robot's top, faded at the rims.

use super::cell_grid::CellGrid;
use crate::linear::UPPER;
use config::PatchConfig;
use geometry::layout::{reach_mm, topmost_patch};
use messages::MAX_PATCHES;

/// Standard deviation of the fading: demosaicing mixes pixels with their neighbours, and a sum that changes
/// gradually has a gradient towards its maximum.
const FADE_MM: f64 = 6.0;
/// Side of a cell: small beside the fading, so no interpolation between cells is needed.
const CELL_MM: f64 = 1.0;
/// Least share of a patch in the cells of its inside.
const INSIDE: f32 = 0.5;
/// Floats in a row of the table: one for each patch, padded to a register.
pub(crate) const ROW: usize = 8;
const _: () = assert!(MAX_PATCHES <= ROW);

/// One value for each patch; the rest is 0.
pub(crate) type PatchRow = [f32; ROW];

/// The share of each patch at every point of a robot's top.
#[derive(Debug, Clone)]
pub(crate) struct Shares {
    /// Half the table's side. Shares are 0 beyond it and in the cells at its border.
    pub reach_mm: f64,
    columns: usize,
    /// Share of each patch, by cell.
    cells: Vec<PatchRow>,
    /// Share of a patch and its derivatives by x and y per millimetre: patch by patch, by cell.
    slopes: Vec<[f32; 4]>,
    /// For each patch, the sum of its shares in square millimetres.
    pub areas_mm2: PatchRow,
    /// For each patch, the area of the cells inside it, see [`INSIDE`].
    pub insides_mm2: PatchRow,
    /// Negative second derivatives, by steps in x, y (mm) and heading (rad) in the robot's frame, of the sum
    /// over a whole robot at its own pose, in square millimetres; as an upper triangle.
    pub curvature: [f64; 6],
}

impl Shares {
    pub fn new(patches: &[PatchConfig]) -> Self {
        // Leaves room for a border of cells without shares.
        let reach_mm = reach_mm(patches) + 2.0 * FADE_MM + CELL_MM;
        let columns = ((2.0 * reach_mm / CELL_MM).ceil() as usize).max(3) + 2;
        let reach_mm = columns as f64 * CELL_MM / 2.0;
        let place = |index: usize| (index as f64 + 0.5) * CELL_MM - reach_mm;
        let mut faded = vec![[0.0; MAX_PATCHES]; columns * columns];
        for (cell, share) in faded.iter_mut().enumerate() {
            let point = [place(cell % columns), place(cell / columns)];
            if let Some(patch) = topmost_patch(patches, point) {
                share[patch] = 1.0;
            }
        }
        let curvature = curvature(faded.clone(), columns, place);
        fade(&mut faded, columns, FADE_MM);

        let count = columns * columns;
        let mut cells = vec![PatchRow::default(); count];
        let mut slopes = vec![[0.0; 4]; count * MAX_PATCHES];
        let inner = 1..columns - 1;
        for (row, column) in inner.clone().flat_map(|row| inner.clone().map(move |c| (row, c))) {
            let cell = row * columns + column;
            let near = [cell, cell - 1, cell + 1, cell - columns, cell + columns];
            for patch in 0..patches.len().min(MAX_PATCHES) {
                let [here, left, right, above, below] = near.map(|near| faded[near][patch]);
                let slope =
                    [right - left, below - above].map(|change| change / (2.0 * CELL_MM as f32));
                cells[cell][patch] = here;
                slopes[patch * count + cell] = [here, slope[0], slope[1], 0.0];
            }
        }
        let cell_mm2 = (CELL_MM * CELL_MM) as f32;
        let over_all = |of: fn(f32) -> f32| -> PatchRow {
            std::array::from_fn(|patch| {
                cell_mm2 * cells.iter().map(|share| of(share[patch])).sum::<f32>()
            })
        };
        let areas_mm2 = over_all(|share| share);
        let insides_mm2 = over_all(|share| f32::from(u8::from(share >= INSIDE)));
        Self { reach_mm, columns, cells, slopes, areas_mm2, insides_mm2, curvature }
    }

    /// The grid of the table's cells. A point outside lies in a cell without shares.
    #[inline(always)]
    pub fn grid(&self) -> CellGrid {
        let columns = self.columns as f32;
        CellGrid::new(self.columns, 1.0 / CELL_MM as f32, (columns - 1.0) / 2.0)
    }

    /// Shares by cell.
    #[inline(always)]
    pub fn cells(&self) -> &[PatchRow] {
        &self.cells
    }

    /// Share of a patch and its derivatives by x and y, by cell.
    #[inline(always)]
    pub fn slopes_of(&self, patch: usize) -> &[[f32; 4]] {
        let count = self.columns * self.columns;
        &self.slopes[patch * count..(patch + 1) * count]
    }

    /// Whether a cell with this share of a patch lies inside it.
    #[inline(always)]
    pub fn is_inside(share: f32) -> bool {
        share >= INSIDE
    }

    /// Sum of all shares in square millimetres: that over a whole robot at its own pose.
    pub fn area_mm2(&self) -> f32 {
        self.areas_mm2.iter().sum()
    }
}

/// [`Shares::curvature`]. The sum over a robot is the correlation of its sharp patches with the faded ones.
/// That equals the autocorrelation of patches faded by half the variance, so the negative second derivatives
/// at 0 are sums of products of the slopes of these.
fn curvature(
    mut shares: Vec<[f32; MAX_PATCHES]>,
    columns: usize,
    place: impl Fn(usize) -> f64,
) -> [f64; 6] {
    fade(&mut shares, columns, FADE_MM / std::f64::consts::SQRT_2);
    let mut sums = [0.0; 6];
    for (row, column) in (1..columns - 1).flat_map(|row| (1..columns - 1).map(move |c| (row, c))) {
        let cell = row * columns + column;
        // Derivative of each patch's share, by the central difference.
        let between = |step: usize| {
            let pairs = shares[cell - step].iter().zip(&shares[cell + step]);
            pairs.map(|(before, behind)| f64::from(behind - before) / (2.0 * CELL_MM))
        };
        for (x, y) in between(1).zip(between(columns)) {
            let slope = [x, y, place(row) * x - place(column) * y];
            for (sum, (i, j)) in sums.iter_mut().zip(UPPER) {
                *sum += slope[i] * slope[j] * CELL_MM * CELL_MM;
            }
        }
    }
    sums
}

/// Blurs shares with three box filters, which is close to a Gaussian.
fn fade(shares: &mut [[f32; MAX_PATCHES]], columns: usize, sigma_mm: f64) {
    // A box of width w has a variance of (w² − 1)/12 cells²; each takes its part of what is left.
    let mut left = (sigma_mm / CELL_MM).powi(2);
    for boxes in [3.0, 2.0, 1.0] {
        let half = (((12.0 * left / boxes + 1.0).max(1.0).sqrt() - 1.0) / 2.0).round() as usize;
        left -= ((2 * half + 1).pow(2) - 1) as f64 / 12.0;
        for vertical in [false, true] {
            let before = shares.to_vec();
            let index = |line: usize, place: usize| {
                if vertical { place * columns + line } else { line * columns + place }
            };
            for line in 0..columns {
                for place in 0..columns {
                    let around = place.saturating_sub(half)..(place + half + 1).min(columns);
                    let mut sum = [0.0; MAX_PATCHES];
                    for other in around {
                        let share = &before[index(line, other)];
                        sum.iter_mut().zip(share).for_each(|(sum, share)| *sum += share);
                    }
                    shares[index(line, place)] = sum.map(|sum| sum / (2 * half + 1) as f32);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Config;

    #[test]
    fn shares_add_up_to_the_patches() {
        let config = Config::default();
        let shares = Shares::new(&config.robots.patches);
        for (patch, expected) in [34.0 * 34.0, 34.0 * 34.0].iter().enumerate() {
            let area = f64::from(shares.areas_mm2[patch]);
            assert!((area / expected - 1.0).abs() < 0.01, "{area} mm²");
        }
    }

    #[test]
    fn points_outside_have_no_share() {
        let shares = Shares::new(&Config::default().robots.patches);
        for [x, y] in [[1e9, 0.0], [0.0, -1e9], [f32::NAN, 0.0], [f32::INFINITY, f32::NAN]] {
            assert_eq!(shares.cells()[shares.grid().cell_at(x, y) as usize], PatchRow::default());
        }
    }
}
