use super::*;
use nalgebra::{Matrix3, SMatrix, SVector, Vector2};
use proptest::prelude::*;

const T: f64 = 0.0125;

fn motion(change: impl Fn(&mut config::FilterConfig)) -> RobotMotion {
    let mut config = Config::default();
    change(&mut config.filter);
    RobotMotion::new(&config)
}

fn start(pose: [f64; 3], variances: [f64; 5]) -> Gaussian<5> {
    Gaussian {
        mean: Vector5::new(pose[0], pose[1], pose[2], 0.0, 0.0),
        covariance: Matrix5::from_diagonal(&variances.into()),
    }
}

fn drive(kind: i32, wheels: [f64; 2]) -> Drive {
    match kind {
        0 => Drive::Steered { left_mm_s: wheels[0], right_mm_s: wheels[1] },
        1 => Drive::Standing,
        2 => Drive::Free,
        _ => Drive::Struck,
    }
}

/// Q of eq. (12) as sums of outer products.
fn process_noise(motion: &RobotMotion, state: &Vector5<f64>, drive: Drive, t: f64) -> Matrix5<f64> {
    let step = motion.step(state, drive, t);
    let forward = Vector5::new(step.cos, step.sin, 0.0, 0.0, 0.0);
    let sideways = Vector5::new(-step.sin, step.cos, 0.0, 0.0, 0.0);
    let (turning, v, omega) = (Vector5::z(), Vector5::w(), Vector5::a());
    let density = |sigma: f64| sigma * sigma * FilterConfig::NOISE_LASTS_S;
    let scale = motion.noise_scale(drive);
    let mut q = sideways * sideways.transpose() * (density(scale * motion.lateral) * t);
    if let Drive::Free | Drive::Struck = drive {
        let axes = [
            (forward, v, density(scale * motion.acceleration)),
            (turning, omega, density(scale * motion.angular_acceleration)),
        ];
        for (axis, speed, density) in axes {
            let shared = axis * speed.transpose() + speed * axis.transpose();
            q += axis * axis.transpose() * (density * t.powi(3) / 3.0);
            q += shared * (density * t.powi(2) / 2.0);
            q += speed * speed.transpose() * (density * t);
        }
    } else {
        let axes =
            [(forward, v, scale * motion.slip), (turning, omega, scale * motion.angular_slip)];
        for (axis, speed, sigma) in axes {
            q += axis * axis.transpose() * (density(sigma) * t);
            q += speed * speed.transpose() * (sigma * sigma * (1.0 - step.phi * step.phi));
        }
    }
    q
}

/// The paper's filter: three states, eqs. (11) to (14) as printed, except for the heading in eq. (11): at the
/// start of the interval (0) or half way (0.5).
struct ThreeStates {
    x: Vector3<f64>,
    p: Matrix3<f64>,
    wheel_base_mm: f64,
    heading_at: f64,
}

impl ThreeStates {
    fn predict(&mut self, left: f64, right: f64, t: f64, q: Matrix3<f64>) {
        let turn = t / self.wheel_base_mm * (right - left);
        let step = 0.5 * t * (left + right);
        let heading = self.x[2] + self.heading_at * turn;
        self.x += Vector3::new(step * heading.cos(), step * heading.sin(), turn);
        let a = Matrix3::new(
            1.0,
            0.0,
            -step * heading.sin(),
            0.0,
            1.0,
            step * heading.cos(),
            0.0,
            0.0,
            1.0,
        );
        self.p = a * self.p * a.transpose() + q;
    }

    fn correct(&mut self, z: Vector3<f64>, r: Matrix3<f64>) {
        let k = self.p * (self.p + r).try_inverse().unwrap();
        let mut innovation = z - self.x;
        innovation[2] = wrap_angle(innovation[2]);
        self.x += k * innovation;
        self.p = (Matrix3::identity() - k) * self.p;
    }
}

/// Runs both filters on the same commands and measurements; returns the largest distance between their means
/// and between their covariances.
fn compare(motion: &RobotMotion, heading_at: f64, frames: &[([f64; 2], [f64; 3])]) -> (f64, f64) {
    let mut ours = start([10.0, 20.0, 0.5], [1.0, 2.0, 0.01, 0.0, 0.0]);
    let mut papers = ThreeStates {
        x: Vector3::new(10.0, 20.0, 0.5),
        p: Matrix3::from_diagonal(&Vector3::new(1.0, 2.0, 0.01)),
        wheel_base_mm: motion.wheel_base_mm,
        heading_at,
    };
    let r = motion.noise;
    let mut worst = (0.0f64, 0.0f64);
    for &([left_mm_s, right_mm_s], noise) in frames {
        let drive = Drive::Steered { left_mm_s, right_mm_s };
        let q = motion.process_noise(&motion.step(&ours.mean, drive, T), drive);
        let q = q.fixed_view::<3, 3>(0, 0).into_owned();
        motion.predict(&mut ours, drive, T);
        papers.predict(left_mm_s, right_mm_s, T, q);
        let z = papers.x + Vector3::from(noise);
        let mut difference = z - ours.mean.fixed_rows::<3>(0);
        wrap_heading(&mut difference);
        let innovation = ours.innovation(difference, &motion.noise).unwrap();
        ours.correct(&innovation, &motion.noise);
        wrap_heading(&mut ours.mean);
        papers.correct(z, r);
        let mut apart = papers.x - ours.mean.fixed_rows::<3>(0);
        wrap_heading(&mut apart);
        worst.0 = worst.0.max(apart.norm());
        worst.1 = worst.1.max((papers.p - ours.covariance.fixed_view::<3, 3>(0, 0)).norm());
    }
    worst
}

fn frames(
    speeds: impl Strategy<Value = [f64; 2]>,
) -> impl Strategy<Value = Vec<([f64; 2], [f64; 3])>> {
    let noise = [-1.0..1.0, -1.0..1.0, -0.03..0.03];
    prop::collection::vec((speeds, noise), 1..40)
}

proptest! {
    /// With commands, no lag and no noise of the speeds: eqs. (11)–(14) with the heading half way, state and
    /// covariance.
    #[test]
    fn steered_is_the_papers_filter(
        frames in frames([-1500.0..1500.0, -1500.0..1500.0]),
    ) {
        let silent = motion(|filter| {
            filter.command_noise_mm_s = 0.0;
            filter.command_noise_deg_s = 0.0;
            filter.lateral_noise_mm_s = 0.0;
        });
        let (mean, covariance) = compare(&silent, 0.5, &frames);
        prop_assert!(mean < 1e-8 && covariance < 1e-8, "{mean} {covariance}");
        // With noise, too, the speeds do not carry over into the pose.
        let (mean, covariance) = compare(&motion(|_| {}), 0.5, &frames);
        prop_assert!(mean < 1e-8 && covariance < 1e-8, "{mean} {covariance}");
    }

    /// Straight on, it is exactly eq. (11).
    #[test]
    fn straight_on_nothing_differs_from_the_paper(
        frames in frames((-1500.0..1500.0).prop_map(|v| [v, v])),
    ) {
        let (mean, covariance) = compare(&motion(|_| {}), 0.0, &frames);
        prop_assert!(mean < 1e-8 && covariance < 1e-8, "{mean} {covariance}");
    }

    /// In a curve it differs by the stated term, and is nearer to the true arc.
    #[test]
    fn in_a_curve_half_way_is_nearer_to_the_arc(
        left_mm_s in -1500.0..1500.0,
        right_mm_s in -1500.0..1500.0,
        theta in -3.0..3.0,
    ) {
        let motion = motion(|_| {});
        let from = Vector5::new(0.0, 0.0, theta, 0.0, 0.0);
        let drive = Drive::Steered { left_mm_s, right_mm_s };
        let ours = motion.advance(&from, drive, T).fixed_rows::<2>(0).into_owned();
        let (v, omega) = (0.5 * (left_mm_s + right_mm_s), (right_mm_s - left_mm_s) / 65.0);
        let papers = Vector2::new(theta.cos(), theta.sin()) * (v * T);
        // Its chord: a difference of two points on a large circle would be lost in rounding.
        let half = 0.5 * omega * T;
        let chord = v * T * if half == 0.0 { 1.0 } else { half.sin() / half };
        let arc = Vector2::new((theta + half).cos(), (theta + half).sin()) * chord;
        let bound = T * T * (v * omega).abs() / 2.0;
        prop_assert!((ours - papers).norm() <= bound + 1e-9);
        prop_assert!((ours - arc).norm() <= T.powi(3) * (v * omega * omega).abs() / 24.0 + 1e-9);
        prop_assert!((ours - arc).norm() <= (papers - arc).norm() + 1e-9);
    }

    /// Eq. (13) against finite differences.
    #[test]
    fn jacobian_is_the_derivative(
        state in prop::array::uniform5(-1.0..1.0),
        wheels in prop::array::uniform2(-1500.0..1500.0),
        kind in 0..4,
        lag_ms in prop_oneof![Just(0.0), 1.0..200.0],
        t in 0.001..0.05,
    ) {
        let motion = motion(|filter| filter.command_lag_ms = lag_ms);
        let drive = drive(kind, wheels);
        let scale = Vector5::new(1000.0, 1000.0, 3.0, 1500.0, 10.0);
        let state = Vector5::from(state).component_mul(&scale);
        let a = motion.jacobian(&state, drive, t);
        for column in 0..5 {
            let mut step = Vector5::zeros();
            step[column] = 1e-5 * scale[column];
            let mut difference =
                motion.advance(&(state + step), drive, t) - motion.advance(&(state - step), drive, t);
            wrap_heading(&mut difference);
            let numeric = difference / (2.0 * step[column]);
            prop_assert!((a.column(column) - numeric).norm() < 1e-4, "{a} {column} {numeric}");
        }
    }

    /// Skipping zeros changes no bit of eqs. (12) and (13).
    #[test]
    fn shortcuts_change_nothing(
        state in prop::array::uniform5(-1.0..1.0),
        entries in prop::array::uniform25(-3.0..3.0),
        wheels in prop::array::uniform2(-1500.0..1500.0),
        kind in 0..4,
        lag_ms in prop_oneof![Just(0.0), 1.0..200.0],
        t in 0.001..0.05,
    ) {
        let motion = motion(|filter| filter.command_lag_ms = lag_ms);
        let drive = drive(kind, wheels);
        let scale = Vector5::new(1000.0, 1000.0, 3.0, 1500.0, 10.0);
        let mean = Vector5::from(state).component_mul(&scale);
        let root = Matrix5::from_row_slice(&entries);
        let mut belief = Gaussian { mean, covariance: root * root.transpose() };
        belief.symmetrise();

        let a = motion.jacobian(&mean, drive, t);
        let q = process_noise(&motion, &mean, drive, t);
        let covariance = a * belief.covariance * a.transpose() + q;
        let mut expected = Gaussian { mean: motion.advance(&mean, drive, t), covariance };
        expected.symmetrise();
        motion.predict(&mut belief, drive, t);
        prop_assert_eq!(belief.mean, expected.mean);
        // The noise is summed in another order here.
        let off = (belief.covariance - expected.covariance).norm();
        prop_assert!(off <= 1e-13 * expected.covariance.norm(), "{off}");
        let propagated = propagated(&a, &(root + root.transpose()));
        let dense = a * (root + root.transpose()) * a.transpose();
        prop_assert_eq!(propagated.upper_triangle(), dense.upper_triangle());
    }

    /// After any steps, the covariance is symmetric and positive definite.
    #[test]
    fn covariance_stays_positive_definite(
        steps in prop::collection::vec(
            (0..4, prop::array::uniform2(-2000.0..2000.0), 0.0..0.2, any::<bool>()),
            1..200,
        ),
    ) {
        let motion = motion(|filter| filter.command_lag_ms = 30.0);
        let mut belief = motion.initial(&Vector3::new(1.0, 2.0, 3.0)).hypotheses[0].belief;
        for (kind, [left_mm_s, right_mm_s], dt_s, seen) in steps {
            let drive = match kind {
                0 => Drive::Steered { left_mm_s, right_mm_s },
                1 => Drive::Standing,
                2 => Drive::Free,
                _ => Drive::Struck,
            };
            motion.predict(&mut belief, drive, dt_s);
            if seen {
                let difference = Vector3::new(left_mm_s, right_mm_s, 1.0) * 1e-3;
                let innovation = belief.innovation(difference, &motion.noise).unwrap();
                belief.correct(&innovation, &motion.noise);
            }
            prop_assert_eq!(belief.covariance, belief.covariance.transpose());
            prop_assert!(belief.covariance.cholesky().is_some(), "{}", belief.covariance);
        }
    }
}

#[test]
fn two_halves_add_as_much_noise_as_one_whole() {
    let motion = motion(|_| {});
    for drive in [
        Drive::Steered { left_mm_s: 0.0, right_mm_s: 0.0 },
        Drive::Standing,
        Drive::Free,
        Drive::Struck,
    ] {
        // Standing at the origin, where the model is linear.
        let known = start([0.0; 3], [0.0; 5]);
        let (mut once, mut twice) = (known, known);
        motion.predict(&mut once, drive, T);
        motion.predict(&mut twice, drive, T / 2.0);
        motion.predict(&mut twice, drive, T / 2.0);
        let apart = (once.covariance - twice.covariance).norm();
        assert!(apart <= 1e-9 * once.covariance.norm(), "{drive:?} {apart}");
    }
}

#[test]
fn a_lagging_robot_approaches_its_command() {
    let motion = motion(|filter| filter.command_lag_ms = 40.0);
    let drive = Drive::Steered { left_mm_s: 1000.0, right_mm_s: 1000.0 };
    let mut state = Vector5::zeros();
    for _ in 0..16 {
        state = motion.advance(&state, drive, 0.0025);
    }
    // After one time constant: 1 − 1/e of the speed, and 1/e of a time constant's distance.
    assert!((state[V] - 632.1206).abs() < 1e-3, "{state}");
    assert!((state[X] - 14.7152).abs() < 1e-3, "{state}");
    // In any number of steps.
    let whole = motion.advance(&Vector5::zeros(), drive, 0.04);
    assert!((whole - state).norm() < 1e-9);
}

/// Simulates the model with its own noise: the innovations must be as large as predicted.
#[test]
fn innovations_are_as_large_as_predicted() {
    let motion = motion(|_| {});
    for drive in [Drive::Steered { left_mm_s: 500.0, right_mm_s: 700.0 }, Drive::Free] {
        let mut random = 1u64;
        let mut normal = move || {
            // Sum of twelve uniform numbers: mean 6, variance 1.
            (0..12).fold(-6.0, |sum, _| {
                random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                sum + (random >> 11) as f64 / (1u64 << 53) as f64
            })
        };
        let mut truth = Vector5::new(0.0, 0.0, 1.0, 0.0, 0.0);
        let mut belief = motion.initial(&truth.fixed_rows::<3>(0).into()).hypotheses[0].belief;
        let (mut sum, mut errors, mut count) = (0.0, 0.0, 0.0);
        for frame in 0..6000 {
            let root =
                motion.process_noise(&motion.step(&truth, drive, T), drive).cholesky().unwrap().l();
            truth = motion.advance(&truth, drive, T)
                + root * SVector::<f64, 5>::from_fn(|_, _| normal());
            // Free speeds would drift to where the model is no longer nearly linear.
            truth[V] *= 0.99;
            truth[OMEGA] *= 0.99;
            belief.mean[V] *= 0.99;
            belief.mean[OMEGA] *= 0.99;
            motion.predict(&mut belief, drive, T);
            let noise = Vector3::from_fn(|i, _| motion.noise[(i, i)].sqrt() * normal());
            let mut difference = truth.fixed_rows::<3>(0) + noise - belief.mean.fixed_rows::<3>(0);
            wrap_heading(&mut difference);
            let innovation = belief.innovation(difference, &motion.noise).unwrap();
            belief.correct(&innovation, &motion.noise);
            if frame >= 50 {
                let mut error = truth - belief.mean;
                wrap_heading(&mut error);
                let precision: SMatrix<f64, 5, 5> = belief.covariance.try_inverse().unwrap();
                sum += innovation.distance2;
                errors += error.dot(&(precision * error));
                count += 1.0;
            }
        }
        // χ² with 3 degrees of freedom has variance 6; four standard deviations of the mean.
        let bound = 4.0 * (6.0f64 / count).sqrt();
        assert!((sum / count - 3.0).abs() < bound, "{drive:?}: {}", sum / count);
        // Errors of successive frames are correlated, so their mean scatters more.
        assert!((errors / count - 5.0).abs() < 0.8, "{drive:?}: {}", errors / count);
    }
}
