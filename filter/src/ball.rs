//! The Kalman filter of the ball: constant velocity with rolling friction ([`constant_velocity`]).
//!
//! The state is (x, y, vx, vy), measured are x and y; prediction is x̂⁻ = A x̂, P⁻ = A P Aᵀ + Q, and
//! correction is eq. (14) of the paper with H = [I 0]. Two hypotheses differ in Q: a rolling ball hardly
//! accelerates, a kick changes the velocity by metres per second within a frame. They are combined by the
//! interacting-multiple-model scheme ([`imm`](crate::imm)).

use crate::constant_velocity::{self, ConstantVelocity, wrap_nothing};
use crate::gaussian::Gaussian;
use crate::imm::{Imm, Wrap};
use crate::rolling::Rates;
use crate::track::Motion;
use config::FilterConfig;
use messages::BALL_HYPOTHESES;
use nalgebra::{Matrix2, Vector2, Vector4};

/// Limit of a ball's speed, used to tell whether two sightings can be of the same ball.
const MAX_SPEED_MM_S: f64 = 6000.0;

/// The constants of the filter, from the configuration, in mm and s.
#[derive(Debug, Clone, PartialEq)]
pub struct BallMotion {
    noise: Matrix2<f64>,
    /// Acceleration noise of each hypothesis.
    accelerations: [f64; BALL_HYPOTHESES],
    rolling: ConstantVelocity,
}

impl BallMotion {
    /// From the configuration.
    pub fn new(config: &FilterConfig) -> Self {
        let rolling = config.ball_acceleration_noise_mm_s2;
        Self {
            noise: Matrix2::identity() * config.ball_noise_mm.powi(2),
            accelerations: [rolling, rolling * config.ball_kick_factor],
            rolling: ConstantVelocity::new(config.ball_friction_per_s),
        }
    }

    /// Predicts a belief by `dt_s` under one of the hypotheses (by its index).
    pub fn predict(&self, belief: &mut Gaussian<4>, hypothesis: usize, dt_s: f64) {
        self.rolling.predict(belief, self.accelerations[hypothesis], dt_s);
    }

    /// The state of a rolling ball after `dt_s`.
    pub fn advance(&self, state: &Vector4<f64>, dt_s: f64) -> Vector4<f64> {
        self.rolling.advance(state, dt_s)
    }

    /// Rate of change of its position.
    pub fn rates(&self, belief: &Gaussian<4>) -> Rates<2> {
        ConstantVelocity::rates(belief)
    }
}

impl Motion<4, BALL_HYPOTHESES, 2> for BallMotion {
    const WRAP: Wrap<4> = wrap_nothing::<4>;
    const WRAP_MEASURED: Wrap<2> = wrap_nothing::<2>;
    /// Transition probabilities between two frames: rows from rolling, struck; columns to the same.
    const TRANSITIONS: [[f64; BALL_HYPOTHESES]; BALL_HYPOTHESES] = [[0.98, 0.02], [0.9, 0.1]];

    fn noise(&self) -> &Matrix2<f64> {
        &self.noise
    }

    fn initial(&self, measured: &Vector2<f64>) -> Imm<4, BALL_HYPOTHESES> {
        Imm::new(constant_velocity::first_seen(measured, &self.noise), [0.9, 0.1])
    }

    fn reach(&self, dt_s: f64) -> Vector2<f64> {
        constant_velocity::reach(&self.noise, MAX_SPEED_MM_S * dt_s)
    }

    fn limits(&self) -> Vector4<f64> {
        constant_velocity::limits()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Config;
    use nalgebra::Matrix4;

    #[test]
    fn a_rolling_ball_slows_down() {
        let config = FilterConfig { ball_friction_per_s: 0.3, ..Config::default().filter };
        let motion = BallMotion::new(&config);
        let start = Vector4::new(0.0, 0.0, 1000.0, -500.0);
        let end = motion.advance(&start, 1.0);
        assert!((end[2] - 700.0).abs() < 1e-9 && (end[3] + 350.0).abs() < 1e-9, "{end}");
        // 300 / −ln 0.7
        assert!((end[0] - 841.1019).abs() < 1e-3, "{end}");
        // In any number of steps.
        let cut = (0..10).fold(start, |state, _| motion.advance(&state, 0.1));
        assert!((cut - end).norm() < 1e-9);
    }

    #[test]
    fn without_friction_it_rolls_on() {
        let config = FilterConfig { ball_friction_per_s: 0.0, ..Config::default().filter };
        let end = BallMotion::new(&config).advance(&Vector4::new(1.0, 2.0, 300.0, 40.0), 0.5);
        assert!((end - Vector4::new(151.0, 22.0, 300.0, 40.0)).norm() < 1e-9, "{end}");
        let config = FilterConfig { ball_friction_per_s: 1.0, ..Config::default().filter };
        let end = BallMotion::new(&config).advance(&Vector4::new(1.0, 2.0, 300.0, 40.0), 0.5);
        assert!(end.iter().all(|value| value.is_finite()));
    }

    #[test]
    fn two_halves_add_as_much_noise_as_one_whole() {
        let config = FilterConfig { ball_friction_per_s: 0.0, ..Config::default().filter };
        let motion = BallMotion::new(&config);
        let known = Gaussian { mean: Vector4::zeros(), covariance: Matrix4::zeros() };
        for hypothesis in 0..BALL_HYPOTHESES {
            let (mut once, mut twice) = (known, known);
            motion.predict(&mut once, hypothesis, 0.0125);
            motion.predict(&mut twice, hypothesis, 0.00625);
            motion.predict(&mut twice, hypothesis, 0.00625);
            let apart = (once.covariance - twice.covariance).norm();
            assert!(apart <= 1e-9 * once.covariance.norm(), "{apart}");
        }
    }
}
