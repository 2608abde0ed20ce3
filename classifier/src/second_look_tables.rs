//! The second look as tables: four look-ups and three ANDs find the colours whose bounds on hue and
//! saturation a pixel may meet.
//!
//! A box in RGB hardly bounds a hue: red, green and blue of a dim orange, of a bright one and of a grey floor
//! lie in the same ranges. Ratios of channels do bound it. With m = min(R, G, B),
//!
//! * hue depends only on the ratios (R − m) : (G − m) : (B − m), that is, on each channel's share of the
//!   greatest of the three;
//! * saturation depends only on the ratio of the grey m to the colour (R − m) + (G − m) + (B − m).
//!
//! A ratio is a difference of logarithms, and the logarithm of a byte is a table entry. So a pixel has four
//! *keys*, small integers below [`KEYS`]: log(max − m) − log(c − m) for each channel c, in sixteenths of an
//! octave, and log(colour / 2) − log(grey), in eighths of an octave plus an offset. For each key there is a
//! table of bit sets: bit i is set if colour i admits some pixel with that key. The AND of the four entries is
//! a superset of the colours that admit the pixel; [`SecondLook`] decides which of them do.
//!
//! The tables are made from ranges of ratios, not from pixels: an entry of [`LOG`] stands for a range of
//! bytes, a key for a range of quotients of them, and a hue bound is compared with the hues at both ends.

use crate::MAX_CLASSES;
use crate::second_look::{SecondLook, saturation_of};

/// Number of values of a key.
pub(crate) const KEYS: usize = 64;

/// Logarithm to the base 2 in sixteenths of an octave, plus 128, with linear mantissas (1.5 is half an octave
/// above 1); 0 for 0. Not decreasing.
pub(crate) const LOG: Bytes = {
    let mut table = [0; 256];
    let mut value = 1;
    while value < 256 {
        let octave = (value as u32).ilog2();
        let mantissa = ((value as u32) << 4 >> octave) & 15;
        table[value] = 128 + 16 * octave as u8 + mantissa as u8;
        value += 1;
    }
    Bytes(table)
};

/// Logarithm of the grey, in eighths of an octave.
pub(crate) const GREY_LOG: Bytes = {
    let mut table = [0; 256];
    let mut value = 1;
    while value < 256 {
        table[value] = LOG.0[value] / 2;
        value += 1;
    }
    Bytes(table)
};

/// Logarithm of the colour, in eighths of an octave; 0 for 0. Offset so that the key for saturation is in the
/// middle of its range where there is as much colour as grey.
pub(crate) const COLOR_LOG: Bytes = {
    let mut table = [0; 256];
    let mut value = 1;
    while value < 256 {
        table[value] = GREY_LOG.0[value] + KEYS as u8 / 2;
        value += 1;
    }
    Bytes(table)
};

/// A table with an entry for each byte, aligned to cache lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(align(64))]
pub(crate) struct Bytes(pub [u8; 256]);

impl Bytes {
    /// The entry for a byte.
    pub const fn of(&self, value: u8) -> u8 {
        self.0[value as usize]
    }
}

/// The keys of a pixel, as [`crate::kernels`] computes them for registers full of pixels. For red, green and
/// blue: 0 where the channel is the greatest, 63 where it is the least. For saturation: 0 without colour, 63
/// with hardly any grey.
#[cfg(test)]
pub(crate) fn keys([red, green, blue]: [u8; 3]) -> [u8; 4] {
    let least = red.min(green).min(blue);
    let above = [red, green, blue].map(|value| value - least);
    let greatest = above[0].max(above[1]).max(above[2]);
    let middle = above[0] ^ above[1] ^ above[2] ^ greatest;
    let [r, g, b] = above.map(|value| key(LOG.of(greatest), LOG.of(value)));
    let color = (u16::from(greatest) + u16::from(middle)).div_ceil(2);
    [r, g, b, key(COLOR_LOG.of(color as u8), GREY_LOG.of(least))]
}

/// Difference of two logarithms, limited to 0..[`KEYS`]. Of max − m and c − m for a channel c, or of half of
/// the colour (rounded up) and of the grey.
const fn key(of_more: u8, of_less: u8) -> u8 {
    let key = of_more.saturating_sub(of_less);
    if key < KEYS as u8 { key } else { KEYS as u8 - 1 }
}

/// A quotient of small numbers.
#[derive(Debug, Clone, Copy)]
struct Ratio(u16, u16);

impl Ratio {
    const fn is_less(self, other: Self) -> bool {
        (self.0 as u32) * (other.1 as u32) < (other.0 as u32) * (self.1 as u32)
    }
}

/// Lowest and highest ratio that a key stands for; `None` if no pixel has the key.
type Range = Option<[Ratio; 2]>;

const fn widened(range: Range, low: Ratio, high: Ratio) -> Range {
    match range {
        None => Some([low, high]),
        Some([lowest, highest]) => Some([
            if low.is_less(lowest) { low } else { lowest },
            if highest.is_less(high) { high } else { highest },
        ]),
    }
}

/// Steps of a table that does not decrease: lowest and highest byte of each value, and the number of values.
const fn steps(table: &Bytes) -> ([[u16; 2]; 256], usize) {
    let (mut steps, mut count) = ([[0; 2]; 256], 0);
    let mut value = 0;
    while value < 256 {
        if value == 0 || table.0[value] != table.0[value - 1] {
            steps[count][0] = value as u16;
            count += 1;
        }
        steps[count - 1][1] = value as u16;
        value += 1;
    }
    (steps, count)
}

/// For each key of a channel, the shares (c − m) / (max − m) that it stands for.
const CHANNEL_PARTS: [Range; KEYS] = {
    let mut parts = [None; KEYS];
    let (steps, count) = steps(&LOG);
    let mut greatest = 1;
    while greatest < count {
        let mut channel = 0;
        while channel <= greatest {
            let ([least, most], [low, high]) = (steps[channel], steps[greatest]);
            let key = key(LOG.of(low as u8), LOG.of(least as u8)) as usize;
            let whole = if most < low { Ratio(most, low) } else { Ratio(1, 1) };
            parts[key] = widened(parts[key], Ratio(least, high), whole);
            channel += 1;
        }
        greatest += 1;
    }
    parts
};

/// For each key of saturation, the saturations that it stands for.
const SATURATIONS: [Range; KEYS] = {
    let mut saturations = [None; KEYS];
    // Saturation is 0 without colour, and for black.
    saturations[0] = Some([Ratio(0, 1), Ratio(0, 1)]);
    let ((colors, color_count), (greys, grey_count)) = (steps(&COLOR_LOG), steps(&GREY_LOG));
    let mut color = 1;
    while color < color_count {
        let mut grey = 0;
        while grey < grey_count {
            let ([low, high], [least, most]) = (colors[color], greys[grey]);
            let key = key(COLOR_LOG.of(low as u8), GREY_LOG.of(least as u8)) as usize;
            let lowest = Ratio(2 * low - 1, 3 * most + 2 * low - 1);
            let highest = Ratio(2 * high, 3 * least + 2 * high);
            saturations[key] = widened(saturations[key], lowest, highest);
            grey += 1;
        }
        color += 1;
    }
    saturations
};

/// For each of the four keys, a bit set of the colours that may admit a pixel with it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SecondLookTables(pub [[u32; KEYS]; 4]);

impl SecondLookTables {
    /// For the second looks of the colours in the bit set `bits`; the colours in `others` admit everything.
    pub fn new(looks: &[SecondLook; MAX_CLASSES], bits: u32, others: u32) -> Self {
        let mut tables = [[others; KEYS]; 4];
        let [channels @ .., saturations] = &mut tables;
        for (class, look) in looks.iter().enumerate().filter(|(class, _)| bits >> class & 1 == 1) {
            for (channel, table) in channels.iter_mut().enumerate() {
                for (entry, parts) in table.iter_mut().zip(CHANNEL_PARTS) {
                    let admits = parts.is_some_and(|parts| may_admit_parts(look, channel, parts));
                    *entry |= u32::from(admits) << class;
                }
            }
            for (entry, range) in saturations.iter_mut().zip(SATURATIONS) {
                let admits = range.is_some_and(|range| {
                    let [low, high] = range.map(|Ratio(a, b)| saturation_of(a.into(), b.into()));
                    look.may_admit_saturation(low, high)
                });
                *entry |= u32::from(admits) << class;
            }
        }
        Self(tables)
    }

    /// The colours whose second look may admit a pixel, as a bit set.
    #[cfg(test)]
    pub fn admitting(&self, rgb: [u8; 3]) -> u32 {
        let entries = self.0.iter().zip(keys(rgb));
        entries.fold(!0, |bits, (table, key)| bits & table[usize::from(key)])
    }
}

/// Whether a second look may admit a pixel whose share (c − m) / (max − m) for a channel c is in this range.
fn may_admit_parts(look: &SecondLook, channel: usize, [low, high]: [Ratio; 2]) -> bool {
    let [next, last] = [(channel + 1) % 3, (channel + 2) % 3];
    let of = |values: [(usize, u16); 2]| {
        let mut rgb = [0; 3];
        values.into_iter().for_each(|(channel, value)| rgb[channel] = value as u8);
        rgb
    };
    // One of the other channels is the greatest, and the third is the least.
    let is_between = [next, last].into_iter().any(|greatest| {
        let [a, b] = [low, high].map(|Ratio(part, all)| of([(channel, part), (greatest, all)]));
        look.may_admit_hue(a, b)
    });
    let is_greatest = high.0 == high.1
        && look.may_admit_hue(of([(channel, 1), (last, 1)]), of([(channel, 1), (next, 1)]));
    let is_least = low.0 == 0
        && look.may_admit_hue(of([(next, 1), (channel, 0)]), of([(last, 1), (channel, 0)]));
    is_between || is_greatest || is_least
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::ColorConfig;
    use proptest::prelude::*;

    fn look(hue_deg: Option<[f64; 2]>, saturation: Option<[f64; 2]>) -> Option<SecondLook> {
        let all = [0, 255];
        let color = ColorConfig {
            name: String::new(),
            red: all,
            green: all,
            blue: all,
            hue_deg,
            saturation,
            y: None,
            u: None,
            v: None,
            looks: [0; 3],
        };
        SecondLook::new(&color).unwrap()
    }

    fn tables(look: SecondLook) -> SecondLookTables {
        let mut looks = [SecondLook::ANY; MAX_CLASSES];
        looks[3] = look;
        SecondLookTables::new(&looks, 1 << 3, !(1 << 3))
    }

    /// All pixels with channels from these values.
    fn pixels(values: &[u8]) -> impl Iterator<Item = [u8; 3]> {
        let count = values.len();
        (0..count.pow(3))
            .map(move |i| [i % count, i / count % count, i / count / count].map(|i| values[i]))
    }

    proptest! {
        #[test]
        fn no_admitted_pixel_is_lost(
            hue in proptest::option::of((0.0..360.0, 0.0..360.0f64)),
            saturation in proptest::option::of((0.0..1.0f64, 0.0..1.0f64)),
            rgb in proptest::collection::vec(any::<[u8; 3]>(), 200),
            dark in 0u8..6,
        ) {
            let saturation = saturation.map(|(a, b)| [a.min(b), a.max(b)]);
            let Some(look) = look(hue.map(|(a, b)| [a, a + b * b / 360.0]), saturation) else { return Ok(()) };
            let tables = tables(look);
            for rgb in rgb.into_iter().map(|rgb| rgb.map(|value| value >> dark)) {
                let bits = tables.admitting(rgb);
                prop_assert_eq!(bits | 1 << 3, !0);
                prop_assert!(bits >> 3 & 1 == 1 || !look.admits(rgb), "{:?}", rgb);
            }
        }
    }

    #[test]
    fn colors_exactly_on_a_bound_are_kept() {
        let values = [0, 1, 2, 3, 5, 9, 64, 100, 127, 128, 200, 254, 255];
        for degrees in (0..360).step_by(15).map(f64::from) {
            for (hue, saturation) in [(0.0, [0.0, 0.0]), (30.0, [1.0, 1.0]), (0.0, [0.0, 1.0])] {
                let look = look(Some([degrees, degrees + hue]), Some(saturation)).unwrap();
                let tables = tables(look);
                for rgb in pixels(&values).filter(|&rgb| look.admits(rgb)) {
                    assert_eq!(tables.admitting(rgb), !0, "{rgb:?} {degrees}");
                }
            }
        }
        for saturation in [[0.0, 0.0], [0.5, 0.5], [1.0, 1.0]] {
            let look = look(None, Some(saturation)).unwrap();
            let tables = tables(look);
            for rgb in pixels(&values).filter(|&rgb| look.admits(rgb)) {
                assert_eq!(tables.admitting(rgb), !0, "{rgb:?} {saturation:?}");
            }
        }
    }

    #[test]
    fn colors_just_outside_the_bounds_do_not_pass() {
        let values: Vec<u8> = (0..=255).step_by(5).collect();
        for degrees in (0..360).step_by(20).map(f64::from) {
            let look = look(Some([degrees, degrees + 25.0]), Some([0.35, 0.8])).unwrap();
            let wider = [degrees - 9.0, degrees + 34.0];
            let wider = self::look(Some(wider), Some([0.29, 0.85])).unwrap();
            let tables = tables(look);
            for rgb in pixels(&values).filter(|&rgb| !wider.admits(rgb)) {
                assert_eq!(tables.admitting(rgb) >> 3 & 1, 0, "{rgb:?} {degrees}");
            }
        }
    }
}
