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
use beside::Place;
use candidate::{MAX_PARTS, Part};
use geometry::{CameraModel, FieldPoint};
use messages::DetectionFrame;
use parts::{MAX_MERGED_RATIO, SPLIT_RATIO};
use split::{MAX_PIECES, Splitter};
use std::ops::Range;

/// Most candidates of one kind; of more, those with the likeliest areas are kept. Thirty-two robots with two
/// dots of a colour each have 64, and a few more for fragments.
const MAX_CANDIDATES: usize = 192;

/// Finds candidates, and keeps them until the next frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct CandidateFinder {
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
            self.sort_from(begin);
            self.is_cut |= self.candidates.len() > begin + MAX_CANDIDATES;
            self.candidates.truncate(begin + MAX_CANDIDATES);
            // The kinds of team patches come first, so all their candidates are known.
            if kind.team.is_none() {
                if !is_guessed {
                    self.guess_places(pattern, camera);
                    is_guessed = true;
                }
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

#[cfg(test)]
mod tests;
