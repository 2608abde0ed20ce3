//! The bounds of regions, class by class, in arrays that a vector instruction compares thirty-two of at a time:
//! footprints are held against all regions of a colour.

use super::class_index::CLASSES;
use fearless_simd::{Level, dispatch};
use messages::Region;
use std::ops::Range;

/// Regions that are compared together.
const TOGETHER: usize = 32;

/// A rectangle of pixels, both ends of columns and rows included.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    pub columns: [i32; 2],
    pub rows: [i32; 2],
}

/// The bounds of regions, added class by class. Each class begins at a multiple of [`TOGETHER`].
#[derive(Debug, Clone)]
pub(crate) struct BoundsByClass {
    level: Level,
    /// First and last column, first and last row.
    sides: [Vec<u16>; 4],
    /// Begin and end of each class.
    ranges: [[usize; 2]; CLASSES],
}

/// The sides of bounds without pixels.
const NOWHERE: [u16; 4] = [u16::MAX, 0, u16::MAX, 0];

impl Default for BoundsByClass {
    fn default() -> Self {
        Self { level: Level::new(), sides: Default::default(), ranges: [[0; 2]; CLASSES] }
    }
}

impl BoundsByClass {
    pub fn clear(&mut self) {
        self.sides.iter_mut().for_each(Vec::clear);
        self.ranges = [[0; 2]; CLASSES];
    }

    /// Begins a class.
    pub fn begin_class(&mut self, class: usize) {
        self.ranges[class] = [self.sides[0].len(); 2];
    }

    /// Adds a region to the current class.
    pub fn push(&mut self, region: &Region) {
        let sides = [region.left, region.right, region.top, region.bottom];
        self.sides.iter_mut().zip(sides).for_each(|(list, side)| list.push(side));
    }

    /// Ends a class.
    pub fn end_class(&mut self, class: usize) {
        let end = self.sides[0].len().next_multiple_of(TOGETHER);
        self.sides.iter_mut().zip(NOWHERE).for_each(|(list, side)| list.resize(end, side));
        self.ranges[class][1] = end;
    }

    /// Finds the regions of a class that have a pixel within `bounds`: their numbers in the class, in order.
    pub fn meeting(&self, class: usize, bounds: &Bounds, found: &mut Vec<u32>) {
        found.clear();
        let ([left, right], [top, bottom]) = (bounds.columns, bounds.rows);
        if right < 0 || bottom < 0 {
            return;
        }
        let clip = |side: i32| side.clamp(0, i32::from(u16::MAX)) as u16;
        let sides = [left, right, top, bottom].map(clip);
        let [begin, end] = self.ranges[class];
        let range = begin..end;
        dispatch!(self.level, _simd => self.compare(range, sides, found));
    }

    #[inline(always)]
    fn compare(&self, range: Range<usize>, sides: [u16; 4], found: &mut Vec<u32>) {
        let [left, right, top, bottom] = sides;
        let [lefts, rights, tops, bottoms] = &self.sides;
        for group in range.clone().step_by(TOGETHER) {
            let of = |list: &[u16]| -> [u16; TOGETHER] {
                std::array::from_fn(|index| list[group..group + TOGETHER][index])
            };
            let (lefts, rights) = (of(lefts), of(rights));
            let (tops, bottoms) = (of(tops), of(bottoms));
            let meets: [u16; TOGETHER] = std::array::from_fn(|index| {
                u16::from(
                    (lefts[index] <= right)
                        & (left <= rights[index])
                        & (tops[index] <= bottom)
                        & (top <= bottoms[index]),
                )
            });
            if meets.iter().fold(0, |any, meets| any | meets) == 0 {
                continue;
            }
            let first = (group - range.start) as u32;
            let meeting = (first..).zip(meets).filter(|(_, meets)| *meets != 0);
            found.extend(meeting.map(|(number, _)| number));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_region() -> impl Strategy<Value = Region> {
        prop::array::uniform4(0..100u16).prop_map(|[left, width, top, height]| Region {
            left,
            right: left + width / 4,
            top,
            bottom: top + height / 4,
            ..Region::default()
        })
    }

    proptest! {
        #[test]
        fn every_level_finds_the_regions_that_meet(
            classes in prop::collection::vec(prop::collection::vec(any_region(), 0..80), 3),
            columns in prop::array::uniform2(-20..140i32),
            rows in prop::array::uniform2(-20..140i32),
        ) {
            let bounds = Bounds { columns, rows };
            for level in [Level::new(), Level::baseline()] {
                let mut by_class = BoundsByClass { level, ..BoundsByClass::default() };
                for class in 0..CLASSES {
                    let regions = classes.get(class).map_or(&[][..], Vec::as_slice);
                    by_class.begin_class(class);
                    regions.iter().for_each(|region| by_class.push(region));
                    by_class.end_class(class);
                }
                for (class, regions) in classes.iter().enumerate() {
                    let is_met = |region: &Region| {
                        i32::from(region.left) <= columns[1]
                            && columns[0] <= i32::from(region.right)
                            && i32::from(region.top) <= rows[1]
                            && rows[0] <= i32::from(region.bottom)
                    };
                    let numbers = (0..).zip(regions).filter(|(_, region)| is_met(region));
                    let expected: Vec<u32> = numbers.map(|(number, _)| number).collect();
                    let mut found = Vec::new();
                    by_class.meeting(class, &bounds, &mut found);
                    prop_assert_eq!(found, expected);
                }
            }
        }
    }
}
