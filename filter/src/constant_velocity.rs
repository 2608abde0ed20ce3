//! Motion in the plane with a velocity that stays, but for what friction takes of it.
//!
//! State (x, y, vx, vy). Over a time T the velocity falls by the factor φ = (1 − friction)^T and
//! carries the thing T·ψ·v, ψ = (φ − 1)/(T·ln(1 − friction)); the model is linear. Noise is white
//! acceleration, as for a free robot.

use crate::gaussian::Gaussian;
use crate::rolling::Rates;
use common::config::FilterConfig;
use nalgebra::{Matrix4, Vector4};

/// Friction that would stop a thing at once is taken as this, to keep the logarithm finite.
const MAX_FRICTION_PER_S: f64 = 0.999;

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
