//! Candidates at the places that candidates for team patches predict, whatever regions their pixels belong to.

use super::CandidateFinder;
use super::candidate::{CUT_OUT, Part};
use crate::pattern::footprint::{self, Footprint};
use crate::pattern::{Kind, Pattern};
use crate::regions::measure::Measure;
use geometry::CameraModel;
use messages::{DetectionFrame, Region};

/// Most candidates for team patches of a kind that footprints are placed for; those with the likeliest areas.
const MAX_GUESSES: usize = 48;
/// Most runs and pixels visited by footprints in a frame: a few milliseconds. Ten robots take some ten
/// thousand.
const CUT_WORK_PER_FRAME: usize = 2_000_000;

/// The place of another patch that a candidate for a team patch predicts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    /// Index into the pattern's tops.
    top: usize,
    /// The first part of the team patch.
    beside: Part,
    footprint: Footprint,
}

impl CandidateFinder {
    /// Fills `places` from the candidates for team patches.
    pub(super) fn guess_places(&mut self, pattern: &Pattern, camera: &CameraModel) {
        // Only kinds of team patches have ranges at this point.
        for range in self.ranges.iter().zip(&pattern.kinds) {
            let (range, kind) = range;
            let top = pattern.top_of_kind(kind);
            let expected = &top.patches[top.team_patch];
            for team_patch in self.candidates[range.clone()].iter().take(MAX_GUESSES) {
                let poses = footprint::poses(expected, &team_patch.measure);
                for pose in poses.into_iter().flatten() {
                    for patch in (0..top.patches.len()).filter(|&patch| patch != top.team_patch) {
                        let Some(footprint) = Footprint::new(top, camera, &pose, patch) else {
                            continue;
                        };
                        let beside = team_patch.seed();
                        self.places.push(Place { top: kind.top, beside, footprint });
                    }
                }
            }
        }
    }

    /// Adds the pixels at the places that team patches predict for the kind.
    pub(super) fn look_beside_team_patches(
        &mut self,
        pattern: &Pattern,
        kind: &Kind,
        camera: &CameraModel,
        frame: &DetectionFrame,
    ) {
        for index in 0..self.places.len() {
            let Place { top, beside, footprint } = self.places[index];
            if (top, footprint.patch) != (kind.top, kind.patch) {
                continue;
            }
            let before = self.candidates.len();
            self.cut_out(pattern, kind, camera, frame, &footprint);
            for candidate in &mut self.candidates[before..] {
                candidate.beside = Some(beside);
            }
        }
    }

    /// Adds the pixels of the kind's colour in a footprint.
    fn cut_out(
        &mut self,
        pattern: &Pattern,
        kind: &Kind,
        camera: &CameraModel,
        frame: &DetectionFrame,
        footprint: &Footprint,
    ) {
        let top = pattern.top_of_kind(kind);
        let mut sums = footprint.sums();
        // Pixels of the region that has most of them, and the region.
        let mut most = (0, 0);
        let Some(measured) = self.by_height.get(top.height) else { return };
        let of_class = measured.of_class(kind.class);
        measured.meeting(kind.class, &footprint.bounds, &mut self.meeting);
        for &index in &self.meeting {
            let index = of_class[index as usize].region;
            let Some(region) = frame.regions().get(index as usize) else { continue };
            self.cut_work += cut_work(region);
            if self.cut_work > CUT_WORK_PER_FRAME {
                return;
            }
            let pixels = footprint.add(top, region, frame, &mut sums);
            if pixels > most.0 {
                most = (pixels, index);
            }
        }
        let Some(cut) = self.cuts.checked_add(1).filter(|_| most.0 > 0) else { return };
        if let Some(measure) = Measure::new(&sums.moments(), camera, top.height_mm) {
            self.cuts = cut;
            let part = Part { region: most.1, piece: cut, pieces: CUT_OUT };
            self.push(pattern, &top.patches[kind.patch], &[part], measure);
        }
    }
}

/// Runs and pixels visited for a region and a footprint, about.
fn cut_work(region: &Region) -> usize {
    const FOOTPRINT_PX: u32 = 400;
    region.run_count as usize + region.pixel_count.min(FOOTPRINT_PX) as usize
}
