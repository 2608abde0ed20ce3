//! The extended Kalman filter of a robot with differential drive (section 6.2 of the paper).
//!
//! # State
//!
//! The paper's state is (x, y, θ), eq. (10), with wheel speeds given. Here the speed v along the
//! heading and the turning rate ω are states too, so that one filter serves robots whose commands
//! are known and robots whose commands are not: a [`Drive`] says where v and ω come from.
//!
//! # Prediction over a time T
//!
//! With v̄ and ω̄ the means of the two speeds over T and θ_m = θ + T·ω̄/2 the heading half way:
//!
//! | state | after T | paper |
//! |---|---|---|
//! | x | x + T·v̄·cos θ_m | eq. (11): θ in place of θ_m |
//! | y | y + T·v̄·sin θ_m | eq. (11): θ in place of θ_m |
//! | θ | θ + T·ω̄ | eq. (11) |
//! | v, ω | u + φ·(v − u) for each, φ = e^(−T/lag) | – |
//!
//! For a [steered](Drive::Steered) robot u is the command, v_u = (v_R + v_L)/2 and ω_u = (v_R − v_L)/b (eq.
//! 7). Without lag φ = 0 and v̄ = v_u, ω̄ = ω_u: the speeds are set by the command and do not carry over into
//! the pose, which leaves the three-state filter of the paper. A [standing](Drive::Standing) robot is one
//! steered with u = 0. For a [free](Drive::Free) robot φ = 1: the speeds persist. In between, v̄ = u + ψ·(v − u)
//! with ψ = (1 − φ)·lag/T.
//!
//! Eq. (11) takes the heading at the start of the interval. A robot at 1 m/s turning at 10 rad/s would be
//! predicted T²·v·ω/2 = 0.8 mm to one side in every frame of 12.5 ms, more than the noise of the measurement.
//! The heading half way leaves an error of third order, T³·v·ω²/24 (0.008 mm), at no cost; for ω = 0 the two
//! are equal. A test compares both with a three-state filter written as the paper prints it.
//!
//! # Noise
//!
//! Q of eq. (12) is made of white noises, so that predicting twice over T/2 adds as much as once over T (with
//! a lag, nearly), and frames may come at any rate. The configured standard deviations are those of noise
//! that lasts for [`FilterConfig::NOISE_LASTS_S`], one frame at 80 fps: a speed noise of σ mm/s moves a robot
//! by σ·12.5 ms per frame.
//!
//! The noises of a steered robot are those of real wheels, which slip. In a synthetic match whose robots slip
//! as much (`synthetic.slip = 1`) innovations are distributed as predicted (`tests/match_consistency.rs`);
//! robots that obey exactly have far smaller ones.
//!
//! # Correlated measurement errors
//!
//! Eq. (14) assumes that the errors of successive measurements are independent. They are not: most of the
//! error of a pose comes from the position of its edges on the pixel grid, and persists until they have moved
//! by a part of a pixel. In the synthetic match most of the variance is of this kind, measured by centroids
//! or by edges, and its correlation over a distance d falls as e^(−d/0.8 mm), a fifth of a pixel. A filter
//! that takes a hundred measurements of a standing robot as independent converges to the error of that one
//! place, up to 2° in heading.
//!
//! With correlation ρ between neighbours, (1 + ρ)/(1 − ρ) measurements are worth one. So if a steered
//! robot's path to the next frame is short, R is multiplied by that factor in eq. (14)
//! ([`repeats`](RobotMotion::repeats)), which preserves the estimate made on the way to the standing place.
//! The gate uses the plain R. A free robot's path is not known well enough for this.

use crate::gaussian::Gaussian;
use crate::imm::{Imm, Wrap};
use crate::rolling::Rates;
use crate::track::Motion;
use config::{Config, FilterConfig};
use geometry::wrap_angle;
use messages::{QueuedCommand, ROBOT_HYPOTHESES};
use nalgebra::{Matrix3, Matrix5, Vector3, Vector5};

/// Indices into the state.
const X: usize = 0;
const Y: usize = 1;
const THETA: usize = 2;
const V: usize = 3;
const OMEGA: usize = 4;

/// Noise of a robot commanded to stand, relative to that of a driving one.
const STANDING_SLIP: f64 = 0.05;
/// Limit of the measurements that count as one: the sensor's noise makes each slightly independent, and a
/// robot that is moved against its commands must not be held in place for seconds.
const MAX_REPEATS: f64 = 30.0;
/// Initial standard deviations of the speeds.
const INITIAL_V_SIGMA_MM_S: f64 = 1000.0;
const INITIAL_OMEGA_SIGMA: f64 = 10.0;
/// Limits of a robot's speeds, used to tell whether two sightings can be of the same robot.
const MAX_V_MM_S: f64 = 4000.0;
const MAX_OMEGA: f64 = 40.0;

/// Source of a robot's speeds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drive {
    /// A command.
    Steered {
        /// v_L,ref
        left_mm_s: f64,
        /// v_R,ref
        right_mm_s: f64,
    },
    /// No command; the robot is assumed to stand.
    Standing,
    /// Unknown: the speeds persist and change at random.
    Free,
    /// Hit, lifted or pushed: free, with `filter.collision_factor` times the noise.
    Struck,
}

impl Drive {
    /// The drives of the hypotheses of a robot's track, in their order, while `command` acts.
    pub fn hypotheses(command: Option<&QueuedCommand>) -> [Drive; ROBOT_HYPOTHESES] {
        let steered = command.map_or(Drive::Standing, |command| Drive::Steered {
            left_mm_s: command.left_mm_s,
            right_mm_s: command.right_mm_s,
        });
        [steered, Drive::Free, Drive::Struck]
    }
}

/// The constants of the filter, from the configuration, in mm, s, rad.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotMotion {
    wheel_base_mm: f64,
    lag_s: f64,
    noise: Matrix3<f64>,
    acceleration: f64,
    angular_acceleration: f64,
    lateral: f64,
    slip: f64,
    angular_slip: f64,
    collision_factor: f64,
    repeat_distance_mm: f64,
}

/// Quantities of a prediction step.
struct Step {
    dt_s: f64,
    /// v̄ and ω̄.
    mean_v: f64,
    mean_omega: f64,
    /// sin θ_m and cos θ_m.
    sin: f64,
    cos: f64,
    u_v: f64,
    u_omega: f64,
    phi: f64,
    psi: f64,
}

impl RobotMotion {
    /// From the configuration.
    pub fn new(config: &Config) -> Self {
        let filter = &config.filter;
        let heading_sigma = filter.heading_noise_deg.to_radians();
        Self {
            wheel_base_mm: config.robots.wheel_base_mm,
            lag_s: filter.command_lag_ms * 1e-3,
            noise: Matrix3::from_diagonal(&Vector3::new(
                filter.position_noise_mm.powi(2),
                filter.position_noise_mm.powi(2),
                heading_sigma.powi(2),
            )),
            acceleration: filter.acceleration_noise_mm_s2,
            angular_acceleration: filter.angular_acceleration_noise_deg_s2.to_radians(),
            lateral: filter.lateral_noise_mm_s,
            slip: filter.command_noise_mm_s,
            angular_slip: filter.command_noise_deg_s.to_radians(),
            collision_factor: filter.collision_factor,
            repeat_distance_mm: filter.repeat_distance_mm,
        }
    }

    /// Eqs. (11) and (12): predicts a belief by `dt_s`. Returns the distance that the faster wheel rolls
    /// meanwhile.
    pub fn predict(&self, belief: &mut Gaussian<5>, drive: Drive, dt_s: f64) -> f64 {
        let step = self.step(&belief.mean, drive, dt_s);
        let propagated = propagated(&step.jacobian(), &belief.covariance);
        belief.mean = step.end(&belief.mean);
        belief.covariance = propagated + self.process_noise(&step, drive);
        belief.symmetrise();
        (step.mean_v.abs() + 0.5 * self.wheel_base_mm * step.mean_omega.abs()) * dt_s
    }

    /// Eq. (11): f(x̂, u).
    pub fn advance(&self, state: &Vector5<f64>, drive: Drive, dt_s: f64) -> Vector5<f64> {
        self.step(state, drive, dt_s).end(state)
    }

    /// Eq. (13): the partial derivatives of [`advance`](Self::advance).
    pub fn jacobian(&self, state: &Vector5<f64>, drive: Drive, dt_s: f64) -> Matrix5<f64> {
        self.step(state, drive, dt_s).jacobian()
    }

    /// For each hypothesis, the number of consecutive measurements that share one error, if a steered robot's
    /// wheels roll `path_mm` between them; see the module's section on correlated measurement errors.
    pub fn repeats(&self, path_mm: f64) -> [f64; ROBOT_HYPOTHESES] {
        let steered = if self.repeat_distance_mm > 0.0 {
            let correlation = (-path_mm / self.repeat_distance_mm).exp();
            ((1.0 + correlation) / (1.0 - correlation)).min(MAX_REPEATS)
        } else {
            1.0
        };
        [steered, 1.0, 1.0]
    }

    /// Rates of change of position and heading.
    pub fn rates(&self, belief: &Gaussian<5>) -> Rates<3> {
        let (mean, covariance) = (&belief.mean, &belief.covariance);
        let (sin, cos) = mean[THETA].sin_cos();
        let (forward, turning) = (Vector3::new(cos, sin, 0.0), Vector3::z());
        Rates {
            mean: mean[V] * forward + mean[OMEGA] * turning,
            covariance: covariance[(V, V)] * forward * forward.transpose()
                + covariance[(OMEGA, OMEGA)] * turning * turning.transpose(),
        }
    }

    /// Q of eq. (12).
    fn process_noise(&self, step: &Step, drive: Drive) -> Matrix5<f64> {
        let Step { dt_s, sin, cos, .. } = *step;
        let density = |sigma: f64| sigma * sigma * FilterConfig::NOISE_LASTS_S;
        let scale = self.noise_scale(drive);
        let lateral = density(scale * self.lateral) * dt_s;
        // The upper triangle: sideways · sidewaysᵀ, with sideways = (−sin, cos).
        let mut q = Matrix5::zeros();
        q[(X, X)] = sin * sin * lateral;
        q[(X, Y)] = -sin * cos * lateral;
        q[(Y, Y)] = cos * cos * lateral;
        // Along (cos, sin), and about the heading.
        let mut add = |forward: f64, turning: f64| {
            q[(X, X)] += cos * cos * forward;
            q[(X, Y)] += cos * sin * forward;
            q[(Y, Y)] += sin * sin * forward;
            q[(THETA, THETA)] += turning;
        };
        if let Drive::Free | Drive::Struck = drive {
            // White acceleration, integrated once into the speed and twice into the pose.
            let forward = density(scale * self.acceleration);
            let turning = density(scale * self.angular_acceleration);
            let cube = |density: f64| density * dt_s.powi(3) / 3.0;
            add(cube(forward), cube(turning));
            let shared = |density: f64| density * dt_s.powi(2) / 2.0;
            q[(X, V)] = cos * shared(forward);
            q[(Y, V)] = sin * shared(forward);
            q[(THETA, OMEGA)] = shared(turning);
            q[(V, V)] = forward * dt_s;
            q[(OMEGA, OMEGA)] = turning * dt_s;
        } else {
            // White speed, integrated into the pose; the speed itself converges to the command and loses its
            // old noise.
            let (slip, angular_slip) = (scale * self.slip, scale * self.angular_slip);
            add(density(slip) * dt_s, density(angular_slip) * dt_s);
            let forgotten = 1.0 - step.phi * step.phi;
            q[(V, V)] = slip * slip * forgotten;
            q[(OMEGA, OMEGA)] = angular_slip * angular_slip * forgotten;
        }
        q.fill_lower_triangle_with_upper_triangle();
        q
    }

    /// Noise of a drive relative to the configured one: standing wheels do not slip.
    fn noise_scale(&self, drive: Drive) -> f64 {
        match drive {
            Drive::Steered { left_mm_s, right_mm_s } => {
                let wheel_mm_s = left_mm_s.abs().max(right_mm_s.abs());
                (wheel_mm_s / FilterConfig::FULL_SLIP_MM_S).clamp(STANDING_SLIP, 1.0)
            }
            Drive::Standing => STANDING_SLIP,
            Drive::Free => 1.0,
            Drive::Struck => self.collision_factor,
        }
    }

    /// Quantities of a step from a state over `dt_s`.
    fn step(&self, state: &Vector5<f64>, drive: Drive, dt_s: f64) -> Step {
        // u + φ·(v − u) and u + ψ·(v − u), for both speeds.
        let (u_v, u_omega, phi, psi) = match drive {
            Drive::Steered { left_mm_s, right_mm_s } => {
                let (phi, psi) = if self.lag_s > 0.0 && dt_s > 0.0 {
                    let lags = dt_s / self.lag_s;
                    ((-lags).exp(), -(-lags).exp_m1() / lags)
                } else {
                    (0.0, 0.0)
                };
                let u_v = 0.5 * (right_mm_s + left_mm_s);
                (u_v, (right_mm_s - left_mm_s) / self.wheel_base_mm, phi, psi)
            }
            Drive::Standing => (0.0, 0.0, 0.0, 0.0),
            Drive::Free | Drive::Struck => (0.0, 0.0, 1.0, 1.0),
        };
        let mean_omega = u_omega + psi * (state[OMEGA] - u_omega);
        let (sin, cos) = (state[THETA] + 0.5 * dt_s * mean_omega).sin_cos();
        let mean_v = u_v + psi * (state[V] - u_v);
        Step { dt_s, mean_v, mean_omega, sin, cos, u_v, u_omega, phi, psi }
    }
}

impl Step {
    fn end(&self, state: &Vector5<f64>) -> Vector5<f64> {
        let Self { dt_s, mean_v, mean_omega, sin, cos, u_v, u_omega, phi, .. } = *self;
        Vector5::new(
            state[X] + dt_s * mean_v * cos,
            state[Y] + dt_s * mean_v * sin,
            wrap_angle(state[THETA] + dt_s * mean_omega),
            u_v + phi * (state[V] - u_v),
            u_omega + phi * (state[OMEGA] - u_omega),
        )
    }

    fn jacobian(&self) -> Matrix5<f64> {
        let Self { dt_s, mean_v, sin, cos, phi, psi, .. } = *self;
        let half_turn = 0.5 * dt_s * psi;
        let mut a = Matrix5::identity();
        a[(X, THETA)] = -dt_s * mean_v * sin;
        a[(Y, THETA)] = dt_s * mean_v * cos;
        a[(X, V)] = dt_s * psi * cos;
        a[(Y, V)] = dt_s * psi * sin;
        a[(X, OMEGA)] = -dt_s * mean_v * sin * half_turn;
        a[(Y, OMEGA)] = dt_s * mean_v * cos * half_turn;
        a[(THETA, OMEGA)] = dt_s * psi;
        a[(V, V)] = phi;
        a[(OMEGA, OMEGA)] = phi;
        a
    }
}

/// A·P·Aᵀ for a [jacobian](Step::jacobian), most of which is 0, and symmetric P; only its upper triangle.
fn propagated(a: &Matrix5<f64>, p: &Matrix5<f64>) -> Matrix5<f64> {
    // Rows of A·P; rows of P are its columns.
    let along = |axis: usize| {
        p.column(axis)
            + p.column(THETA) * a[(axis, THETA)]
            + p.column(V) * a[(axis, V)]
            + p.column(OMEGA) * a[(axis, OMEGA)]
    };
    let rows = [
        along(X),
        along(Y),
        p.column(THETA) + p.column(OMEGA) * a[(THETA, OMEGA)],
        p.column(V) * a[(V, V)],
        p.column(OMEGA) * a[(OMEGA, OMEGA)],
    ];
    let mut propagated = Matrix5::zeros();
    for (index, row) in rows.iter().enumerate() {
        for axis in [X, Y] {
            propagated[(index, axis)] = row[axis]
                + row[THETA] * a[(axis, THETA)]
                + row[V] * a[(axis, V)]
                + row[OMEGA] * a[(axis, OMEGA)];
        }
        propagated[(index, THETA)] = row[THETA] + row[OMEGA] * a[(THETA, OMEGA)];
        propagated[(index, V)] = row[V] * a[(V, V)];
        propagated[(index, OMEGA)] = row[OMEGA] * a[(OMEGA, OMEGA)];
    }
    propagated
}

impl Motion<5, ROBOT_HYPOTHESES, 3> for RobotMotion {
    const WRAP: Wrap<5> = wrap_heading::<5>;
    const WRAP_MEASURED: Wrap<3> = wrap_heading::<3>;
    /// Transition probabilities between two frames: rows from steered, free, struck; columns to the same. A
    /// steered robot becomes free if it departs from its command, a free one becomes steered if it stops (or
    /// obeys again), and a collision lasts for a frame or two.
    const TRANSITIONS: [[f64; ROBOT_HYPOTHESES]; ROBOT_HYPOTHESES] =
        [[0.992, 0.007, 0.001], [0.020, 0.977, 0.003], [0.300, 0.600, 0.100]];

    fn noise(&self) -> &Matrix3<f64> {
        &self.noise
    }

    fn initial(&self, measured: &Vector3<f64>) -> Imm<5, ROBOT_HYPOTHESES> {
        let belief = Gaussian {
            mean: Vector5::new(measured[X], measured[Y], measured[THETA], 0.0, 0.0),
            covariance: Matrix5::from_diagonal(&Vector5::new(
                self.noise[(X, X)],
                self.noise[(Y, Y)],
                self.noise[(THETA, THETA)],
                INITIAL_V_SIGMA_MM_S.powi(2),
                INITIAL_OMEGA_SIGMA.powi(2),
            )),
        };
        Imm::new(belief, [0.45, 0.45, 0.10])
    }

    fn reach(&self, dt_s: f64) -> Vector3<f64> {
        Vector3::new(MAX_V_MM_S, MAX_V_MM_S, MAX_OMEGA) * dt_s
            + self.noise.diagonal().map(|variance| 6.0 * variance.sqrt())
    }

    fn limits(&self) -> Vector5<f64> {
        Vector5::new(1e6, 1e6, std::f64::consts::PI, 1e6, 1e5)
    }
}

fn wrap_heading<const N: usize>(state: &mut nalgebra::SVector<f64, N>) {
    state[THETA] = wrap_angle(state[THETA]);
}

#[cfg(test)]
mod tests;
