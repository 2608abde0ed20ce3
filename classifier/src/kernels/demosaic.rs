//! Bilinear demosaicing (eqs. 1–3) of a register full of pixels.
//!
//! A row lies in memory as the sensor sends it, sites of its own colour and green ones in turns. A
//! register loaded one byte to the left or right of another holds every pixel's neighbour, so all
//! means are of whole registers, and what belongs to the sites of one kind is picked with a mask of
//! every other byte. The four Bayer orders are two such masks and who is called red.

use super::lanes::Lanes;
use super::scalar::Sites;
use fearless_simd::prelude::*;

/// Which pixels of a block are at the sites of the row's own colour; the others are green.
#[derive(Clone, Copy)]
pub struct ColoredLanes<S: Simd>(S::mask8s);

impl<S: Lanes> ColoredLanes<S> {
    /// Of the block that begins in column `start`.
    #[inline(always)]
    pub fn new(simd: S, sites: Sites, start: usize) -> Self {
        const EVERY_OTHER: u64 = 0x5555_5555_5555_5555;
        let bits = EVERY_OTHER << ((start ^ sites.colored_parity) & 1);
        Self(S::mask8s::from_bitmask(simd, bits & (!0 >> (64 - S::u8s::LEN))))
    }
}

/// A block's pixels in one row, and their neighbours left and right.
#[derive(Clone, Copy)]
struct Triple<S: Simd> {
    left: S::u8s,
    here: S::u8s,
    right: S::u8s,
}

impl<S: Lanes> Triple<S> {
    /// Of a row that begins one pixel before the block.
    #[inline(always)]
    fn load(simd: S, row: &[u8]) -> Self {
        let lanes = S::u8s::LEN;
        Self {
            left: S::u8s::from_slice(simd, &row[..lanes]),
            here: S::u8s::from_slice(simd, &row[1..lanes + 1]),
            right: S::u8s::from_slice(simd, &row[2..lanes + 2]),
        }
    }
}

/// The own colour of the row, green, and the other colour of a block's pixels, exactly. The rows
/// are the one above, the row itself and the one below, and begin one pixel before the block.
#[inline(always)]
pub fn colors<S: Lanes>(
    simd: S,
    rows: [&[u8]; 3],
    ColoredLanes(at_colored): ColoredLanes<S>,
) -> [S::u8s; 3] {
    let above = Triple::load(simd, rows[0]);
    let here = Triple::load(simd, rows[1]);
    let below = Triple::load(simd, rows[2]);
    let cross = exact_mean4(simd, above.here, below.here, here.left, here.right);
    let diagonal = exact_mean4(simd, above.left, above.right, below.left, below.right);
    [
        at_colored.select(here.here, simd.mean(here.left, here.right)),
        at_colored.select(cross, here.here),
        at_colored.select(diagonal, simd.mean(above.here, below.here)),
    ]
}

/// (a + b + c + d + 2) / 4, rounded down. The mean of two means is that, or 1 more if it had to be
/// rounded up and one of the two had been rounded up before.
#[inline(always)]
fn exact_mean4<S: Lanes>(simd: S, a: S::u8s, b: S::u8s, c: S::u8s, d: S::u8s) -> S::u8s {
    let (ab, cd) = (simd.mean(a, b), simd.mean(c, d));
    simd.mean(ab, cd) - (((a ^ b) | (c ^ d)) & (ab ^ cd) & 1)
}

/// By how much [`rough_colors`] may be too high.
pub const EXCESS: u8 = 1;

/// As [`colors`], of a block in two rows at once, but means of four may be 1 too high. The rows are
/// the one above the two, the two, and the one below; where pixels are coloured in the upper of the
/// two, they are green in the lower.
///
/// Two rows share what is loaded and what is the mean of left and right: 12 loads and 10 means for
/// both, where [`colors`] takes 9 loads and 8 means, and the corrections, for each.
#[inline(always)]
pub fn rough_colors<S: Lanes>(
    simd: S,
    rows: [&[u8]; 4],
    ColoredLanes(at_colored): ColoredLanes<S>,
) -> [[S::u8s; 3]; 2] {
    let row0 = Triple::load(simd, rows[0]);
    let row1 = Triple::load(simd, rows[1]);
    let row2 = Triple::load(simd, rows[2]);
    let row3 = Triple::load(simd, rows[3]);
    let across0 = simd.mean(row0.left, row0.right);
    let across1 = simd.mean(row1.left, row1.right);
    let across2 = simd.mean(row2.left, row2.right);
    let across3 = simd.mean(row3.left, row3.right);
    let upright = simd.mean(row0.here, row2.here);
    let upper = [
        at_colored.select(row1.here, across1),
        at_colored.select(simd.mean(upright, across1), row1.here),
        at_colored.select(simd.mean(across0, across2), upright),
    ];
    let upright = simd.mean(row1.here, row3.here);
    let lower = [
        at_colored.select(across2, row2.here),
        at_colored.select(row2.here, simd.mean(upright, across2)),
        at_colored.select(upright, simd.mean(across1, across3)),
    ];
    [upper, lower]
}
