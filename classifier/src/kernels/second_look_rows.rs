//! Step 2 of the kernel for [mosaics](super::bayer) if colours have second looks: noted blocks are demosaiced
//! exactly and classified a register full of pixels at a time ([`second_look`](super::second_look)).

use super::RowRuns;
use super::bayer::{Noted, Row, every_other, exact_colors};
use super::classes::Classes;
use super::lanes::Lanes;
use super::second_look::SecondLookClassifier;
use crate::mask::Span;
use fearless_simd::prelude::*;

/// [`classify`], not inlined, so that it has all registers to itself.
#[inline(never)]
pub fn classify_outlined<S: Lanes, const P: usize>(
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

/// Classifies the noted blocks that have passing pixels in a row; `index` is its index in the pair. `P` is
/// the column parity of its coloured sites.
#[inline(always)]
fn classify<S: Lanes, const P: usize>(
    simd: S,
    row: &Row,
    noted: &[Noted],
    index: usize,
    runs: &mut RowRuns,
) {
    let lanes = S::u8s::LEN;
    let classifier = SecondLookClassifier::new(row.setup);
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
        let even = classifier.classify(simd, even, passing[0]);
        let odd = classifier.classify(simd, odd, passing[1]);
        if even.is_none() && odd.is_none() {
            continue;
        }
        let mut classes = Classes::new();
        classes.set_columns(simd, [even, odd]);
        classes.append_to_row(simd, start, end - start, runs);
    }
}

/// Mask of the pixels in spans.
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
