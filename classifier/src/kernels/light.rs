//! [Corrections](Correction) of registers full of pixels, each pixel by its zone.

use super::lanes::{Lanes, MAX_LANES};
use crate::correction::Correction;
use crate::zones::ZonedTables;
use fearless_simd::prelude::*;

/// The corrections of a row's pixels. Tiles have even sides, so two neighbouring pixels share a correction,
/// and an entry is for both.
#[derive(Debug, Clone, Default)]
pub struct RowLight {
    haze: Vec<u8>,
    gains: [Vec<u16>; 3],
    is_corrected: bool,
    /// Valid for rows `< end_row`.
    end_row: usize,
}

impl RowLight {
    /// Begins a picture of this width.
    pub fn begin(&mut self, width: usize) {
        self.end_row = 0;
        let entries = width.div_ceil(2).next_multiple_of(MAX_LANES);
        if self.haze.len() < entries {
            self.haze.resize(entries, 0);
            self.gains.iter_mut().for_each(|gains| gains.resize(entries, 0));
        }
    }

    /// The corrections of a row; `None` if nothing is to be corrected. Rows must be requested from top to
    /// bottom.
    #[inline(always)]
    pub fn of_row(&mut self, zoned: ZonedTables, row: usize) -> Option<&Self> {
        if row >= self.end_row {
            self.set(zoned, row);
        }
        self.is_corrected.then_some(self)
    }

    #[inline(never)]
    fn set(&mut self, zoned: ZonedTables, row: usize) {
        let tile = zoned.zones.tile_px();
        self.end_row = (row / tile + 1) * tile;
        let tiles = zoned.zones.tiles_of_row(row);
        let correction = |zone: u8| zoned.tables[usize::from(zone)].correction();
        self.is_corrected = tiles.iter().any(|&zone| correction(zone) != Correction::NONE);
        if !self.is_corrected {
            return;
        }
        for (index, &zone) in tiles.iter().enumerate() {
            let Correction { haze, gains } = correction(zone);
            let entries = self.haze.len();
            let begin = (index * tile / 2).min(entries);
            // The last tile also fills the last register.
            let end =
                if index + 1 == tiles.len() { entries } else { (begin + tile / 2).min(entries) };
            self.haze[begin..end].fill(haze);
            for (list, gain) in self.gains.iter_mut().zip(gains) {
                list[begin..end].fill(gain);
            }
        }
    }

    /// The entries from `at` on, for pixels in even or in odd columns.
    #[inline(always)]
    pub fn load<S: Lanes>(&self, simd: S, at: usize) -> Light<S> {
        let (lanes, half) = (S::u8s::LEN, S::u16s::LEN);
        let bytes = |values: &[u8]| S::u8s::from_slice(simd, &values[at..at + lanes]);
        let words = |values: &[u16]| {
            let values = &values[at..at + lanes];
            [S::u16s::from_slice(simd, &values[..half]), S::u16s::from_slice(simd, &values[half..])]
        };
        let [red, green, blue] = &self.gains;
        let gains = [words(red), words(green), words(blue)];
        Light { haze: bytes(&self.haze), gains }
    }
}

/// The corrections of a register full of pixels.
#[derive(Clone, Copy)]
pub struct Light<S: Lanes> {
    haze: S::u8s,
    gains: [[S::u16s; 2]; 3],
}

impl<S: Lanes> Light<S> {
    /// The same correction for all pixels.
    #[inline(always)]
    pub fn everywhere(simd: S, Correction { haze, gains }: Correction) -> Self {
        let [red, green, blue] = gains;
        let word = |value: u16| [S::u16s::splat(simd, value); 2];
        Self { haze: S::u8s::splat(simd, haze), gains: [word(red), word(green), word(blue)] }
    }

    /// Corrects each pixel as [`Correction::apply`] does.
    #[inline(always)]
    pub fn corrected(&self, simd: S, [red, green, blue]: [S::u8s; 3]) -> [S::u8s; 3] {
        [self.channel(simd, 0, red), self.channel(simd, 1, green), self.channel(simd, 2, blue)]
    }

    #[inline(always)]
    fn channel(&self, simd: S, channel: usize, values: S::u8s) -> S::u8s {
        simd.scaled(values.saturating_sub(self.haze), self.gains[channel])
    }
}
