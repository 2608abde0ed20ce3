//! From candidates to robots: section 6.1 of the paper, for any layout of patches.
//!
//! Of each team patch there are [hypotheses](crate::hypotheses): the complete robots it could belong to.
//! Hypotheses contradict each other when they use the same pixels, are the same robot, have team
//! patches of one team closer than eq. (4) allows, or when their bodies would overlap. Which to
//! believe is decided for the whole picture at once: as many as possible, and of those the ones
//! that fit best. So each team patch gets its own identification patch, as Fig. 7 demands, even
//! where another robot's lies nearer.

use crate::agreement::Surroundings;
use crate::assignment::{Choice, Solver};
use crate::candidates::{Candidate, CandidateFinder};
use crate::hypotheses::{Fate, Hypothesis, Hypothesiser, NO_CANDIDATE, Outcome, fit};
use crate::measure::{Measure, MomentSums, distance_mm};
use crate::pattern::Pattern;
use crate::pitch::Pitch;
use crate::pose::{image_pose, robot_from_field};
use crate::prior::Prior;
use crate::second_opinion::{self, AMBIGUITY, MAX_OPINIONS, Opinion};
use common::geometry::{CameraModel, FieldPoint, ImagePoint, Pose, wrap_angle};
use common::messages::{DetectedRobot, DetectionFrame, MAX_PATCHES, Team};

/// Most hypotheses that are weighed against each other; when there are more, the worst of each team
/// patch are left out. A match has one or two for each robot.
const MAX_HYPOTHESES: usize = 512;
/// Most poses of paired robots that a second opinion begins with.
const MAX_STARTS: usize = 4;
/// What each other patch costs that lies on what would be the robot's top: it must have slipped
/// between two robots, or be one that the robot should have been explained with.
const STRANGER_COST: f64 = 2.0;
/// Bodies shrunk to this fraction of their size must not overlap.
const BODY_FRACTION: f64 = 0.8;
/// A team patch whose best robot has this misfit for each patch, or more, gets a second opinion.
const DOUBTFUL: f64 = 0.1;

/// Finds the robots of a frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct Pairing {
    pub finder: CandidateFinder,
    hypothesiser: Hypothesiser,
    hypotheses: Vec<Hypothesis>,
    /// For each team, what became of the candidates for its team patch.
    fates: [Vec<Fate>; 2],
    /// Candidates for team patches, with the number of their hypotheses, in the order in which these are
    /// made.
    groups: Vec<(Team, usize, usize)>,
    choices: Vec<Choice>,
    believed: Vec<usize>,
    /// The search for the best choice was given up.
    is_cut: bool,
    /// Those believed before the ambiguous among them were dropped.
    named: Vec<usize>,
    solver: Solver,
    surroundings: Surroundings,
    opinions: Vec<Opinion>,
    paired: Vec<Pose>,
    /// The believed hypotheses, and their patches, that pieces of a region belong to, and what is
    /// measured of each.
    owners: Vec<(usize, usize)>,
    sums: Vec<MomentSums>,
}

/// What the steps below look at.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scene<'a> {
    pub pattern: &'a Pattern,
    pub camera: &'a CameraModel,
    pub pitch: &'a Pitch,
    pub prior: &'a Prior,
}

impl Pairing {
    /// Finds the robots among the regions of `frame` and appends them to it, by team and number.
    pub fn find(&mut self, scene: &Scene, frame: &mut DetectionFrame) {
        self.finder.find(scene.pattern, scene.camera, scene.pitch, frame);
        self.hypothesise(scene, frame);
        self.believe(scene);
        self.separate_grown_together(scene, frame);
        self.write(scene, frame);
        let is_cut = |fate: &Fate| fate.is_cut;
        if self.is_cut || self.finder.is_cut || self.fates.iter().flatten().any(is_cut) {
            frame.flags |= DetectionFrame::SEARCH_CUT;
        }
    }

    /// The hypotheses that are believed.
    pub fn robots(&self) -> impl Iterator<Item = &Hypothesis> {
        self.believed.iter().map(|&index| &self.hypotheses[index])
    }

    /// The candidate a robot's patch was found as; `None` if only its pixels were.
    pub fn candidate(
        &self,
        pattern: &Pattern,
        robot: &Hypothesis,
        patch: usize,
    ) -> Option<&Candidate> {
        let kind = pattern.identities[robot.identity].kinds[patch];
        self.finder.of_kind(kind).get(robot.candidates[patch])
    }

    /// What became of a candidate for a team patch.
    pub fn fate(&self, team: Team, candidate: usize) -> Fate {
        let unknown = Fate { outcome: Outcome::Incomplete, is_cut: true };
        self.fates[team as usize].get(candidate).copied().unwrap_or(unknown)
    }

    fn hypothesise(&mut self, scene: &Scene, frame: &DetectionFrame) {
        self.hypotheses.clear();
        self.groups.clear();
        let mut opinions_left = 0;
        for team in Team::ALL {
            // Whatever one team's colour is mistaken for, the other keeps its share.
            opinions_left += MAX_OPINIONS / Team::ALL.len();
            self.fates[team as usize].clear();
            for candidate in 0..self.finder.of_kind(scene.pattern.team_kind(team)).len() {
                let first = self.hypotheses.len();
                let hypotheses = &mut self.hypotheses;
                let hypothesiser = &mut self.hypothesiser;
                let mut fate =
                    hypothesiser.of_team_patch(scene, &self.finder, team, candidate, hypotheses);
                if opinions_left > 0 && self.ask_pixels(scene, frame, team, candidate, first) {
                    opinions_left -= 1;
                    if self.hypotheses.len() > first {
                        fate.outcome = Outcome::Complete;
                    }
                }
                self.fates[team as usize].push(fate);
                self.groups.push((team, candidate, self.hypotheses.len() - first));
            }
        }
        if self.hypotheses.len() > MAX_HYPOTHESES {
            self.keep_best_of_each();
        }
        self.hypotheses.sort_unstable_by(Hypothesis::by_cost);
    }

    /// Leaves out hypotheses until there are no more than [`MAX_HYPOTHESES`]: every team patch keeps its
    /// best ones, and none keeps more than another that has as many.
    fn keep_best_of_each(&mut self) {
        let total = |most: usize| self.groups.iter().map(|group| group.2.min(most)).sum::<usize>();
        let most = (1..MAX_HYPOTHESES).take_while(|&most| total(most) <= MAX_HYPOTHESES).last();
        let most = most.unwrap_or(0);
        let (mut begin, mut kept) = (0, 0);
        for &(team, candidate, count) in &self.groups {
            let group = begin..begin + count;
            self.hypotheses[group].sort_unstable_by(Hypothesis::by_cost);
            for index in begin..begin + count.min(most) {
                self.hypotheses.swap(kept, index);
                kept += 1;
            }
            self.fates[team as usize][candidate].is_cut |= count > most;
            begin += count;
        }
        self.hypotheses.truncate(kept);
    }

    /// Replaces the hypotheses of a team patch, those from `first` on, by what its pixels say, if they
    /// fit badly and the pixels say something. Returns whether the pixels were asked.
    fn ask_pixels(
        &mut self,
        scene: &Scene,
        frame: &DetectionFrame,
        team: Team,
        candidate: usize,
        first: usize,
    ) -> bool {
        let pattern = scene.pattern;
        let doubtful = DOUBTFUL * pattern.patches.len() as f64;
        let paired = &self.hypotheses[first..];
        if paired.iter().any(|hypothesis| hypothesis.misfit < doubtful) {
            return false;
        }
        self.paired.clear();
        self.paired.extend(paired.iter().take(MAX_STARTS).map(|hypothesis| hypothesis.pose));
        let team_patch = &self.finder.of_kind(pattern.team_kind(team))[candidate];
        let is_asked = second_opinion::ask(
            scene,
            frame,
            team,
            &team_patch.measure,
            &self.paired,
            &mut self.surroundings,
            &mut self.opinions,
        );
        let is_inside = |opinion: &&Opinion| scene.pitch.contains(opinion.pose.position, 0.0);
        let mut opinions = self.opinions.iter().filter(is_inside).peekable();
        if opinions.peek().is_some() {
            self.hypotheses.truncate(first);
        }
        self.hypotheses.extend(opinions.map(|opinion| {
            let Opinion { identity, pose, misfit } = *opinion;
            let mut candidates = [NO_CANDIDATE; MAX_PATCHES];
            candidates[pattern.team_patch] = candidate;
            let mut places = [FieldPoint::default(); MAX_PATCHES];
            for (place, patch) in places.iter_mut().zip(&pattern.patches) {
                *place = pose.field_from_robot(patch.centroid_mm);
            }
            let prior = scene.prior.cost(identity, pose.position, pattern.size_mm);
            Hypothesis { identity, candidates, places, pose, misfit, cost: misfit + prior }
        }));
        is_asked
    }

    /// Chooses among the hypotheses.
    fn believe(&mut self, scene: &Scene) {
        let pattern = scene.pattern;
        for index in 0..self.hypotheses.len() {
            let strangers = self.count_strangers(pattern, &self.hypotheses[index]);
            self.hypotheses[index].cost += STRANGER_COST * f64::from(strangers);
        }
        self.choices.clear();
        self.choices.extend(self.hypotheses.iter().map(|hypothesis| {
            // All that begin with the same pixels of the team's colour exclude each other.
            let kind = pattern.identities[hypothesis.identity].kinds[pattern.team_patch];
            let team_patch = &self.finder.of_kind(kind)[hypothesis.candidates[pattern.team_patch]];
            let seed = team_patch.seed();
            Choice {
                group: u64::from(seed.region) << 16 | u64::from(seed.piece),
                cost: hypothesis.cost,
            }
        }));
        let (hypotheses, finder) = (&self.hypotheses, &self.finder);
        let contradict =
            |a: usize, b: usize| contradict(pattern, finder, &hypotheses[a], &hypotheses[b]);
        self.is_cut = !self.solver.solve(&self.choices, contradict, &mut self.believed);
        self.drop_ambiguous();
    }

    /// Of a robot whose pixels speak for another of its team just as well, and that other one is not
    /// found elsewhere, it is not known which of the two it is: better no name than a wrong one.
    fn drop_ambiguous(&mut self) {
        let (hypotheses, choices) = (&self.hypotheses, &self.choices);
        let is_named = |identity: usize, believed: &[usize]| {
            believed.iter().any(|&index| hypotheses[index].identity == identity)
        };
        self.named.clone_from(&self.believed);
        let believed = &self.named;
        self.believed.retain(|&index| {
            let robot = &hypotheses[index];
            let is_rival = |&(other, rival): &(usize, &Hypothesis)| {
                choices[other].group == choices[index].group
                    && rival.identity != robot.identity
                    && rival.cost < robot.cost + f64::from(AMBIGUITY)
                    && !is_named(rival.identity, believed)
            };
            robot.candidates.iter().filter(|&&candidate| candidate != NO_CANDIDATE).count() > 1
                || !hypotheses.iter().enumerate().any(|entry| is_rival(&entry))
        });
    }

    /// Other regions of a patch's size and shape on the robot's top.
    fn count_strangers(&self, pattern: &Pattern, hypothesis: &Hypothesis) -> u32 {
        let half = pattern.size_mm * BODY_FRACTION / 2.0;
        let own = &pattern.identities[hypothesis.identity].kinds;
        // Pixels have been asked about everything on the top already.
        if hypothesis.candidates[..own.len()].contains(&NO_CANDIDATE) {
            return 0;
        }
        let is_own = |region: u32| {
            own.iter()
                .zip(&hypothesis.candidates)
                .any(|(&kind, &candidate)| self.finder.of_kind(kind)[candidate].uses_region(region))
        };
        let mut count = 0;
        for spot in &self.finder.spots {
            let place = spot.measure.position;
            if distance_mm(place, hypothesis.pose.position) > 1.5 * half {
                continue;
            }
            let [x, y] = robot_from_field(&pattern.body(&hypothesis.pose), place);
            let could_be_patch = || {
                pattern.patches.iter().any(|patch| {
                    spot.measure.area_mm2 >= pattern.limits.min_area_ratio * patch.area_mm2
                        && spot.measure.is_shaped_like(patch)
                })
            };
            if x.abs() < half && y.abs() < half && !is_own(spot.region) && could_be_patch() {
                count += 1;
            }
        }
        count
    }

    /// Where believed robots share a region that was taken apart, their poses now tell better
    /// whose pixels are whose than the distance from two centroids: each pixel goes to the robot
    /// on whose body it lies deepest. Places and poses are measured again from that.
    fn separate_grown_together(&mut self, scene: &Scene, frame: &DetectionFrame) {
        const ROUNDS: usize = 2;
        let pattern = scene.pattern;
        for index in 0..self.believed.len() {
            for patch in 0..pattern.patches.len() {
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
            for patch in 0..pattern.patches.len() {
                let robot = &self.hypotheses[index];
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
                let place = scene.camera.field_from_image(point, scene.pattern.height_mm);
                let remoteness = |&(index, patch): &(usize, usize)| {
                    let pose = &self.hypotheses[index].pose;
                    let [body_x, body_y] = robot_from_field(&scene.pattern.body(pose), place);
                    let [x, y] = robot_from_field(pose, place);
                    let [px, py] = scene.pattern.patches[patch].centroid_mm;
                    // Two patches of one robot are equally deep on its body.
                    (body_x.abs().max(body_y.abs()), (x - px).hypot(y - py))
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
            let measure = Measure::new(&moments, scene.camera, scene.pattern.height_mm);
            let hypothesis = &mut self.hypotheses[index];
            // Poses so wrong that nothing is left of a patch make a worse guess, not a better one.
            let Some(measure) = measure else { continue };
            let patch_area = scene.pattern.patches[patch].area_mm2;
            if measure.area_mm2 < scene.pattern.limits.min_area_ratio * patch_area {
                continue;
            }
            hypothesis.places[patch] = measure.position;
            if let Some(pose) = fit(scene.pattern, &hypothesis.places) {
                hypothesis.pose = pose;
            }
        }
        self.sums = all_sums;
    }

    fn write(&mut self, scene: &Scene, frame: &mut DetectionFrame) {
        let pattern = scene.pattern;
        let hypotheses = &self.hypotheses;
        self.believed.sort_unstable_by_key(|&index| {
            let identity = &pattern.identities[hypotheses[index].identity];
            (identity.team, identity.id)
        });
        for robot in self.robots() {
            let identity = &pattern.identities[robot.identity];
            let (image, orientation_image) =
                image_pose(scene.camera, &robot.pose, pattern.height_mm);
            let mut patch_regions = [u32::MAX; MAX_PATCHES];
            for (patch, region) in patch_regions.iter_mut().enumerate().take(pattern.patches.len())
            {
                if let Some(candidate) = self.candidate(pattern, robot, patch) {
                    *region = candidate.seed().region;
                }
            }
            frame.push_robot(DetectedRobot {
                team: identity.team as u32,
                robot_id: identity.id,
                x_mm: robot.pose.position.x_mm as f32,
                y_mm: robot.pose.position.y_mm as f32,
                orientation: wrap_angle(robot.pose.orientation) as f32,
                confidence: (-robot.misfit / pattern.patches.len() as f64).exp() as f32,
                x_px: image.x_px as f32,
                y_px: image.y_px as f32,
                orientation_image: orientation_image as f32,
                patch_count: pattern.patches.len() as u32,
                patch_regions,
                ..DetectedRobot::default()
            });
        }
    }
}

fn contradict(pattern: &Pattern, finder: &CandidateFinder, a: &Hypothesis, b: &Hypothesis) -> bool {
    let (identity_a, identity_b) =
        (&pattern.identities[a.identity], &pattern.identities[b.identity]);
    let (body_a, body_b) = (pattern.body(&a.pose), pattern.body(&b.pose));
    if a.identity == b.identity || bodies_overlap(pattern.size_mm, &body_a, &body_b) {
        return true;
    }
    let team = pattern.team_patch;
    let too_close = || {
        distance_mm(a.places[team], b.places[team])
            < TEAM_PATCH_DISTANCE * pattern.team_patch_size_mm()
    };
    if identity_a.team == identity_b.team && too_close() {
        return true;
    }
    identity_a.kinds.iter().zip(&a.candidates).any(|(&kind_a, &candidate_a)| {
        let Some(ours) = finder.of_kind(kind_a).get(candidate_a) else { return false };
        identity_b.kinds.iter().zip(&b.candidates).any(|(&kind_b, &candidate_b)| {
            let theirs = finder.of_kind(kind_b).get(candidate_b);
            pattern.kinds[kind_a].class == pattern.kinds[kind_b].class
                && theirs.is_some_and(|theirs| ours.overlaps(theirs))
        })
    })
}

/// Team patches of one team are farther apart than this many patch sizes (eq. 4).
pub(crate) const TEAM_PATCH_DISTANCE: f64 = 0.75;

/// Whether two squares, somewhat smaller than robots, share a point: they do unless one of their
/// four axes separates them.
fn bodies_overlap(size_mm: f64, a: &Pose, b: &Pose) -> bool {
    let half = size_mm * BODY_FRACTION / 2.0;
    if distance_mm(a.position, b.position) > 3.0 * half {
        return false;
    }
    let (sin, cos) = (a.orientation - b.orientation).sin_cos();
    let reach = half * (1.0 + sin.abs() + cos.abs());
    let [ax, ay] = robot_from_field(a, b.position);
    let [bx, by] = robot_from_field(b, a.position);
    [ax, ay, bx, by].iter().all(|offset| offset.abs() < reach)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_4;

    fn pose(x: f64, y: f64, orientation: f64) -> Pose {
        Pose { position: FieldPoint::new(x, y), orientation }
    }

    #[test]
    fn bodies_may_touch_and_not_overlap() {
        let here = pose(0.0, 0.0, 0.0);
        assert!(!bodies_overlap(75.0, &here, &pose(75.0, 0.0, 0.0)));
        assert!(!bodies_overlap(75.0, &here, &pose(75.0, 30.0, 0.0)));
        assert!(!bodies_overlap(75.0, &here, &pose(91.0, 0.0, FRAC_PI_4)));
        assert!(bodies_overlap(75.0, &here, &pose(55.0, 30.0, 0.0)));
        // Side by side this far apart they would only touch; a corner reaches farther.
        assert!(bodies_overlap(75.0, &here, &pose(70.0, 0.0, FRAC_PI_4)));
        assert!(!bodies_overlap(75.0, &here, &pose(70.0, 0.0, 0.0)));
    }
}
