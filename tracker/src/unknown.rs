//! Unidentified robots: candidates for team patches that belong to no identified robot.
//!
//! A team need not know which patches its opponents wear, and a robot of its own may have lost one. The team
//! patch gives the robot's place to within the patch's distance from the robot's centre. Number and heading
//! are not guessed.

use crate::candidates::Candidate;
use crate::faint::FaintRobots;
use crate::pairing::{Pairing, Scene, TEAM_PATCH_DISTANCE};
use crate::pattern::Top;
use crate::regions::measure::distance_mm;
use messages::{DetectedRobot, DetectionFrame, MAX_PATCHES, RobotId, Team};
use std::f64::consts::PI;

/// Confidence of an unidentified robot whose patch has the expected area.
const CONFIDENCE: f64 = 0.5;

/// Sigma of a patch's place.
const MEASURED_MM: f64 = 1.0;
/// Variance of an unknown heading, evenly spread over a turn.
const ANY_HEADING: f64 = PI * PI / 3.0;

/// Finds unidentified robots, and keeps them until the next frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct UnknownRobots {
    found: Vec<Found>,
}

#[derive(Debug, Clone, Copy)]
struct Found {
    team: Team,
    /// Index into the pattern's tops.
    top: usize,
    candidate: Candidate,
}

impl UnknownRobots {
    /// Forgets the robots of the last frame.
    pub fn clear(&mut self) {
        self.found.clear();
    }

    /// Adds the candidates that are in no identified robot to the frame, which stays sorted by team and
    /// number.
    pub fn find(
        &mut self,
        scene: &Scene,
        pairing: &Pairing,
        faint: &FaintRobots,
        frame: &mut DetectionFrame,
    ) {
        self.found.clear();
        let pattern = scene.pattern;
        for team in Team::ALL {
            for &kind in pattern.team_kinds(team) {
                let top = pattern.kinds[kind].top;
                // The likeliest size first.
                for candidate in pairing.finder.of_kind(kind) {
                    if scene.pitch.contains(candidate.measure.position, 0.0)
                        && !is_of_known(scene, pairing, candidate)
                        && !faint.covers(pattern, candidate.measure.position)
                        && !self.is_of_found(&pattern.tops[top], candidate)
                    {
                        self.found.push(Found { team, top, candidate: *candidate });
                    }
                }
            }
        }
        // The centre lies at the layout's distance from the patch, in an unknown direction.
        for &Found { team, top, candidate } in &self.found {
            let top = &pattern.tops[top];
            let [x, y] = top.patches[top.team_patch].centroid_mm;
            let place = (x * x + y * y) / 2.0 + MEASURED_MM * MEASURED_MM;
            let covariance = [place, 0.0, 0.0, place, 0.0, ANY_HEADING].map(|term| term as f32);
            let (measure, mut patch_regions) = (&candidate.measure, [u32::MAX; MAX_PATCHES]);
            patch_regions[top.team_patch] = candidate.seed().region;
            frame.push_robot(DetectedRobot {
                team: team as u32,
                robot_id: RobotId::UNKNOWN,
                x_mm: measure.position.x_mm as f32,
                y_mm: measure.position.y_mm as f32,
                confidence: (CONFIDENCE * (-candidate.misfit).exp()) as f32,
                x_px: measure.image.x_px as f32,
                y_px: measure.image.y_px as f32,
                patch_count: top.patches.len() as u32,
                patch_regions,
                covariance,
                ..DetectedRobot::default()
            });
        }
        if !self.found.is_empty() {
            let count = (frame.robot_count as usize).min(frame.robots.len());
            frame.robots[..count].sort_by_key(|robot| (robot.team, robot.robot_id));
        }
    }

    /// Whether a region is in an unidentified robot.
    pub fn use_region(&self, region: u32) -> bool {
        self.found.iter().any(|found| found.candidate.uses_region(region))
    }

    fn is_of_found(&self, top: &Top, candidate: &Candidate) -> bool {
        let least_mm = TEAM_PATCH_DISTANCE * top.team_patch_size_mm();
        self.found.iter().any(|Found { candidate: other, .. }| {
            other.overlaps(candidate)
                || distance_mm(other.measure.position, candidate.measure.position) < least_mm
        })
    }
}

/// Whether a candidate is in a paired robot, or lies on one.
fn is_of_known(scene: &Scene, pairing: &Pairing, candidate: &Candidate) -> bool {
    let pattern = scene.pattern;
    pairing.robots().any(|robot| {
        distance_mm(robot.pose.position, candidate.measure.position) < pattern.size_mm / 2.0
            || (0..pattern.top_of(robot.identity).patches.len())
                .filter_map(|patch| pairing.candidate(pattern, robot, patch))
                .any(|own| own.overlaps(candidate))
    })
}
