//! Nonlinear least squares by the Levenberg–Marquardt method (Nocedal & Wright, *Numerical
//! Optimization*, section 10.3), for the few parameters and few hundred residuals of a camera.
//!
//! With residuals r and their Jacobian J (by central differences), each step solves
//!
//! ```text
//! (JᵀJ + λ·diag(JᵀJ))·δ = Jᵀr
//! ```
//!
//! and subtracts δ from the parameters if that lowers the sum of squares. λ is divided by 10 after a
//! successful step and multiplied by 10 after a failed one. The covariance of the parameters is (JᵀJ)⁻¹
//! at the end.

use nalgebra::{DMatrix, DVector};

/// Result of a minimisation.
#[derive(Debug, Clone)]
pub(super) struct Minimum {
    /// The parameters at the minimum.
    pub parameters: DVector<f64>,
    /// The sum of squares at the minimum.
    pub sum_of_squares: f64,
    /// Covariance of the parameters for residuals of variance 1; `None` if they are not determined.
    pub covariance: Option<DMatrix<f64>>,
}

const MAX_STEPS: usize = 200;
/// Step of the central differences; parameters are of order one.
const DERIVATIVE_STEP: f64 = 1e-6;

/// Finds the local minimum of the sum of squares near `start`. Parameters should be scaled to order
/// one. `None` if the residuals are not finite at the start.
pub(super) fn minimise(
    start: DVector<f64>,
    residuals: impl Fn(&DVector<f64>) -> DVector<f64>,
) -> Option<Minimum> {
    let mut parameters = start;
    let mut rest = residuals(&parameters);
    let mut cost = rest.norm_squared();
    if !cost.is_finite() {
        return None;
    }
    let mut damping = 1e-3;
    for _ in 0..MAX_STEPS {
        let jacobian = jacobian(&parameters, rest.len(), &residuals);
        let normal = jacobian.tr_mul(&jacobian);
        let gradient = jacobian.tr_mul(&rest);
        let Some((next, next_rest, next_cost)) =
            step(&parameters, &normal, &gradient, cost, &mut damping, &residuals)
        else {
            break;
        };
        let gain = cost - next_cost;
        (parameters, rest, cost) = (next, next_rest, next_cost);
        if gain <= 1e-12 * cost || cost < 1e-18 {
            break;
        }
    }
    let jacobian = jacobian(&parameters, rest.len(), &residuals);
    let covariance = invert(jacobian.tr_mul(&jacobian));
    Some(Minimum { parameters, sum_of_squares: cost, covariance })
}

/// A step that lowers the sum of squares; `None` if there is none.
fn step(
    parameters: &DVector<f64>,
    normal: &DMatrix<f64>,
    gradient: &DVector<f64>,
    cost: f64,
    damping: &mut f64,
    residuals: &impl Fn(&DVector<f64>) -> DVector<f64>,
) -> Option<(DVector<f64>, DVector<f64>, f64)> {
    while *damping < 1e12 {
        let mut damped = normal.clone();
        for index in 0..damped.nrows() {
            damped[(index, index)] += *damping * normal[(index, index)].max(1e-12);
        }
        if let Some(decomposed) = damped.cholesky() {
            let next = parameters - decomposed.solve(gradient);
            let rest = residuals(&next);
            let next_cost = rest.norm_squared();
            // False for a NaN.
            if next_cost < cost {
                *damping = (*damping / 10.0).max(1e-12);
                return Some((next, rest, next_cost));
            }
        }
        *damping *= 10.0;
    }
    None
}

fn jacobian(
    parameters: &DVector<f64>,
    rows: usize,
    residuals: &impl Fn(&DVector<f64>) -> DVector<f64>,
) -> DMatrix<f64> {
    let mut jacobian = DMatrix::zeros(rows, parameters.len());
    let mut moved = parameters.clone();
    for column in 0..parameters.len() {
        moved[column] = parameters[column] + DERIVATIVE_STEP;
        let ahead = residuals(&moved);
        moved[column] = parameters[column] - DERIVATIVE_STEP;
        let behind = residuals(&moved);
        moved[column] = parameters[column];
        jacobian.set_column(column, &((ahead - behind) / (2.0 * DERIVATIVE_STEP)));
    }
    jacobian
}

/// The inverse of a normal matrix; `None` if it is numerically singular.
fn invert(normal: DMatrix<f64>) -> Option<DMatrix<f64>> {
    // Scaled to a unit diagonal, so that different units do not look like a singular matrix.
    let scale = normal.diagonal().map(f64::sqrt);
    if !scale.iter().all(|&scale| scale > 0.0 && scale.is_finite()) {
        return None;
    }
    let scale = DMatrix::from_diagonal(&scale.map(f64::recip));
    let scaled = &scale * normal * &scale;
    let eigenvalues = scaled.symmetric_eigenvalues();
    if eigenvalues.min() < 1e-11 * eigenvalues.max() {
        return None;
    }
    Some(&scale * scaled.try_inverse()? * &scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bent_valley_leads_to_its_lowest_point() {
        // Rosenbrock's function as residuals: the minimum is at (1, 1).
        let minimum = minimise(DVector::from_vec(vec![-1.2, 1.0]), |p| {
            DVector::from_vec(vec![10.0 * (p[1] - p[0] * p[0]), 1.0 - p[0]])
        })
        .unwrap();
        assert!((minimum.parameters - DVector::from_vec(vec![1.0, 1.0])).norm() < 1e-6);
        assert!(minimum.sum_of_squares < 1e-12);
    }

    #[test]
    fn the_covariance_of_a_line_is_the_textbooks() {
        // y = a + b·x at x = −1, 0, 1: variances 1/3 and 1/2.
        let minimum = minimise(DVector::zeros(2), |p| {
            DVector::from_iterator(3, [-1.0, 0.0, 1.0].map(|x| p[0] + p[1] * x - 2.0 - 3.0 * x))
        })
        .unwrap();
        let covariance = minimum.covariance.unwrap();
        assert!((covariance[(0, 0)] - 1.0 / 3.0).abs() < 1e-6);
        assert!((covariance[(1, 1)] - 0.5).abs() < 1e-6);
    }

    #[test]
    fn undetermined_parameters_have_no_covariance() {
        let sum_only = |p: &DVector<f64>| DVector::from_vec(vec![p[0] + p[1] - 1.0, 0.0]);
        let minimum = minimise(DVector::zeros(2), sum_only).unwrap();
        assert!(minimum.sum_of_squares < 1e-12 && minimum.covariance.is_none());
        assert!(minimise(DVector::zeros(1), |_| DVector::from_vec(vec![f64::NAN])).is_none());
    }
}
