//! Normal equations of one sector and channel of the rim, from which unknowns are eliminated one by one
//! (Schur complements): first the background, then the rim's offset or the shading.

use super::rim_samples::{BACKGROUND, SHADE, SLOPE, SOFTNESS, Sums, TERMS, VALUE};
use super::{SAMPLE_NOISE, SHADE_NOISE};

/// Components of the shading b.
pub(super) const SHADES: usize = 4;
/// Terms without the background.
const LEFT: usize = TERMS - 1;
/// Keeps the elimination of the rim's offset from dividing by zero where no sample shows it.
const LEAST_SLOPE: f64 = 1e-3;

/// Sums of a sector and channel after the background has been eliminated.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Block {
    sums: [[f64; LEFT]; LEFT],
    /// Background as a linear function of the other terms: a = levels[value] − levels[shades] · shades.
    levels: [f64; LEFT],
    /// Normal equations of the shading and their right side, the rim's offset eliminated as well.
    shading: [[f64; SHADES + 1]; SHADES],
}

impl Block {
    /// Eliminates the background, with a prior of `level` that counts as much as `samples` samples.
    pub fn new(sums: &Sums, level: f64, samples: f64) -> Self {
        let f = |row: usize, column: usize| f64::from(sums[row][column]);
        let own = f(BACKGROUND, BACKGROUND) + samples;
        let mut shares: [f64; LEFT] = std::array::from_fn(|index| f(BACKGROUND, index + 1));
        shares[VALUE - 1] += samples * level;
        let levels = shares.map(|share| share / own);
        let mut left = [[0.0; LEFT]; LEFT];
        for (row, left) in left.iter_mut().enumerate() {
            for (column, left) in left.iter_mut().enumerate() {
                *left = f(row + 1, column + 1) - levels[row] * shares[column];
            }
        }
        left[VALUE - 1][VALUE - 1] += samples * level * level;
        let offset = left[SLOPE - 1];
        let factor = offset.map(|sum| sum / (offset[SLOPE - 1] + LEAST_SLOPE));
        let mut shading = [[0.0; SHADES + 1]; SHADES];
        for (row, shading) in shading.iter_mut().enumerate() {
            for (column, shading) in shading.iter_mut().enumerate() {
                // Shades, then the value.
                let column = if column == SHADES { VALUE - 1 } else { column };
                *shading = left[row][column] - factor[row] * offset[column];
            }
        }
        Self { sums: left, levels, shading }
    }

    /// Adds the normal equations of the shading, the rim's offset eliminated.
    pub fn add_to(&self, normal: &mut [[f64; SHADES + 1]; SHADES], weight: f64) {
        for (normal, shading) in normal.iter_mut().zip(&self.shading) {
            for (normal, shading) in normal.iter_mut().zip(shading) {
                *normal += weight * shading;
            }
        }
    }

    /// Level of the background.
    pub fn level(&self, shades: &[f64; SHADES]) -> f64 {
        let of_shades: f64 =
            self.levels.iter().zip(shades).map(|(level, shade)| level * shade).sum();
        self.levels[VALUE - 1] - of_shades
    }

    /// With r the residuals of the shading, e the derivative by the rim's offset and h that by the point
    /// spread function's size: e·e, e·r, r·r, h·h and h·r (h with the offset eliminated). If `is_free`, the
    /// ball's level in the sector may differ from the shading by [`SHADE_NOISE`].
    pub fn rim(&self, shades: &[f64; SHADES], contrast: f64, is_free: bool) -> [f64; 5] {
        // Shade, slope, softness, residual.
        const KEPT: [usize; 4] = [SHADE - 1, SLOPE - 1, SOFTNESS - 1, VALUE - 1];
        let mut left = [[0.0; 4]; 4];
        for (row, &from) in left[..3].iter_mut().zip(&KEPT) {
            for (column, &to) in row[..3].iter_mut().zip(&KEPT) {
                *column = self.sums[from][to];
            }
            let of_shades: f64 =
                self.sums[from].iter().zip(shades).map(|(sum, shade)| sum * shade).sum();
            row[3] = self.sums[from][VALUE - 1] - of_shades;
        }
        let mut squares = self.sums[VALUE - 1][VALUE - 1];
        for (sums, shade) in self.sums.iter().zip(shades) {
            let of_shades: f64 = sums.iter().zip(shades).map(|(sum, shade)| sum * shade).sum();
            squares += shade * (of_shades - 2.0 * sums[VALUE - 1]);
        }
        let [a, b, c] = [left[0][3], left[1][3], left[2][3]];
        left[3] = [a, b, c, squares];
        if is_free {
            let deviation = SHADE_NOISE * contrast.abs() + 1.0;
            eliminate(&mut left, 0, (SAMPLE_NOISE / deviation).powi(2));
        }
        let ([ee, er], rr) = ([left[1][1], left[1][3]], left[3][3].max(0.0));
        eliminate(&mut left, 1, LEAST_SLOPE);
        [ee, er, rr, left[2][2], left[2][3]]
    }
}

/// Eliminates one quantity from the sums, with a prior of 0 that counts as much as `samples` samples.
fn eliminate<const N: usize>(sums: &mut [[f64; N]; N], index: usize, samples: f64) {
    let by = sums[index];
    let own = by[index] + samples;
    for (row, factor) in sums.iter_mut().zip(by.map(|factor| factor / own)) {
        row.iter_mut().zip(by).for_each(|(sum, by)| *sum -= factor * by);
    }
}

/// Solves symmetric equations by Gaussian elimination; the last column is the right side.
pub(super) fn solve(mut rows: [[f64; SHADES + 1]; SHADES]) -> Option<[f64; SHADES]> {
    for pivot in 0..SHADES {
        let by = rows[pivot][pivot];
        if by.is_nan() || by < 1e-12 {
            return None;
        }
        let above = rows[pivot];
        for row in rows.iter_mut().skip(pivot + 1) {
            let factor = row[pivot] / by;
            row.iter_mut().zip(above).for_each(|(it, above)| *it -= factor * above);
        }
    }
    let mut solution = [0.0; SHADES];
    for row in (0..SHADES).rev() {
        let known: f64 = (row + 1..SHADES).map(|column| rows[row][column] * solution[column]).sum();
        solution[row] = (rows[row][SHADES] - known) / rows[row][row];
    }
    Some(solution)
}
