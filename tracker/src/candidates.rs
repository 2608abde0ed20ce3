//! Candidates: regions, and parts and groups of regions, that may be a certain patch in a certain colour.
//!
//! A candidate of a kind is one of
//!
//! * a region of the kind's colour whose area and shape a patch could have,
//! * such a region merged with up to three smaller ones of its colour near it, because noise or another patch
//!   may have cut the patch in pieces: their average, weighted by area (section 6.1),
//! * one of 2 to 4 pieces of a region that is too large, because patches of two robots may have grown
//!   together ([`split`](crate::split)),
//! * the pixels of the colour at the place that a candidate for a team patch predicts
//!   ([`footprint`](crate::footprint)), whatever region they belong to.
//!
//! Candidates made of the same pixels contradict each other. The assignment decides which are real, when the
//! value of each explanation is known; nothing is ruled out here.

use crate::class_index::ClassIndex;
use crate::footprint::{self, Footprint};
use crate::measure::{Measure, Moments};
use crate::measured_regions::{MeasuredRegion, MeasuredRegions};
use crate::pattern::{ExpectedPatch, Kind, Pattern, Top};
use crate::pitch::Pitch;
use crate::split::{MAX_PIECES, Splitter};
use common::geometry::CameraModel;
use common::messages::{DetectionFrame, Region};
use std::ops::Range;

/// Most regions that are merged into one candidate.
pub(crate) const MAX_PARTS: usize = 4;
/// Most candidates of one kind; of more, those with the likeliest areas are kept. Thirty-two robots with two
/// dots of a colour each have 64, and a few more for fragments.
const MAX_CANDIDATES: usize = 192;
/// Least area of a fragment, as a fraction of the patch's area.
const MIN_FRAGMENT_RATIO: f64 = 0.05;
/// Largest area of merged fragments, as a multiple of the patch's area.
const MAX_MERGED_RATIO: f64 = 1.35;
/// Largest distance of a fragment from the largest one, as a multiple of the patch's reach.
const MERGE_REACH: f64 = 1.3;
/// Largest deviation of merged fragments along their longer axis, as a multiple of the patch's.
const MAX_MERGED_SPREAD: f64 = 1.4;
/// Area per piece of a region that is split, as a multiple of the patch's area.
const SPLIT_RATIO: Range<f64> = 0.65..1.5;

/// Number of pieces of a part that was cut out by a footprint.
const CUT_OUT: u16 = u16::MAX;
/// Most candidates for team patches of a kind that footprints are placed for; those with the likeliest areas.
const MAX_GUESSES: usize = 48;
/// Most runs and pixels visited by footprints in a frame: a few milliseconds. Ten robots take some ten
/// thousand.
const CUT_WORK_PER_FRAME: usize = 2_000_000;

/// A region, a piece of one that was split, or the pixels of one within a footprint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Part {
    pub region: u32,
    /// Index of the piece, from 0; number of the footprint in the frame, from 1.
    pub piece: u16,
    /// Number of pieces; 1 for the whole region, [`CUT_OUT`] for a footprint.
    pub pieces: u16,
}

/// A possible patch.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Candidate {
    /// Largest first.
    parts: [Part; MAX_PARTS],
    part_count: usize,
    pub measure: Measure,
    /// Cost of its area: 0 to 1 at the limits.
    pub misfit: f64,
    /// For a footprint's pixels, the first part of the team patch that predicts them: they are a patch of
    /// that robot or of none.
    pub beside: Option<Part>,
}

impl Part {
    fn whole(region: u32) -> Self {
        Self { region, piece: 0, pieces: 1 }
    }

    /// Whether two parts share pixels.
    fn overlaps(&self, other: &Self) -> bool {
        self.region == other.region && (self.pieces != other.pieces || self.piece == other.piece)
    }
}

impl Candidate {
    /// The parts, the largest first.
    pub fn parts(&self) -> &[Part] {
        &self.parts[..self.part_count]
    }

    /// The largest part.
    pub fn seed(&self) -> Part {
        self.parts[0]
    }

    /// Whether two candidates share pixels.
    pub fn overlaps(&self, other: &Self) -> bool {
        self.parts().iter().any(|part| other.parts().iter().any(|theirs| part.overlaps(theirs)))
    }

    pub fn uses_region(&self, region: u32) -> bool {
        self.parts().iter().any(|part| part.region == region)
    }
}

/// The place of another patch that a candidate for a team patch predicts.
#[derive(Debug, Clone, Copy)]
struct Place {
    /// Index into the pattern's tops.
    top: usize,
    /// The first part of the team patch.
    beside: Part,
    footprint: Footprint,
}

/// Finds candidates, and keeps them until the next frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct CandidateFinder {
    /// For each height of the pattern, the measured regions.
    by_height: Vec<MeasuredRegions>,
    candidates: Vec<Candidate>,
    /// For each kind of the pattern, its part of `candidates`.
    ranges: Vec<Range<usize>>,
    splitter: Splitter,
    /// Squared distance and index of the fragments near a region.
    near: Vec<(f64, usize)>,
    /// There were more than [`MAX_CANDIDATES`] of a kind.
    pub is_cut: bool,
    /// Places of other patches that the candidates for team patches predict.
    places: Vec<Place>,
    /// Number of parts cut out in this frame.
    cuts: u16,
    cut_work: usize,
}

impl CandidateFinder {
    /// Regions in the colours of a top's patches, measured at its height; class by class, in each the largest
    /// first.
    pub fn measured_on(&self, top: &Top) -> &[MeasuredRegion] {
        self.by_height.get(top.height).map_or(&[], MeasuredRegions::all)
    }

    /// The regions of one class, largest first.
    pub fn measured_of(&self, top: &Top, class: u32) -> &[MeasuredRegion] {
        self.by_height.get(top.height).map_or(&[], |regions| regions.of_class(class))
    }

    /// Candidates of a kind, the likeliest area first; those of footprints among them.
    pub fn of_kind(&self, kind: usize) -> &[Candidate] {
        self.ranges.get(kind).map_or(&[], |range| &self.candidates[range.clone()])
    }

    /// Finds the candidates among the regions of `frame`.
    pub fn find(
        &mut self,
        pattern: &Pattern,
        camera: &CameraModel,
        pitch: &Pitch,
        frame: &DetectionFrame,
        index: &ClassIndex,
    ) {
        self.splitter.start_frame();
        self.measure_regions(pattern, camera, pitch, frame, index);
        self.candidates.clear();
        self.ranges.clear();
        self.places.clear();
        let mut is_guessed = false;
        (self.cuts, self.cut_work, self.is_cut) = (0, 0, false);
        for (kind, alike) in pattern.kinds.iter().zip(&pattern.alike) {
            let begin = self.candidates.len();
            match alike {
                Some(alike) => self.copy_kind(*alike),
                None => self.find_kind(pattern, kind, camera, frame),
            }
            // A total order: no two candidates are equal.
            let by_misfit = |a: &Candidate, b: &Candidate| {
                a.misfit.total_cmp(&b.misfit).then_with(|| a.parts().cmp(b.parts()))
            };
            self.candidates[begin..].sort_unstable_by(by_misfit);
            self.is_cut |= self.candidates.len() > begin + MAX_CANDIDATES;
            self.candidates.truncate(begin + MAX_CANDIDATES);
            // The kinds of team patches come first, so all their candidates are known.
            if kind.team.is_none() {
                if !is_guessed {
                    self.guess_places(pattern, camera);
                    is_guessed = true;
                }
                self.look_beside_team_patches(pattern, kind, camera, frame);
                self.candidates[begin..].sort_unstable_by(by_misfit);
            }
            self.ranges.push(begin..self.candidates.len());
        }
    }

    fn measure_regions(
        &mut self,
        pattern: &Pattern,
        camera: &CameraModel,
        pitch: &Pitch,
        frame: &DetectionFrame,
        index: &ClassIndex,
    ) {
        self.by_height.resize(pattern.heights_mm.len(), MeasuredRegions::default());
        for (height, regions) in self.by_height.iter_mut().enumerate() {
            let is_there = |kind: &&Kind| pattern.top_of_kind(kind).height == height;
            let kinds = pattern.kinds.iter().filter(is_there);
            let classes = kinds.fold(0u32, |classes, kind| classes | 1 << kind.class);
            let height_mm = pattern.heights_mm[height];
            // A patch lies within half a diagonal of the centre of its robot.
            let slack_mm = pattern.size_mm * 0.75;
            regions.measure(frame, index, classes, camera, height_mm, pitch, slack_mm);
        }
    }

    /// Copies the candidates of an earlier kind that has the same ones, except those of footprints.
    fn copy_kind(&mut self, kind: usize) {
        for index in self.ranges[kind].clone() {
            let candidate = self.candidates[index];
            if candidate.beside.is_none() {
                self.candidates.push(candidate);
            }
        }
    }

    fn find_kind(
        &mut self,
        pattern: &Pattern,
        kind: &Kind,
        camera: &CameraModel,
        frame: &DetectionFrame,
    ) {
        let (top, patch) = (pattern.top_of_kind(kind), pattern.patch_of_kind(kind));
        for seed in 0..self.measured_of(top, kind.class).len() {
            let measured = self.measured_of(top, kind.class)[seed];
            if measured.outside {
                continue;
            }
            let ratio = measured.measure.area_mm2 / patch.area_mm2;
            self.push(pattern, patch, &[Part::whole(measured.region)], measured.measure);
            if ratio < MAX_MERGED_RATIO {
                self.merge(pattern, top, patch, kind.class, seed);
            }
            for pieces in 2..=MAX_PIECES {
                if SPLIT_RATIO.contains(&(ratio / pieces as f64)) {
                    self.split(pattern, top, patch, &measured, pieces, camera, frame);
                }
            }
        }
    }

    /// Fills `places` from the candidates for team patches.
    fn guess_places(&mut self, pattern: &Pattern, camera: &CameraModel) {
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
    fn look_beside_team_patches(
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
        let regions =
            self.by_height.get(top.height).map_or(&[][..], |regions| regions.of_class(kind.class));
        for measured in regions.iter().filter(|measured| measured.bounds.meets(&footprint.bounds)) {
            let Some(region) = frame.regions().get(measured.region as usize) else { continue };
            self.cut_work += cut_work(region);
            if self.cut_work > CUT_WORK_PER_FRAME {
                return;
            }
            let pixels = footprint.add(top, region, frame, &mut sums);
            if pixels > most.0 {
                most = (pixels, measured.region);
            }
        }
        let Some(cut) = self.cuts.checked_add(1).filter(|_| most.0 > 0) else { return };
        if let Some(measure) = Measure::new(&sums.moments(), camera, top.height_mm) {
            self.cuts = cut;
            let part = Part { region: most.1, piece: cut, pieces: CUT_OUT };
            self.push(pattern, &top.patches[kind.patch], &[part], measure);
        }
    }

    /// Adds a candidate if it can be the patch at all.
    fn push(&mut self, pattern: &Pattern, patch: &ExpectedPatch, parts: &[Part], measure: Measure) {
        let area_ratio = measure.area_mm2 / patch.area_mm2;
        if !pattern.limits.admit_area(area_ratio) || !measure.is_shaped_like(patch) {
            return;
        }
        let mut candidate = Candidate {
            parts: [Part::whole(u32::MAX); MAX_PARTS],
            part_count: parts.len().min(MAX_PARTS),
            measure,
            misfit: pattern.limits.area_misfit(area_ratio),
            beside: None,
        };
        for (slot, part) in candidate.parts.iter_mut().zip(parts) {
            *slot = *part;
        }
        self.candidates.push(candidate);
    }

    /// Adds the region merged with one, two and three smaller ones of its class, nearest first.
    fn merge(
        &mut self,
        pattern: &Pattern,
        top: &Top,
        patch: &ExpectedPatch,
        class: u32,
        seed: usize,
    ) {
        let measured = self.measured_of(top, class)[seed];
        let mut near = std::mem::take(&mut self.near);
        near.clear();
        let reach2 = (MERGE_REACH * patch.reach_mm).powi(2);
        // Largest first, so all that follow are too small as well.
        for (index, other) in self.measured_of(top, class).iter().enumerate().skip(seed + 1) {
            if other.measure.area_mm2 < MIN_FRAGMENT_RATIO * patch.area_mm2 {
                break;
            }
            let (here, there) = (measured.measure.position, other.measure.position);
            let (dx, dy) = (here.x_mm - there.x_mm, here.y_mm - there.y_mm);
            let distance2 = dx * dx + dy * dy;
            if distance2 < reach2 {
                near.push((distance2, index));
            }
        }
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));

        let mut parts = [Part::whole(measured.region); MAX_PARTS];
        let mut count = 1;
        let mut merged = measured.measure;
        for &(_, index) in &near {
            let fragment = self.measured_of(top, class)[index];
            let together = merged.merged(&fragment.measure);
            if together.area_mm2 > MAX_MERGED_RATIO * patch.area_mm2
                || together.deviations_mm()[0] > MAX_MERGED_SPREAD * patch.major_mm
            {
                continue;
            }
            merged = together;
            parts[count] = Part::whole(fragment.region);
            count += 1;
            self.push(pattern, patch, &parts[..count], merged);
            if count == MAX_PARTS {
                break;
            }
        }
        self.near = near;
    }

    /// Adds the pieces of a region that is split.
    #[allow(clippy::too_many_arguments)] // The context of all steps, and the region.
    fn split(
        &mut self,
        pattern: &Pattern,
        top: &Top,
        patch: &ExpectedPatch,
        measured: &MeasuredRegion,
        count: usize,
        camera: &CameraModel,
        frame: &DetectionFrame,
    ) {
        let Some(region) = frame.regions().get(measured.region as usize) else { return };
        let runs = frame.runs_of(region);
        let whole = Moments::of_region(region, runs);
        let Some(pieces) = self.splitter.split(region, &whole, runs, count) else { return };
        for (piece, moments) in (0u16..).zip(&pieces[..count]) {
            if let Some(measure) = Measure::new(moments, camera, top.height_mm) {
                let part = Part { region: measured.region, piece, pieces: count as u16 };
                self.push(pattern, patch, &[part], measure);
            }
        }
    }
}

/// Runs and pixels visited for a region and a footprint, about.
fn cut_work(region: &Region) -> usize {
    const FOOTPRINT_PX: u32 = 400;
    region.run_count as usize + region.pixel_count.min(FOOTPRINT_PX) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::regions::RegionFinder;
    use bytemuck::Zeroable;
    use common::config::Config;
    use common::messages::{Run, Team};

    /// Candidates for the yellow team patch among yellow rectangles [left, top, right, bottom), the
    /// right and bottom ends not included; nine pixels are about a patch.
    fn yellow_candidates(rectangles: &[[u16; 4]]) -> (CandidateFinder, usize) {
        let config = Config::default();
        let pattern = Pattern::new(&config).unwrap();
        let kind = pattern.team_kinds(Team::Yellow)[0];
        let mut runs = Vec::new();
        for row in 0..480u16 {
            let mut columns: Vec<u16> = rectangles
                .iter()
                .filter(|[_, top, _, bottom]| (*top..*bottom).contains(&row))
                .flat_map(|[left, _, right, _]| *left..*right)
                .collect();
            columns.sort_unstable();
            for stretch in columns.chunk_by(|a, b| a + 1 == *b) {
                let (begin, end) = (stretch[0], stretch[stretch.len() - 1] + 1);
                let class = pattern.kinds[kind].class as u8;
                runs.push(Run { row, begin, end, class, reserved: 0 });
            }
        }
        let mut frame = Box::new(DetectionFrame::zeroed());
        RegionFinder::new(640, 480, 8, 8).find(&runs, &mut frame);
        let camera = CameraModel::new(&config.geometry, 640, 480).unwrap();
        let mut finder = CandidateFinder::default();
        let mut index = ClassIndex::default();
        index.fill(&frame);
        finder.find(&pattern, &camera, &Pitch::new(&config), &frame, &index);
        (finder, kind)
    }

    #[test]
    fn a_patch_is_a_candidate() {
        let (finder, kind) = yellow_candidates(&[[300, 200, 309, 209]]);
        let [candidate] = finder.of_kind(kind) else { panic!("{:?}", finder.of_kind(kind)) };
        assert!((900.0..1400.0).contains(&candidate.measure.area_mm2), "{candidate:?}");
        assert!((candidate.measure.image.x_px - 304.0).abs() < 1e-9);
    }

    #[test]
    fn rims_around_patches_are_not() {
        // A rim one pixel wide around a patch, half of one two pixels wide, and a string.
        for rim in [
            vec![
                [300, 200, 311, 201],
                [300, 201, 301, 210],
                [310, 201, 311, 210],
                [300, 210, 311, 211],
            ],
            vec![[300, 200, 313, 202], [300, 202, 302, 213]],
            vec![[300, 200, 330, 201]],
            vec![[300, 200, 322, 202]],
        ] {
            let (finder, kind) = yellow_candidates(&rim);
            assert_eq!(finder.by_height[0].all().len(), 1, "{rim:?} is not one region");
            assert!(finder.of_kind(kind).is_empty(), "{rim:?}: {:?}", finder.of_kind(kind));
        }
    }

    #[test]
    fn fragments_are_averaged_by_weight() {
        let (finder, kind) = yellow_candidates(&[[300, 200, 304, 209], [305, 200, 309, 209]]);
        let merged = finder.of_kind(kind)[0];
        assert_eq!(merged.parts().len(), 2);
        assert!((merged.measure.image.x_px - 304.0).abs() < 1e-3, "{merged:?}");
        // The halves alone stay possible, but less likely.
        assert!(finder.of_kind(kind)[1..].iter().all(|candidate| candidate.parts().len() == 1));
        assert_eq!(finder.of_kind(kind).len(), 3);
    }

    #[test]
    fn two_patches_side_by_side_are_not_averaged() {
        let (finder, kind) = yellow_candidates(&[[300, 200, 309, 209], [310, 200, 319, 209]]);
        assert_eq!(finder.of_kind(kind).len(), 2);
        assert!(finder.of_kind(kind).iter().all(|candidate| candidate.parts().len() == 1));
    }

    #[test]
    fn two_patches_grown_together_come_apart() {
        let (finder, kind) = yellow_candidates(&[[300, 200, 317, 209]]);
        let pieces: Vec<&Candidate> =
            finder.of_kind(kind).iter().filter(|candidate| candidate.seed().pieces == 2).collect();
        let [a, b] = pieces[..] else { panic!("{:?}", finder.of_kind(kind)) };
        assert!(!a.overlaps(b));
        let whole = finder.of_kind(kind).iter().find(|c| c.seed().pieces == 1).unwrap();
        assert!(whole.overlaps(a) && whole.overlaps(b));
    }

    #[test]
    fn regions_outside_the_pitch_are_not_candidates() {
        // Beside a goal, behind the goal line; and a proper one.
        let (finder, kind) = yellow_candidates(&[[4, 60, 13, 69], [300, 200, 309, 209]]);
        let outside: Vec<bool> =
            finder.by_height[0].all().iter().map(|measured| measured.outside).collect();
        assert_eq!(outside.iter().filter(|&&outside| outside).count(), 1);
        let [candidate] = finder.of_kind(kind) else { panic!("{:?}", finder.of_kind(kind)) };
        assert!((candidate.measure.image.x_px - 304.0).abs() < 1e-9);
    }
}
