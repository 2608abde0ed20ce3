//! Motion in the plane with a velocity that stays, but for what friction takes of it.
//!
//! State (x, y, vx, vy). Over a time T the velocity falls by the factor φ = (1 − friction)^T and
//! carries the thing T·ψ·v, ψ = (φ − 1)/(T·ln(1 − friction)); the model is linear. Noise is white
//! acceleration, as for a free robot.

use crate::gaussian::Gaussian;
use crate::rolling::Rates;
use common::config::FilterConfig;
use nalgebra::{Matrix2, Matrix4, SVector, Vector2, Vector4};

/// Friction that would stop a thing at once is taken as this, to keep the logarithm finite.
const MAX_FRICTION_PER_S: f64 = 0.999;
/// Uncertainty of the velocity of a thing seen for the first time.
const INITIAL_SPEED_SIGMA_MM_S: f64 = 1000.0;
/// A state that is farther from 0 than this, in mm and s, is none.
const MOST: f64 = 1e6;
/// How many deviations of a measurement a thing may seem to have gone farther than it has.
const SIGMAS: f64 = 6.0;

/// How a thing moves that nobody steers, in mm and s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConstantVelocity {
    /// −ln(1 − friction): the rate at which the speed decays.
    decay_per_s: f64,
}

impl ConstantVelocity {
    /// Of a thing that loses this fraction of its speed in a second.
    pub fn new(friction_per_s: f64) -> Self {
        let friction = friction_per_s.clamp(0.0, MAX_FRICTION_PER_S);
        Self { decay_per_s: -(-friction).ln_1p() }
    }

    /// What is believed `dt_s` later of a thing whose velocity changes at random, with accelerations of
    /// `acceleration_mm_s2` (1σ) that last for [`FilterConfig::NOISE_LASTS_S`].
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

    /// Where it moves to.
    pub fn advance(&self, state: &Vector4<f64>, dt_s: f64) -> Vector4<f64> {
        self.transition(dt_s) * state
    }

    /// How fast its position changes.
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

/// What is believed of a thing seen for the first time.
pub fn first_seen(measured: &Vector2<f64>, noise: &Matrix2<f64>) -> Gaussian<4> {
    let speed_variance = INITIAL_SPEED_SIGMA_MM_S.powi(2);
    let variances = Vector4::new(noise[(0, 0)], noise[(1, 1)], speed_variance, speed_variance);
    Gaussian {
        mean: Vector4::new(measured[0], measured[1], 0.0, 0.0),
        covariance: Matrix4::from_diagonal(&variances),
    }
}

/// How far apart two sightings of a thing can be that goes `most_mm` at most between them.
pub fn reach(noise: &Matrix2<f64>, most_mm: f64) -> Vector2<f64> {
    noise.diagonal().map(|variance| most_mm + SIGMAS * variance.sqrt())
}

/// Beyond these there is no state.
pub fn limits() -> Vector4<f64> {
    Vector4::repeat(MOST)
}

/// No component of such a state is an angle.
pub fn no_angles<const N: usize>(_: &mut SVector<f64, N>) {}
