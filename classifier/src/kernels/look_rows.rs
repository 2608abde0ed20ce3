//! The second step of the kernel for [mosaics](super::bayer) where colours have second looks: the noted
//! blocks are demosaiced exactly and classified a register full of pixels at a time ([`looks`](super::looks)).

use super::RowRuns;
use super::bayer::{Noted, Row, every_other, exact_colors};
use super::classes::Classes;
use super::lanes::Lanes;
use super::looks::PixelLooks;
use crate::mask::Span;
use fearless_simd::prelude::*;

/// [`classify`] as a function of its own, which has all registers for itself.
#[inline(never)]
pub fn classify_apart<S: Lanes, const P: usize>(
    simd: S,
    row: &Row,
    noted: &[Noted],
    index: usize,
    runs: &mut RowRuns,
) {
    simd.vectorize(
        #[inline(always)]
        || classify::<S, P>(simd, row, noted, index, runs),
    );
}

/// Classifies those of the noted blocks of a row where something may be, as it is with `index` among two. `P`
/// is the column parity of its coloured sites.
#[inline(always)]
fn classify<S: Lanes, const P: usize>(
    simd: S,
    row: &Row,
    noted: &[Noted],
    index: usize,
    runs: &mut RowRuns,
) {
    let lanes = S::u8s::LEN;
    let looks = PixelLooks::new(row.setup);
    for noted in noted {
        let start = 2 * lanes * noted.index;
        let end = row.width.min(start + 2 * lanes);
        let block = Span { begin: start, end };
        let passing = within_spans(noted.passing[index], row.spans, block);
        if passing == [0; 2] {
            continue;
        }
        let [mut even, mut odd] = exact_colors::<S, P>(simd, row, noted.index);
        if let Some(light) = row.light {
            let light = light.load(simd, lanes * noted.index);
            (even, odd) = (light.corrected(simd, even), light.corrected(simd, odd));
        }
        let even = looks.classify(simd, even, passing[0]);
        let odd = looks.classify(simd, odd, passing[1]);
        if even.is_none() && odd.is_none() {
            continue;
        }
        let mut classes = Classes::new();
        classes.set_columns(simd, [even, odd]);
        classes.hand_in(simd, start, end - start, runs);
    }
}

/// Mask of the pixels that are in spans.
#[inline(always)]
fn within_spans(passing: [u64; 2], spans: &[Span], block: Span) -> [u64; 2] {
    if let [span] = spans
        && span.begin <= block.begin
        && block.end <= span.end
    {
        return passing;
    }
    let mut columns = [0; 2];
    for span in spans {
        let span = span.within(block);
        for (parity, columns) in columns.iter_mut().enumerate() {
            *columns |= every_other(span, block.begin, parity);
        }
    }
    [passing[0] & columns[0], passing[1] & columns[1]]
}
