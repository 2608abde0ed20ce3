//! The tables of [second looks](crate::look_tables), for registers full of pixels.
//!
//! What the [prefilter](super::prefilter) lets pass is looked at with these before any pixel is looked at by
//! itself: without bounds on red, green and blue worth the name that is nearly all of a picture, and
//! what of it has the hue and saturation of a colour is little.

use super::buckets::Buckets;
use super::lanes::Lanes;
use super::prefilter::ChannelFilter;
use crate::look_tables::{Bytes, KEYS, LookTables};
use fearless_simd::prelude::*;

/// The buckets, a bit each, whose colours may admit a pixel with each of the four keys.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LookFilter([ChannelFilter; 4]);

impl LookFilter {
    pub fn new(tables: &LookTables, buckets: &Buckets) -> Self {
        Self(tables.0.each_ref().map(|table| ChannelFilter::of_six_bits(table, buckets)))
    }

    /// The buckets whose colours may admit pixels with these keys.
    #[inline(always)]
    pub fn admitting<S: Lanes>(&self, simd: S, keys: [S::u8s; 4]) -> S::u8s {
        let Self([red, green, blue, saturation]) = self;
        let [r, g, b, s] = keys;
        let hues = simd.look_up_key(simd.table(red), r) & simd.look_up_key(simd.table(green), g);
        hues & simd.look_up_key(simd.table(blue), b) & simd.look_up_key(simd.table(saturation), s)
    }
}

/// The [keys](crate::look_tables) of pixels whose values are taken for others, if there are corrections.
#[inline(always)]
pub fn keys<S: Lanes>(simd: S, rgb: [S::u8s; 3], corrections: Option<&[Bytes; 3]>) -> [S::u8s; 4] {
    let [red, green, blue] = match corrections {
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
    let [red, green, blue] =
        [key::<S>(top, logs[0]), key::<S>(top, logs[1]), key::<S>(top, logs[2])];
    [red, green, blue, key::<S>(simd.color_log(color), simd.grey_log(least))]
}

/// From two logarithms.
#[inline(always)]
fn key<S: Lanes>(of_more: S::u8s, of_less: S::u8s) -> S::u8s {
    of_more.saturating_sub(of_less).min(KEYS as u8 - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ClassTables;
    use crate::kernels::lanes::MAX_LANES;
    use crate::look_tables::{self, COLOR_LOG, GREY_LOG, LOG};
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
            let table = Bytes(std::array::from_fn(|value| (value * 7 + value / 9) as u8));
            let all: [u8; 256] = std::array::from_fn(|value| value as u8);
            for bytes in all.chunks_exact(S::u8s::LEN) {
                let values = S::u8s::from_slice(simd, bytes);
                let of = |table: &Bytes| -> Vec<u8> {
                    bytes.iter().map(|&byte| table.of(byte)).collect()
                };
                assert_eq!(store::<S>(simd.log(values)), of(&LOG));
                assert_eq!(store::<S>(simd.color_log(values)), of(&COLOR_LOG));
                assert_eq!(store::<S>(simd.grey_log(values)), of(&GREY_LOG));
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
                    let found = keys(simd, rgb, tables.corrections()).map(store::<S>);
                    for lane in 0..S::u8s::LEN {
                        let rgb = [0, 1, 2].map(|channel: usize| {
                            let value = channels[channel][lane];
                            tables.corrections().map_or(value, |c| c[channel].of(value))
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
