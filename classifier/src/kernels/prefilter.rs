//! A cheap test that finds the few pixels that may have a colour.
//!
//! Most of a pitch is background, which is recognised without knowing each colour. The colours are sorted
//! into at most eight buckets, one bit each, and each channel has a small table of the buckets whose ranges
//! may hold a coarse value. The AND of the three entries is zero only for background; pixels that pass are
//! tested exactly.
//!
//! These are the three tables of section 4.2 again, with entries of one byte and so few of them that a vector
//! register holds a whole table and one shuffle instruction looks up a register full of pixels.

use super::buckets::Buckets;

/// Filters of the three channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Prefilter(pub [ChannelFilter; 3]);

/// The buckets, a bit each, that a channel's value may belong to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(align(64))]
pub struct ChannelFilter {
    /// Indexed by the upper six bits of the value.
    pub fine: [u8; 64],
    /// Indexed by its upper four bits.
    pub coarse: [u8; 16],
}

impl Prefilter {
    /// For the colours in the exact tables, sorted into `buckets`, and for values at most `excess` above the
    /// exact ones. Rebuilt for each zone when the light changes, in well below a microsecond.
    pub fn new(tables: &[[u32; 256]; 3], buckets: &Buckets, excess: u8) -> Self {
        Self([0, 1, 2].map(|channel: usize| ChannelFilter::new(&tables[channel], buckets, excess)))
    }

    /// Also passes every pixel that `other` passes.
    pub fn add(&mut self, other: &Self) {
        for (own, other) in self.0.iter_mut().zip(&other.0) {
            own.coarse.iter_mut().zip(other.coarse).for_each(|(own, other)| *own |= other);
            own.fine.iter_mut().zip(other.fine).for_each(|(own, other)| *own |= other);
        }
    }
}

impl ChannelFilter {
    fn new(table: &[u32; 256], buckets: &Buckets, excess: u8) -> Self {
        let (mut coarse, mut fine) = ([0; 16], [0; 64]);
        // Neighbouring values mostly belong to the same colours.
        let (mut classes_before, mut bits_before) = (0, 0);
        for (index, (bits, values)) in fine.iter_mut().zip(table.as_chunks::<4>().0).enumerate() {
            let [a, b, c, d] = values;
            // A value that is too high may belong to one of the values below.
            let lower = &table[(4 * index).saturating_sub(usize::from(excess))..4 * index];
            let classes = lower.iter().fold(a | b | c | d, |all, classes| all | classes);
            if classes != classes_before {
                (classes_before, bits_before) = (classes, buckets.of(classes));
            }
            *bits = bits_before;
            coarse[index / 4] |= bits_before;
        }
        Self { coarse, fine }
    }

    /// For a table indexed by six bits.
    pub fn of_six_bits(entries: &[u32; 64], buckets: &Buckets) -> Self {
        let fine = entries.map(|classes| buckets.of(classes));
        let mut coarse = [0; 16];
        for (bits, fine) in coarse.iter_mut().zip(fine.as_chunks::<4>().0) {
            *bits = fine[0] | fine[1] | fine[2] | fine[3];
        }
        Self { coarse, fine }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The exact tables of some boxes.
    fn tables(boxes: &[[[u8; 2]; 3]]) -> [[u32; 256]; 3] {
        let mut tables = [[0; 256]; 3];
        for (class, ranges) in boxes.iter().enumerate() {
            for (table, &[low, high]) in tables.iter_mut().zip(ranges) {
                table[usize::from(low)..=usize::from(high)]
                    .iter_mut()
                    .for_each(|e| *e |= 1 << class);
            }
        }
        tables
    }

    fn passes(filter: &Prefilter, pixel: [u8; 3]) -> [bool; 2] {
        let entries = |table: fn(&ChannelFilter, u8) -> u8| {
            (0..3).fold(0xff, |bits, i| bits & table(&filter.0[i], pixel[i])) != 0
        };
        [
            entries(|filter, value| filter.coarse[usize::from(value >> 4)]),
            entries(|filter, value| filter.fine[usize::from(value >> 2)]),
        ]
    }

    proptest! {
        #[test]
        fn no_color_is_lost(
            bounds in proptest::collection::vec(any::<[(u8, u8); 3]>(), 0..=32),
            shares in [0.0..=1.0f32, 0.0..=1.0f32, 0.0..=1.0f32],
            excess in 0u8..3,
            sorted_as in proptest::collection::vec(any::<[(u8, u8); 3]>(), 0..=32),
        ) {
            let [boxes, others] = [bounds, sorted_as].map(|bounds| -> Vec<[[u8; 2]; 3]> {
                bounds.iter().map(|b| b.map(|(a, b)| [a.min(b), a.max(b)])).collect()
            });
            // The buckets may have been made for other colours.
            let buckets = Buckets::new(&tables(&others), excess);
            let filter = Prefilter::new(&tables(&boxes), &buckets, excess);
            for ranges in boxes {
                let pixel = std::array::from_fn(|channel| {
                    let [low, high] = ranges[channel];
                    let high = high.saturating_add(excess);
                    low + (f32::from(high - low) * shares[channel]).round() as u8
                });
                prop_assert_eq!(passes(&filter, pixel), [true; 2]);
            }
        }
    }

    #[test]
    fn far_away_values_do_not_pass() {
        let of = |boxes: &[[[u8; 2]; 3]]| {
            let tables = tables(boxes);
            Prefilter::new(&tables, &Buckets::new(&tables, 1), 1)
        };
        let boxes = [[[100, 120], [0, 20], [200, 255]], [[0, 20], [100, 120], [200, 255]]];
        let filter = of(&boxes);
        for near in [[110, 10, 220], [10, 110, 220]] {
            assert_eq!(passes(&filter, near), [true; 2]);
        }
        for far in [[110, 110, 220], [110, 10, 180], [10, 10, 220]] {
            assert_eq!(passes(&filter, far), [false; 2]);
        }
        assert_eq!(passes(&of(&[]), [0, 0, 0]), [false; 2]);
    }
}
