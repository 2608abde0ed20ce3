//! A cheap test that finds the few pixels worth looking at.
//!
//! Most of a pitch is background, and that it is can be seen without knowing which colour it is not.
//! So the colours are sorted into at most eight buckets, one bit each, and for every channel there is
//! one small table that tells for a coarse value in which buckets' ranges it may lie. The AND of the
//! three entries is zero for what is certainly background. It errs on the other side only: what
//! passes is looked at exactly.
//!
//! These are the three tables of section 4.2 once more, with bytes for entries, and so few of them
//! that a vector register holds a whole table and one shuffle instruction looks up a register full
//! of pixels.

use crate::MAX_CLASSES;

/// For the three channels of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Prefilter(pub [ChannelFilter; 3]);

/// The buckets, a bit each, that a channel's value may belong to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChannelFilter {
    /// By the upper four bits of the value.
    pub coarse: [u8; 16],
    /// By its upper six bits.
    pub fine: [u8; 64],
}

const BUCKETS: usize = 8;

impl Prefilter {
    /// For the colours in the exact tables, and for values that are at most `excess` above the exact
    /// ones.
    pub fn new(tables: &[[u32; 256]; 3], excess: u8) -> Self {
        let mut buckets = [Bucket { values: [0; 3] }; MAX_CLASSES];
        for (channel, table) in tables.iter().enumerate() {
            for (value, &classes) in (0..=255u8).zip(table) {
                let values = 1 << (value >> 2) | 1 << (value.saturating_add(excess) >> 2);
                for (class, bucket) in buckets.iter_mut().enumerate() {
                    if classes >> class & 1 == 1 {
                        bucket.values[channel] |= values;
                    }
                }
            }
        }
        let mut count = 0;
        for index in 0..MAX_CLASSES {
            if buckets[index].volume() > 0 {
                buckets[count] = buckets[index];
                count += 1;
            }
        }
        while count > BUCKETS {
            let (first, second) = cheapest_pair(&buckets[..count]);
            buckets[first] = buckets[first].merged(&buckets[second]);
            count -= 1;
            buckets[second] = buckets[count];
        }
        Self([0, 1, 2].map(|channel| {
            let may_hold = |value: usize| {
                let bit = |(index, bucket): (usize, &Bucket)| {
                    u8::from(bucket.values[channel] >> value & 1 == 1) << index
                };
                buckets[..count].iter().enumerate().map(bit).fold(0, |bits, bit| bits | bit)
            };
            ChannelFilter {
                coarse: std::array::from_fn(|index| {
                    (4 * index..4 * index + 4).fold(0, |bits, value| bits | may_hold(value))
                }),
                fine: std::array::from_fn(may_hold),
            }
        }))
    }
}

impl Prefilter {
    /// Lets pass what either does.
    pub fn or(&self, other: &Self) -> Self {
        Self(std::array::from_fn(|channel| {
            let (a, b) = (&self.0[channel], &other.0[channel]);
            ChannelFilter {
                coarse: std::array::from_fn(|index| a.coarse[index] | b.coarse[index]),
                fine: std::array::from_fn(|index| a.fine[index] | b.fine[index]),
            }
        }))
    }
}

/// Colours that share a bit. For each channel, bit v is set if a value whose upper six bits are v may
/// belong to one of them.
#[derive(Debug, Clone, Copy)]
struct Bucket {
    values: [u64; 3],
}

impl Bucket {
    fn merged(&self, other: &Self) -> Self {
        Self { values: [0, 1, 2].map(|channel| self.values[channel] | other.values[channel]) }
    }

    /// How much of the colour space passes.
    fn volume(&self) -> u64 {
        self.values.iter().map(|values| u64::from(values.count_ones())).product()
    }
}

/// The two buckets, first one first, that let the least pass needlessly when they become one.
fn cheapest_pair(buckets: &[Bucket]) -> (usize, usize) {
    let cost = |&(first, second): &(usize, usize)| {
        let (first, second) = (&buckets[first], &buckets[second]);
        first.merged(second).volume() as i64 - (first.volume() + second.volume()) as i64
    };
    let pairs = (1..buckets.len()).flat_map(|second| (0..second).map(move |first| (first, second)));
    pairs.min_by_key(cost).expect("there are at least two buckets")
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
        ) {
            let boxes: Vec<[[u8; 2]; 3]> =
                bounds.iter().map(|b| b.map(|(a, b)| [a.min(b), a.max(b)])).collect();
            let filter = Prefilter::new(&tables(&boxes), excess);
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
        let boxes = [[[100, 120], [0, 20], [200, 255]], [[0, 20], [100, 120], [200, 255]]];
        let filter = Prefilter::new(&tables(&boxes), 1);
        for near in [[110, 10, 220], [10, 110, 220]] {
            assert_eq!(passes(&filter, near), [true; 2]);
        }
        for far in [[110, 110, 220], [110, 10, 180], [10, 10, 220]] {
            assert_eq!(passes(&filter, far), [false; 2]);
        }
        let nothing = Prefilter::new(&tables(&[]), 1);
        assert_eq!(passes(&nothing, [0, 0, 0]), [false; 2]);
    }
}
