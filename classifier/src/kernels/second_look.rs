//! Second looks at registers full of pixels.
//!
//! Without tight bounds on red, green and blue, the [prefilter](super::prefilter) passes nearly all of a
//! picture, of which little has the hue and saturation of a colour. So passing pixels are first looked up in
//! the tables of [`crate::second_look_tables`]. Where some pass again, the bounds of their colours decide for
//! all pixels of the register at once: a bound is a sum of two products of 16-bit integers, for which there
//! is an instruction.

use super::Setup;
use super::buckets::Buckets;
use super::lanes::Lanes;
use super::prefilter::{ChannelFilter, Prefilter};
use crate::second_look::{Bound, SecondLook};
use crate::second_look_tables::{KEYS, SecondLookTables};
use crate::{BACKGROUND, ClassTables};
use fearless_simd::prelude::*;

/// For each of the four keys, the buckets whose colours may admit a pixel with that key, a bit each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SecondLookFilter([ChannelFilter; 4]);

impl SecondLookFilter {
    pub fn new(tables: &SecondLookTables, buckets: &Buckets) -> Self {
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

/// The [keys](crate::second_look_tables) of pixels.
#[inline(always)]
pub fn keys<S: Lanes>(simd: S, [red, green, blue]: [S::u8s; 3]) -> [S::u8s; 4] {
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

/// Key from two logarithms.
#[inline(always)]
fn key<S: Lanes>(of_more: S::u8s, of_less: S::u8s) -> S::u8s {
    of_more.saturating_sub(of_less).min(KEYS as u8 - 1)
}

/// The tables that classify pixels if colours have second looks.
#[derive(Clone, Copy)]
pub struct SecondLookClassifier<'a> {
    colors: &'a ClassTables,
    boxes: &'a Prefilter,
    second_looks: &'a SecondLookFilter,
    buckets: &'a Buckets,
}

impl<'a> SecondLookClassifier<'a> {
    #[inline(always)]
    pub fn new(setup: Setup<'a>) -> Self {
        let Setup { zoned, second_looks, buckets, .. } = setup;
        Self {
            colors: zoned.colors,
            boxes: &second_looks.boxes.rgb,
            second_looks: &second_looks.rgb,
            buckets,
        }
    }

    /// The classes of those pixels of a register whose bits are set, under the light in which the colours
    /// were set; [`BACKGROUND`] for the others. `None` if all are background.
    #[inline(always)]
    pub fn classify<S: Lanes>(self, simd: S, rgb: [S::u8s; 3], pixels: u64) -> Option<S::u8s> {
        if pixels == 0 {
            return None;
        }
        let Prefilter([red, green, blue]) = self.boxes;
        let boxes = simd.buckets(rgb, [simd.table(red), simd.table(green), simd.table(blue)]);
        let buckets = boxes & self.second_looks.admitting(simd, keys(simd, rgb));
        let pixels = pixels & simd.any_bucket(buckets);
        if pixels == 0 {
            return None;
        }
        Some(classify_outlined(simd, self, &rgb, &buckets, pixels))
    }
}

/// [`classify_exactly`], not inlined, so that it has all registers to itself.
#[inline(never)]
fn classify_outlined<S: Lanes>(
    simd: S,
    with: SecondLookClassifier,
    rgb: &[S::u8s; 3],
    buckets: &S::u8s,
    pixels: u64,
) -> S::u8s {
    simd.vectorize(
        #[inline(always)]
        || classify_exactly(simd, with, *rgb, *buckets, pixels),
    )
}

/// The first colour in each pixel's buckets whose box holds it and whose second look admits it.
#[inline(always)]
fn classify_exactly<S: Lanes>(
    simd: S,
    with: SecondLookClassifier,
    rgb: [S::u8s; 3],
    buckets: S::u8s,
    pixels: u64,
) -> S::u8s {
    let seen = HueSaturation::new(simd, rgb);
    let mut classes = S::u8s::splat(simd, BACKGROUND);
    // An earlier colour replaces a later one.
    let colors = &with.colors.second_looks().classes;
    for class in (0..colors.len()).rev() {
        let (ranges, look) = &colors[class];
        let mut found = !(buckets & with.buckets.bit(class)).simd_eq(0).to_bitmask() & pixels;
        if found == 0 {
            continue;
        }
        for channel in 0..3 {
            let [low, high] = ranges[channel];
            found &= (rgb[channel] - low).simd_le(high - low).to_bitmask();
        }
        found &= seen.admitted(simd, look);
        classes =
            S::mask8s::from_bitmask(simd, found).select(S::u8s::splat(simd, class as u8), classes);
    }
    classes
}

/// Operands of [bounds](Bound), a quarter of the pixels each, as pairs of 16-bit integers.
struct HueSaturation<S: Lanes> {
    hue: [S::i16s; 4],
    saturation: [S::i16s; 4],
}

impl<S: Lanes> HueSaturation<S> {
    #[inline(always)]
    fn new(simd: S, [red, green, blue]: [S::u8s; 3]) -> Self {
        let least = red.min(green).min(blue);
        let (red, green, blue, least) = (red.widen(), green.widen(), blue.widen(), least.widen());
        let [[hue0, hue1], [saturation0, saturation1]] =
            Self::of_half(simd, red.0, green.0, blue.0, least.0);
        let [[hue2, hue3], [saturation2, saturation3]] =
            Self::of_half(simd, red.1, green.1, blue.1, least.1);
        Self {
            hue: [hue0, hue1, hue2, hue3],
            saturation: [saturation0, saturation1, saturation2, saturation3],
        }
    }

    #[inline(always)]
    fn of_half(
        _: S,
        red: S::u16s,
        green: S::u16s,
        blue: S::u16s,
        least: S::u16s,
    ) -> [[S::i16s; 2]; 2] {
        let (low, high) = (red - blue).interleave(green - blue);
        let sum = red + green + blue;
        let (low_saturation, high_saturation) = (sum - least - least - least).interleave(sum);
        [[low.bitcast(), high.bitcast()], [low_saturation.bitcast(), high_saturation.bitcast()]]
    }

    /// A bit for each pixel that meets the bounds.
    #[inline(always)]
    fn admitted(&self, simd: S, look: &SecondLook) -> u64 {
        let [lowest, highest] = look.saturation;
        let [from, to] = look.hue;
        let saturation = met(simd, self.saturation, lowest) & met(simd, self.saturation, highest);
        let (from, to) = (met(simd, self.hue, from), met(simd, self.hue, to));
        saturation & if look.is_reflex { from | to } else { from & to }
    }
}

/// A bit for each pair that meets a bound.
#[inline(always)]
fn met<S: Lanes>(simd: S, [first, second, third, fourth]: [S::i16s; 4], bound: Bound) -> u64 {
    if bound == Bound::NONE {
        return !0;
    }
    let factors = i32::from(bound.b) << 16 | i32::from(bound.a as u16);
    let factors: S::i16s = S::i32s::splat(simd, factors).bitcast();
    let lanes = S::i32s::LEN;
    let first = first.pairwise_dot_product(factors).simd_ge(bound.least).to_bitmask();
    let second = second.pairwise_dot_product(factors).simd_ge(bound.least).to_bitmask();
    let third = third.pairwise_dot_product(factors).simd_ge(bound.least).to_bitmask();
    let fourth = fourth.pairwise_dot_product(factors).simd_ge(bound.least).to_bitmask();
    first | second << lanes | third << (2 * lanes) | fourth << (3 * lanes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::correction::Correction;
    use crate::kernels::lanes::MAX_LANES;
    use crate::kernels::light::Light;
    use crate::second_look_tables::{self, Bytes, COLOR_LOG, GREY_LOG, LOG};
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
    fn vector_logarithms_equal_the_tables() {
        fn check<S: Lanes>(simd: S) {
            let all: [u8; 256] = std::array::from_fn(|value| value as u8);
            for bytes in all.chunks_exact(S::u8s::LEN) {
                let values = S::u8s::from_slice(simd, bytes);
                let of = |table: &Bytes| -> Vec<u8> {
                    bytes.iter().map(|&byte| table.of(byte)).collect()
                };
                assert_eq!(store::<S>(simd.log(values)), of(&LOG));
                assert_eq!(store::<S>(simd.color_log(values)), of(&COLOR_LOG));
                assert_eq!(store::<S>(simd.grey_log(values)), of(&GREY_LOG));
            }
        }
        with_each_level!(check);
    }

    #[test]
    fn vector_keys_equal_the_scalar_ones() {
        fn check<S: Lanes>(simd: S) {
            for correction in [Correction::new([-3, 0, 9], 12), Correction::NONE] {
                let light = Light::everywhere(simd, correction);
                let mut state = 1u32;
                for round in 0..3000 {
                    let mut channels = [[0; MAX_LANES]; 3];
                    for value in channels.as_flattened_mut() {
                        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                        *value = (state >> 24) as u8 >> (round % 8);
                    }
                    let rgb =
                        channels.each_ref().map(|c| S::u8s::from_slice(simd, &c[..S::u8s::LEN]));
                    let found = keys(simd, light.corrected(simd, rgb)).map(store::<S>);
                    for lane in 0..S::u8s::LEN {
                        let rgb = [0, 1, 2].map(|c| correction.apply(c, channels[c][lane]));
                        let found = found.each_ref().map(|keys| keys[lane]);
                        assert_eq!(found, second_look_tables::keys(rgb), "{rgb:?}");
                    }
                }
            }
        }
        with_each_level!(check);
    }
}
