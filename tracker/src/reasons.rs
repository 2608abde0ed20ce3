//! Rejections: the reasons why regions became no robot, from which colours and lamps are set up.

use crate::candidates::Candidate;
use crate::faint::FaintRobots;
use crate::pairing::hypotheses::{Outcome, SearchResult};
use crate::pairing::{Pairing, TEAM_PATCH_DISTANCE};
use crate::pattern::{Kind, Pattern, Top};
use crate::regions::measure::distance_mm;
use crate::regions::measured_regions::MeasuredRegion;
use crate::unknown::UnknownRobots;
use geometry::ImagePoint;
use messages::{DetectionFrame, MAX_REGIONS, RejectReason, Rejected, Team};

/// Least area of a region that is listed, as a fraction of the smallest admitted area: smaller ones are
/// noise.
const WORTH_LISTING: f64 = 0.25;

/// Collects rejections; of too many the largest are kept.
#[derive(Debug, Clone, Default)]
pub(crate) struct Rejections {
    list: Vec<(f64, Rejected)>,
    used: UsedRegions,
}

/// The regions of robots that were found.
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

    /// Adds a region of a team, or of [`Rejected::BALL`] or [`Rejected::UNKNOWN_TEAM`].
    pub fn add(&mut self, team: u32, reason: RejectReason, place: ImagePoint, area_mm2: f64) {
        let (x_px, y_px) = (place.x_px as f32, place.y_px as f32);
        self.list.push((area_mm2, Rejected { team, reason: reason as u32, x_px, y_px }));
    }

    /// Appends the rejections to the message, largest first, those that are too small behind all others, as
    /// far as there is room.
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

/// Lists the regions that should have become a robot and did not.
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
        for measured in pairing.finder.measured_of(top, class) {
            if measured.measure.area_mm2 < worth_listing
                || unknown.use_region(measured.region)
                || faint.covers(pattern, measured.measure.position)
            {
                continue;
            }
            let reason = match reason(pattern, pairing, used, team, measured) {
                // A blurred robot may be there.
                Some(RejectReason::NoIdentificationPatch | RejectReason::TooSmall)
                    if faint.has_skipped(measured.region) =>
                {
                    Some(RejectReason::NotLookedAt)
                }
                reason => reason,
            };
            if let Some(reason) = reason {
                rejections.add(
                    team as u32,
                    reason,
                    measured.measure.image,
                    measured.measure.area_mm2,
                );
            }
        }
    }
}

/// Lists every identification patch of the right size that is in no robot and has no region of a team's
/// colour near it: the robot is not found because its team's colour is not.
fn explain_lonely_patches(
    pattern: &Pattern,
    pairing: &Pairing,
    used: &UsedRegions,
    faint: &FaintRobots,
    rejections: &mut Rejections,
) {
    let is_of_team = |class: u32| Team::ALL.iter().any(|&team| pattern.team_class(team) == class);
    // Where teams have different heights, the error of each place is small.
    let top = first_top(pattern, Team::Yellow);
    for measured in pairing.finder.measured_on(top) {
        if measured.outside
            || is_of_team(measured.class)
            || used.contain(measured.region)
            || faint.covers(pattern, measured.measure.position)
        {
            continue;
        }
        let could_be = pattern.kinds.iter().filter(|kind| {
            let patch = pattern.patch_of_kind(kind);
            kind.team.is_none()
                && kind.class == measured.class
                && pattern.limits.admit_area(measured.measure.area_mm2 / patch.area_mm2)
                && measured.measure.is_shaped_like(patch)
        });
        let farthest = could_be.map(|kind| reach_mm(pattern, kind)).reduce(f64::max);
        let is_lonely = farthest.is_some_and(|farthest| {
            // Regions of any size: a bad team patch is listed with a reason of its own.
            let place = measured.measure.position;
            !Team::ALL.iter().any(|&team| {
                pairing.finder.is_any_near(top, pattern.team_class(team), place, farthest)
            })
        });
        if is_lonely {
            let (reason, measure) = (RejectReason::NoTeamPatch, &measured.measure);
            rejections.add(Rejected::UNKNOWN_TEAM, reason, measure.image, measure.area_mm2);
        }
    }
}

/// The top of a team's first kind, whose height is used for all regions of the team.
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

/// The reason why a region of a team's colour is not in a robot; `None` if it is in one.
fn reason(
    pattern: &Pattern,
    pairing: &Pairing,
    used: &UsedRegions,
    team: Team,
    measured: &MeasuredRegion,
) -> Option<RejectReason> {
    if used.contain(measured.region) {
        return None;
    }
    if measured.outside {
        return Some(RejectReason::OutsideField);
    }
    let candidates = || {
        let kinds = pattern.team_kinds(team).iter();
        kinds.flat_map(|&kind| {
            pairing.finder.of_kind(kind).iter().enumerate().map(move |c| (kind, c))
        })
    };
    let results = candidates()
        .filter(|(_, (_, candidate))| candidate.uses_region(measured.region))
        .map(|(kind, (index, _))| pairing.result(kind, index));
    let result = results.reduce(SearchResult::better);
    let Some(result) = result else {
        let team_kinds = pattern.team_kinds(team).iter().map(|&kind| &pattern.kinds[kind]);
        let expected_mm2 = team_kinds.map(|kind| pattern.patch_of_kind(kind).area_mm2);
        let most_mm2 = pattern.limits.max_area_ratio * expected_mm2.fold(0.0, f64::max);
        let too_large = measured.measure.area_mm2 > most_mm2;
        // A region of the right area but too narrow counts as too small.
        return Some(if too_large { RejectReason::TooLarge } else { RejectReason::TooSmall });
    };

    let least_distance = TEAM_PATCH_DISTANCE * first_top(pattern, team).team_patch_size_mm();
    let too_close = candidates().any(|(_, (_, other))| {
        !other.uses_region(measured.region)
            && distance_mm(other.measure.position, measured.measure.position) < least_distance
            && (other.measure.area_mm2 > measured.measure.area_mm2
                || used.contain(other.seed().region))
    });
    if too_close {
        return Some(RejectReason::TooCloseToTeamPatch);
    }
    if result.is_unasked {
        return Some(RejectReason::NotLookedAt);
    }
    if result.is_cut {
        return Some(RejectReason::SearchCut);
    }
    Some(match result.outcome {
        Outcome::Complete => RejectReason::TakenByAnother,
        Outcome::Outside => RejectReason::OutsideField,
        Outcome::Incomplete
            if unused_identification_near(pattern, pairing, used, team, measured) =>
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
    used: &UsedRegions,
    team: Team,
    measured: &MeasuredRegion,
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
                    && distance_mm(candidate.measure.position, measured.measure.position) <= reach
            })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use messages::MAX_REJECTED;

    #[test]
    fn regions_that_are_too_small_are_dropped_first_when_the_list_is_full() {
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
