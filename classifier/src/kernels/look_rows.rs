//! The second step of the kernel for [mosaics](super::bayer) where colours have second looks: the noted
//! blocks are demosaiced exactly and classified a register full of pixels at a time ([`looks`](super::looks)).

use super::RowRuns;
use super::bayer::{Noted, Row, every_other};
use super::classes::Classes;
use super::demosaic::{at_colored_sites, at_green_sites};
use super::lanes::Lanes;
use super::looks::ZoneLooks;
use super::planes::MARGIN;
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
        || match row.zone.map(|zone| ZoneLooks::new(row.setup, zone)) {
            Some(zone) => classify::<S, P, true>(simd, row, Some(zone), noted, index, runs),
            None => classify::<S, P, false>(simd, row, None, noted, index, runs),
        },
    );
}

/// Classifies those of the noted blocks of a row where something may be, as it is with `index` among two. `P`
/// is the column parity of its coloured sites; `ONE` if all of it is in one zone.
#[inline(always)]
fn classify<S: Lanes, const P: usize, const ONE: bool>(
    simd: S,
    row: &Row,
    zone: Option<ZoneLooks>,
    noted: &[Noted],
    index: usize,
    runs: &mut RowRuns,
) {
    let lanes = S::u8s::LEN;
    for noted in noted {
        let start = 2 * lanes * noted.index;
        let end = row.width.min(start + 2 * lanes);
        let block = Span { begin: start, end };
        let passing = within_spans(noted.passing[index], row.spans, block);
        if passing == [0; 2] {
            continue;
        }
        let at = MARGIN + lanes * noted.index;
        let colored = rgb::<S>(at_colored_sites(simd, row.rows, P, at), row.has_red);
        let green = rgb::<S>(at_green_sites(simd, row.rows, 1 - P, at), row.has_red);
        let (even, odd) = if P == 0 { (colored, green) } else { (green, colored) };
        let mut classes = Classes::new();
        if ONE && let Some(zone) = zone {
            let even = zone.classify(simd, even, passing[0]);
            let odd = zone.classify(simd, odd, passing[1]);
            if even.is_none() && odd.is_none() {
                continue;
            }
            classes.set_columns(simd, [even, odd]);
        } else {
            for (span, zone) in row.setup.zoned.zones.divide(row.row, block) {
                let zone = ZoneLooks::new(row.setup, zone);
                let even = zone.classify(simd, even, passing[0] & every_other(span, start, 0));
                let odd = zone.classify(simd, odd, passing[1] & every_other(span, start, 1));
                classes.set_columns(simd, [even, odd]);
            }
        }
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

/// Sorts a row's own colour and the other one into red and blue.
#[inline(always)]
fn rgb<S: Lanes>([own, green, other]: [S::u8s; 3], has_red: bool) -> [S::u8s; 3] {
    if has_red { [own, green, other] } else { [other, green, own] }
}
