//! A normal distribution over a state, and its correction by a measurement.
//!
//! The measured quantities are the first components of every state (eq. 9 of the paper: `H = [I 0]`), so a
//! measurement of `Z` components corrects a state of `N ≥ Z`. For `N = Z` this is eq. (14).

use nalgebra::{SMatrix, SVector};

/// Mean and covariance of a state of `N` components.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gaussian<const N: usize> {
    /// x̂ of the paper.
    pub mean: SVector<f64, N>,
    /// P of the paper; exactly symmetric.
    pub covariance: SMatrix<f64, N, N>,
}

/// Difference between a measurement and its prediction, and how improbable it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovation<const Z: usize> {
    /// Measured minus predicted, angles wrapped.
    pub difference: SVector<f64, Z>,
    /// Inverse of the covariance S of `difference`.
    pub precision: SMatrix<f64, Z, Z>,
    /// Squared Mahalanobis distance: `difference` in units of its own uncertainty, also called normalised
    /// innovation squared. Its mean is `Z` if the model is right.
    pub distance2: f64,
    /// Logarithm of the probability density of the measurement.
    pub ln_density: f64,
}

impl<const N: usize> Gaussian<N> {
    /// The innovation of a measurement that differs by `difference` from the mean, with noise covariance R.
    /// `None` if its covariance is unusable (not positive definite, or not finite).
    pub fn innovation<const Z: usize>(
        &self,
        difference: SVector<f64, Z>,
        noise: &SMatrix<f64, Z, Z>,
    ) -> Option<Innovation<Z>> {
        let predicted = self.covariance.fixed_view::<Z, Z>(0, 0);
        let factor = cholesky(&(predicted + noise))?;
        let precision = inverse(&factor);
        let distance2 = difference.dot(&(precision * difference));
        let ln_determinant = 2.0 * factor.diagonal().map(f64::ln).sum();
        let ln_density =
            -0.5 * (distance2 + ln_determinant + Z as f64 * std::f64::consts::TAU.ln());
        (distance2.is_finite() && ln_density.is_finite()).then_some(Innovation {
            difference,
            precision,
            distance2,
            ln_density,
        })
    }

    /// Eq. (14): gain, corrected state, corrected covariance. The covariance is computed in Joseph's
    /// form, (I − KH) P (I − KH)ᵀ + K R Kᵀ: equal to the paper's (I − K) P⁻ for the gain used here,
    /// but a sum of squares, so rounding cannot make it indefinite.
    pub fn correct<const Z: usize>(
        &mut self,
        innovation: &Innovation<Z>,
        noise: &SMatrix<f64, Z, Z>,
    ) {
        let gain = self.covariance.fixed_columns::<Z>(0) * innovation.precision;
        self.mean += gain * innovation.difference;
        // The first columns of I − KH; the others are those of I.
        let mut keep = SMatrix::<f64, N, Z>::identity();
        keep -= gain;
        let before = &self.covariance;
        // (I − KH) P, without the terms that are 0.
        let kept = SMatrix::<f64, N, N>::from_fn(|row, column| {
            let kept = sum((0..Z).map(|k| keep[(row, k)] * before[(k, column)]));
            if row < Z { kept } else { kept + before[(row, column)] }
        });
        let spread = gain * noise;
        for column in 0..N {
            for row in 0..=column {
                let old = sum((0..Z).map(|k| kept[(row, k)] * keep[(column, k)]));
                let old = if column < Z { old } else { old + kept[(row, column)] };
                let new = sum((0..Z).map(|k| spread[(row, k)] * gain[(column, k)]));
                self.covariance[(row, column)] = old + new;
            }
        }
        self.symmetrise();
    }

    /// Makes the covariance exactly symmetric by copying its upper triangle over the lower one.
    pub fn symmetrise(&mut self) {
        self.covariance.fill_lower_triangle_with_upper_triangle();
    }

    /// The upper triangle of the covariance, row by row; `LENGTH` is N·(N+1)/2.
    pub fn packed_covariance<const LENGTH: usize>(&self) -> [f64; LENGTH] {
        let mut packed = [0.0; LENGTH];
        for (slot, (row, column)) in packed.iter_mut().zip(upper_triangle(N)) {
            *slot = self.covariance[(row, column)];
        }
        packed
    }

    /// Inverse of [`packed_covariance`](Self::packed_covariance).
    pub fn from_packed<const LENGTH: usize>(mean: [f64; N], packed: &[f64; LENGTH]) -> Self {
        let mut covariance = SMatrix::zeros();
        for (value, (row, column)) in packed.iter().zip(upper_triangle(N)) {
            covariance[(row, column)] = *value;
            covariance[(column, row)] = *value;
        }
        Self { mean: mean.into(), covariance }
    }

    /// The covariance row by row; `LENGTH` is N².
    pub fn covariance_rows<const LENGTH: usize>(&self) -> [f64; LENGTH] {
        let mut rows = [0.0; LENGTH];
        for (index, slot) in rows.iter_mut().enumerate().take(N * N) {
            *slot = self.covariance[(index / N, index % N)];
        }
        rows
    }

    /// Whether this is a valid belief: finite, no mean beyond its limit, no negative or infinite variance, no
    /// correlation beyond ±1. Applied to input and to output, so that a successor never refuses a belief of
    /// this filter.
    pub fn is_possible(&self, limits: &SVector<f64, N>) -> bool {
        /// Tolerance for rounding in the correlations.
        const ROUNDING: f64 = 1.0 + 1e-6;
        /// A standard deviation of a thousand kilometres.
        const MAX_VARIANCE: f64 = 1e18;
        let p = &self.covariance;
        self.mean.iter().zip(limits.iter()).all(|(value, limit)| value.abs() <= *limit)
            && upper_triangle(N).all(|(row, column)| {
                let bound = p[(row, row)] * p[(column, column)];
                p[(row, column)].is_finite()
                    && (0.0..=MAX_VARIANCE).contains(&p[(row, row)])
                    && p[(row, column)].powi(2) <= bound * ROUNDING
            })
    }
}

/// A sum that does not add its first term to 0, which would take time.
fn sum(terms: impl Iterator<Item = f64>) -> f64 {
    terms.reduce(|sum, term| sum + term).unwrap_or(0.0)
}

/// The lower triangle L of a symmetric matrix L·Lᵀ; `None` if it is not positive definite. The library's
/// function gives the same result, but takes several times as long, since it does not know the size; likewise
/// the inverse.
pub fn cholesky<const Z: usize>(matrix: &SMatrix<f64, Z, Z>) -> Option<SMatrix<f64, Z, Z>> {
    let mut l = SMatrix::<f64, Z, Z>::zeros();
    for column in 0..Z {
        for row in column..Z {
            let mut value = matrix[(row, column)];
            for k in 0..column {
                value -= l[(column, k)] * l[(row, k)];
            }
            l[(row, column)] = value;
        }
        let square = l[(column, column)];
        // False for NaN, too.
        let root = if square > 0.0 { square.sqrt() } else { return None };
        l[(column, column)] = root;
        for row in column + 1..Z {
            l[(row, column)] /= root;
        }
    }
    Some(l)
}

/// Inverse of L·Lᵀ: for each column e of I, solves L y = e and Lᵀ x = y.
fn inverse<const Z: usize>(l: &SMatrix<f64, Z, Z>) -> SMatrix<f64, Z, Z> {
    let mut inverse = SMatrix::<f64, Z, Z>::identity();
    for column in 0..Z {
        for row in column..Z {
            let solved = inverse[(row, column)] / l[(row, row)];
            inverse[(row, column)] = solved;
            for below in row + 1..Z {
                inverse[(below, column)] -= solved * l[(below, row)];
            }
        }
        for row in (0..Z).rev() {
            let terms = (row + 1..Z).map(|below| l[(below, row)] * inverse[(below, column)]);
            inverse[(row, column)] = (inverse[(row, column)] - sum(terms)) / l[(row, row)];
        }
    }
    inverse
}

/// Rows and columns of the upper triangle of a `size`×`size` matrix, row by row.
fn upper_triangle(size: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..size).flat_map(move |row| (row..size).map(move |column| (row, column)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Matrix3, Matrix5, Vector2, Vector3};
    use proptest::prelude::*;

    fn gaussian(entries: [f64; 9], mean: [f64; 3]) -> Gaussian<3> {
        let root = Matrix3::from_row_slice(&entries);
        let mut result = Gaussian {
            mean: mean.into(),
            covariance: root * root.transpose() + Matrix3::identity() * 1e-3,
        };
        result.symmetrise();
        result
    }

    proptest! {
        /// If everything is measured, correction is eq. (14) as printed.
        #[test]
        fn correction_is_the_papers(
            entries in prop::array::uniform9(-3.0..3.0),
            mean in prop::array::uniform3(-10.0..10.0),
            measured in prop::array::uniform3(-10.0..10.0),
            sigma in prop::array::uniform3(0.1..3.0),
        ) {
            let before = gaussian(entries, mean);
            let variances = Vector3::from(sigma.map(|sigma: f64| sigma * sigma));
            let z = Vector3::from(measured);

            let r = Matrix3::from_diagonal(&variances);
            let k = before.covariance * (before.covariance + r).try_inverse().unwrap();
            let x = before.mean + k * (z - before.mean);
            let p = (Matrix3::identity() - k) * before.covariance;

            let mut after = before;
            let innovation = before.innovation(z - before.mean, &r).unwrap();
            after.correct(&innovation, &r);
            prop_assert!((after.mean - x).norm() < 1e-8);
            prop_assert!((after.covariance - p).norm() < 1e-8);
            prop_assert_eq!(after.covariance, after.covariance.transpose());
            prop_assert!(after.covariance.cholesky().is_some());
        }

        /// Equal to the library's results, bit for bit.
        #[test]
        fn shortcuts_change_nothing(
            entries in prop::array::uniform25(-3.0..3.0f64),
            mean in prop::array::uniform5(-10.0..10.0f64),
            difference in prop::array::uniform3(-5.0..5.0f64),
            noise in prop::array::uniform9(-2.0..2.0f64),
        ) {
            let root = Matrix5::from_row_slice(&entries);
            let covariance = root * root.transpose() + Matrix5::identity() * 1e-3;
            let mut state = Gaussian { mean: mean.into(), covariance };
            state.symmetrise();
            let root = Matrix3::from_row_slice(&noise);
            let noise = root * root.transpose() + Matrix3::identity() * 1e-3;
            let difference = Vector3::from(difference);

            let factor = (state.covariance.fixed_view::<3, 3>(0, 0) + noise).cholesky().unwrap();
            let innovation = state.innovation(difference, &noise).unwrap();
            prop_assert_eq!(innovation.precision, factor.inverse());
            let distance2 = difference.dot(&(innovation.precision * difference));
            let ln_determinant = 2.0 * factor.l_dirty().diagonal().map(f64::ln).sum();
            let constant = 3.0 * std::f64::consts::TAU.ln();
            prop_assert_eq!(innovation.distance2, distance2);
            prop_assert_eq!(innovation.ln_density, -0.5 * (distance2 + ln_determinant + constant));

            let gain = state.covariance.fixed_columns::<3>(0) * innovation.precision;
            let mut keep = Matrix5::identity();
            let mut measured = keep.fixed_columns_mut::<3>(0);
            measured -= gain;
            let mut corrected = Gaussian {
                mean: state.mean + gain * difference,
                covariance: keep * state.covariance * keep.transpose()
                    + gain * noise * gain.transpose(),
            };
            corrected.symmetrise();
            state.correct(&innovation, &noise);
            prop_assert_eq!(state, corrected);
        }

        /// Packing is lossless.
        #[test]
        fn packing_is_exact(entries in prop::array::uniform9(-3.0..3.0)) {
            let before = gaussian(entries, [1.0, 2.0, 3.0]);
            let packed: [f64; 6] = before.packed_covariance();
            prop_assert_eq!(Gaussian::from_packed([1.0, 2.0, 3.0], &packed), before);
        }
    }

    #[test]
    fn indefinite_matrices_have_no_root() {
        for matrix in [
            Matrix2::new(1.0, 2.0, 2.0, 1.0),
            Matrix2::new(0.0, 0.0, 0.0, 1.0),
            Matrix2::new(-1.0, 0.0, 0.0, 1.0),
            Matrix2::new(f64::NAN, 0.0, 0.0, 1.0),
            Matrix2::new(1.0, 1.0, 1.0, 1.0),
        ] {
            assert_eq!(cholesky(&matrix), None, "{matrix}");
            assert!(matrix.cholesky().is_none(), "{matrix}");
        }
    }

    #[test]
    fn part_of_the_state_can_be_measured() {
        // Position 1 ± 2 and a speed correlated with it; the position is measured as 3 ± 2.
        let mut state =
            Gaussian { mean: Vector2::new(1.0, 0.0), covariance: Matrix2::new(4.0, 2.0, 2.0, 3.0) };
        let noise = nalgebra::Matrix1::new(4.0);
        let innovation = state.innovation(nalgebra::Vector1::new(2.0), &noise).unwrap();
        assert!((innovation.distance2 - 0.5).abs() < 1e-12);
        let density = (-0.25f64).exp() / (std::f64::consts::TAU * 8.0).sqrt();
        assert!((innovation.ln_density - density.ln()).abs() < 1e-12);
        state.correct(&innovation, &noise);
        assert!((state.mean - Vector2::new(2.0, 0.5)).norm() < 1e-12);
        assert!((state.covariance - Matrix2::new(2.0, 1.0, 1.0, 2.5)).norm() < 1e-12);
    }

    #[test]
    fn impossible_beliefs_are_recognised() {
        let limits = Vector2::new(10.0, 10.0);
        let good =
            Gaussian { mean: Vector2::new(1.0, 0.0), covariance: Matrix2::new(4.0, 2.0, 2.0, 3.0) };
        assert!(good.is_possible(&limits));
        let with = |mean: f64, variance: f64, covariance: f64| Gaussian {
            mean: Vector2::new(mean, 0.0),
            covariance: Matrix2::new(variance, covariance, covariance, 3.0),
        };
        for (mean, variance, covariance) in [
            (f64::NAN, 4.0, 2.0),
            (11.0, 4.0, 2.0),
            (1.0, -4.0, 2.0),
            (1.0, f64::NAN, 2.0),
            (1.0, f64::INFINITY, 2.0),
            (1.0, 4.0, 4.0),
            (1.0, 4.0, f64::NAN),
        ] {
            let bad = with(mean, variance, covariance);
            assert!(!bad.is_possible(&limits), "{bad:?}");
        }
    }
}
