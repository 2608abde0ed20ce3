//! Hypotheses: complete robots that a team patch and candidates around it could be.
//!
//! A *hypothesis* is a team patch, and for each identification patch of one configured robot a
//! candidate of its colour in its place. The paper's eq. (5) asks for an identification patch between
//! ¾ patch sizes and a robot's size away from the team patch; with the layout known, the distance
//! itself is known, and what is asked for is that distance, give or take the configured tolerance, and
//! likewise between any two patches, and then that each patch lies within the tolerance of its place
//! once the pose is fitted (which also tells left from right).

use crate::candidates::{Candidate, CandidateFinder};
use crate::measure::distance_mm;
use crate::pairing::Scene;
use crate::pattern::{Pattern, Top};
use crate::pose::fit_pose;
use common::geometry::{FieldPoint, Pose};
use common::messages::MAX_PATCHES;
use std::cmp::Ordering;
use std::ops::Range;

/// Most distances looked at for one team patch, shared evenly by the robots of its team: rubbish takes a
/// bounded time, and no robot's share depends on what others wear. Twelve robots that touch take some
/// hundred.
const MAX_CHECKS: u32 = 6_000;
/// Most hypotheses made of one team patch; when there are more, the worst are left out.
const MAX_HYPOTHESES_EACH: usize = 64;
/// Most candidates of one kind around a team patch. Touching robots of one colour have a dozen.
const MAX_NEAR: usize = 32;
/// Weight of a patch's distance from its place: this much when it is off by the whole tolerance.
/// Areas count 1 at their limits: they depend on light and focus, distances do not.
const PLACE_WEIGHT: f64 = 8.0;
/// What each further fragment of a patch costs: of two explanations, the simpler one.
const FRAGMENT_COST: f64 = 0.05;
/// What a patch costs that is cut out of its region where the team patch says it must be: it has a
/// better size and place than a whole region by the way it is made, not by what is seen.
const CUT_COST: f64 = 0.05;
/// In the place of a candidate: the patch was not found as one.
pub(crate) const NO_CANDIDATE: usize = usize::MAX;

/// A robot that may be there.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hypothesis {
    /// Index into the pattern's identities.
    pub identity: usize,
    /// For each patch, index among the candidates of its kind; [`NO_CANDIDATE`] where the pixels
    /// were asked instead.
    pub candidates: [usize; MAX_PATCHES],
    /// Where each patch was measured.
    pub places: [FieldPoint; MAX_PATCHES],
    pub pose: Pose,
    /// How badly the patches fit: sum over the patches of what place and area are off, see
    /// [`PLACE_WEIGHT`].
    pub misfit: f64,
    /// Misfit, and what else speaks against it.
    pub cost: f64,
}

impl Hypothesis {
    /// The likeliest first. No two are equal, so the order is always the same.
    pub fn by_cost(a: &Self, b: &Self) -> Ordering {
        let content = |h: &Self| (h.identity, h.candidates);
        a.cost.total_cmp(&b.cost).then_with(|| content(a).cmp(&content(b)))
    }

    /// Marks it as not to be believed.
    pub fn discard(&mut self) {
        self.cost = f64::INFINITY;
    }

    pub fn is_kept(&self) -> bool {
        self.cost.is_finite()
    }
}

/// What became of a candidate for a team patch on its way to a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Fate {
    pub outcome: Outcome,
    /// A limit kept some explanations from being looked at: what is said of it may be wrong.
    pub is_cut: bool,
    /// It is doubtful, but there was no time left to ask its pixels.
    pub is_unasked: bool,
}

impl Fate {
    /// The better of the fates of two candidates made of the same region.
    pub fn better(self, other: Self) -> Self {
        Self {
            outcome: self.outcome.max(other.outcome),
            is_cut: self.is_cut || other.is_cut,
            is_unasked: self.is_unasked || other.is_unasked,
        }
    }
}

/// How far a candidate for a team patch came.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Outcome {
    /// No robot of the team has its patches around it.
    Incomplete,
    /// A complete robot, but outside the pitch.
    Outside,
    /// At least one hypothesis.
    Complete,
}

/// Makes hypotheses of one team patch after the other, reusing its lists.
#[derive(Debug, Clone, Default)]
pub(crate) struct Hypothesiser {
    near: Near,
}

/// Candidates in reach of a team patch: those whose distance from it is that of the layout, give or take
/// the tolerance (eq. 5).
#[derive(Debug, Clone, Default)]
struct Near {
    /// Indices among the candidates of their kind.
    candidates: Vec<usize>,
    /// For each kind of the pattern, its part of `candidates`.
    ranges: Vec<Range<usize>>,
}

impl Near {
    /// Returns whether a list was cut.
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

/// Whether two candidates are as far apart as the layout says, and nothing belongs to both.
fn is_in_reach(pattern: &Pattern, a: &Candidate, b: &Candidate, expected_mm: f64) -> bool {
    let distance = distance_mm(a.measure.position, b.measure.position);
    (distance - expected_mm).abs() <= pattern.limits.patch_tolerance_mm && !a.overlaps(b)
}

impl Hypothesiser {
    /// Appends all hypotheses of one candidate for a team patch; returns what became of it.
    pub fn of_team_patch(
        &mut self,
        scene: &Scene,
        finder: &CandidateFinder,
        team_kind: usize,
        candidate: usize,
        hypotheses: &mut Vec<Hypothesis>,
    ) -> Fate {
        let pattern = scene.pattern;
        let top = pattern.top_of_kind(&pattern.kinds[team_kind]);
        let team_patch = &finder.of_kind(team_kind)[candidate];
        let first = hypotheses.len();
        let is_cut = self.near.find(pattern, finder, team_kind, team_patch);
        let mut builder = Builder {
            scene,
            top,
            finder,
            near: &self.near,
            hypotheses,
            picked: [0; MAX_PATCHES],
            is_cut,
            fate: Outcome::Incomplete,
        };
        builder.picked[top.team_patch] = candidate;
        builder.add_patch(pattern.wearers(team_kind), 0, MAX_CHECKS);
        let Builder { mut is_cut, fate: outcome, .. } = builder;
        if hypotheses.len() > first + MAX_HYPOTHESES_EACH {
            hypotheses[first..].sort_unstable_by(Hypothesis::by_cost);
            hypotheses.truncate(first + MAX_HYPOTHESES_EACH);
            is_cut = true;
        }
        Fate { outcome, is_cut, is_unasked: false }
    }
}

/// Puts together all hypotheses of one team patch.
struct Builder<'a, 's> {
    scene: &'a Scene<'s>,
    top: &'a Top,
    finder: &'a CandidateFinder,
    near: &'a Near,
    hypotheses: &'a mut Vec<Hypothesis>,
    /// For each patch before the current one, and the team patch: index among its candidates.
    picked: [usize; MAX_PATCHES],
    is_cut: bool,
    fate: Outcome,
}

impl Builder<'_, '_> {
    /// Tries all candidates in reach for `patch` and everything behind it, for identities that wear the
    /// same before it. Looks at no more than `checks` distances, of which each identity has the same
    /// share; returns how many are left.
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
                if self.fits_those_picked(alike[0], patch, candidate) {
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

    /// Whether the identification patches before have the right distance from this one.
    fn fits_those_picked(&self, identity: usize, patch: usize, index: usize) -> bool {
        let pattern = self.scene.pattern;
        let candidate = self.candidate(identity, patch, index);
        (0..patch).filter(|&other| other != self.top.team_patch).all(|other| {
            let picked = self.candidate(identity, other, self.picked[other]);
            is_in_reach(pattern, candidate, picked, self.top.distance_mm(patch, other))
        })
    }

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
            self.fate = self.fate.max(Outcome::Outside);
            return;
        }
        self.fate = Outcome::Complete;
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

/// The pose that fits patches measured at these places best.
pub(crate) fn fit(top: &Top, places: &[FieldPoint; MAX_PATCHES]) -> Option<Pose> {
    fit_pose(
        top.patches
            .iter()
            .zip(places)
            .map(|(patch, &place)| (patch.centroid_mm, place, patch.area_mm2)),
    )
}
