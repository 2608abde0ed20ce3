//! Bilinear demosaicing (eqs. 1–3) of registers full of sites of one kind.
//!
//! In the [planes](super::planes) of a row, a site's left and right neighbours are in the other plane: one at
//! the same index, the other one at the index before (for sites in even columns) or behind (odd ones). So all
//! means are taken of whole registers, without shuffles. The four Bayer orders reduce to the column parity of
//! the sites that are not green, and to whether a row's own colour is red or blue.

use super::lanes::Lanes;
use super::planes::Planes;
use fearless_simd::prelude::*;

/// A register full of pixels of one parity, from index `at` of a plane.
#[inline(always)]
fn here<S: Lanes>(simd: S, row: Planes, parity: usize, at: usize) -> S::u8s {
    S::u8s::from_slice(simd, &row[parity][at..at + S::u8s::LEN])
}

/// The left and right neighbours of these pixels: the one with the same index in the other plane, then the
/// other.
#[inline(always)]
fn beside<S: Lanes>(simd: S, row: Planes, parity: usize, at: usize) -> (S::u8s, S::u8s) {
    (here(simd, row, 1 - parity, at), here(simd, row, 1 - parity, at + 2 * parity - 1))
}

/// A row's own colour, green, and the other colour, exactly, for a register full of coloured sites in columns
/// of this parity. The rows are the one above, the row itself and the one below.
#[inline(always)]
pub fn at_colored_sites<S: Lanes>(
    simd: S,
    [above, row, below]: [Planes; 3],
    parity: usize,
    at: usize,
) -> [S::u8s; 3] {
    let (up, down) = (here(simd, above, parity, at), here(simd, below, parity, at));
    let (left, right) = beside(simd, row, parity, at);
    let (up_left, up_right) = beside(simd, above, parity, at);
    let (down_left, down_right) = beside(simd, below, parity, at);
    let green = exact_mean4(simd, up, down, left, right);
    let other = exact_mean4(simd, up_left, up_right, down_left, down_right);
    [here(simd, row, parity, at), green, other]
}

/// A row's own colour, green, and the other colour, exactly, for a register full of green sites.
#[inline(always)]
pub fn at_green_sites<S: Lanes>(
    simd: S,
    [above, row, below]: [Planes; 3],
    parity: usize,
    at: usize,
) -> [S::u8s; 3] {
    let (up, down) = (here(simd, above, parity, at), here(simd, below, parity, at));
    let (left, right) = beside(simd, row, parity, at);
    [simd.mean(left, right), here(simd, row, parity, at), simd.mean(up, down)]
}

/// (a + b + c + d + 2) / 4, rounded down. The mean of two rounded means equals that, or exceeds it by 1 if it
/// was rounded up and one of the two had been rounded up before.
#[inline(always)]
fn exact_mean4<S: Lanes>(simd: S, a: S::u8s, b: S::u8s, c: S::u8s, d: S::u8s) -> S::u8s {
    let (ab, cd) = (simd.mean(a, b), simd.mean(c, d));
    simd.mean(ab, cd) - (((a ^ b) | (c ^ d)) & (ab ^ cd) & 1)
}

/// Maximum error of [`rough_colors`], upwards.
pub const EXCESS: u8 = 1;

/// The colours of all sites of two rows, where means of four may be 1 too high. The rows are the one above
/// the pair, the pair, and the one below, each from one pixel before the register; `P` is the column parity
/// of the upper row's coloured sites.
///
/// Two rows share loads and means of left and right neighbours: 14 loads and 14 means for four registers full
/// of pixels.
#[inline(always)]
pub fn rough_colors<S: Lanes, const P: usize>(simd: S, rows: [Planes; 4]) -> [[[S::u8s; 3]; 2]; 2] {
    // Columns of the upper row's coloured sites, and the columns between them.
    let (on0, on1) = (here(simd, rows[0], P, 1), here(simd, rows[1], P, 1));
    let (on2, on3) = (here(simd, rows[2], P, 1), here(simd, rows[3], P, 1));
    let (off0, off1) = (here(simd, rows[0], 1 - P, 1), here(simd, rows[1], 1 - P, 1));
    let (off2, off3) = (here(simd, rows[2], 1 - P, 1), here(simd, rows[3], 1 - P, 1));
    // Means of left and right neighbours.
    let around_on0 = simd.mean(off0, here(simd, rows[0], 1 - P, 2 * P));
    let around_on1 = simd.mean(off1, here(simd, rows[1], 1 - P, 2 * P));
    let around_on2 = simd.mean(off2, here(simd, rows[2], 1 - P, 2 * P));
    let around_off1 = simd.mean(on1, here(simd, rows[1], P, 2 - 2 * P));
    let around_off2 = simd.mean(on2, here(simd, rows[2], P, 2 - 2 * P));
    let around_off3 = simd.mean(on3, here(simd, rows[3], P, 2 - 2 * P));
    let upper_on =
        [on1, simd.mean(simd.mean(on0, on2), around_on1), simd.mean(around_on0, around_on2)];
    let upper_off = [around_off1, off1, simd.mean(off0, off2)];
    let lower_on = [around_on2, on2, simd.mean(on1, on3)];
    let lower_off =
        [off2, simd.mean(simd.mean(off1, off3), around_off2), simd.mean(around_off1, around_off3)];
    if P == 0 {
        [[upper_on, upper_off], [lower_on, lower_off]]
    } else {
        [[upper_off, upper_on], [lower_off, lower_on]]
    }
}
