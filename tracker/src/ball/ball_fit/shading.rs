//! Normal equations of one sector and channel of the rim, from which unknowns are eliminated one by one
//! (Schur complements): first the background, then the rim's offset or the shading.

use super::rim_samples::{BACKGROUND, SHADE, SLOPE, SOFTNESS, TERMS, VALUE};
use super::wide::Number;
use super::{SAMPLE_NOISE, SHADE_NOISE};

/// Components of the shading b.
pub(super) const SHADES: usize = 4;
/// Terms without the background.
const LEFT: usize = TERMS - 1;
/// Keeps the elimination of the rim's offset from dividing by zero where no sample shows it.
const LEAST_SLOPE: f64 = 1e-3;

/// Sums of a sector and channel, or of a group of sectors, after the background has been eliminated.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Block<T> {
    sums: [[T; LEFT]; LEFT],
    /// Background as a linear function of the other terms: a = levels[value] − levels[shades] · shades.
    levels: [T; LEFT],
    /// Normal equations of the shading and their right side, the rim's offset eliminated as well.
    pub shading: [[T; SHADES + 1]; SHADES],
}

impl<T: Number> Block<T> {
    /// Eliminates the background, with a prior of `level` that counts as much as `samples` samples. `sum`
    /// returns the sum of the products of two terms.
    #[inline(always)]
    pub fn new(sum: impl Fn(usize, usize) -> T, level: f64, samples: f64) -> Self {
        let own = sum(BACKGROUND, BACKGROUND) + T::of(samples);
        let mut shares: [T; LEFT] = std::array::from_fn(|index| sum(BACKGROUND, index + 1));
        shares[VALUE - 1] = shares[VALUE - 1] + T::of(samples * level);
        let levels = shares.map(|share| share / own);
        let mut left = [[T::default(); LEFT]; LEFT];
        for row in 0..LEFT {
            for column in row..LEFT {
                let term = sum(row + 1, column + 1) - levels[row] * shares[column];
                left[row][column] = term;
                left[column][row] = term;
            }
        }
        let value = &mut left[VALUE - 1][VALUE - 1];
        *value = *value + T::of(samples * level * level);
        let offset = left[SLOPE - 1];
        let whole = offset[SLOPE - 1] + T::of(LEAST_SLOPE);
        let factor = offset.map(|sum| sum / whole);
        let mut shading = [[T::default(); SHADES + 1]; SHADES];
        for (row, shading) in shading.iter_mut().enumerate() {
            for (column, shading) in shading.iter_mut().enumerate() {
                // Shades, then the value.
                let column = if column == SHADES { VALUE - 1 } else { column };
                *shading = left[row][column] - factor[row] * offset[column];
            }
        }
        Self { sums: left, levels, shading }
    }

    /// Level of the background.
    #[inline(always)]
    pub fn level(&self, shades: &[f64; SHADES]) -> T {
        self.levels[VALUE - 1] - of_shades(&self.levels, shades)
    }

    /// With r the residuals of the shading, e the derivative by the rim's offset and h that by the point
    /// spread function's size: e·e, e·r, r·r, h·h and h·r (h with the offset eliminated). If `is_free`, the
    /// ball's level in the sector may differ from the shading by [`SHADE_NOISE`].
    #[inline(always)]
    pub fn rim(&self, shades: &[f64; SHADES], contrast: T, is_free: bool) -> [T; 5] {
        // Shade, slope, softness, residual.
        const KEPT: [usize; 4] = [SHADE - 1, SLOPE - 1, SOFTNESS - 1, VALUE - 1];
        let mut left = [[T::default(); 4]; 4];
        for (row, &from) in left[..3].iter_mut().zip(&KEPT) {
            for (column, &to) in row[..3].iter_mut().zip(&KEPT) {
                *column = self.sums[from][to];
            }
            row[3] = self.sums[from][VALUE - 1] - of_shades(&self.sums[from], shades);
        }
        let mut squares = self.sums[VALUE - 1][VALUE - 1];
        for (sums, &shade) in self.sums.iter().zip(shades) {
            let left = of_shades(sums, shades) - T::of(2.0) * sums[VALUE - 1];
            squares = squares + T::of(shade) * left;
        }
        let [a, b, c] = [left[0][3], left[1][3], left[2][3]];
        left[3] = [a, b, c, squares];
        if is_free {
            let deviation = T::of(SHADE_NOISE) * contrast.abs() + T::of(1.0);
            let samples = T::of(SAMPLE_NOISE) / deviation;
            eliminate(&mut left, 0, samples * samples);
        }
        let ([ee, er], rr) = ([left[1][1], left[1][3]], left[3][3].at_least(0.0));
        eliminate(&mut left, 1, T::of(LEAST_SLOPE));
        [ee, er, rr, left[2][2], left[2][3]]
    }
}

/// Sum of the first terms times the shades.
#[inline(always)]
fn of_shades<T: Number>(terms: &[T; LEFT], shades: &[f64; SHADES]) -> T {
    let products = terms.iter().zip(shades).map(|(&term, &shade)| term * T::of(shade));
    products.reduce(|sum, product| sum + product).unwrap_or_default()
}

/// Eliminates one quantity from the sums, with a prior of 0 that counts as much as `samples` samples.
#[inline(always)]
fn eliminate<T: Number, const N: usize>(sums: &mut [[T; N]; N], index: usize, samples: T) {
    let by = sums[index];
    let own = by[index] + samples;
    for (row, factor) in sums.iter_mut().zip(by.map(|factor| factor / own)) {
        for (sum, by) in row.iter_mut().zip(by) {
            *sum = *sum - factor * by;
        }
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

#[cfg(test)]
mod tests {
    use super::super::wide::{LANES, Wide};
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Four sectors at a time give what each gives by itself.
        #[test]
        fn sectors_together_give_the_same(
            terms in prop::collection::vec(-2.0..2.0f64, LANES * 3 * TERMS),
            shades in prop::array::uniform4(-50.0..120.0f64),
            contrast in prop::array::uniform4(-90.0..90.0f64),
            level in -40.0..40.0f64,
            samples in 0.01..5.0f64,
            is_free in any::<bool>(),
        ) {
            // Sums over three samples.
            let sum = |lane: usize, row: usize, column: usize| {
                let of = |sample: usize, term: usize| terms[(lane * 3 + sample) * TERMS + term];
                (0..3).map(|sample| of(sample, row) * of(sample, column)).sum::<f64>()
            };
            let together = Block::new(
                |row, column| Wide(std::array::from_fn(|lane| sum(lane, row, column))),
                level,
                samples,
            );
            let rims = together.rim(&shades, Wide(contrast), is_free);
            for (lane, &contrast) in contrast.iter().enumerate() {
                let alone = Block::new(|row, column| sum(lane, row, column), level, samples);
                prop_assert_eq!(together.level(&shades).0[lane], alone.level(&shades));
                let rim = alone.rim(&shades, contrast, is_free);
                prop_assert_eq!(rims.map(|rim| rim.0[lane]), rim);
                for (together, alone) in
                    together.shading.as_flattened().iter().zip(alone.shading.as_flattened())
                {
                    prop_assert_eq!(together.0[lane], *alone);
                }
            }
        }
    }
}
