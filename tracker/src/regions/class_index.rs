//! The regions of a frame by colour class.

use super::bounds::{Bounds, BoundsByClass};
use messages::{DetectionFrame, Region};

/// Number of colour classes.
pub(crate) const CLASSES: usize = 32;

/// Lists of the regions of each class, in the order of the frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct ClassIndex {
    /// Indices of regions, class by class.
    regions: Vec<u32>,
    bounds: BoundsByClass,
    /// End of each class in `regions`, and begin of the next.
    ends: [usize; CLASSES],
}

impl ClassIndex {
    /// Replaces the lists by those of `frame`. Regions of no class are left out.
    pub fn fill(&mut self, frame: &DetectionFrame) {
        let class_of = |region: &Region| Some(region.class as usize).filter(|&c| c < CLASSES);
        let mut counts = [0; CLASSES];
        frame.regions().iter().filter_map(class_of).for_each(|class| counts[class] += 1);
        let (mut next, mut end) = ([0; CLASSES], 0);
        for class in 0..CLASSES {
            next[class] = end;
            end += counts[class];
        }
        self.regions.clear();
        self.regions.resize(end, 0);
        for (index, region) in (0u32..).zip(frame.regions()) {
            if let Some(class) = class_of(region) {
                self.regions[next[class]] = index;
                next[class] += 1;
            }
        }
        self.ends = next;
        self.bounds.clear();
        let regions = frame.regions();
        for class in 0..CLASSES {
            let begin = class.checked_sub(1).map_or(0, |before| self.ends[before]);
            self.bounds.begin_class(class);
            for &index in &self.regions[begin..self.ends[class]] {
                self.bounds.push(&regions[index as usize]);
            }
            self.bounds.end_class(class);
        }
    }

    /// Finds the regions of a class that have a pixel within `bounds`: their numbers in
    /// [`of_class`](Self::of_class), in order.
    pub fn meeting(&self, class: usize, bounds: &Bounds, found: &mut Vec<u32>) {
        self.bounds.meeting(class, bounds, found);
    }

    /// Indices of the regions of a class.
    pub fn of_class(&self, class: usize) -> &[u32] {
        let begin = class.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.regions[begin..self.ends[class]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::regions::RegionFinder;
    use bytemuck::Zeroable;
    use messages::Run;

    #[test]
    fn every_region_is_listed_once_under_its_class() {
        let runs: Vec<Run> = (0..60u16)
            .map(|row| Run { row, begin: 10, end: 20, class: (row * 7 % 5) as u8, reserved: 0 })
            .collect();
        let mut frame = Box::new(DetectionFrame::zeroed());
        RegionFinder::new(64, 64, 8, 1).find(&runs, &mut frame);
        let mut index = ClassIndex::default();
        // Twice: a second call replaces the lists.
        for _ in 0..2 {
            index.fill(&frame);
            let mut seen = Vec::new();
            for class in 0..CLASSES {
                for &region in index.of_class(class) {
                    assert_eq!(frame.regions()[region as usize].class as usize, class);
                    seen.push(region);
                }
            }
            seen.sort_unstable();
            assert!(seen.iter().copied().eq(0..frame.regions().len() as u32));
            assert_eq!(seen.len(), 60);
        }
    }
}
