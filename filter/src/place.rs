//! What a robot that cannot be told from others of its team says about a robot that is missing.
//!
//! When an identification patch is hidden for a moment, the tracker still sees where the team patch
//! is. With the heading that is believed of the missing robot, the place of its patch is a measurement
//! of its centre: of two components, more uncertain across the arm from centre to patch the less
//! certain the heading is. The correlation between the two errors is not used, which makes the
//! correction a little weaker than it could be, never bolder.

use crate::blend::Wrap;
use crate::gaussian::Innovation;
use crate::robot::RobotMotion;
use crate::track::{Candidate, Motion, Track};
use common::messages::{ROBOT_HYPOTHESES, TrackStatus};
use nalgebra::{Matrix2, Rotation2, Vector2};

type Robot = Track<5, ROBOT_HYPOTHESES, 3>;

/// A heading that is less certain than this is as good as none.
const MAX_HEADING_VARIANCE: f64 = 1.0;

/// The probability density, per mm², that the patch seen is that of the robot; `None` outside the gate
/// of every hypothesis. `patch_mm` is where the patch is in the robot's frame.
pub fn density(
    robot: &Robot,
    patch_mm: &Vector2<f64>,
    seen: &Candidate<2>,
    gate_chi2: f64,
) -> Option<f64> {
    let innovations = innovations(robot, patch_mm, seen).map(|it| it.map(|(i, _)| i));
    robot.blend.density(&innovations, gate_chi2)
}

/// Corrects the robot's place by the patch, and calls it [`Located`](TrackStatus::Located). For how
/// long it has not been recognised is not changed by that, so nobody keeps a number for ever on the
/// strength of being there.
pub fn correct(robot: &mut Robot, patch_mm: &Vector2<f64>, seen: &Candidate<2>) {
    const WRAP: Wrap<5> = RobotMotion::WRAP;
    let innovations = innovations(robot, patch_mm, seen);
    robot.blend.weigh(&innovations.map(|it| it.map(|(innovation, _)| innovation.ln_density)));
    for (hypothesis, innovation) in robot.blend.hypotheses.iter_mut().zip(innovations) {
        if let Some((innovation, noise)) = innovation {
            hypothesis.belief.correct(&innovation, &noise);
            WRAP(&mut hypothesis.belief.mean);
        }
    }
    robot.status = TrackStatus::Located;
}

/// By hypothesis, the innovation of the centre as measured by the patch, and that measurement's noise.
fn innovations(
    robot: &Robot,
    patch_mm: &Vector2<f64>,
    seen: &Candidate<2>,
) -> [Option<(Innovation<2>, Matrix2<f64>)>; ROBOT_HYPOTHESES] {
    robot.blend.hypotheses.map(|hypothesis| {
        let belief = &hypothesis.belief;
        let arm = Rotation2::new(belief.mean[2]) * patch_mm;
        let across = Vector2::new(-arm.y, arm.x);
        let heading_variance = belief.covariance[(2, 2)].min(MAX_HEADING_VARIANCE);
        let noise = seen.noise + across * across.transpose() * heading_variance;
        let difference = seen.measured - arm - belief.mean.fixed_rows::<2>(0);
        Some((belief.innovation(difference, &noise)?, noise))
    })
}
