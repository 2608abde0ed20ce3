//! Hypotheses: the complete robots that a team patch and the candidates around it could be.
//!
//! A *hypothesis* is a candidate for the team patch and, for each identification patch of one configured
//! robot, a candidate in that patch's colour. The paper's eq. (5) asks for an identification patch between ¾
//! patch sizes and a robot's size away from the team patch. Here the layout is known, so with dₖₗ the
//! layout's distance between patches k and l and τ the configured tolerance,
//!
//! | |pₖ − pₗ| − dₖₗ | ≤ τ for any two patches, and |pₖ − pose(cₖ)| ≤ τ once the pose is fitted,
//!
//! where pₖ is the candidate's place and cₖ the centroid in the layout. The second condition also tells left
//! from right. The search is depth-first over the patches; identities that wear the same kinds so far share
//! it, and every identity has the same share of [`MAX_CHECKS`].

use super::Scene;
use crate::candidates::{Candidate, CandidateFinder};
use crate::pattern::{Pattern, Top};
use crate::pose::fit_pose;
use crate::regions::measure::distance_mm;
use geometry::{FieldPoint, Pose};
use messages::MAX_PATCHES;
use std::cmp::Ordering;
use std::ops::Range;

/// Most distances compared for one team patch, shared evenly by the identities of its team: any input takes a
/// bounded time, and no identity's share depends on what others wear. Twelve touching robots take some
/// hundred.
const MAX_CHECKS: u32 = 6_000;
/// Most hypotheses of one team patch; the costliest beyond it are dropped.
const MAX_HYPOTHESES_EACH: usize = 64;
/// Most candidates of one kind around a team patch. Touching robots of one colour have a dozen.
const MAX_NEAR: usize = 32;
/// Cost of a patch that is a whole tolerance away from its place. Areas cost 1 at their limits: they depend
/// on light and focus, distances do not.
const PLACE_WEIGHT: f64 = 8.0;
/// Cost of each further fragment of a patch: prefers the simpler of two explanations.
const FRAGMENT_COST: f64 = 0.05;
/// Cost of a patch that was cut out of its region at the place that the team patch predicts: its size and
/// place are good by construction, not by evidence.
const CUT_COST: f64 = 0.05;
/// Stands for a patch without a candidate.
pub(crate) const NO_CANDIDATE: usize = usize::MAX;

/// A possible robot.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hypothesis {
    /// Index into the pattern's identities.
    pub identity: usize,
    /// For each patch, index among the candidates of its kind, or [`NO_CANDIDATE`] where the pose comes from
    /// pixels ([`second_opinion`](crate::pairing::second_opinion)).
    pub candidates: [usize; MAX_PATCHES],
    /// Measured place of each patch.
    pub places: [FieldPoint; MAX_PATCHES],
    pub pose: Pose,
    /// Sum over the patches of the costs of place and area, see [`PLACE_WEIGHT`].
    pub misfit: f64,
    /// Misfit, cost of the prior, and cost of unexplained patches on the top.
    pub cost: f64,
}

impl Hypothesis {
    /// Orders by cost, then by content: no two are equal, so the order is always the same.
    pub fn by_cost(a: &Self, b: &Self) -> Ordering {
        let content = |h: &Self| (h.identity, h.candidates);
        a.cost.total_cmp(&b.cost).then_with(|| content(a).cmp(&content(b)))
    }

    /// Marks the hypothesis as ruled out.
    pub fn discard(&mut self) {
        self.cost = f64::INFINITY;
    }

    pub fn is_kept(&self) -> bool {
        self.cost.is_finite()
    }
}

/// Result of the search for robots with one candidate for a team patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct SearchResult {
    pub outcome: Outcome,
    /// A limit kept some explanations from being tried, so the outcome may be wrong.
    pub is_cut: bool,
    /// No hypothesis fits well, and the frame's budget left no second opinion.
    pub is_unasked: bool,
}

impl SearchResult {
    /// The better of the results of two candidates made of the same region.
    pub fn better(self, other: Self) -> Self {
        Self {
            outcome: self.outcome.max(other.outcome),
            is_cut: self.is_cut || other.is_cut,
            is_unasked: self.is_unasked || other.is_unasked,
        }
    }
}

/// How far the search came with a candidate for a team patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Outcome {
    /// No robot's patches are all around it.
    Incomplete,
    /// A complete robot outside the pitch.
    Outside,
    /// At least one hypothesis.
    Complete,
}

/// Makes the hypotheses of one team patch after the other, reusing its lists.
#[derive(Debug, Clone, Default)]
pub(crate) struct HypothesisMaker {
    near: Near,
}

/// Candidates whose distance from a team patch is that of the layout within the tolerance (eq. 5).
#[derive(Debug, Clone, Default)]
struct Near {
    /// Indices among the candidates of their kind.
    candidates: Vec<usize>,
    /// For each kind of the pattern, its part of `candidates`.
    ranges: Vec<Range<usize>>,
}

impl Near {
    /// Fills the lists; returns whether [`MAX_NEAR`] cut one.
    fn find(
        &mut self,
        pattern: &Pattern,
        finder: &CandidateFinder,
        team_kind: usize,
        team_patch: &Candidate,
    ) -> bool {
        let of_top = pattern.kinds[team_kind].top;
        let top = &pattern.tops[of_top];
        let mut is_cut = false;
        self.candidates.clear();
        self.ranges.clear();
        for (index, kind) in pattern.kinds.iter().enumerate() {
            let begin = self.candidates.len();
            if kind.team.is_none() && kind.top == of_top {
                let expected_mm = top.distance_mm(kind.patch, top.team_patch);
                let is_near = |(_, candidate): &(usize, &Candidate)| {
                    is_in_reach(pattern, candidate, team_patch, expected_mm)
                        && candidate.beside.is_none_or(|seed| seed == team_patch.seed())
                };
                // The likeliest size comes first.
                let mut near = finder.of_kind(index).iter().enumerate().filter(is_near);
                self.candidates.extend(near.by_ref().take(MAX_NEAR).map(|(index, _)| index));
                is_cut |= near.next().is_some();
            }
            self.ranges.push(begin..self.candidates.len());
        }
        is_cut
    }

    fn of_kind(&self, kind: usize) -> Range<usize> {
        self.ranges[kind].clone()
    }
}

/// Whether two candidates have the layout's distance within the tolerance, and share no pixels.
fn is_in_reach(pattern: &Pattern, a: &Candidate, b: &Candidate, expected_mm: f64) -> bool {
    let distance = distance_mm(a.measure.position, b.measure.position);
    (distance - expected_mm).abs() <= pattern.limits.patch_tolerance_mm && !a.overlaps(b)
}

impl HypothesisMaker {
    /// Appends all hypotheses of one candidate for a team patch.
    pub fn of_team_patch(
        &mut self,
        scene: &Scene,
        finder: &CandidateFinder,
        team_kind: usize,
        candidate: usize,
        hypotheses: &mut Vec<Hypothesis>,
    ) -> SearchResult {
        let pattern = scene.pattern;
        let top = pattern.top_of_kind(&pattern.kinds[team_kind]);
        let team_patch = &finder.of_kind(team_kind)[candidate];
        let first = hypotheses.len();
        let is_cut = self.near.find(pattern, finder, team_kind, team_patch);
        let mut search = Search {
            scene,
            top,
            finder,
            near: &self.near,
            hypotheses,
            picked: [0; MAX_PATCHES],
            is_cut,
            outcome: Outcome::Incomplete,
        };
        search.picked[top.team_patch] = candidate;
        search.add_patch(pattern.wearers(team_kind), 0, MAX_CHECKS);
        let Search { mut is_cut, outcome, .. } = search;
        if hypotheses.len() > first + MAX_HYPOTHESES_EACH {
            hypotheses[first..].sort_unstable_by(Hypothesis::by_cost);
            hypotheses.truncate(first + MAX_HYPOTHESES_EACH);
            is_cut = true;
        }
        SearchResult { outcome, is_cut, is_unasked: false }
    }
}

/// Depth-first search for the hypotheses of one team patch.
struct Search<'a, 's> {
    scene: &'a Scene<'s>,
    top: &'a Top,
    finder: &'a CandidateFinder,
    near: &'a Near,
    hypotheses: &'a mut Vec<Hypothesis>,
    /// For the team patch and each patch before the current one: index among the candidates of its kind.
    picked: [usize; MAX_PATCHES],
    is_cut: bool,
    outcome: Outcome,
}

impl Search<'_, '_> {
    /// Tries all candidates in reach for `patch` and the patches after it, for identities that wear the same
    /// kinds before it. Compares at most `checks` distances, of which each identity has the same share;
    /// returns the number of unused ones.
    fn add_patch(&mut self, identities: &[usize], patch: usize, checks: u32) -> u32 {
        let pattern = self.scene.pattern;
        if patch == self.top.patches.len() {
            identities.iter().for_each(|&identity| self.complete(identity));
            return checks;
        }
        if patch == self.top.team_patch {
            return self.add_patch(identities, patch + 1, checks);
        }
        let kind_of = |identity: usize| pattern.identities[identity].kinds[patch];
        let mut unused = 0;
        for alike in identities.chunk_by(|&a, &b| kind_of(a) == kind_of(b)) {
            let share = u64::from(checks) * alike.len() as u64 / identities.len() as u64;
            let mut checks = share as u32;
            for place in self.near.of_kind(kind_of(alike[0])) {
                if checks == 0 {
                    self.is_cut = true;
                    break;
                }
                checks -= 1;
                let candidate = self.near.candidates[place];
                if self.fits_picked(alike[0], patch, candidate) {
                    self.picked[patch] = candidate;
                    checks = self.add_patch(alike, patch + 1, checks);
                }
            }
            unused += checks;
        }
        unused
    }

    fn candidate(&self, identity: usize, patch: usize, index: usize) -> &Candidate {
        &self.finder.of_kind(self.scene.pattern.identities[identity].kinds[patch])[index]
    }

    /// Whether a candidate has the right distance from the identification patches picked before it.
    fn fits_picked(&self, identity: usize, patch: usize, index: usize) -> bool {
        let pattern = self.scene.pattern;
        let candidate = self.candidate(identity, patch, index);
        (0..patch).filter(|&other| other != self.top.team_patch).all(|other| {
            let picked = self.candidate(identity, other, self.picked[other]);
            is_in_reach(pattern, candidate, picked, self.top.distance_mm(patch, other))
        })
    }

    /// Adds the hypothesis of all picked candidates if they fit a pose on the pitch.
    fn complete(&mut self, identity: usize) {
        let pattern = self.scene.pattern;
        let mut places = [FieldPoint::default(); MAX_PATCHES];
        for (patch, place) in places.iter_mut().enumerate().take(self.top.patches.len()) {
            *place = self.candidate(identity, patch, self.picked[patch]).measure.position;
        }
        let Some(pose) = fit(self.top, &places) else { return };
        let mut misfit = 0.0;
        for (patch, expected) in self.top.patches.iter().enumerate() {
            let off_mm = distance_mm(pose.field_from_robot(expected.centroid_mm), places[patch]);
            if off_mm > pattern.limits.patch_tolerance_mm {
                return;
            }
            let candidate = self.candidate(identity, patch, self.picked[patch]);
            misfit += PLACE_WEIGHT * (off_mm / pattern.limits.patch_tolerance_mm).powi(2)
                + candidate.misfit
                + FRAGMENT_COST * (candidate.parts().len() - 1) as f64;
            if candidate.beside.is_some() {
                misfit += CUT_COST;
            }
        }
        if !self.scene.pitch.contains(pose.position, 0.0) {
            self.outcome = self.outcome.max(Outcome::Outside);
            return;
        }
        self.outcome = Outcome::Complete;
        let prior = self.scene.prior.cost(identity, pose.position, pattern.size_mm);
        self.hypotheses.push(Hypothesis {
            identity,
            candidates: self.picked,
            places,
            pose,
            misfit,
            cost: misfit + prior,
        });
    }
}

/// The pose that fits the layout's centroids to measured places by least squares, weighted by area.
pub(crate) fn fit(top: &Top, places: &[FieldPoint; MAX_PATCHES]) -> Option<Pose> {
    fit_pose(
        top.patches
            .iter()
            .zip(places)
            .map(|(patch, &place)| (patch.centroid_mm, place, patch.area_mm2)),
    )
}
