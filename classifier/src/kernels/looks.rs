//! The tables of [second looks](crate::look_tables), for registers full of pixels.
//!
//! What the [prefilter](super::prefilter) lets pass is looked at with these before any pixel is looked at by
//! itself: without bounds on red, green and blue worth the name that is nearly all of a picture, and
//! what of it has the hue and saturation of a colour is little.

use super::buckets::Buckets;
use super::lanes::Lanes;
use super::prefilter::ChannelFilter;
use crate::ClassTables;
use crate::look_tables::{HUE_SCALE, LookTables, SATURATION_SCALE};
use fearless_simd::prelude::*;

/// The buckets, a bit each, whose colours may admit a pixel with each of the four keys.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LookFilter([ChannelFilter; 4]);

impl LookFilter {
    pub fn new(tables: &LookTables, buckets: &Buckets) -> Self {
        Self(tables.0.each_ref().map(|table| ChannelFilter::of_entries(table, buckets)))
    }

    /// The buckets whose colours may admit pixels with these keys.
    #[inline(always)]
    pub fn admitting<S: Lanes>(&self, simd: S, keys: [S::u8s; 4]) -> S::u8s {
        let Self([red, green, blue, saturation]) = self;
        let [r, g, b, s] = keys;
        let hues = simd.look_up(simd.table(red), r) & simd.look_up(simd.table(green), g);
        hues & simd.look_up(simd.table(blue), b) & simd.look_up(simd.table(saturation), s)
    }
}

/// The [keys](crate::look_tables::keys) of pixels as the tables' second looks see them.
#[inline(always)]
pub fn keys<S: Lanes>(simd: S, rgb: [S::u8s; 3], tables: &ClassTables) -> [S::u8s; 4] {
    let [red, green, blue] = match tables.corrections() {
        None => rgb,
        Some([red, green, blue]) => {
            [simd.map(red, rgb[0]), simd.map(green, rgb[1]), simd.map(blue, rgb[2])]
        }
    };
    let least = red.min(green).min(blue);
    let [r, g, b] = [red - least, green - least, blue - least];
    let greatest = r.max(g).max(b);
    let middle = r ^ g ^ b ^ greatest;
    let color = simd.mean(greatest, middle);
    let logs = [simd.log(r), simd.log(g), simd.log(b)];
    let top = logs[0].max(logs[1]).max(logs[2]);
    let saturation = saturation_key(simd, simd.log(color), simd.log(least));
    [
        hue_key(logs[0], top, simd),
        hue_key(logs[1], top, simd),
        hue_key(logs[2], top, simd),
        saturation,
    ]
}

#[inline(always)]
fn hue_key<S: Lanes>(channel: S::u8s, greatest: S::u8s, _: S) -> S::u8s {
    const { assert!(HUE_SCALE == 4) };
    let behind = greatest.saturating_sub(channel);
    let twice = behind.saturating_add(behind);
    twice.saturating_add(twice)
}

#[inline(always)]
fn saturation_key<S: Lanes>(_: S, color: S::u8s, grey: S::u8s) -> S::u8s {
    const { assert!(SATURATION_SCALE == 2) };
    let (more, less) = (color.saturating_sub(grey), grey.saturating_sub(color));
    let middle = color.min(128);
    middle.saturating_sub(less.saturating_add(less)).saturating_add(more.saturating_add(more))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::lanes::MAX_LANES;
    use crate::look_tables::{self, LOG};
    use fearless_simd::Level;

    /// Calls a function with each instruction set that this machine has.
    macro_rules! with_each_level {
        ($function:ident) => {
            let machine = Level::new();
            #[cfg(target_arch = "x86_64")]
            {
                machine.as_avx512().into_iter().for_each($function);
                machine.as_avx2().into_iter().for_each($function);
                machine.as_sse4_2().into_iter().for_each($function);
            }
            #[cfg(target_arch = "aarch64")]
            machine.as_neon().into_iter().for_each($function);
        };
    }

    fn store<S: Lanes>(values: S::u8s) -> Vec<u8> {
        let mut bytes = vec![0; S::u8s::LEN];
        values.store_slice(&mut bytes);
        bytes
    }

    #[test]
    fn every_byte_is_mapped_and_has_its_logarithm() {
        fn check<S: Lanes>(simd: S) {
            let table: [u8; 256] = std::array::from_fn(|value| (value * 7 + value / 9) as u8);
            let all: [u8; 256] = std::array::from_fn(|value| value as u8);
            for bytes in all.chunks_exact(S::u8s::LEN) {
                let values = S::u8s::from_slice(simd, bytes);
                let of = |table: &[u8; 256]| -> Vec<u8> {
                    bytes.iter().map(|&byte| table[usize::from(byte)]).collect()
                };
                assert_eq!(store::<S>(simd.log(values)), of(&LOG));
                assert_eq!(store::<S>(simd.map(&table, values)), of(&table));
            }
        }
        with_each_level!(check);
    }

    #[test]
    fn keys_are_those_of_each_pixel() {
        fn check<S: Lanes>(simd: S) {
            let dim = ClassTables::new(&[]).unwrap();
            for tables in [dim.under([-3, 0, 9]), dim] {
                let mut state = 1u32;
                for round in 0..3000 {
                    let mut channels = [[0; MAX_LANES]; 3];
                    for value in channels.as_flattened_mut() {
                        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                        *value = (state >> 24) as u8 >> (round % 8);
                    }
                    let rgb =
                        channels.each_ref().map(|c| S::u8s::from_slice(simd, &c[..S::u8s::LEN]));
                    let found = keys(simd, rgb, &tables).map(store::<S>);
                    for lane in 0..S::u8s::LEN {
                        let rgb = [0, 1, 2].map(|channel: usize| {
                            let value = channels[channel][lane];
                            tables.corrections().map_or(value, |c| c[channel][usize::from(value)])
                        });
                        let found = found.each_ref().map(|keys| keys[lane]);
                        assert_eq!(found, look_tables::keys(rgb), "{rgb:?}");
                    }
                }
            }
        }
        with_each_level!(check);
    }
}
