//! Candidates: regions, and parts and groups of regions, that may be a certain patch in a certain colour.
//!
//! A candidate of a kind is one of
//!
//! * a region of the kind's colour whose area and shape a patch could have,
//! * such a region merged with up to three smaller ones of its colour near it, because noise or another patch
//!   may have cut the patch in pieces: their average, weighted by area (section 6.1),
//! * one of 2 to 4 pieces of a region that is too large, because patches of two robots may have grown
//!   together ([`split`](split)),
//! * the pixels of the colour at the place that a candidate for a team patch predicts
//!   ([`footprint`](crate::pattern::footprint)), whatever region they belong to.
//!
//! Regions in identification colours are measured only near candidates for team patches, and where they are
//! large enough to be told of: on real pitches most are specks.
//!
//! Candidates made of the same pixels contradict each other. The assignment decides which are real, when the
//! value of each explanation is known; nothing is ruled out here.

mod beside;
mod candidate;
mod parts;
pub(crate) mod split;

pub(crate) use candidate::Candidate;

use crate::pattern::{ExpectedPatch, Kind, Pattern, Top};
use crate::pitch::Pitch;
use crate::regions::class_index::ClassIndex;
use crate::regions::measure::Measure;
use crate::regions::measured_regions::{MeasuredRegion, MeasuredRegions};
use crate::regions::vicinity::{Vicinity, least_mm_per_px};
use beside::Place;
use candidate::{MAX_PARTS, Part};
use geometry::{CameraModel, FieldPoint, ImagePoint};
use messages::{DetectionFrame, Region};
use parts::{MAX_MERGED_RATIO, MERGE_REACH, SPLIT_RATIO};
use split::{MAX_PIECES, Splitter};
use std::ops::Range;

/// Most candidates of one kind; of more, those with the likeliest areas are kept. Thirty-two robots with two
/// dots of a colour each have 64, and a few more for fragments.
const MAX_CANDIDATES: usize = 192;
/// Factor on the largest area of a pixel that was found at some places of the pitch.
const PIXEL_AREA_SLACK: f64 = 1.1;

/// Finds candidates, and keeps them until the next frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct CandidateFinder {
    /// For each height, the pixels of a region in an identification colour from which it is measured wherever
    /// it lies; 0 where missing.
    worth_telling_px: Vec<f64>,
    vicinity: Vicinity,
    /// For each height of the pattern, the measured regions.
    by_height: Vec<MeasuredRegions>,
    candidates: Vec<Candidate>,
    /// While they are sorted: the misfit's bits and the index of each, and the sorted ones.
    order: Vec<(u64, u32)>,
    sorted: Vec<Candidate>,
    /// For each kind of the pattern, its part of `candidates`.
    ranges: Vec<Range<usize>>,
    splitter: Splitter,
    /// Squared distance and index of the fragments near a region.
    near: Vec<(f64, usize)>,
    /// Regions within the bounds of a footprint.
    meeting: Vec<u32>,
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

    /// Calls `take` with each region of [`measured_on`](Self::measured_on) within reach of a place, in order.
    pub fn near<'a>(
        &'a self,
        top: &Top,
        place: FieldPoint,
        reach_mm: f64,
        mut take: impl FnMut(&'a MeasuredRegion),
    ) {
        let Some(regions) = self.by_height.get(top.height) else { return };
        let all = regions.all();
        regions.near(0..all.len(), place, reach_mm, |index, _| take(&all[index]));
    }

    /// Whether a region of one class is within reach of a place.
    pub fn is_any_near(&self, top: &Top, class: u32, place: FieldPoint, reach_mm: f64) -> bool {
        let Some(regions) = self.by_height.get(top.height) else { return false };
        let mut is_any = false;
        regions.near(regions.range(class), place, reach_mm, |_, _| is_any = true);
        is_any
    }

    /// Candidates of a kind, the likeliest area first; those of footprints among them.
    pub fn of_kind(&self, kind: usize) -> &[Candidate] {
        self.ranges.get(kind).map_or(&[], |range| &self.candidates[range.clone()])
    }

    /// A finder for robots on a pitch.
    pub fn new(pattern: &Pattern, camera: &CameraModel, pitch: &Pitch) -> Self {
        let of_identification = pattern.kinds.iter().filter(|kind| kind.team.is_none());
        let least_mm2 = of_identification.map(|kind| pattern.patch_of_kind(kind).area_mm2);
        let least_mm2 = pattern.limits.min_area_ratio * least_mm2.fold(f64::INFINITY, f64::min);
        let worth_telling_px = pattern.heights_mm.iter().map(|&height_mm| {
            let areas = pitch.grid().map(|place| {
                camera.pixel_area_mm2(camera.image_from_field(place, height_mm), height_mm)
            });
            // `max` would pass over NaN.
            let largest_mm2 = areas.fold(0.0, |a, b| if b <= a { a } else { b });
            let pixels = least_mm2 / (PIXEL_AREA_SLACK * largest_mm2);
            if pixels.is_finite() { pixels } else { 0.0 }
        });
        Self { worth_telling_px: worth_telling_px.collect(), ..Self::default() }
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
        self.by_height.resize(pattern.heights_mm.len(), MeasuredRegions::default());
        self.by_height.iter_mut().for_each(MeasuredRegions::clear);
        for height in 0..self.by_height.len() {
            let of_teams = classes(pattern, height, |kind| kind.team.is_some());
            self.measure_regions(pattern, camera, pitch, frame, index, height, of_teams, |_| true);
        }
        self.candidates.clear();
        self.ranges.clear();
        self.places.clear();
        let mut is_guessed = false;
        (self.cuts, self.cut_work, self.is_cut) = (0, 0, false);
        for (kind, alike) in pattern.kinds.iter().zip(&pattern.alike) {
            let begin = self.candidates.len();
            // The kinds of team patches come first, so all their candidates are known.
            if kind.team.is_none() && !is_guessed {
                self.measure_near_team_patches(pattern, camera, pitch, frame, index);
                self.guess_places(pattern, camera);
                is_guessed = true;
            }
            match alike {
                Some(alike) => self.copy_kind(*alike),
                None => self.find_kind(pattern, kind, camera, frame),
            }
            self.sort_from(begin);
            self.is_cut |= self.candidates.len() > begin + MAX_CANDIDATES;
            self.candidates.truncate(begin + MAX_CANDIDATES);
            if kind.team.is_none() {
                self.look_beside_team_patches(pattern, kind, camera, frame);
                self.sort_from(begin);
            }
            self.ranges.push(begin..self.candidates.len());
        }
    }

    /// Sorts the candidates from an index on, the likeliest area first. Each is moved once.
    fn sort_from(&mut self, begin: usize) {
        let candidates = &self.candidates[begin..];
        self.order.clear();
        // Positive numbers are in the order of their bits.
        self.order.extend((0..).zip(candidates).map(|(index, it)| (it.misfit.to_bits(), index)));
        // A total order: no two candidates are equal.
        self.order.sort_unstable_by(|&(a_misfit, a), &(b_misfit, b)| {
            let parts = |index: u32| candidates[index as usize].parts();
            a_misfit.cmp(&b_misfit).then_with(|| parts(a).cmp(parts(b)))
        });
        self.sorted.clear();
        self.sorted.extend(self.order.iter().map(|&(_, index)| candidates[index as usize]));
        self.candidates[begin..].copy_from_slice(&self.sorted);
    }

    /// Measures the regions of these classes (a bit set) at a height that are `wanted`.
    #[allow(clippy::too_many_arguments)] // The context of all steps, and the regions.
    fn measure_regions(
        &mut self,
        pattern: &Pattern,
        camera: &CameraModel,
        pitch: &Pitch,
        frame: &DetectionFrame,
        index: &ClassIndex,
        height: usize,
        classes: u32,
        wanted: impl Fn(&Region) -> bool,
    ) {
        let height_mm = pattern.heights_mm[height];
        // A patch lies within half a diagonal of the centre of its robot.
        let slack_mm = pattern.size_mm * 0.75;
        let regions = &mut self.by_height[height];
        regions.measure(frame, index, classes, camera, height_mm, pitch, slack_mm, wanted);
    }

    /// Measures the regions in identification colours that may matter.
    fn measure_near_team_patches(
        &mut self,
        pattern: &Pattern,
        camera: &CameraModel,
        pitch: &Pitch,
        frame: &DetectionFrame,
        index: &ClassIndex,
    ) {
        for height in 0..self.by_height.len() {
            let mut vicinity = std::mem::take(&mut self.vicinity);
            vicinity.clear();
            for (kind, range) in pattern.kinds.iter().zip(&self.ranges) {
                let top = pattern.top_of_kind(kind);
                if top.height != height {
                    continue;
                }
                let reach_mm = reach_mm(pattern, top);
                let mut add = |point: ImagePoint| {
                    let mm_per_px = least_mm_per_px(camera, point, top.height_mm);
                    vicinity.add(point, reach_mm / mm_per_px);
                };
                for candidate in &self.candidates[range.clone()] {
                    add(candidate.measure.image);
                    // Of a candidate that is not one whole region, the regions as well.
                    let parts = candidate.parts();
                    let parts = if let [Part { pieces: 1, .. }] = parts { &[] } else { parts };
                    for part in parts {
                        let region = &frame.regions()[part.region as usize];
                        add(ImagePoint::new(region.x_px.into(), region.y_px.into()));
                    }
                }
            }
            let least_px = self.worth_telling_px.get(height).copied().unwrap_or(0.0);
            let is_wanted = |region: &Region| {
                f64::from(region.pixel_count) >= least_px || vicinity.meets(region)
            };
            let of_teams = classes(pattern, height, |kind| kind.team.is_some());
            let of_all = classes(pattern, height, |_| true);
            let classes = of_all & !of_teams;
            self.measure_regions(pattern, camera, pitch, frame, index, height, classes, is_wanted);
            self.vicinity = vicinity;
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
            // Fragments are smaller than the region.
            let most = MAX_PARTS as f64 * ratio;
            if ratio < MAX_MERGED_RATIO && most >= pattern.limits.min_area_ratio {
                self.merge(pattern, top, patch, kind.class, seed);
            }
            for pieces in 2..=MAX_PIECES {
                if SPLIT_RATIO.contains(&(ratio / pieces as f64)) {
                    self.split(pattern, top, patch, &measured, pieces, camera, frame);
                }
            }
        }
    }

    /// Adds a candidate if it can be the patch at all.
    fn push(&mut self, pattern: &Pattern, patch: &ExpectedPatch, parts: &[Part], measure: Measure) {
        let area_ratio = measure.area_mm2 / patch.area_mm2;
        if !pattern.limits.admit_area(area_ratio) || !measure.is_shaped_like(patch) {
            return;
        }
        let misfit = pattern.limits.area_misfit(area_ratio);
        self.candidates.push(Candidate::new(parts, measure, misfit));
    }
}

/// The classes (a bit set) of the kinds at a height that are `wanted`.
fn classes(pattern: &Pattern, height: usize, wanted: impl Fn(&Kind) -> bool) -> u32 {
    let is_there = |kind: &&Kind| pattern.top_of_kind(kind).height == height && wanted(kind);
    pattern.kinds.iter().filter(is_there).fold(0, |classes, kind| classes | 1 << kind.class)
}

/// Distance from the place of a team patch within which regions may belong to its robot, or lie on it.
fn reach_mm(pattern: &Pattern, top: &Top) -> f64 {
    // A candidate may be merged from regions that lie this far from each other.
    let patches = top.patches.iter().enumerate().map(|(patch, expected)| {
        top.distance_mm(patch, top.team_patch) + 2.0 * MERGE_REACH * expected.reach_mm
    });
    let [x_mm, y_mm] = top.patches[top.team_patch].centroid_mm;
    let on_top = x_mm.hypot(y_mm) + top.core.reach_mm();
    pattern.limits.patch_tolerance_mm + patches.fold(on_top, f64::max)
}

#[cfg(test)]
mod tests;
