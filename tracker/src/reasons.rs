//! Why candidates became nothing: what a person needs to see to set up colours and lamps.

use crate::candidates::Spot;
use crate::faint::FaintRobots;
use crate::hypotheses::{Fate, Outcome};
use crate::pairing::{Pairing, TEAM_PATCH_DISTANCE};
use crate::pattern::{Kind, Pattern, Top};
use crate::unknown::UnknownRobots;
use common::geometry::ImagePoint;
use common::messages::{DetectionFrame, RejectReason, Rejected, Team};

/// Below this fraction of the smallest size that is admitted, a region is plain noise and not
/// worth listing.
const WORTH_LISTING: f64 = 0.25;

/// Collects rejections; the most telling survive when there are too many.
#[derive(Debug, Clone, Default)]
pub(crate) struct Rejections {
    list: Vec<(f64, Rejected)>,
}

impl Rejections {
    pub fn clear(&mut self) {
        self.list.clear();
    }

    /// Adds a candidate of a team, or what stands in its place ([`Rejected::BALL`]).
    pub fn add(&mut self, team: u32, reason: RejectReason, place: ImagePoint, area_mm2: f64) {
        let (x_px, y_px) = (place.x_px as f32, place.y_px as f32);
        self.list.push((area_mm2, Rejected { team, reason: reason as u32, x_px, y_px }));
    }

    /// Appends what was collected to the message, largest first, and the small fry behind all
    /// others; what does not fit is dropped.
    pub fn write(&mut self, frame: &mut DetectionFrame) {
        self.list.sort_unstable_by(|(a_area, a), (b_area, b)| {
            let is_small = |rejected: &Rejected| rejected.reason == RejectReason::TooSmall as u32;
            let by_place = || {
                a.team
                    .cmp(&b.team)
                    .then(a.y_px.total_cmp(&b.y_px))
                    .then(a.x_px.total_cmp(&b.x_px))
                    .then(a.reason.cmp(&b.reason))
            };
            is_small(a).cmp(&is_small(b)).then(b_area.total_cmp(a_area)).then_with(by_place)
        });
        for (_, rejected) in &self.list {
            if !frame.push_rejected(*rejected) {
                break;
            }
        }
    }
}

/// Lists every region of a team's colour that is in no robot.
pub(crate) fn explain_team_patches(
    pattern: &Pattern,
    pairing: &Pairing,
    faint: &FaintRobots,
    unknown: &UnknownRobots,
    rejections: &mut Rejections,
) {
    for team in Team::ALL {
        let (class, top) = (pattern.team_class(team), first_top(pattern, team));
        let worth_listing =
            WORTH_LISTING * pattern.limits.min_area_ratio * least_team_patch_mm2(pattern, team);
        for spot in pairing.finder.spots(top) {
            if spot.class != class
                || spot.measure.area_mm2 < worth_listing
                || unknown.use_region(spot.region)
                || faint.covers(pattern, spot.measure.position)
            {
                continue;
            }
            if let Some(reason) = reason(pattern, pairing, team, spot) {
                rejections.add(team as u32, reason, spot.measure.image, spot.measure.area_mm2);
            }
        }
    }
}

/// Lists every identification patch of the right size that is in no robot and has no region of a
/// team's colour beside it: whoever wears it is not seen, because his team's colour is not.
pub(crate) fn explain_lonely_patches(
    pattern: &Pattern,
    pairing: &Pairing,
    faint: &FaintRobots,
    rejections: &mut Rejections,
) {
    let is_of_team = |class: u32| Team::ALL.iter().any(|&team| pattern.team_class(team) == class);
    // Where teams have different heights, each patch is off by the same little.
    let spots = || pairing.finder.spots(first_top(pattern, Team::Yellow)).iter();
    // However small: a bad team patch is listed with a reason of its own.
    let team_spots = || spots().filter(|spot| is_of_team(spot.class));
    for spot in spots() {
        if spot.outside
            || is_of_team(spot.class)
            || is_used(pattern, pairing, spot.region)
            || faint.covers(pattern, spot.measure.position)
        {
            continue;
        }
        let could_be = pattern.kinds.iter().filter(|kind| {
            let patch = pattern.patch_of_kind(kind);
            kind.team.is_none()
                && kind.class == spot.class
                && pattern.limits.admit_area(spot.measure.area_mm2 / patch.area_mm2)
                && spot.measure.is_shaped_like(patch)
        });
        let farthest = could_be.map(|kind| reach_mm(pattern, kind)).reduce(f64::max);
        let is_lonely = farthest.is_some_and(|farthest| {
            team_spots()
                .all(|team| team.measure.position.distance(spot.measure.position) > farthest)
        });
        if is_lonely {
            let (reason, measure) = (RejectReason::NoTeamPatch, &spot.measure);
            rejections.add(Rejected::UNKNOWN_TEAM, reason, measure.image, measure.area_mm2);
        }
    }
}

/// The top by whose height a team's regions are judged: that of its first kind.
fn first_top(pattern: &Pattern, team: Team) -> &Top {
    pattern.top_of_kind(&pattern.kinds[pattern.team_kinds(team)[0]])
}

/// Area of the smallest team patch that robots of a team wear.
fn least_team_patch_mm2(pattern: &Pattern, team: Team) -> f64 {
    let kinds = pattern.team_kinds(team).iter().map(|&kind| &pattern.kinds[kind]);
    kinds.map(|kind| pattern.patch_of_kind(kind).area_mm2).fold(f64::INFINITY, f64::min)
}

/// Farthest that an identification patch of a kind may lie from its team patch.
fn reach_mm(pattern: &Pattern, kind: &Kind) -> f64 {
    let top = pattern.top_of_kind(kind);
    top.distance_mm(kind.patch, top.team_patch) + pattern.limits.patch_tolerance_mm
}

/// Whether a region is in a robot.
fn is_used(pattern: &Pattern, pairing: &Pairing, region: u32) -> bool {
    pairing.robots().any(|robot| {
        (0..pattern.top_of(robot.identity).patches.len())
            .filter_map(|patch| pairing.candidate(pattern, robot, patch))
            .any(|candidate| candidate.uses_region(region))
    })
}

/// Why a region of a team's colour is not in a robot; `None` if it is.
fn reason(pattern: &Pattern, pairing: &Pairing, team: Team, spot: &Spot) -> Option<RejectReason> {
    let is_used = |region: u32| is_used(pattern, pairing, region);
    if is_used(spot.region) {
        return None;
    }
    if spot.outside {
        return Some(RejectReason::OutsideField);
    }
    let candidates = || {
        let kinds = pattern.team_kinds(team).iter();
        kinds.flat_map(|&kind| {
            pairing.finder.of_kind(kind).iter().enumerate().map(move |c| (kind, c))
        })
    };
    let fates = candidates()
        .filter(|(_, (_, candidate))| candidate.uses_region(spot.region))
        .map(|(kind, (index, _))| pairing.fate(kind, index));
    let best =
        |a: Fate, b: Fate| Fate { outcome: a.outcome.max(b.outcome), is_cut: a.is_cut || b.is_cut };
    let fate = fates.reduce(best);
    let Some(fate) = fate else {
        let team_kinds = pattern.team_kinds(team).iter().map(|&kind| &pattern.kinds[kind]);
        let expected_mm2 = team_kinds.map(|kind| pattern.patch_of_kind(kind).area_mm2);
        let most_mm2 = pattern.limits.max_area_ratio * expected_mm2.fold(0.0, f64::max);
        let too_large = spot.measure.area_mm2 > most_mm2;
        // Neither can be a string of many pixels: too narrow is too small.
        return Some(if too_large { RejectReason::TooLarge } else { RejectReason::TooSmall });
    };

    let least_distance = TEAM_PATCH_DISTANCE * first_top(pattern, team).team_patch_size_mm();
    let too_close = candidates().any(|(_, (_, other))| {
        !other.uses_region(spot.region)
            && other.measure.position.distance(spot.measure.position) < least_distance
            && (other.measure.area_mm2 > spot.measure.area_mm2 || is_used(other.seed().region))
    });
    if too_close {
        return Some(RejectReason::TooCloseToTeamPatch);
    }
    if fate.is_cut {
        return Some(RejectReason::SearchCut);
    }
    Some(match fate.outcome {
        Outcome::Complete => RejectReason::TakenByAnother,
        Outcome::Outside => RejectReason::OutsideField,
        Outcome::Incomplete
            if unused_identification_near(pattern, pairing, team, spot, &is_used) =>
        {
            RejectReason::LayoutMismatch
        }
        Outcome::Incomplete => RejectReason::NoIdentificationPatch,
    })
}

/// Whether an identification patch that some robot of the team wears lies within reach of the
/// region, at whatever distance, and belongs to no robot that was found.
fn unused_identification_near(
    pattern: &Pattern,
    pairing: &Pairing,
    team: Team,
    spot: &Spot,
    is_used: &dyn Fn(u32) -> bool,
) -> bool {
    let identities = pattern.identities.iter().filter(|identity| identity.team == team);
    identities.flat_map(|identity| &identity.kinds).any(|&kind| {
        let reach = reach_mm(pattern, &pattern.kinds[kind]);
        pattern.kinds[kind].team.is_none()
            && pairing.finder.of_kind(kind).iter().any(|candidate| {
                candidate.measure.position.distance(spot.measure.position) <= reach
                    && !is_used(candidate.seed().region)
            })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use common::messages::MAX_REJECTED;

    #[test]
    fn the_small_fry_goes_first_when_the_list_is_full() {
        let mut rejections = Rejections::default();
        for index in 0..MAX_REJECTED {
            let place = ImagePoint::new(index as f64, 0.0);
            rejections.add(0, RejectReason::TooSmall, place, 1e6 + index as f64);
            rejections.add(1, RejectReason::TakenByAnother, place, index as f64);
        }
        let mut frame = Box::new(DetectionFrame::zeroed());
        rejections.write(&mut frame);
        assert_eq!(frame.rejected().len(), MAX_REJECTED);
        assert!(frame.rejected().iter().all(|rejected| rejected.team == 1));
        assert_eq!(frame.rejected()[0].x_px, (MAX_REJECTED - 1) as f32);

        rejections.clear();
        rejections.add(0, RejectReason::TooSmall, ImagePoint::new(1.0, 2.0), 5.0);
        frame.clear();
        rejections.write(&mut frame);
        assert_eq!(frame.rejected().len(), 1);
    }
}
