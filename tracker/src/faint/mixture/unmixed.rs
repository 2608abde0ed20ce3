//! Solution of the normal equations of the [mixture](super), and comparison of robots' colours with it.

use super::sums::Sums;
use super::{Colors, LAMBDA, Mixture, PARTS, Samples};
use crate::raw::CHANNELS;
use messages::MAX_PATCHES;

/// Least and greatest brightness of a robot's colours, relative to the configured ones.
const BRIGHTNESS: [f64; 2] = [0.2, 2.5];
/// Keeps body and floor, which have no prior, from making the matrix singular.
const REGULAR: f64 = 1e-3;

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

/// A robot's colours, with what of their comparison depends on nothing else.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Look {
    pub colors: Colors,
    /// CᵀC for each pair of patches, channels added.
    products: [[f64; MAX_PATCHES]; MAX_PATCHES],
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

impl Look {
    pub fn new(colors: Colors) -> Self {
        let products = colors.map(|own| colors.map(|other| dot(&own, &other)));
        Self { colors, products }
    }
}

impl Mixture {
    pub(super) fn solve(&self, samples: &Samples, sums: &Sums) -> Option<Unmixed> {
        let patches = self.patch_count;
        // Rows: the patches of this top, body, floor. Columns: the same, and the right sides by channel.
        let mut matrix = [[0.0; PARTS + CHANNELS]; PARTS];
        let mut rights = [[0.0; PARTS]; CHANNELS];
        let mut rows = 0;
        for (row, &part) in self.parts().iter().enumerate() {
            for (column, &other) in self.parts().iter().enumerate().skip(row) {
                let product = f64::from(sums.products[part][other]);
                matrix[row][column] = product;
                matrix[column][row] = product;
            }
            for (right, levels) in rights.iter_mut().zip(&sums.levels) {
                right[row] = f64::from(levels[part]);
            }
            rows = row + 1;
        }
        // The shares of a sample add up to 1, so the sum of all products is the sum of the weights.
        let weight: f64 = matrix.iter().flatten().sum();
        for row in 0..rows {
            matrix[row][row] += if row < patches { LAMBDA } else { REGULAR };
            for (channel, right) in rights.iter().enumerate() {
                matrix[row][PARTS + channel] = right[row];
            }
        }
        invert(&mut matrix, rows)?;

        let squares = f64::from(sums.squares);
        let means = rights.map(|right| right.iter().sum::<f64>());
        let variation = squares - means.iter().map(|sum| sum * sum / weight).sum::<f64>();
        let mut unmixed = Unmixed {
            patch_count: patches,
            levels: Colors::default(),
            inverse: [[0.0; MAX_PATCHES]; MAX_PATCHES],
            left: squares,
            variation,
            scale: samples.count as f64 / weight,
        };
        for (row, solved) in matrix[..rows].iter().enumerate() {
            for (channel, right) in rights.iter().enumerate() {
                unmixed.left -= solved[PARTS + channel] * right[row];
            }
            if row < patches {
                unmixed.inverse[row][..patches].copy_from_slice(&solved[..patches]);
                unmixed.levels[row].copy_from_slice(&solved[PARTS..]);
            }
        }
        Some(unmixed)
    }
}

/// Replaces the first `rows` rows and columns, which are symmetric, by their inverse, and the right sides
/// behind them by the solutions (Gauss–Jordan elimination); `None` if they are not positive definite.
fn invert(matrix: &mut [[f64; PARTS + CHANNELS]; PARTS], rows: usize) -> Option<()> {
    for pivot in 0..rows {
        let own = matrix[pivot][pivot];
        if !(own > 1e-9 && own.is_finite()) {
            return None;
        }
        matrix[pivot][pivot] = 1.0;
        let by = matrix[pivot].map(|term| term / own);
        for (row, terms) in matrix[..rows].iter_mut().enumerate() {
            if row == pivot {
                *terms = by;
                continue;
            }
            let factor = std::mem::take(&mut terms[pivot]);
            terms.iter_mut().zip(by).for_each(|(term, by)| *term -= factor * by);
        }
    }
    Some(())
}

impl Unmixed {
    /// Cost and brightness of the best explanation of the picture by these colours.
    pub fn compare(&self, look: &Look) -> Match {
        let (mut along, mut squares, mut explained) = (0.0, 0.0, 0.0);
        for patch in 0..self.patch_count {
            along += dot(&look.colors[patch], &self.levels[patch]);
            squares += look.products[patch][patch];
            let pairs = self.inverse[patch].iter().zip(&look.products[patch]);
            explained += pairs.map(|(inverse, product)| inverse * product).sum::<f64>();
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
    pub fn distance(&self, look: &Look) -> f64 {
        let brightness = self.compare(look).brightness;
        let mut squares = 0.0;
        for (patch, color) in look.colors.iter().enumerate().take(self.patch_count) {
            // Undoes the shrinkage of the levels towards 0 that λ causes.
            let held = (1.0 - LAMBDA * self.inverse[patch][patch]).max(0.05);
            for (level, color) in self.levels[patch].iter().zip(color) {
                squares += (level / (held * brightness) - color).powi(2);
            }
        }
        squares.sqrt()
    }

    /// The levels of a patch under the prior of these colours.
    pub fn level(&self, look: &Look, brightness: f64, patch: usize) -> [f64; CHANNELS] {
        std::array::from_fn(|channel| {
            let pull = look.colors.iter().enumerate().take(self.patch_count);
            let pull = pull.map(|(other, color)| self.inverse[patch][other] * color[channel]);
            self.levels[patch][channel] + LAMBDA * brightness * pull.sum::<f64>()
        })
    }
}

fn dot(a: &[f64; CHANNELS], b: &[f64; CHANNELS]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The inverse times the matrix is 1, and the matrix times the solutions are the right sides.
        #[test]
        fn the_inverse_and_the_solutions_solve_the_equations(
            terms in prop::collection::vec(-3.0..3.0f64, PARTS * (PARTS + CHANNELS)),
            rows in 1..=PARTS,
        ) {
            let term = |row: usize, column: usize| terms[row * (PARTS + CHANNELS) + column];
            let mut matrix = [[0.0; PARTS + CHANNELS]; PARTS];
            for (row, column) in (0..rows).flat_map(|row| (0..rows).map(move |it| (row, it))) {
                // Positive definite: a product with the own transpose, and a diagonal.
                let product = (0..rows).map(|k| term(row, k) * term(column, k)).sum::<f64>();
                matrix[row][column] = product + if row == column { 0.5 } else { 0.0 };
            }
            for (row, terms) in matrix[..rows].iter_mut().enumerate() {
                terms[PARTS..].copy_from_slice(&[0, 1, 2].map(|it| term(row, PARTS + it)));
            }
            let given = matrix;
            prop_assert_eq!(invert(&mut matrix, rows), Some(()));
            for (row, given) in given[..rows].iter().enumerate() {
                let times = |column: usize| {
                    (0..rows).map(|k| given[k] * matrix[k][column]).sum::<f64>()
                };
                for column in 0..rows {
                    let expected = if row == column { 1.0 } else { 0.0 };
                    prop_assert!((times(column) - expected).abs() < 1e-6);
                }
                for (column, right) in given.iter().enumerate().skip(PARTS) {
                    prop_assert!((times(column) - right).abs() < 1e-6);
                }
            }
        }
    }

    #[test]
    fn a_singular_matrix_has_no_inverse() {
        for term in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let mut matrix = [[0.0; PARTS + CHANNELS]; PARTS];
            (matrix[0][0], matrix[1][1]) = (1.0, term);
            assert_eq!(invert(&mut matrix, 2), None);
        }
    }
}
