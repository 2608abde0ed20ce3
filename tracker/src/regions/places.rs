//! Places on the field in arrays that a vector instruction compares sixteen of at a time: searches for what is
//! near a place go through all regions of a frame again and again.

use fearless_simd::{Level, dispatch};
use geometry::FieldPoint;
use std::ops::Range;

/// Places that are compared together.
const TOGETHER: usize = 16;
/// Farthest place from the field's centre, with the reach, for which single precision is used.
const FARTHEST_MM: f32 = 1e5;
/// Added to a reach: at the farthest place single precision is good for a hundredth of a millimetre.
const SLACK_MM: f32 = 0.05;

/// A list of places.
#[derive(Debug, Clone)]
pub(crate) struct Places {
    level: Level,
    exact: Vec<FieldPoint>,
    x_mm: Vec<f32>,
    y_mm: Vec<f32>,
}

impl Default for Places {
    fn default() -> Self {
        Self { level: Level::new(), exact: Vec::new(), x_mm: Vec::new(), y_mm: Vec::new() }
    }
}

impl Places {
    pub fn clear(&mut self) {
        self.exact.clear();
        self.x_mm.clear();
        self.y_mm.clear();
    }

    pub fn push(&mut self, place: FieldPoint) {
        self.exact.push(place);
        self.x_mm.push(place.x_mm as f32);
        self.y_mm.push(place.y_mm as f32);
    }

    /// Calls `take` with the indices in `range` of the places at most `reach_mm` from `place`, in order, and
    /// the squares of their distances.
    pub fn near(
        &self,
        range: Range<usize>,
        place: FieldPoint,
        reach_mm: f64,
        mut take: impl FnMut(usize, f64),
    ) {
        dispatch!(self.level, _simd => self.compare(range, place, reach_mm, &mut take));
    }

    #[inline(always)]
    fn compare(
        &self,
        range: Range<usize>,
        place: FieldPoint,
        reach_mm: f64,
        take: &mut impl FnMut(usize, f64),
    ) {
        let reach2 = reach_mm * reach_mm;
        let mut check = |index: usize| {
            let there = self.exact[index];
            let (dx, dy) = (there.x_mm - place.x_mm, there.y_mm - place.y_mm);
            let distance2 = dx * dx + dy * dy;
            if distance2 <= reach2 {
                take(index, distance2);
            }
        };
        let (x, y, reach) = (place.x_mm as f32, place.y_mm as f32, reach_mm as f32 + SLACK_MM);
        // False for NaN.
        let is_on_a_pitch = x.abs().max(y.abs()) + reach < FARTHEST_MM;
        if !is_on_a_pitch {
            range.for_each(check);
            return;
        }
        let (xs, ys) = (&self.x_mm[range.clone()], &self.y_mm[range.clone()]);
        let (xs, x_rest) = xs.as_chunks::<TOGETHER>();
        let (ys, y_rest) = ys.as_chunks::<TOGETHER>();
        let is_near = |there_x: f32, there_y: f32| {
            ((there_x - x).abs() <= reach) & ((there_y - y).abs() <= reach)
        };
        let mut begin = range.start;
        for (xs, ys) in xs.iter().zip(ys) {
            let mut any = 0;
            for lane in 0..TOGETHER {
                any |= u32::from(is_near(xs[lane], ys[lane]));
            }
            if any != 0 {
                (begin..begin + TOGETHER).for_each(&mut check);
            }
            begin += TOGETHER;
        }
        for (&there_x, &there_y) in x_rest.iter().zip(y_rest) {
            if is_near(there_x, there_y) {
                check(begin);
            }
            begin += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_level_finds_the_places_near_another(
            list in prop::collection::vec((-900.0..900.0f64, -900.0..900.0f64), 0..90),
            x in -900.0..900.0f64,
            y in -900.0..900.0f64,
            scale in prop::sample::select(vec![1.0, 1e-3, 1e9]),
            reach_mm in 0.0..700.0f64,
            skipped in 0..40usize,
        ) {
            let place = FieldPoint::new(x * scale, y * scale);
            let reach_mm = reach_mm * scale;
            for level in [Level::new(), Level::baseline()] {
                let mut places = Places { level, ..Places::default() };
                for &(x, y) in &list {
                    places.push(FieldPoint::new(x * scale, y * scale));
                }
                let skipped = skipped.min(list.len());
                let mut found = Vec::new();
                places.near(skipped..list.len(), place, reach_mm, |index, _| found.push(index));
                let is_near = |&index: &usize| {
                    let (there_x, there_y) = list[index];
                    let (dx, dy) = (there_x * scale - place.x_mm, there_y * scale - place.y_mm);
                    dx * dx + dy * dy <= reach_mm * reach_mm
                };
                let expected: Vec<usize> = (skipped..list.len()).filter(is_near).collect();
                prop_assert_eq!(found, expected);
            }
        }
    }
}
