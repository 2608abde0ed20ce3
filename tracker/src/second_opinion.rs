//! Robots whose patches are in too bad a state to be paired: what the pixels themselves say.
//!
//! Where a team patch found no robot that fits it well, its shape (or what was paired with it)
//! says where the robot must be; the pose is then fitted to all pixels around it
//! ([`agreement`](crate::agreement)), first to those of any identification colour, and then each robot
//! of the team is asked how well it agrees. That needs no whole region of any colour, so it also names
//! robots whose patches are half dark, cut in pieces or grown together. Of robots that agree about
//! equally well, the assignment may choose; all others are ruled out, since a wrong name is worse than
//! none.

use crate::agreement::{Accepted, Cover, Surroundings};
use crate::class_index::ClassIndex;
use crate::footprint;
use crate::measure::Measure;
use crate::pairing::Scene;
use crate::pattern::{Pattern, Top};
use common::geometry::Pose;
use common::messages::{DetectionFrame, MAX_PATCHES};

/// Looks at pixels that second opinions may take in a frame, about a millisecond of them; ten robots of 250
/// pixels take a tenth. Patches that are not asked about for lack of it are listed with
/// [`RejectReason::NotLookedAt`](common::messages::RejectReason::NotLookedAt).
pub(crate) const WORK_PER_FRAME: u64 = 600_000;
/// A robot that seems to stand so far outside the pitch may still prove to stand on it.
const START_SLACK_MM: f64 = 15.0;
/// Half of the team patch must agree, after what disagrees has been taken off …
const MIN_TEAM_AGREEMENT: f32 = 0.3;
/// … and of the identification patches together so much: one may be too dark to have a colour, if
/// the others are good.
const MIN_MEAN_AGREEMENT: f32 = -0.05;
/// Another colour that fills so much of a patch contradicts the robot that would wear the patch.
const CONTRADICTION: f32 = 0.5;
/// From a pose at which less of the team patch agrees nothing good comes.
const MIN_START: f32 = 0.0;
/// Robots that agree less than the best by this before their own pose is fitted will not overtake it.
const WORTH_FITTING: f32 = 0.25;
/// Robots that agree less than the best by this, over all their patches together, are ruled out.
pub(crate) const AMBIGUITY: f32 = 0.15;

/// A robot that the pixels agree with.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Opinion {
    /// Index into the pattern's identities.
    pub identity: usize,
    pub pose: Pose,
    /// Sum over the patches of what is missing to full agreement, weighted like the sum of a
    /// hypothesis: 0 is perfect.
    pub misfit: f64,
}

/// Gives second opinions, reusing its lists.
#[derive(Debug, Clone, Default)]
pub(crate) struct SecondOpinion {
    surroundings: Surroundings,
    /// Poses that were looked at, and what the pixels cover there.
    seen: Vec<(Pose, Cover)>,
    /// The robots that the pixels of the team patch asked about last agree with.
    pub opinions: Vec<Opinion>,
}

impl SecondOpinion {
    /// Asks the pixels around a team patch of a kind which robot it is. `paired` are poses of robots that
    /// were paired with it, if any. Returns how many looks at pixels it took.
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
        self.surroundings.take_work()
    }

    /// Returns early where there is nothing to be seen.
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
        let Self { surroundings, seen, opinions } = self;
        seen.clear();
        let by_shape = footprint::poses(&top.patches[top.team_patch], team_patch);
        // A floor beside the pitch may be full of what looks like team patches.
        let is_inside = |pose: &Pose| scene.pitch.contains(pose.position, START_SLACK_MM);
        if !by_shape.iter().flatten().chain(paired).any(is_inside) {
            return;
        }
        surroundings.look_at(top, scene.camera, frame, index, team_patch.position);
        let any = accepted_by_any(pattern, team_kind);
        for pose in paired.iter().chain(by_shape.iter().flatten()) {
            seen.push((*pose, surroundings.cover(shares, pose)));
        }
        let starts = seen.iter().filter(|(pose, _)| is_inside(pose));
        let starts = starts.map(|(pose, cover)| (cover.total(shares, &any), pose, cover));
        let Some((_, &start, cover)) = starts.reduce(|a, b| if b.0 > a.0 { b } else { a }) else {
            return;
        };
        if cover.agreement(shares, &any)[top.team_patch] < MIN_START {
            return;
        }
        let near = surroundings.best_near(shares, &any, start);
        // Where the floor has a patch's colour, any pose agrees somehow, and pairing knew better: robots begin
        // from either.
        seen.truncate(paired.len());
        seen.push((near, surroundings.cover(shares, &near)));
        seen.rotate_right(1);
        let start_of = |accepted: &Accepted| {
            let starts = seen.iter().map(|(pose, cover)| (cover.total(shares, accepted), *pose));
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
            let pose = surroundings.best_near(shares, &accepted, start);
            let agreement = surroundings.cover(shares, &pose).agreement(shares, &accepted);
            let agreement = &agreement[..top.patches.len()];
            best = best.max(agreement.iter().sum());
            if !is_believable(top, agreement) {
                continue;
            }
            let inside = surroundings.cover_inside(shares, &pose).parts(shares, &accepted);
            if !is_contradicted(top, &inside) {
                let misfit = agreement.iter().map(|&part| 1.0 - f64::from(part)).sum();
                opinions.push(Opinion { identity, pose, misfit });
            }
        }
        // Whoever is ruled out may still have been the best: then nobody is sure.
        let full = top.patches.len() as f64;
        opinions.retain(|opinion| full - opinion.misfit >= f64::from(best - AMBIGUITY));
    }
}

fn is_believable(top: &Top, agreement: &[f32]) -> bool {
    let own = agreement[top.team_patch];
    let mean = (agreement.iter().sum::<f32>() - own) / (agreement.len() - 1) as f32;
    own >= MIN_TEAM_AGREEMENT && mean >= MIN_MEAN_AGREEMENT
}

/// Whether a patch of another colour lies where a robot would wear one of its own. One that is missing
/// says nothing: it may be too dark to have a colour.
fn is_contradicted(top: &Top, inside: &[[f32; 2]; MAX_PATCHES]) -> bool {
    let patches = inside.iter().enumerate().take(top.patches.len());
    patches
        .filter(|&(patch, _)| patch != top.team_patch)
        .any(|(_, [own, other])| *other >= CONTRADICTION && own < other)
}

/// The colours of a robot.
fn accepted_by(pattern: &Pattern, identity: usize) -> Accepted {
    let mut accepted = [0; MAX_PATCHES];
    for (bits, &kind) in accepted.iter_mut().zip(&pattern.identities[identity].kinds) {
        *bits = 1u32.checked_shl(pattern.kinds[kind].class).unwrap_or(0);
    }
    accepted
}

/// The colours of all robots that wear a team patch of a kind, patch by patch.
fn accepted_by_any(pattern: &Pattern, team_kind: usize) -> Accepted {
    let mut accepted = [0; MAX_PATCHES];
    for &identity in pattern.wearers(team_kind) {
        let own = accepted_by(pattern, identity);
        accepted.iter_mut().zip(own).for_each(|(bits, own)| *bits |= own);
    }
    accepted
}
