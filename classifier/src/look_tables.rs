//! Second looks as tables: which colours' bounds on hue and saturation a pixel may meet, found by four
//! look-ups and three ANDs.
//!
//! Boxes in RGB hardly bound a hue: red, green and blue of a dim orange, of a bright one and of a grey
//! floor lie in the same ranges. Ratios do. With m the least of R, G and B,
//!
//! * hue depends only on the ratios (R − m) : (G − m) : (B − m), so on how far each channel stays behind
//!   the greatest of the three;
//! * saturation depends only on the ratio of m to (R − m) + (G − m) + (B − m).
//!
//! Ratios are differences of logarithms, and logarithms of bytes are a table. So a pixel has four *keys*
//! below [`KEYS`]: how many steps of [`LOG`] each channel stays behind the greatest, and how many
//! the colour in a pixel is stronger than the grey. For each key there is a table with a bit for each colour that
//! admits some pixel with that key. What is left after the AND of the four is a superset of the colours that
//! admit the pixel. Which of them do, [`SecondLook`] decides.
//!
//! Tables are made from ranges of ratios, not from pixels: a value of [`LOG`] stands for a range of bytes,
//! a key for a range of quotients of them, and a hue bound is compared with the hues at both ends.

use crate::MAX_CLASSES;
use crate::second_look::{SecondLook, saturation_of};

/// A key is below this.
pub(crate) const KEYS: usize = 64;

/// 0 for 0; else 128 and the logarithm to the base 2 in sixteenths, where mantissas count as they are (so
/// 1.5 is half an octave above 1). Rises with the value.
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

/// The same in eighths, for grey.
pub(crate) const GREY_LOG: Bytes = {
    let mut table = [0; 256];
    let mut value = 1;
    while value < 256 {
        table[value] = LOG.0[value] / 2;
        value += 1;
    }
    Bytes(table)
};

/// The same for colour, so much higher that the key for saturation is in the middle where there is as much
/// of it as of grey; but 0 for none.
pub(crate) const COLOR_LOG: Bytes = {
    let mut table = [0; 256];
    let mut value = 1;
    while value < 256 {
        table[value] = GREY_LOG.0[value] + KEYS as u8 / 2;
        value += 1;
    }
    Bytes(table)
};

/// A table of all bytes that is not spread over more cache lines than need be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(align(64))]
pub(crate) struct Bytes(pub [u8; 256]);

impl Bytes {
    /// The entry for a value.
    pub const fn of(&self, value: u8) -> u8 {
        self.0[value as usize]
    }
}

/// The keys of a pixel, as [`crate::kernels`] compute them of many at once: for red, green and blue 0 where
/// the channel is the greatest and 63 where it is the least; for saturation 0 where there is no colour, 63
/// where there is hardly any grey.
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

/// From the logarithms of the greatest channel and of another, both without what all three share; or from
/// those of half of what the channels have above the least one, rounded up, and of that.
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

/// Both ends of the ratios that a key stands for; `None` if there is none.
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

/// Where in a table that rises the value changes: the least and the greatest byte of each value, and how
/// many values there are.
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

/// Indexed by a channel's key: admitted share of the greatest channel.
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

/// Indexed by the saturation key: the saturations it stands for.
const SATURATIONS: [Range; KEYS] = {
    let mut saturations = [None; KEYS];
    // Without any colour it is 0, that of black too.
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

/// For each key the colours, a bit each, that may admit a pixel with it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LookTables(pub [[u32; KEYS]; 4]);

impl LookTables {
    /// For the second looks of the colours whose bits are set, and other colours, which admit everything.
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

/// Whether a second look may admit a pixel of which a channel has such a part of the greatest one, both
/// without what all three share.
fn may_admit_parts(look: &SecondLook, channel: usize, [low, high]: [Ratio; 2]) -> bool {
    let [next, last] = [(channel + 1) % 3, (channel + 2) % 3];
    let of = |values: [(usize, u16); 2]| {
        let mut rgb = [0; 3];
        values.into_iter().for_each(|(channel, value)| rgb[channel] = value as u8);
        rgb
    };
    // One of the others is the greatest, and the third the least.
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
    use common::config::ColorConfig;
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

    fn tables(look: SecondLook) -> LookTables {
        let mut looks = [SecondLook::ANY; MAX_CLASSES];
        looks[3] = look;
        LookTables::new(&looks, 1 << 3, !(1 << 3))
    }

    /// Every pixel whose channels are among these.
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
    fn bounds_that_colors_meet_exactly_lose_none() {
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
    fn what_is_a_little_beside_the_bounds_does_not_pass() {
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
