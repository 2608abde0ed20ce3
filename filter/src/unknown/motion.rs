//! Motion model of a robot of which only the team is known.

use crate::constant_velocity::{self, ConstantVelocity, wrap_nothing};
use crate::gaussian::Gaussian;
use crate::imm::{Imm, Wrap};
use crate::rolling::Rates;
use crate::track::Motion;
use config::{Config, FilterConfig, PatchRole};
use geometry::layout::Layout;
use messages::UNKNOWN_HYPOTHESES;
use nalgebra::{Matrix2, Matrix4, Vector2, Vector4};

/// Limit of a robot's speed.
const MAX_SPEED_MM_S: f64 = 4000.0;
/// Turning rate of robots, 1σ, rad/s: it moves the patch relative to the centre.
const TURNING_SIGMA: f64 = 4.0;

/// The constants of the filter, from the configuration, in mm and s.
///
/// The state is that of the team patch, which is measured to a millimetre from frame to frame. The offset
/// from patch to centre has known length and unknown direction; its covariance is added to the output only.
/// It must not be treated as measurement noise: it is constant, and a filter would average it away after a
/// few frames.
#[derive(Debug, Clone, PartialEq)]
pub struct UnknownMotion {
    motion: ConstantVelocity,
    noise: Matrix2<f64>,
    /// Acceleration noise of each hypothesis.
    accelerations: [f64; UNKNOWN_HYPOTHESES],
    patch_mm: Vector2<f64>,
}

impl UnknownMotion {
    /// From the configuration.
    pub fn new(config: &Config) -> Self {
        let FilterConfig { position_noise_mm, acceleration_noise_mm_s2, collision_factor, .. } =
            config.filter;
        let layout = Layout::new(&config.robots);
        let patch = layout.patches.iter().find(|patch| patch.role == PatchRole::Team);
        Self {
            motion: ConstantVelocity::new(0.0),
            noise: Matrix2::identity() * position_noise_mm.powi(2),
            accelerations: [1.0, collision_factor].map(|factor| factor * acceleration_noise_mm_s2),
            patch_mm: patch.map_or_else(Vector2::zeros, |patch| patch.centroid_mm.into()),
        }
    }

    /// Position of the team patch in the robot's frame.
    pub fn patch_mm(&self) -> &Vector2<f64> {
        &self.patch_mm
    }

    /// Predicts a belief about the patch by `dt_s` under one of the hypotheses (by its index).
    pub fn predict(&self, belief: &mut Gaussian<4>, hypothesis: usize, dt_s: f64) {
        self.motion.predict(belief, self.accelerations[hypothesis], dt_s);
    }

    /// The state after `dt_s`, without noise.
    pub fn advance(&self, state: &Vector4<f64>, dt_s: f64) -> Vector4<f64> {
        self.motion.advance(state, dt_s)
    }

    /// Rates of change of the patch's position.
    pub fn rates(&self, belief: &Gaussian<4>) -> Rates<2> {
        ConstantVelocity::rates(belief)
    }

    /// Belief about the centre, from that about the patch.
    pub fn center(&self, patch: Gaussian<4>) -> Gaussian<4> {
        let place = self.center_variance();
        let velocity = place * TURNING_SIGMA.powi(2);
        let unknown = Matrix4::from_diagonal(&Vector4::new(place, place, velocity, velocity));
        Gaussian { covariance: patch.covariance + unknown, ..patch }
    }

    /// Variance of each coordinate of the centre, given the patch: that of a point on a circle.
    pub fn center_variance(&self) -> f64 {
        self.patch_mm.norm_squared() / 2.0
    }
}

impl Motion<4, UNKNOWN_HYPOTHESES, 2> for UnknownMotion {
    const WRAP: Wrap<4> = wrap_nothing::<4>;
    const WRAP_MEASURED: Wrap<2> = wrap_nothing::<2>;
    /// Transition probabilities between two frames: rows from driving freely, struck; columns to the same.
    const TRANSITIONS: [[f64; UNKNOWN_HYPOTHESES]; UNKNOWN_HYPOTHESES] = [[0.99, 0.01], [0.9, 0.1]];

    fn noise(&self) -> &Matrix2<f64> {
        &self.noise
    }

    fn initial(&self, measured: &Vector2<f64>) -> Imm<4, UNKNOWN_HYPOTHESES> {
        Imm::new(constant_velocity::first_seen(measured, &self.noise), [0.9, 0.1])
    }

    fn reach(&self, dt_s: f64) -> Vector2<f64> {
        constant_velocity::reach(&self.noise, MAX_SPEED_MM_S * dt_s)
    }

    fn limits(&self) -> Vector4<f64> {
        constant_velocity::limits()
    }
}
