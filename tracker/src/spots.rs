//! The regions of a frame that may be of a patch, measured on the plane of the tops.

use crate::class_index::{CLASSES, ClassIndex};
use crate::measure::{Measure, Moments};
use crate::pitch::Pitch;
use common::geometry::CameraModel;
use common::messages::{DetectionFrame, Region};

/// A region of a colour that some patch has.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Spot {
    /// Index of the region in the message.
    pub region: u32,
    pub class: u32,
    pub bounds: Bounds,
    pub measure: Measure,
    /// Too far outside the pitch to belong to a robot on it.
    pub outside: bool,
}

/// The columns and rows of a region, both ends included.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    pub columns: [i32; 2],
    pub rows: [i32; 2],
}

/// The spots at one height, class by class, in each class the largest first.
#[derive(Debug, Clone, Default)]
pub(crate) struct Spots {
    list: Vec<Spot>,
    /// Where the spots of each class end in `list`; there those of the next begin.
    ends: [usize; CLASSES],
}

impl Bounds {
    fn of_region(region: &Region) -> Self {
        Self {
            columns: [i32::from(region.left), i32::from(region.right)],
            rows: [i32::from(region.top), i32::from(region.bottom)],
        }
    }

    /// Whether both have a pixel in common, as rectangles.
    pub fn meets(&self, other: &Self) -> bool {
        let meets = |a: [i32; 2], b: [i32; 2]| a[0] <= b[1] && b[0] <= a[1];
        meets(self.columns, other.columns) && meets(self.rows, other.rows)
    }
}

impl Spots {
    /// Measures the regions of `frame` that have one of the `classes` (a bit set) at a height. Spots on the
    /// pitch, or outside by no more than `slack_mm`, are inside.
    #[allow(clippy::too_many_arguments)] // A frame, and everything that says where its regions lie.
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
                self.list.push(Spot { region: index, class, bounds, measure, outside });
            }
            self.list[begin..].sort_unstable_by(|a, b| {
                b.measure.area_mm2.total_cmp(&a.measure.area_mm2).then(a.region.cmp(&b.region))
            });
            self.ends[class] = self.list.len();
        }
    }

    /// All of them, class by class.
    pub fn all(&self) -> &[Spot] {
        &self.list
    }

    /// The spots of a class, largest first.
    pub fn of_class(&self, class: u32) -> &[Spot] {
        let class = class as usize;
        let begin = class.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.list[begin..self.ends[class]]
    }
}
