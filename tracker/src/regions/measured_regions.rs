//! The regions of a frame in colours of patches, measured on the plane of the tops.

use super::class_index::{CLASSES, ClassIndex};
use super::measure::{Measure, Moments};
use crate::pitch::Pitch;
use geometry::CameraModel;
use messages::{DetectionFrame, Region};

/// A region in a colour of some patch, and its measures.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MeasuredRegion {
    /// Index of the region in the message.
    pub region: u32,
    pub class: u32,
    pub bounds: Bounds,
    pub measure: Measure,
    /// Whether it lies too far outside the pitch to belong to a robot on it.
    pub outside: bool,
}

/// The columns and rows of a region, both ends included.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    pub columns: [i32; 2],
    pub rows: [i32; 2],
}

/// The measured regions at one height, class by class, in each class the largest first.
#[derive(Debug, Clone, Default)]
pub(crate) struct MeasuredRegions {
    list: Vec<MeasuredRegion>,
    /// End of each class in `list`, and begin of the next.
    ends: [usize; CLASSES],
}

impl Bounds {
    fn of_region(region: &Region) -> Self {
        Self {
            columns: [i32::from(region.left), i32::from(region.right)],
            rows: [i32::from(region.top), i32::from(region.bottom)],
        }
    }

    /// Whether two rectangles have a pixel in common.
    pub fn meets(&self, other: &Self) -> bool {
        let meets = |a: [i32; 2], b: [i32; 2]| a[0] <= b[1] && b[0] <= a[1];
        meets(self.columns, other.columns) && meets(self.rows, other.rows)
    }
}

impl MeasuredRegions {
    /// Measures the regions of `frame` in one of the `classes` (a bit set) at a height. Regions at most
    /// `slack_mm` outside the pitch count as inside.
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
    ) {
        self.list.clear();
        for class in 0..CLASSES {
            let begin = self.list.len();
            let regions = if classes >> class & 1 == 1 { index.of_class(class) } else { &[] };
            for &index in regions {
                let region = &frame.regions()[index as usize];
                let moments = Moments::of_region(region, frame.runs_of(region));
                let Some(measure) = Measure::new(&moments, camera, height_mm) else { continue };
                let outside = !pitch.contains(measure.position, slack_mm);
                let (class, bounds) = (region.class, Bounds::of_region(region));
                self.list.push(MeasuredRegion { region: index, class, bounds, measure, outside });
            }
            self.list[begin..].sort_unstable_by(|a, b| {
                b.measure.area_mm2.total_cmp(&a.measure.area_mm2).then(a.region.cmp(&b.region))
            });
            self.ends[class] = self.list.len();
        }
    }

    /// All measured regions, class by class.
    pub fn all(&self) -> &[MeasuredRegion] {
        &self.list
    }

    /// The measured regions of a class, largest first.
    pub fn of_class(&self, class: u32) -> &[MeasuredRegion] {
        let class = class as usize;
        let begin = class.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.list[begin..self.ends[class]]
    }
}
