//! Correction of a robot that was not recognised by a team patch of its team.
//!
//! If an identification patch is hidden for a moment, the tracker still sees the team patch, at z. With the
//! estimated heading θ of the missing robot and the patch at a in the robot's frame, z − R(θ) a measures the
//! robot's centre. Its covariance is that of the patch, plus n nᵀ σ_θ² with n perpendicular to R(θ) a: the
//! less certain the heading, the less certain the centre across the arm. The correlation between the errors
//! of measurement and heading is ignored; this makes the correction weaker than optimal, never overconfident.

use crate::gaussian::Innovation;
use crate::imm::Wrap;
use crate::robot::RobotMotion;
use crate::track::{Candidate, Motion, Track};
use messages::{ROBOT_HYPOTHESES, TrackStatus};
use nalgebra::{Matrix2, Rotation2, Vector2};

type Robot = Track<5, ROBOT_HYPOTHESES, 3>;

/// Limit of the heading's variance, rad²: above it the heading is unknown.
const MAX_HEADING_VARIANCE: f64 = 1.0;

/// Probability density, per mm², of the patch under the robot's track; `None` outside the gate of every
/// hypothesis. `patch_mm` is the position of the patch in the robot's frame.
pub fn density(
    robot: &Robot,
    patch_mm: &Vector2<f64>,
    seen: &Candidate<2>,
    gate_chi2: f64,
) -> Option<f64> {
    let innovations = innovations(robot, patch_mm, seen).map(|it| it.map(|(i, _)| i));
    robot.imm.density(&innovations, gate_chi2)
}

/// Corrects the robot's position by the patch, and sets its status to [`Located`](TrackStatus::Located). The
/// time since it was last recognised keeps running, so a robot cannot keep its identity by its position
/// alone.
pub fn correct(robot: &mut Robot, patch_mm: &Vector2<f64>, seen: &Candidate<2>) {
    const WRAP: Wrap<5> = RobotMotion::WRAP;
    let innovations = innovations(robot, patch_mm, seen);
    robot.imm.update_probabilities(
        &innovations.map(|it| it.map(|(innovation, _)| innovation.ln_density)),
    );
    for (hypothesis, innovation) in robot.imm.hypotheses.iter_mut().zip(innovations) {
        if let Some((innovation, noise)) = innovation {
            hypothesis.belief.correct(&innovation, &noise);
            WRAP(&mut hypothesis.belief.mean);
        }
    }
    robot.status = TrackStatus::Located;
}

/// For each hypothesis, the innovation of the centre, and the covariance of its measurement.
fn innovations(
    robot: &Robot,
    patch_mm: &Vector2<f64>,
    seen: &Candidate<2>,
) -> [Option<(Innovation<2>, Matrix2<f64>)>; ROBOT_HYPOTHESES] {
    robot.imm.hypotheses.map(|hypothesis| {
        let belief = &hypothesis.belief;
        let arm = Rotation2::new(belief.mean[2]) * patch_mm;
        let across = Vector2::new(-arm.y, arm.x);
        let heading_variance = belief.covariance[(2, 2)].min(MAX_HEADING_VARIANCE);
        let noise = seen.noise + across * across.transpose() * heading_variance;
        let difference = seen.measured - arm - belief.mean.fixed_rows::<2>(0);
        Some((belief.innovation(difference, &noise)?, noise))
    })
}
