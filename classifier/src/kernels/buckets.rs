//! Assignment of colours to the bits of the [prefilter](super::prefilter): at most eight buckets, merged
//! greedily so that as little as possible of the colour space passes.
//!
//! Assigning takes longer than everything else about a prefilter, so it is done once, for the colours as
//! configured. Under another light their ranges move, but remain similar relative to each other. The
//! assignment affects only how much passes; it never rejects a pixel of a colour.

use crate::MAX_CLASSES;

const BUCKETS: usize = 8;

/// For each colour, the bit of its bucket.
#[derive(Debug, Clone)]
pub struct Buckets([u8; MAX_CLASSES]);

impl Buckets {
    /// For the colours in the exact tables, and for values at most `excess` above the exact ones.
    pub fn new(tables: &[[u32; 256]; 3], excess: u8) -> Self {
        let mut buckets: [Bucket; MAX_CLASSES] =
            std::array::from_fn(|class| Bucket { values: [0; 3], classes: 1 << class });
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
        // Colours without a range go into the first bucket: later tables may have one.
        let mut bits = [1; MAX_CLASSES];
        for (index, bucket) in buckets[..count].iter().enumerate() {
            for (class, bit) in bits.iter_mut().enumerate() {
                if bucket.classes >> class & 1 == 1 {
                    *bit = 1 << index;
                }
            }
        }
        Self(bits)
    }

    /// The bit of the bucket that a colour is in.
    #[inline(always)]
    pub fn bit(&self, class: usize) -> u8 {
        self.0[class]
    }

    /// The bits of the buckets that a set of colours is in.
    pub fn of(&self, mut classes: u32) -> u8 {
        let mut bits = 0;
        while classes != 0 {
            bits |= self.0[classes.trailing_zeros() as usize];
            classes &= classes - 1;
        }
        bits
    }
}

/// Colours that share a bit.
#[derive(Debug, Clone, Copy)]
struct Bucket {
    /// For each channel, bit v is set if a value whose upper six bits are v may belong to one of the colours.
    values: [u64; 3],
    /// Bit set of the colours.
    classes: u32,
}

impl Bucket {
    fn merged(&self, other: &Self) -> Self {
        let values = [0, 1, 2].map(|channel: usize| self.values[channel] | other.values[channel]);
        Self { values, classes: self.classes | other.classes }
    }

    /// Part of the colour space that passes, in cells.
    fn volume(&self) -> u64 {
        self.values.iter().map(|values| u64::from(values.count_ones())).product()
    }
}

/// The pair of buckets, first one first, whose merging adds the least volume.
fn cheapest_pair(buckets: &[Bucket]) -> (usize, usize) {
    let cost = |&(first, second): &(usize, usize)| {
        let (first, second) = (&buckets[first], &buckets[second]);
        first.merged(second).volume() as i64 - (first.volume() + second.volume()) as i64
    };
    let pairs = (1..buckets.len()).flat_map(|second| (0..second).map(move |first| (first, second)));
    pairs.min_by_key(cost).expect("there are at least two buckets")
}
