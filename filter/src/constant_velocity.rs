//! Motion in the plane at constant velocity, reduced by friction.
//!
//! The state is (x, y, vx, vy). Over a time T the velocity is multiplied by φ = (1 − friction)^T and the
//! position moves by T·ψ·v, with ψ = (φ − 1)/(T·ln(1 − friction)); the model is linear. Process noise is
//! white acceleration, as for a free robot.

use crate::gaussian::Gaussian;
use crate::rolling::Rates;
use config::FilterConfig;
use nalgebra::{Matrix2, Matrix4, SVector, Vector2, Vector4};

/// Limit of friction, which keeps the logarithm finite.
const MAX_FRICTION_PER_S: f64 = 0.999;
/// Initial standard deviation of the velocity.
const INITIAL_SPEED_SIGMA_MM_S: f64 = 1000.0;
/// Limit of the components of a state, in mm and s.
const MAX_COMPONENT: f64 = 1e6;
/// Tolerance of the distance between two sightings, standard deviations of a measurement.
const SIGMAS: f64 = 6.0;

/// Motion model of an object without commands, in mm and s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConstantVelocity {
    /// −ln(1 − friction): the rate at which the speed decays.
    decay_per_s: f64,
}

impl ConstantVelocity {
    /// For an object that loses this fraction of its speed in a second.
    pub fn new(friction_per_s: f64) -> Self {
        let friction = friction_per_s.clamp(0.0, MAX_FRICTION_PER_S);
        Self { decay_per_s: -(-friction).ln_1p() }
    }

    /// Predicts a belief by `dt_s`, with random accelerations of `acceleration_mm_s2` (1σ) that last for
    /// [`FilterConfig::NOISE_LASTS_S`].
    pub fn predict(&self, belief: &mut Gaussian<4>, acceleration_mm_s2: f64, dt_s: f64) {
        let a = self.transition(dt_s);
        let density = acceleration_mm_s2.powi(2) * FilterConfig::NOISE_LASTS_S;
        let mut q = Matrix4::zeros();
        for axis in 0..2 {
            q[(axis, axis)] = density * dt_s.powi(3) / 3.0;
            q[(axis, axis + 2)] = density * dt_s.powi(2) / 2.0;
            q[(axis + 2, axis)] = q[(axis, axis + 2)];
            q[(axis + 2, axis + 2)] = density * dt_s;
        }
        belief.mean = a * belief.mean;
        belief.covariance = a * belief.covariance * a.transpose() + q;
        belief.symmetrise();
    }

    /// The state after `dt_s`, without noise.
    pub fn advance(&self, state: &Vector4<f64>, dt_s: f64) -> Vector4<f64> {
        self.transition(dt_s) * state
    }

    /// Rate of change of the position.
    pub fn rates(belief: &Gaussian<4>) -> Rates<2> {
        Rates {
            mean: belief.mean.fixed_rows::<2>(2).into_owned(),
            covariance: belief.covariance.fixed_view::<2, 2>(2, 2).into_owned(),
        }
    }

    fn transition(&self, dt_s: f64) -> Matrix4<f64> {
        let decayed = self.decay_per_s * dt_s;
        let carried_s = if decayed > 0.0 { -(-decayed).exp_m1() / self.decay_per_s } else { dt_s };
        let mut a = Matrix4::identity();
        for axis in 0..2 {
            a[(axis, axis + 2)] = carried_s;
            a[(axis + 2, axis + 2)] = (-decayed).exp();
        }
        a
    }
}

/// The belief after a first measurement.
pub fn first_seen(measured: &Vector2<f64>, noise: &Matrix2<f64>) -> Gaussian<4> {
    let speed_variance = INITIAL_SPEED_SIGMA_MM_S.powi(2);
    let variances = Vector4::new(noise[(0, 0)], noise[(1, 1)], speed_variance, speed_variance);
    Gaussian {
        mean: Vector4::new(measured[0], measured[1], 0.0, 0.0),
        covariance: Matrix4::from_diagonal(&variances),
    }
}

/// Maximum distance between two sightings of an object that moves by at most `most_mm` between them.
pub fn reach(noise: &Matrix2<f64>, most_mm: f64) -> Vector2<f64> {
    noise.diagonal().map(|variance| most_mm + SIGMAS * variance.sqrt())
}

/// Limits of a valid state.
pub fn limits() -> Vector4<f64> {
    Vector4::repeat(MAX_COMPONENT)
}

/// For states without angles: wraps nothing.
pub fn wrap_nothing<const N: usize>(_: &mut SVector<f64, N>) {}
