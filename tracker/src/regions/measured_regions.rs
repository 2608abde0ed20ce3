//! The regions of a frame in colours of patches, measured on the plane of the tops.

pub(crate) use super::bounds::Bounds;
use super::bounds::BoundsByClass;
use super::class_index::{CLASSES, ClassIndex};
use super::measure::{Measure, Moments};
use super::places::Places;
use crate::pitch::Pitch;
use geometry::{CameraModel, FieldPoint};
use messages::{DetectionFrame, Region};
use std::cmp::Reverse;
use std::ops::Range;

/// A region in a colour of some patch, and its measures.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MeasuredRegion {
    /// Index of the region in the message.
    pub region: u32,
    pub class: u32,
    pub measure: Measure,
    /// Whether it lies too far outside the pitch to belong to a robot on it.
    pub outside: bool,
}

/// The measured regions at one height, class by class, in each class the largest first.
#[derive(Debug, Clone)]
pub(crate) struct MeasuredRegions {
    list: Vec<MeasuredRegion>,
    bounds: BoundsByClass,
    /// Places of the regions in `list`.
    places: Places,
    /// The regions of a class before they are sorted.
    unsorted: Vec<MeasuredRegion>,
    /// Their order by area: the area's bits, the region, and its index in `unsorted`.
    order: Vec<(Reverse<u64>, u32, u32)>,
    /// The part of each class in `list`.
    ranges: [Range<usize>; CLASSES],
}

impl Default for MeasuredRegions {
    fn default() -> Self {
        Self {
            list: Vec::new(),
            bounds: BoundsByClass::default(),
            places: Places::default(),
            unsorted: Vec::new(),
            order: Vec::new(),
            ranges: [const { 0..0 }; CLASSES],
        }
    }
}

impl MeasuredRegions {
    /// Forgets all regions.
    pub fn clear(&mut self) {
        self.list.clear();
        self.bounds.clear();
        self.places.clear();
        self.ranges = [const { 0..0 }; CLASSES];
    }

    /// Measures and adds the regions of `frame` in one of the `classes` (a bit set) that are `wanted`, at a
    /// height. Regions at most `slack_mm` outside the pitch count as inside.
    #[allow(clippy::too_many_arguments)] // A frame, and the geometry that places its regions.
    pub fn measure(
        &mut self,
        frame: &DetectionFrame,
        index: &ClassIndex,
        classes: u32,
        camera: &CameraModel,
        height_mm: f64,
        pitch: &Pitch,
        slack_mm: f64,
        wanted: impl Fn(&Region) -> bool,
    ) {
        let regions = frame.regions();
        for class in (0..CLASSES).filter(|class| classes >> class & 1 == 1) {
            self.unsorted.clear();
            self.order.clear();
            for &index in index.of_class(class) {
                let region = &regions[index as usize];
                if !wanted(region) {
                    continue;
                }
                let moments = Moments::of_region(region, frame.runs_of(region));
                let Some(measure) = Measure::new(&moments, camera, height_mm) else { continue };
                let outside = !pitch.contains(measure.position, slack_mm);
                // Positive numbers are in the order of their bits.
                let area = Reverse(measure.area_mm2.to_bits());
                self.order.push((area, index, self.unsorted.len() as u32));
                let class = region.class;
                self.unsorted.push(MeasuredRegion { region: index, class, measure, outside });
            }
            self.order.sort_unstable();
            let begin = self.list.len();
            self.bounds.begin_class(class);
            for &(_, _, place) in &self.order {
                let measured = self.unsorted[place as usize];
                self.bounds.push(&regions[measured.region as usize]);
                self.places.push(measured.measure.position);
                self.list.push(measured);
            }
            self.ranges[class] = begin..self.list.len();
            self.bounds.end_class(class);
        }
    }

    /// All measured regions, class by class.
    pub fn all(&self) -> &[MeasuredRegion] {
        &self.list
    }

    /// The measured regions of a class, largest first.
    pub fn of_class(&self, class: u32) -> &[MeasuredRegion] {
        &self.list[self.range(class)]
    }

    /// Finds the regions of a class whose bounds meet others: their indices in [`of_class`](Self::of_class).
    pub fn meeting(&self, class: u32, others: &Bounds, found: &mut Vec<u32>) {
        self.bounds.meeting(class as usize, others, found);
    }

    /// Calls `take` with the index, and the square of the distance, of each region that is at most `reach_mm`
    /// from a place, among those with these indices in [`all`](Self::all).
    pub fn near(
        &self,
        range: Range<usize>,
        place: FieldPoint,
        reach_mm: f64,
        take: impl FnMut(usize, f64),
    ) {
        self.places.near(range, place, reach_mm, take);
    }

    /// Indices in [`all`](Self::all) of the regions of a class.
    pub fn range(&self, class: u32) -> Range<usize> {
        self.ranges[class as usize].clone()
    }
}
