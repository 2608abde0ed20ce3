//! Pairing of candidates into robots: section 6.1 of the paper, for any layout of patches.
//!
//! ```text
//! for each candidate for a team patch:
//!     hypotheses = the complete robots that it could belong to      (hypotheses)
//!     if none fits well: replace them by those of the pixels         (second_opinion)
//! cost of each hypothesis += unexplained patches on its top
//! choose the largest set without contradictions, the cheapest of equals (assignment)
//! drop robots whose pixels speak as well for another number
//! measure robots that share a region again
//! ```
//!
//! Two hypotheses contradict each other if they use the same pixels, are the same robot, have team patches of
//! one team closer than eq. (4) allows, or if their bodies overlap. Because the choice is made for the whole
//! picture at once, each team patch gets its own identification patch, as Fig. 7 demands, even where another
//! robot's lies nearer.

pub(crate) mod agreement;
pub(crate) mod assignment;
mod grown_together;
pub(crate) mod hypotheses;
pub(crate) mod prior;
pub(crate) mod second_opinion;

use crate::candidates::{Candidate, CandidateFinder};
use crate::pattern::Pattern;
use crate::pitch::Pitch;
use crate::pose::{image_pose, robot_from_field};
use crate::regions::class_index::ClassIndex;
use crate::regions::measure::{MomentSums, distance_mm};
use assignment::{Choice, Solver};
use geometry::{CameraModel, FieldPoint, Pose, wrap_angle};
use hypotheses::{Hypothesis, HypothesisMaker, NO_CANDIDATE, Outcome, SearchResult};
use messages::{DetectedRobot, DetectionFrame, MAX_PATCHES, Team};
use prior::Prior;
use second_opinion::{AMBIGUITY, Opinion, SecondOpinion, WORK_PER_FRAME};
use std::ops::Range;

/// Most hypotheses of a frame; beyond it the costliest of each team patch are dropped. A match has one or two
/// for each robot.
const MAX_HYPOTHESES: usize = 512;
/// Most paired poses that a second opinion starts from.
const MAX_STARTS: usize = 4;
/// Cost of each other patch on the top of a hypothesis: it lies between two robots, or the robot should have
/// been explained with it.
const UNEXPLAINED_COST: f64 = 2.0;
/// Misfit per patch of the best hypothesis from which a team patch gets a second opinion.
const DOUBTFUL: f64 = 0.1;

/// Finds the robots of a frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct Pairing {
    pub finder: CandidateFinder,
    hypothesis_maker: HypothesisMaker,
    hypotheses: Vec<Hypothesis>,
    /// For each kind of team patch, the results of its candidates.
    results: Vec<Vec<SearchResult>>,
    /// Candidates for team patches, in the order in which their hypotheses are made.
    groups: Vec<Group>,
    choices: Vec<Choice>,
    /// Indices of the chosen hypotheses.
    believed: Vec<usize>,
    /// For each hypothesis, the set of its regions ([`region_set`]).
    region_sets: Vec<u64>,
    /// The search for the best choice was given up.
    is_cut: bool,
    /// `believed` before ambiguous robots were dropped.
    named: Vec<usize>,
    solver: Solver,
    second_opinion: SecondOpinion,
    /// Indices of groups in the order of their second opinions.
    order: Vec<usize>,
    index: ClassIndex,
    paired: Vec<Pose>,
    /// Believed hypotheses and their patches to which pieces of a region belong, and the sums over the pixels
    /// of each.
    owners: Vec<(usize, usize)>,
    sums: Vec<MomentSums>,
}

/// A candidate for a team patch, and its hypotheses.
#[derive(Debug, Clone)]
struct Group {
    team: Team,
    /// Kind of the team patch.
    kind: usize,
    candidate: usize,
    hypotheses: Range<usize>,
    /// One of the hypotheses fits well.
    fits: bool,
}

/// Context of a frame that does not change while it is worked on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scene<'a> {
    pub pattern: &'a Pattern,
    pub camera: &'a CameraModel,
    pub pitch: &'a Pitch,
    pub prior: &'a Prior,
}

impl Pairing {
    /// Pairing for robots on a pitch.
    pub fn new(pattern: &Pattern, camera: &CameraModel, pitch: &Pitch) -> Self {
        Self { finder: CandidateFinder::new(pattern, camera, pitch), ..Self::default() }
    }

    /// Finds the robots among the regions of `frame` and appends them to it, by team and number.
    pub fn find(&mut self, scene: &Scene, frame: &mut DetectionFrame) {
        self.index.fill(frame);
        self.finder.find(scene.pattern, scene.camera, scene.pitch, frame, &self.index);
        self.hypothesise(scene, frame);
        self.believe(scene);
        self.separate_grown_together(scene, frame);
        self.write(scene, frame);
        let is_cut = |result: &SearchResult| result.is_cut || result.is_unasked;
        if self.is_cut || self.finder.is_cut || self.results.iter().flatten().any(is_cut) {
            frame.flags |= DetectionFrame::SEARCH_CUT;
        }
    }

    /// The chosen hypotheses.
    pub fn robots(&self) -> impl Iterator<Item = &Hypothesis> {
        self.believed.iter().map(|&index| &self.hypotheses[index])
    }

    /// The candidate of a robot's patch; `None` for a robot found by its pixels.
    pub fn candidate(
        &self,
        pattern: &Pattern,
        robot: &Hypothesis,
        patch: usize,
    ) -> Option<&Candidate> {
        let kind = pattern.identities[robot.identity].kinds[patch];
        self.finder.of_kind(kind).get(robot.candidates[patch])
    }

    /// Result of the search with a candidate for a team patch.
    pub fn result(&self, kind: usize, candidate: usize) -> SearchResult {
        let unknown =
            SearchResult { outcome: Outcome::Incomplete, is_cut: true, is_unasked: false };
        let of_kind = self.results.get(kind);
        of_kind.and_then(|results| results.get(candidate)).copied().unwrap_or(unknown)
    }

    fn hypothesise(&mut self, scene: &Scene, frame: &DetectionFrame) {
        let pattern = scene.pattern;
        self.hypotheses.clear();
        self.groups.clear();
        self.results.resize(pattern.kinds.len(), Vec::new());
        self.results.iter_mut().for_each(Vec::clear);
        for team in Team::ALL {
            for &kind in pattern.team_kinds(team) {
                for candidate in 0..self.finder.of_kind(kind).len() {
                    let first = self.hypotheses.len();
                    let hypotheses = &mut self.hypotheses;
                    let result = self.hypothesis_maker.of_team_patch(
                        scene,
                        &self.finder,
                        kind,
                        candidate,
                        hypotheses,
                    );
                    self.results[kind].push(result);
                    let hypotheses = first..self.hypotheses.len();
                    let fits = self.any_fits(pattern, kind, hypotheses.clone());
                    self.groups.push(Group { team, kind, candidate, hypotheses, fits });
                }
            }
        }
        self.ask_pixels(scene, frame);
        self.keep_best_of_each();
        self.hypotheses.retain(Hypothesis::is_kept);
        self.hypotheses.sort_unstable_by(Hypothesis::by_cost);
    }

    /// Drops hypotheses until there are at most [`MAX_HYPOTHESES`]: every team patch keeps its cheapest ones,
    /// up to the same number.
    fn keep_best_of_each(&mut self) {
        let count = |group: &Group| group.hypotheses.len();
        let total =
            |most: usize| self.groups.iter().map(|group| count(group).min(most)).sum::<usize>();
        if total(MAX_HYPOTHESES) <= MAX_HYPOTHESES {
            return;
        }
        let most = (1..MAX_HYPOTHESES).take_while(|&most| total(most) <= MAX_HYPOTHESES).last();
        let most = most.unwrap_or(0);
        for group in self.groups.iter().filter(|group| count(group) > most) {
            let hypotheses = &mut self.hypotheses[group.hypotheses.clone()];
            hypotheses.sort_unstable_by(Hypothesis::by_cost);
            hypotheses[most..].iter_mut().for_each(Hypothesis::discard);
            self.results[group.kind][group.candidate].is_cut = true;
        }
    }

    /// Replaces the hypotheses of team patches without a good one by second opinions, if there are any.
    fn ask_pixels(&mut self, scene: &Scene, frame: &DetectionFrame) {
        let pattern = scene.pattern;
        let mut work = 0;
        // By rank, so that teams take turns however many regions one team's colour has.
        let mut order = std::mem::take(&mut self.order);
        order.clear();
        order.extend(0..self.groups.len());
        order
            .sort_unstable_by_key(|&index| (self.groups[index].candidate, self.groups[index].kind));
        for &index in &order {
            let Group { team, kind, candidate, hypotheses, .. } = self.groups[index].clone();
            if self.is_explained(team, kind, candidate) {
                continue;
            }
            if work >= WORK_PER_FRAME {
                self.results[kind][candidate].is_unasked = true;
                continue;
            }
            self.paired.clear();
            let paired = self.hypotheses[hypotheses.clone()].iter().take(MAX_STARTS);
            self.paired.extend(paired.map(|hypothesis| hypothesis.pose));
            work += self.second_opinion.ask(
                scene,
                frame,
                &self.index,
                kind,
                &self.finder.of_kind(kind)[candidate].measure,
                &self.paired,
            );
            let first = self.hypotheses.len();
            for &Opinion { identity, pose, misfit } in &self.second_opinion.opinions {
                if !scene.pitch.contains(pose.position, 0.0) {
                    continue;
                }
                let top = pattern.top_of(identity);
                let mut candidates = [NO_CANDIDATE; MAX_PATCHES];
                candidates[top.team_patch] = candidate;
                let mut places = [FieldPoint::default(); MAX_PATCHES];
                for (place, patch) in places.iter_mut().zip(&top.patches) {
                    *place = pose.field_from_robot(patch.centroid_mm);
                }
                let prior = scene.prior.cost(identity, pose.position, pattern.size_mm);
                let cost = misfit + prior;
                let hypothesis = Hypothesis { identity, candidates, places, pose, misfit, cost };
                self.hypotheses.push(hypothesis);
            }
            if self.hypotheses.len() > first {
                self.hypotheses[hypotheses].iter_mut().for_each(Hypothesis::discard);
                self.groups[index].hypotheses = first..self.hypotheses.len();
                self.results[kind][candidate].outcome = Outcome::Complete;
            }
        }
        self.order = order;
    }

    /// Whether one of the hypotheses fits so well that no second opinion is needed.
    fn any_fits(&self, pattern: &Pattern, kind: usize, hypotheses: Range<usize>) -> bool {
        let doubtful = DOUBTFUL * pattern.top_of_kind(&pattern.kinds[kind]).patches.len() as f64;
        self.hypotheses[hypotheses].iter().any(|hypothesis| hypothesis.misfit < doubtful)
    }

    /// Whether a well fitting hypothesis of the team, on any top, uses pixels of a candidate for a team
    /// patch.
    fn is_explained(&self, team: Team, kind: usize, candidate: usize) -> bool {
        let own = &self.finder.of_kind(kind)[candidate];
        self.groups.iter().any(|group| {
            group.fits
                && group.team == team
                && self.finder.of_kind(group.kind)[group.candidate].overlaps(own)
        })
    }

    /// Chooses among the hypotheses.
    fn believe(&mut self, scene: &Scene) {
        let pattern = scene.pattern;
        for index in 0..self.hypotheses.len() {
            let unexplained = self.count_unexplained(pattern, &self.hypotheses[index]);
            self.hypotheses[index].cost += UNEXPLAINED_COST * f64::from(unexplained);
        }
        self.choices.clear();
        self.choices.extend(self.hypotheses.iter().map(|hypothesis| {
            // Hypotheses of one team patch exclude each other.
            let patch = pattern.top_of(hypothesis.identity).team_patch;
            let kind = pattern.identities[hypothesis.identity].kinds[patch];
            let team_patch = &self.finder.of_kind(kind)[hypothesis.candidates[patch]];
            let seed = team_patch.seed();
            Choice {
                group: u64::from(seed.region) << 16 | u64::from(seed.piece),
                cost: hypothesis.cost,
            }
        }));
        let (hypotheses, finder) = (&self.hypotheses, &self.finder);
        self.region_sets.clear();
        let region_sets = hypotheses.iter().map(|it| region_set(pattern, finder, it));
        self.region_sets.extend(region_sets);
        let region_sets = &self.region_sets;
        let contradict = |a: usize, b: usize| {
            let (one, other) = (&hypotheses[a], &hypotheses[b]);
            are_in_the_way(pattern, one, other)
                || region_sets[a] & region_sets[b] != 0 && share_pixels(pattern, finder, one, other)
        };
        self.is_cut = !self.solver.solve(&self.choices, contradict, &mut self.believed);
        self.drop_ambiguous();
    }

    /// Drops robots found by their pixels that could as well be another robot of the team which was not found
    /// elsewhere: no name is better than a wrong one.
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

    /// Number of other regions of a patch's size and shape on the robot's top.
    fn count_unexplained(&self, pattern: &Pattern, hypothesis: &Hypothesis) -> u32 {
        let top = pattern.top_of(hypothesis.identity);
        let own = &pattern.identities[hypothesis.identity].kinds;
        // A second opinion has compared everything on the top already.
        if hypothesis.candidates[..own.len()].contains(&NO_CANDIDATE) {
            return 0;
        }
        let is_own = |region: u32| {
            own.iter()
                .zip(&hypothesis.candidates)
                .any(|(&kind, &candidate)| self.finder.of_kind(kind)[candidate].uses_region(region))
        };
        let mut count = 0;
        let reach_mm = top.core.reach_mm();
        self.finder.near(top, hypothesis.pose.position, reach_mm, |measured| {
            let place = robot_from_field(&hypothesis.pose, measured.measure.position);
            let could_be_patch = || {
                let same_height = pattern.tops.iter().filter(|other| other.height == top.height);
                same_height.flat_map(|top| &top.patches).any(|patch| {
                    measured.measure.area_mm2 >= pattern.limits.min_area_ratio * patch.area_mm2
                        && measured.measure.is_shaped_like(patch)
                })
            };
            if top.core.contains(place) && !is_own(measured.region) && could_be_patch() {
                count += 1;
            }
        });
        count
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
            let top = pattern.top_of(robot.identity);
            let patches = top.patches.len();
            let (image, orientation_image) = image_pose(scene.camera, &robot.pose, top.height_mm);
            let mut patch_regions = [u32::MAX; MAX_PATCHES];
            for (patch, region) in patch_regions.iter_mut().enumerate().take(patches) {
                if let Some(candidate) = self.candidate(pattern, robot, patch) {
                    *region = candidate.seed().region;
                }
            }
            frame.push_robot(DetectedRobot {
                team: identity.team as u32,
                robot_id: identity.id.into(),
                x_mm: robot.pose.position.x_mm as f32,
                y_mm: robot.pose.position.y_mm as f32,
                orientation: wrap_angle(robot.pose.orientation) as f32,
                confidence: (-robot.misfit / patches as f64).exp() as f32,
                x_px: image.x_px as f32,
                y_px: image.y_px as f32,
                orientation_image: orientation_image as f32,
                patch_count: patches as u32,
                patch_regions,
                ..DetectedRobot::default()
            });
        }
    }
}

/// The regions of a hypothesis as a set of 64 bits: two sets without a common bit have no common region.
fn region_set(pattern: &Pattern, finder: &CandidateFinder, hypothesis: &Hypothesis) -> u64 {
    let kinds = pattern.identities[hypothesis.identity].kinds.iter();
    let candidates = kinds.zip(&hypothesis.candidates);
    let candidates = candidates.filter_map(|(&kind, &index)| finder.of_kind(kind).get(index));
    let parts = candidates.flat_map(Candidate::parts);
    parts.fold(0, |set, part| set | 1 << (part.region % u64::BITS))
}

/// Whether two hypotheses are the same robot, or would stand in the same place.
fn are_in_the_way(pattern: &Pattern, a: &Hypothesis, b: &Hypothesis) -> bool {
    let (identity_a, identity_b) =
        (&pattern.identities[a.identity], &pattern.identities[b.identity]);
    let (top_a, top_b) = (pattern.top_of(a.identity), pattern.top_of(b.identity));
    if a.identity == b.identity || top_a.core.overlaps(&a.pose, &top_b.core, &b.pose) {
        return true;
    }
    let too_close = || {
        let least_mm = top_a.team_patch_size_mm().min(top_b.team_patch_size_mm());
        distance_mm(a.places[top_a.team_patch], b.places[top_b.team_patch])
            < TEAM_PATCH_DISTANCE * least_mm
    };
    identity_a.team == identity_b.team && too_close()
}

/// Whether two hypotheses use the same pixels in the same colour.
fn share_pixels(
    pattern: &Pattern,
    finder: &CandidateFinder,
    a: &Hypothesis,
    b: &Hypothesis,
) -> bool {
    let (identity_a, identity_b) =
        (&pattern.identities[a.identity], &pattern.identities[b.identity]);
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
