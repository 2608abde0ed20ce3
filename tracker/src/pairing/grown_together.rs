//! Robots that share a region which was taken apart are measured again.

use super::hypotheses::fit;
use super::{Pairing, Scene};
use crate::pattern::Pattern;
use crate::pose::robot_from_field;
use crate::regions::measure::{Measure, MomentSums};
use geometry::ImagePoint;
use messages::DetectionFrame;

impl Pairing {
    /// Where believed robots share a region that was taken apart, their poses now tell better
    /// whose pixels are whose than the distance from two centroids: each pixel goes to the robot
    /// on whose body it lies deepest. Places and poses are measured again from that.
    pub(super) fn separate_grown_together(&mut self, scene: &Scene, frame: &DetectionFrame) {
        const ROUNDS: usize = 2;
        let pattern = scene.pattern;
        for index in 0..self.believed.len() {
            let identity = self.hypotheses[self.believed[index]].identity;
            for patch in 0..pattern.top_of(identity).patches.len() {
                let robot = &self.hypotheses[self.believed[index]];
                let Some(candidate) = self.candidate(pattern, robot, patch) else { continue };
                let seed = candidate.seed();
                // Each region once, with its first piece, and only if all pieces have owners.
                if seed.pieces < 2 || seed.piece != 0 {
                    continue;
                }
                let mut owners = std::mem::take(&mut self.owners);
                self.find_owners(pattern, seed.region, &mut owners);
                if owners.len() == usize::from(seed.pieces) {
                    for _ in 0..ROUNDS {
                        self.measure_again(scene, frame, seed.region, &owners);
                    }
                }
                self.owners = owners;
            }
        }
    }

    /// The believed hypotheses, and their patches, that pieces of a region belong to.
    fn find_owners(&self, pattern: &Pattern, region: u32, owners: &mut Vec<(usize, usize)>) {
        owners.clear();
        for &index in &self.believed {
            let robot = &self.hypotheses[index];
            for patch in 0..pattern.top_of(robot.identity).patches.len() {
                let candidate = self.candidate(pattern, robot, patch);
                if candidate.is_some_and(|candidate| candidate.uses_region(region)) {
                    owners.push((index, patch));
                }
            }
        }
    }

    fn measure_again(
        &mut self,
        scene: &Scene,
        frame: &DetectionFrame,
        region: u32,
        owners: &[(usize, usize)],
    ) {
        let Some(region) = frame.regions().get(region as usize) else { return };
        let origin = (f64::from(region.x_px), f64::from(region.y_px));
        let mut all_sums = std::mem::take(&mut self.sums);
        all_sums.clear();
        all_sums.resize(owners.len(), MomentSums::around(origin));
        for run in frame.runs_of(region) {
            for column in run.begin..run.end {
                let (x_px, y_px) = (f64::from(column), f64::from(run.row));
                let point = ImagePoint::new(x_px, y_px);
                let remoteness = |&(index, patch): &(usize, usize)| {
                    let robot = &self.hypotheses[index];
                    let top = scene.pattern.top_of(robot.identity);
                    let place = scene.camera.field_from_image(point, top.height_mm);
                    let [x, y] = robot_from_field(&robot.pose, place);
                    let [px, py] = top.patches[patch].centroid_mm;
                    // Two patches of one robot are equally deep on its body.
                    (-top.body.depth_mm([x, y]), (x - px).hypot(y - py))
                };
                let nearest = (0..owners.len()).min_by(|&a, &b| {
                    let (a, b) = (remoteness(&owners[a]), remoteness(&owners[b]));
                    a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))
                });
                if let Some(nearest) = nearest {
                    all_sums[nearest].add_pixel(x_px, y_px);
                }
            }
        }
        for (&(index, patch), sums) in owners.iter().zip(&all_sums) {
            let moments = sums.moments();
            let hypothesis = &mut self.hypotheses[index];
            let top = scene.pattern.top_of(hypothesis.identity);
            let measure = Measure::new(&moments, scene.camera, top.height_mm);
            // Poses so wrong that nothing is left of a patch make a worse guess, not a better one.
            let Some(measure) = measure else { continue };
            let patch_area = top.patches[patch].area_mm2;
            if measure.area_mm2 < scene.pattern.limits.min_area_ratio * patch_area {
                continue;
            }
            hypothesis.places[patch] = measure.position;
            if let Some(pose) = fit(top, &hypothesis.places) {
                hypothesis.pose = pose;
            }
        }
        self.sums = all_sums;
    }
}
