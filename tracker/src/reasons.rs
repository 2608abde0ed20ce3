//! Why candidates became nothing: what a person needs to see to set up colours and lamps.

use crate::candidates::Candidate;
use crate::faint::FaintRobots;
use crate::hypotheses::{Fate, Outcome};
use crate::measure::distance_mm;
use crate::pairing::{Pairing, TEAM_PATCH_DISTANCE};
use crate::pattern::{Kind, Pattern, Top};
use crate::spots::Spot;
use crate::unknown::UnknownRobots;
use common::geometry::ImagePoint;
use common::messages::{DetectionFrame, MAX_REGIONS, RejectReason, Rejected, Team};

/// Below this fraction of the smallest size that is admitted, a region is plain noise and not
/// worth listing.
const WORTH_LISTING: f64 = 0.25;

/// Collects rejections; the most telling survive when there are too many.
#[derive(Debug, Clone, Default)]
pub(crate) struct Rejections {
    list: Vec<(f64, Rejected)>,
    used: UsedRegions,
}

/// The regions that robots were put together from.
#[derive(Debug, Clone, Default)]
struct UsedRegions {
    is_used: Vec<bool>,
}

impl UsedRegions {
    fn fill(&mut self, pattern: &Pattern, pairing: &Pairing) {
        self.is_used.clear();
        self.is_used.resize(MAX_REGIONS, false);
        for robot in pairing.robots() {
            for patch in 0..pattern.top_of(robot.identity).patches.len() {
                let parts = pairing.candidate(pattern, robot, patch).map(Candidate::parts);
                for part in parts.unwrap_or_default() {
                    if let Some(is_used) = self.is_used.get_mut(part.region as usize) {
                        *is_used = true;
                    }
                }
            }
        }
    }

    fn contain(&self, region: u32) -> bool {
        self.is_used.get(region as usize).copied().unwrap_or(false)
    }
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

/// Lists what should have become a robot and did not.
pub(crate) fn explain(
    pattern: &Pattern,
    pairing: &Pairing,
    faint: &FaintRobots,
    unknown: &UnknownRobots,
    rejections: &mut Rejections,
) {
    let mut used = std::mem::take(&mut rejections.used);
    used.fill(pattern, pairing);
    explain_team_patches(pattern, pairing, &used, faint, unknown, rejections);
    explain_lonely_patches(pattern, pairing, &used, faint, rejections);
    rejections.used = used;
}

/// Lists every region of a team's colour that is in no robot.
fn explain_team_patches(
    pattern: &Pattern,
    pairing: &Pairing,
    used: &UsedRegions,
    faint: &FaintRobots,
    unknown: &UnknownRobots,
    rejections: &mut Rejections,
) {
    for team in Team::ALL {
        let (class, top) = (pattern.team_class(team), first_top(pattern, team));
        let worth_listing =
            WORTH_LISTING * pattern.limits.min_area_ratio * least_team_patch_mm2(pattern, team);
        for spot in pairing.finder.spots_of(top, class) {
            if spot.measure.area_mm2 < worth_listing
                || unknown.use_region(spot.region)
                || faint.covers(pattern, spot.measure.position)
            {
                continue;
            }
            let reason = match reason(pattern, pairing, used, team, spot) {
                // There may be a robot so blurred that its patches have no pixels of their own.
                Some(RejectReason::NoIdentificationPatch | RejectReason::TooSmall)
                    if faint.has_skipped(spot.region) =>
                {
                    Some(RejectReason::NotLookedAt)
                }
                reason => reason,
            };
            if let Some(reason) = reason {
                rejections.add(team as u32, reason, spot.measure.image, spot.measure.area_mm2);
            }
        }
    }
}

/// Lists every identification patch of the right size that is in no robot and has no region of a
/// team's colour beside it: whoever wears it is not seen, because his team's colour is not.
fn explain_lonely_patches(
    pattern: &Pattern,
    pairing: &Pairing,
    used: &UsedRegions,
    faint: &FaintRobots,
    rejections: &mut Rejections,
) {
    let is_of_team = |class: u32| Team::ALL.iter().any(|&team| pattern.team_class(team) == class);
    // Where teams have different heights, each patch is off by the same little.
    let top = first_top(pattern, Team::Yellow);
    // However small: a bad team patch is listed with a reason of its own.
    let team_spots = || {
        let of = |team| pairing.finder.spots_of(top, pattern.team_class(team)).iter();
        Team::ALL.into_iter().flat_map(of)
    };
    for spot in pairing.finder.spots(top) {
        if spot.outside
            || is_of_team(spot.class)
            || used.contain(spot.region)
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
            let distance = |team: &Spot| distance_mm(team.measure.position, spot.measure.position);
            team_spots().all(|team| distance(team) > farthest)
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

/// Why a region of a team's colour is not in a robot; `None` if it is.
fn reason(
    pattern: &Pattern,
    pairing: &Pairing,
    used: &UsedRegions,
    team: Team,
    spot: &Spot,
) -> Option<RejectReason> {
    if used.contain(spot.region) {
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
    let fate = fates.reduce(Fate::better);
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
            && distance_mm(other.measure.position, spot.measure.position) < least_distance
            && (other.measure.area_mm2 > spot.measure.area_mm2 || used.contain(other.seed().region))
    });
    if too_close {
        return Some(RejectReason::TooCloseToTeamPatch);
    }
    if fate.is_unasked {
        return Some(RejectReason::NotLookedAt);
    }
    if fate.is_cut {
        return Some(RejectReason::SearchCut);
    }
    Some(match fate.outcome {
        Outcome::Complete => RejectReason::TakenByAnother,
        Outcome::Outside => RejectReason::OutsideField,
        Outcome::Incomplete if unused_identification_near(pattern, pairing, used, team, spot) => {
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
    used: &UsedRegions,
    team: Team,
    spot: &Spot,
) -> bool {
    let is_worn = |kind: usize| {
        let identities = &pattern.identities;
        identities.iter().any(|identity| identity.team == team && identity.kinds.contains(&kind))
    };
    pattern.kinds.iter().enumerate().any(|(index, kind)| {
        let reach = reach_mm(pattern, kind);
        kind.team.is_none()
            && is_worn(index)
            && pairing.finder.of_kind(index).iter().any(|candidate| {
                !used.contain(candidate.seed().region)
                    && distance_mm(candidate.measure.position, spot.measure.position) <= reach
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
