//! Candidates made of several regions, and of pieces of one.

use super::CandidateFinder;
use super::candidate::{MAX_PARTS, Part};
use crate::pattern::{ExpectedPatch, Pattern, Top};
use crate::regions::measure::{Measure, Moments};
use crate::regions::measured_regions::MeasuredRegion;
use geometry::CameraModel;
use messages::DetectionFrame;
use std::ops::Range;

/// Least area of a fragment, as a fraction of the patch's area.
const MIN_FRAGMENT_RATIO: f64 = 0.05;
/// Largest area of merged fragments, as a multiple of the patch's area.
pub(super) const MAX_MERGED_RATIO: f64 = 1.35;
/// Largest distance of a fragment from the largest one, as a multiple of the patch's reach.
pub(super) const MERGE_REACH: f64 = 1.3;
/// Largest deviation of merged fragments along their longer axis, as a multiple of the patch's.
const MAX_MERGED_SPREAD: f64 = 1.4;
/// Area per piece of a region that is split, as a multiple of the patch's area.
pub(super) const SPLIT_RATIO: Range<f64> = 0.65..1.5;

impl CandidateFinder {
    /// Adds the region merged with one, two and three smaller ones of its class, nearest first.
    pub(super) fn merge(
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
        let of_class = self.measured_of(top, class);
        // Largest first.
        let is_large =
            |other: &MeasuredRegion| other.measure.area_mm2 >= MIN_FRAGMENT_RATIO * patch.area_mm2;
        let fragments = seed + 1..of_class.partition_point(is_large).max(seed + 1);
        let regions = &self.by_height[top.height];
        let first = regions.range(class).start;
        let fragments = first + fragments.start..first + fragments.end;
        let reach_mm = MERGE_REACH * patch.reach_mm;
        regions.near(fragments, measured.measure.position, reach_mm, |index, distance2| {
            near.push((distance2, index - first));
        });
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
    pub(super) fn split(
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
