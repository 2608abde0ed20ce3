//! Rows of a mosaic, separated into even and odd columns.
//!
//! In such a plane, neighbours are sites of the same colour. So a register holds sites of one kind only, and
//! a result computed for a register is needed for all of it. Each row is copied once; the copy also removes
//! stride, two-byte samples, mirrored edges and incomplete registers from the code that follows.

use super::ROWS_AHEAD;
use super::lanes::{Lanes, MAX_LANES};
use super::scalar::{after, before};
use crate::picture::{BayerImage, narrowed};
use fearless_simd::prelude::*;
use runtime::prefetch::prefetch;

/// Rows held at once: a pair, the row above and the row below.
const ROWS: usize = 4;

/// Bytes before the first and behind the last pixel of a plane: room for a neighbour, and alignment of the
/// first pixel to a cache line.
pub const MARGIN: usize = MAX_LANES;

/// A row's even and odd columns. Pixel 0 of each is at [`MARGIN`]; each has one more pixel on both sides, and
/// room for whole registers.
pub type Planes<'a> = [&'a [u8]; 2];

/// The latest rows of a picture, as planes.
#[derive(Debug, Clone, Default)]
pub struct Ring {
    bytes: Vec<u8>,
    /// Index of the first byte aligned to a cache line.
    first: usize,
    plane_bytes: usize,
    /// The picture's row in each slot.
    held: [Option<usize>; ROWS],
}

impl Ring {
    /// Forgets all rows, and makes room for a picture of this width.
    pub fn fit(&mut self, width: usize) {
        self.held = [None; ROWS];
        self.plane_bytes = MARGIN + width.div_ceil(2).next_multiple_of(MAX_LANES) + MARGIN;
        let needed = 2 * ROWS * self.plane_bytes + MAX_LANES;
        if self.bytes.len() < needed {
            self.bytes.resize(needed, 0);
        }
        self.first = self.bytes.as_ptr().align_offset(MAX_LANES).min(MAX_LANES);
    }

    /// Copies a row into the slot of the row four above it.
    #[inline(always)]
    pub fn hold<S: Lanes>(&mut self, simd: S, image: &BayerImage, row: usize) {
        if self.held[row % ROWS] == Some(row) {
            return;
        }
        self.held[row % ROWS] = Some(row);
        let width = image.width();
        let begin = self.first + row % ROWS * 2 * self.plane_bytes;
        let planes = &mut self.bytes[begin..begin + 2 * self.plane_bytes];
        let (even, odd) = planes.split_at_mut(self.plane_bytes);
        let samples = image.row(row);
        let ahead =
            if row + ROWS_AHEAD < image.height() { image.row(row + ROWS_AHEAD) } else { samples };
        let (even_pixels, odd_pixels) = (&mut even[MARGIN..], &mut odd[MARGIN..]);
        match image.shift() {
            None => separate(simd, [samples, ahead], even_pixels, odd_pixels),
            Some(shift) => {
                prefetch(ahead);
                // A plain loop, which the compiler turns into shuffles.
                let pairs = even_pixels.iter_mut().zip(odd_pixels);
                for ((even, odd), &[a, b, c, d]) in pairs.zip(samples.as_chunks::<4>().0) {
                    (*even, *odd) = (narrowed(a, b, shift), narrowed(c, d, shift));
                }
                if let &[low, high] = samples.as_chunks::<4>().1 {
                    even[MARGIN + width / 2] = narrowed(low, high, shift);
                }
            }
        }
        // Column −1 is odd; the parity of the column behind the last one depends on the width.
        odd[MARGIN - 1] = odd[MARGIN + before(0) / 2];
        let mirrored = MARGIN + after(width - 1, width) / 2;
        let behind = if width.is_multiple_of(2) { even } else { odd };
        behind[MARGIN + width / 2] = behind[mirrored];
    }

    /// A row that is held.
    #[inline(always)]
    pub fn row(&self, row: usize) -> Planes<'_> {
        debug_assert_eq!(self.held[row % ROWS], Some(row));
        let begin = self.first + row % ROWS * 2 * self.plane_bytes;
        let (even, odd) =
            self.bytes[begin..begin + 2 * self.plane_bytes].split_at(self.plane_bytes);
        [even, odd]
    }
}

/// Separates even and odd bytes; `even` and `odd` have room for whole registers. Prefetches as many bytes of
/// `ahead`.
#[inline(always)]
fn separate<S: Lanes>(simd: S, [bytes, ahead]: [&[u8]; 2], even: &mut [u8], odd: &mut [u8]) {
    let lanes = S::u8s::LEN;
    let mut pairs = bytes.chunks_exact(2 * lanes);
    let places = even.chunks_exact_mut(lanes).zip(odd.chunks_exact_mut(lanes));
    for ((pair, ahead), (even, odd)) in
        pairs.by_ref().zip(ahead.chunks_exact(2 * lanes)).zip(places)
    {
        prefetch(ahead);
        separate_registers(simd, pair, even, odd);
    }
    // The remaining pairs are separated together with enough of the preceding ones to fill the registers, if
    // the row is long enough. Loading them from a padded copy would stall (3 % of a picture of 2448 columns).
    let (whole, rest) = (bytes.len() & !1, pairs.remainder());
    match whole.checked_sub(2 * lanes) {
        Some(begin) if !rest.is_empty() => {
            let places = begin / 2..whole / 2;
            let (even, odd) = (&mut even[places.clone()], &mut odd[places]);
            separate_registers(simd, &bytes[begin..whole], even, odd);
        }
        Some(_) => {}
        None => {
            let pairs = bytes.as_chunks::<2>().0;
            for ((even, odd), pair) in even.iter_mut().zip(&mut *odd).zip(pairs) {
                [*even, *odd] = *pair;
            }
        }
    }
    if whole < bytes.len() {
        even[whole / 2] = bytes[whole];
    }
}

/// Separates two registers full of bytes.
#[inline(always)]
fn separate_registers<S: Lanes>(simd: S, pair: &[u8], even: &mut [u8], odd: &mut [u8]) {
    let (first, second) = pair.split_at(S::u8s::LEN);
    let first = S::u8s::from_slice(simd, first);
    let second = S::u8s::from_slice(simd, second);
    first.unzip_low(second).store_slice(even);
    first.unzip_high(second).store_slice(odd);
}
