//! Second opinions: robots whose patches are in too bad a state to be paired, identified by their pixels.
//!
//! ```text
//! for a team patch without a hypothesis that fits well:
//!     starts = poses that the patch's shape allows, and poses paired with it
//!     any    = pose of best agreement from the best start, every patch accepting the colours of all robots
//!     for each robot of the team that agrees about as well as the best at one of the starts or at any:
//!         pose = pose of best agreement from there, with the robot's own colours
//!     robots = those that agree within AMBIGUITY of the best, unless another colour contradicts them
//! ```
//!
//! [`agreement`](crate::pairing::agreement) has the measure. No whole region of any colour is needed, so robots whose
//! patches are half dark, cut in pieces or grown together are identified too. Among robots that agree about
//! equally well the assignment chooses; all others are ruled out, since a wrong name is worse than none.

use super::Scene;
use super::agreement::{Accepted, Coverage, NearbyPixels};
use crate::pattern::footprint;
use crate::pattern::{Pattern, Top};
use crate::regions::class_index::ClassIndex;
use crate::regions::measure::Measure;
use geometry::Pose;
use messages::{DetectionFrame, MAX_PATCHES};

/// Most pixel visits of second opinions in a frame, about a millisecond; ten robots of 250 pixels take a
/// tenth. Patches beyond it are listed with
/// [`RejectReason::NotLookedAt`](messages::RejectReason::NotLookedAt).
pub(crate) const WORK_PER_FRAME: u64 = 600_000;
/// Largest distance of a start outside the pitch: the fitted pose may still lie on it.
const START_SLACK_MM: f64 = 15.0;
/// Least agreement of the team patch: about half of it has its colour.
const MIN_TEAM_AGREEMENT: f32 = 0.3;
/// Least mean agreement of the identification patches: one may be too dark to have a colour if the others are
/// good.
const MIN_MEAN_AGREEMENT: f32 = -0.05;
/// Fraction of a patch in another colour that contradicts a robot.
const CONTRADICTION: f32 = 0.5;
/// Least agreement of the team patch at the best start.
const MIN_START: f32 = 0.0;
/// Lag of a robot's total agreement behind the best at the starts, from which it is not fitted.
const WORTH_FITTING: f32 = 0.25;
/// Lag of a robot's total agreement behind the best after the fit, from which it is ruled out.
pub(crate) const AMBIGUITY: f32 = 0.15;

/// A robot that the pixels agree with.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Opinion {
    /// Index into the pattern's identities.
    pub identity: usize,
    pub pose: Pose,
    /// Sum over the patches of 1 − agreement.
    pub misfit: f64,
}

/// Gives second opinions, reusing its lists.
#[derive(Debug, Clone, Default)]
pub(crate) struct SecondOpinion {
    nearby: NearbyPixels,
    /// Starts, and the coverage at each.
    seen: Vec<(Pose, Coverage)>,
    /// The robots of the last call of [`SecondOpinion::ask`].
    pub opinions: Vec<Opinion>,
}

impl SecondOpinion {
    /// Identifies the robot of a team patch of a kind by the pixels around it. `paired` are poses of
    /// hypotheses with this team patch. Returns the number of pixel visits.
    pub fn ask(
        &mut self,
        scene: &Scene,
        frame: &DetectionFrame,
        index: &ClassIndex,
        team_kind: usize,
        team_patch: &Measure,
        paired: &[Pose],
    ) -> u64 {
        self.opinions.clear();
        self.form(scene, frame, index, team_kind, team_patch, paired);
        self.nearby.take_work()
    }

    /// Fills `opinions`; returns early where nothing agrees.
    fn form(
        &mut self,
        scene: &Scene,
        frame: &DetectionFrame,
        index: &ClassIndex,
        team_kind: usize,
        team_patch: &Measure,
        paired: &[Pose],
    ) {
        let pattern = scene.pattern;
        let top = pattern.top_of_kind(&pattern.kinds[team_kind]);
        let shares = &top.shares;
        let Self { nearby, seen, opinions } = self;
        seen.clear();
        let by_shape = footprint::poses(&top.patches[top.team_patch], team_patch);
        // A floor beside the pitch may be full of regions like team patches.
        let is_inside = |pose: &Pose| scene.pitch.contains(pose.position, START_SLACK_MM);
        if !by_shape.iter().flatten().chain(paired).any(is_inside) {
            return;
        }
        nearby.collect(top, scene.camera, frame, index, team_patch.position);
        let any = accepted_by_any(pattern, team_kind);
        for pose in paired.iter().chain(by_shape.iter().flatten()) {
            seen.push((*pose, nearby.coverage(shares, pose)));
        }
        let starts = seen.iter().filter(|(pose, _)| is_inside(pose));
        let starts = starts.map(|(pose, coverage)| (coverage.total(shares, &any), pose, coverage));
        let Some((_, &start, coverage)) = starts.reduce(|a, b| if b.0 > a.0 { b } else { a })
        else {
            return;
        };
        if coverage.agreement(shares, &any)[top.team_patch] < MIN_START {
            return;
        }
        let near = nearby.best_near(shares, &any, start);
        // Where the floor has a patch's colour, any pose agrees somehow, and the paired poses are better
        // starts.
        seen.truncate(paired.len());
        seen.push((near, nearby.coverage(shares, &near)));
        seen.rotate_right(1);
        let start_of = |accepted: &Accepted| {
            let starts =
                seen.iter().map(|(pose, coverage)| (coverage.total(shares, accepted), *pose));
            starts.fold((f32::NEG_INFINITY, near), |a, b| if b.0 > a.0 { b } else { a })
        };
        let wearers = || pattern.wearers(team_kind).iter().copied();
        let at_once = wearers().map(|identity| start_of(&accepted_by(pattern, identity)).0);
        let at_once = at_once.fold(f32::NEG_INFINITY, f32::max);
        let mut best = f32::NEG_INFINITY;
        for identity in wearers() {
            let accepted = accepted_by(pattern, identity);
            let (agreement, start) = start_of(&accepted);
            if agreement < at_once - WORTH_FITTING {
                continue;
            }
            let pose = nearby.best_near(shares, &accepted, start);
            let agreement = nearby.coverage(shares, &pose).agreement(shares, &accepted);
            let agreement = &agreement[..top.patches.len()];
            best = best.max(agreement.iter().sum());
            if !is_believable(top, agreement) {
                continue;
            }
            let inside = nearby.coverage_inside(shares, &pose).parts(shares, &accepted);
            if !is_contradicted(top, &inside) {
                let misfit = agreement.iter().map(|&part| 1.0 - f64::from(part)).sum();
                opinions.push(Opinion { identity, pose, misfit });
            }
        }
        // `best` includes robots that were ruled out: if one of them was the best, no other is certain.
        let full = top.patches.len() as f64;
        opinions.retain(|opinion| full - opinion.misfit >= f64::from(best - AMBIGUITY));
    }
}

fn is_believable(top: &Top, agreement: &[f32]) -> bool {
    let own = agreement[top.team_patch];
    let mean = (agreement.iter().sum::<f32>() - own) / (agreement.len() - 1) as f32;
    own >= MIN_TEAM_AGREEMENT && mean >= MIN_MEAN_AGREEMENT
}

/// Whether another colour fills an identification patch of the robot. A patch without colour does not
/// contradict: it may be too dark.
fn is_contradicted(top: &Top, inside: &[[f32; 2]; MAX_PATCHES]) -> bool {
    let patches = inside.iter().enumerate().take(top.patches.len());
    patches
        .filter(|&(patch, _)| patch != top.team_patch)
        .any(|(_, [own, other])| *other >= CONTRADICTION && own < other)
}

/// For each patch, the class that a robot wears.
fn accepted_by(pattern: &Pattern, identity: usize) -> Accepted {
    let mut accepted = [0; MAX_PATCHES];
    for (bits, &kind) in accepted.iter_mut().zip(&pattern.identities[identity].kinds) {
        *bits = 1u32.checked_shl(pattern.kinds[kind].class).unwrap_or(0);
    }
    accepted
}

/// For each patch, the classes that any robot with a team patch of a kind wears.
fn accepted_by_any(pattern: &Pattern, team_kind: usize) -> Accepted {
    let mut accepted = [0; MAX_PATCHES];
    for &identity in pattern.wearers(team_kind) {
        let own = accepted_by(pattern, identity);
        accepted.iter_mut().zip(own).for_each(|(bits, own)| *bits |= own);
    }
    accepted
}
