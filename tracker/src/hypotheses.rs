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
use crate::pattern::Pattern;
use crate::pose::fit_pose;
use common::geometry::{FieldPoint, Pose};
use common::messages::{MAX_PATCHES, Team};

/// Most distances looked at for one team patch, and most hypotheses made of it.
const MAX_CHECKS: u32 = 5_000;
const MAX_HYPOTHESES_EACH: u32 = 64;
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

/// What became of a candidate for a team patch on its way to a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fate {
    /// No robot of the team has its patches around it.
    Incomplete,
    /// A complete robot, but outside the pitch.
    Outside,
    /// At least one hypothesis.
    Complete,
}

/// Appends all hypotheses of one candidate for a team patch; returns what became of it.
pub(crate) fn of_team_patch(
    scene: &Scene,
    finder: &CandidateFinder,
    team: Team,
    candidate: usize,
    hypotheses: &mut Vec<Hypothesis>,
) -> Fate {
    let mut builder = Builder {
        scene,
        finder,
        hypotheses,
        picked: [0; MAX_PATCHES],
        checks_left: MAX_CHECKS,
        hypotheses_left: MAX_HYPOTHESES_EACH,
        fate: Fate::Incomplete,
    };
    builder.picked[scene.pattern.team_patch] = candidate;
    for (identity, wearer) in scene.pattern.identities.iter().enumerate() {
        if wearer.team == team {
            builder.add_patch(identity, 0);
        }
    }
    builder.fate
}

/// Puts together all hypotheses of one team patch.
struct Builder<'a, 's> {
    scene: &'a Scene<'s>,
    finder: &'a CandidateFinder,
    hypotheses: &'a mut Vec<Hypothesis>,
    /// For each patch before the current one, and the team patch: index among its candidates.
    picked: [usize; MAX_PATCHES],
    checks_left: u32,
    hypotheses_left: u32,
    fate: Fate,
}

impl Builder<'_, '_> {
    /// Tries all candidates for `patch` and everything behind it.
    fn add_patch(&mut self, identity: usize, patch: usize) {
        let pattern = self.scene.pattern;
        if patch == pattern.patches.len() {
            self.complete(identity);
            return;
        }
        if patch == pattern.team_patch {
            self.add_patch(identity, patch + 1);
            return;
        }
        let kind = pattern.identities[identity].kinds[patch];
        for candidate in 0..self.finder.of_kind(kind).len() {
            if self.checks_left == 0 || self.hypotheses_left == 0 {
                return;
            }
            self.checks_left -= 1;
            if self.fits_those_picked(identity, patch, candidate) {
                self.picked[patch] = candidate;
                self.add_patch(identity, patch + 1);
            }
        }
    }

    fn candidate(&self, identity: usize, patch: usize, index: usize) -> &Candidate {
        &self.finder.of_kind(self.scene.pattern.identities[identity].kinds[patch])[index]
    }

    /// Eq. (5), and the same between identification patches.
    fn fits_those_picked(&self, identity: usize, patch: usize, index: usize) -> bool {
        let pattern = self.scene.pattern;
        let candidate = self.candidate(identity, patch, index);
        let team_patch = self.picked[pattern.team_patch];
        let team_patch = self.candidate(identity, pattern.team_patch, team_patch);
        if candidate.beside.is_some_and(|seed| seed != team_patch.seed()) {
            return false;
        }
        let before = (0..patch).filter(|&other| other != pattern.team_patch);
        std::iter::once(pattern.team_patch).chain(before).all(|other| {
            let picked = self.candidate(identity, other, self.picked[other]);
            let distance = distance_mm(candidate.measure.position, picked.measure.position);
            let expected = pattern.distance_mm(patch, other);
            (distance - expected).abs() <= pattern.limits.patch_tolerance_mm
                && !candidate.overlaps(picked)
        })
    }

    fn complete(&mut self, identity: usize) {
        let pattern = self.scene.pattern;
        let mut places = [FieldPoint::default(); MAX_PATCHES];
        for (patch, place) in places.iter_mut().enumerate().take(pattern.patches.len()) {
            *place = self.candidate(identity, patch, self.picked[patch]).measure.position;
        }
        let Some(pose) = fit(pattern, &places) else { return };
        let mut misfit = 0.0;
        for (patch, expected) in pattern.patches.iter().enumerate() {
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
            if self.fate == Fate::Incomplete {
                self.fate = Fate::Outside;
            }
            return;
        }
        self.fate = Fate::Complete;
        self.hypotheses_left -= 1;
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
pub(crate) fn fit(pattern: &Pattern, places: &[FieldPoint; MAX_PATCHES]) -> Option<Pose> {
    fit_pose(
        pattern
            .patches
            .iter()
            .zip(places)
            .map(|(patch, &place)| (patch.centroid_mm, place, patch.area_mm2)),
    )
}
