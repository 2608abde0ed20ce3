//! Runs from the classes of a block of pixels.

use super::RowRuns;
use super::lanes::{Lanes, MAX_LANES};
use crate::BACKGROUND;
use crate::mask::Span;
use fearless_simd::prelude::*;

/// Pixels of the longest block.
pub const MAX_BLOCK: usize = 2 * MAX_LANES;

/// The classes of a block's pixels.
pub struct Classes {
    /// Class of the pixel before the block, then those of the block.
    bytes: [u8; 1 + MAX_BLOCK],
}

impl Classes {
    /// All background.
    #[inline(always)]
    pub fn new() -> Self {
        Self { bytes: [BACKGROUND; 1 + MAX_BLOCK] }
    }

    /// Sets the class of a pixel.
    #[inline(always)]
    pub fn set(&mut self, index: usize, class: u8) {
        self.bytes[index + 1] = class;
    }

    /// Sets the classes of the pixels in even and in odd columns where they are not background.
    #[inline(always)]
    pub fn set_columns<S: Lanes>(&mut self, simd: S, [even, odd]: [Option<S::u8s>; 2]) {
        if even.is_none() && odd.is_none() {
            return;
        }
        let background = S::u8s::splat(simd, BACKGROUND);
        let (even, odd) = (even.unwrap_or(background), odd.unwrap_or(background));
        let (low, high) = even.interleave(odd);
        self.set_all(simd, 0, low);
        self.set_all(simd, S::u8s::LEN, high);
    }

    /// Sets the classes of a register full of pixels where they are not background.
    #[inline(always)]
    pub fn set_all<S: Lanes>(&mut self, simd: S, first: usize, classes: S::u8s) {
        let bytes = &mut self.bytes[first + 1..first + 1 + S::u8s::LEN];
        // Background is above all other values.
        classes.min(S::u8s::from_slice(simd, bytes)).store_slice(bytes);
    }

    /// Adds the block's first `count` pixels, which begin in column `start`, to the runs. Comparing the
    /// classes with themselves shifted by one shows where the class changes. All begins in a register full of
    /// pixels are written before all ends: in noise that saves a sixth of the time, since no branch must
    /// predict their order.
    #[inline(always)]
    pub fn append_to_row<S: Lanes>(
        &mut self,
        simd: S,
        start: usize,
        count: usize,
        runs: &mut RowRuns,
    ) {
        runs.skip_to(start);
        self.bytes[0] = runs.class;
        let lanes = S::u8s::LEN;
        for first in (0..count).step_by(lanes) {
            let before = S::u8s::from_slice(simd, &self.bytes[first..first + lanes]);
            let here = S::u8s::from_slice(simd, &self.bytes[first + 1..first + 1 + lanes]);
            let valid = Span { begin: 0, end: count }.bits(first, lanes);
            let changes = !here.simd_eq(before).to_bitmask() & valid;
            let mut begins = changes & !here.simd_eq(BACKGROUND).to_bitmask();
            let mut ends = changes & !before.simd_eq(BACKGROUND).to_bitmask();
            while begins != 0 {
                let index = first + begins.trailing_zeros() as usize % MAX_LANES;
                runs.begin(start + index, self.bytes[index + 1]);
                begins &= begins - 1;
            }
            while ends != 0 {
                let index = first + ends.trailing_zeros() as usize % MAX_LANES;
                runs.end(start + index);
                ends &= ends - 1;
            }
        }
        runs.class = self.bytes[count];
        runs.reached = start + count;
    }
}
