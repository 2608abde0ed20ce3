//! The vector kernel for Bayer mosaics.
//!
//! It interpolates colours bilinearly (eqs. 1–3 of the paper) and classifies them with the tables of section
//! 4.2. Interpolating every pixel exactly would waste most of the work, since almost all of a pitch is
//! background. So rows are processed in pairs, each pair in two steps.
//!
//! 1. Find, in whole rows, a register full of pixels at a time: interpolate with byte averages, at most one
//!    above the exact value, look up each channel in the [prefilter](super::prefilter) tables, which allow
//!    for that error, AND the three entries, and note each block with a passing pixel, with a bit for each
//!    pixel. Only these notes are written, and no branch depends on the picture.
//! 2. Classify, in noted blocks: interpolate exactly, classify the pixels whose bit is set with the same
//!    tables and the same code as [`scalar`](super::scalar), and join them into runs.

use super::classes::Classes;
use super::demosaic::{at_colored_sites, at_green_sites, rough_colors};
use super::filters::{BlockFilters, RowFilters};
use super::lanes::{Lanes, MAX_LANES, MIN_LANES};
use super::light::RowLight;
use super::planes::{MARGIN, Planes, Ring};
use super::prefilter::Prefilter;
use super::scalar::{Sites, after, before};
use super::second_look_rows;
use super::{RowRuns, RunWriter, Setup, Written};
use crate::ClassTables;
use crate::mask::Span;
use crate::picture::BayerImage;
use fearless_simd::prelude::*;
use messages::Run;
use std::ops::Range;

/// Allocations reused from row to row and frame to frame.
#[derive(Debug, Clone, Default)]
pub struct Scratch {
    ring: Ring,
    noted: Vec<Noted>,
    colors: Colors,
    filters: BlockFilters,
    light: RowLight,
}

/// Red, green and blue of a block's pixels in even and in odd columns.
#[derive(Debug, Clone)]
struct Colors([[[u8; MAX_LANES]; 3]; 2]);

impl Default for Colors {
    fn default() -> Self {
        Self([[[0; MAX_LANES]; 3]; 2])
    }
}

/// A block with pixels that pass the prefilter.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Noted {
    /// Number of the block in its row.
    pub index: usize,
    pub passing: Passing,
}

/// For each of two rows, in even and odd columns: bit i is set if pixel i passes the prefilter.
pub(super) type Passing = [[u64; 2]; 2];

impl Scratch {
    /// Forgets the last picture, and makes room for one of this width.
    fn fit(&mut self, width: usize) {
        self.ring.fit(width);
        self.filters.begin();
        self.light.begin(width);
        let blocks = width.div_ceil(2 * MIN_LANES);
        if self.noted.len() < blocks {
            self.noted.resize(blocks, Noted::default());
        }
    }
}

/// Classifies a Bayer picture, with the result of [`scalar::classify`](super::scalar::classify).
#[inline(always)]
pub fn classify<S: Lanes>(
    simd: S,
    image: &BayerImage,
    setup: Setup,
    scratch: &mut Scratch,
    out: &mut [Run],
) -> Written {
    let mut runs = RunWriter::new(out);
    let (width, height) = (image.width(), image.height());
    let Setup { zoned, prefilters, mask, .. } = setup;
    let block = 2 * S::u8s::LEN;
    let has_looks = zoned.colors.has_second_looks();
    scratch.fit(width);
    let Scratch { ring, noted, colors, filters, light } = scratch;
    for upper in (0..height).step_by(2) {
        // The last row may have no partner; results for the row below it are ignored.
        let lower = after(upper, height);
        let is_pair = upper + 1 < height;
        let spans = [mask.spans(upper), if is_pair { mask.spans(lower) } else { &[] }];
        let around = match (Span::hull(spans[0]), Span::hull(spans[1])) {
            (Some(upper), Some(lower)) => upper.hull_with(lower),
            (Some(only), None) | (None, Some(only)) => only,
            (None, None) => continue,
        };
        let numbers = [before(upper), upper, lower, after(lower, height)];
        for row in numbers {
            ring.hold(simd, image, row);
        }
        let [row0, row1, row2, row3] = numbers;
        let rows = [ring.row(row0), ring.row(row1), ring.row(row2), ring.row(row3)];
        let blocks = around.begin / block..around.end.div_ceil(block);
        let filters = filters.of_row(prefilters, zoned.zones, upper, width.div_ceil(block), block);
        let sites = [Sites::of(image, upper), Sites::of(image, lower)];
        let pair = Pair { rows, has_red: sites[0].has_red };
        let count = match sites[0].colored_parity {
            0 => find_outlined::<S, 0>(simd, &pair, blocks, filters, noted),
            _ => find_outlined::<S, 1>(simd, &pair, blocks, filters, noted),
        };
        if count == 0 {
            continue;
        }
        // Where a row is in one zone, boxes are tested with that zone's tables.
        let zone = filters.only_zone();
        let light = if has_looks || zone.is_none() { light.of_row(zoned, upper) } else { None };
        let tables = zone.map_or(zoned.colors, |zone| &zoned.tables[zone]);
        for (index, spans) in spans.into_iter().enumerate() {
            let rows = [rows[index], rows[index + 1], rows[index + 2]];
            let has_red = sites[index].has_red;
            let part = Row { rows, has_red, spans, width, setup, light, tables };
            let mut row_runs = RowRuns::new(&mut runs, upper + index);
            let noted = &noted[..count];
            let (parity, runs) = (sites[index].colored_parity, &mut row_runs);
            match (has_looks, parity) {
                (false, 0) => {
                    classify_row_outlined::<S, 0>(simd, &part, noted, index, colors, runs)
                }
                (false, _) => {
                    classify_row_outlined::<S, 1>(simd, &part, noted, index, colors, runs)
                }
                (true, 0) => {
                    second_look_rows::classify_outlined::<S, 0>(simd, &part, noted, index, runs)
                }
                (true, _) => {
                    second_look_rows::classify_outlined::<S, 1>(simd, &part, noted, index, runs)
                }
            }
            row_runs.finish();
        }
        if runs.is_cut_off {
            break;
        }
    }
    runs.written()
}

/// A pair of rows with its neighbours, for step 1.
#[derive(Clone, Copy)]
struct Pair<'a> {
    /// The row above the pair, the pair, and the row below.
    rows: [Planes<'a>; 4],
    /// The upper row has red and green sites; otherwise blue and green ones.
    has_red: bool,
}

/// Step 1 for two rows: notes blocks and returns their number. `P` is the column parity of the upper row's
/// coloured sites. Not inlined, so that it has all registers to itself.
#[inline(never)]
fn find_outlined<S: Lanes, const P: usize>(
    simd: S,
    pair: &Pair,
    blocks: Range<usize>,
    filters: RowFilters,
    noted: &mut [Noted],
) -> usize {
    simd.vectorize(
        #[inline(always)]
        || find::<S, P>(simd, pair, blocks, filters, noted),
    )
}

/// Notes the blocks in which a pixel passes the block's prefilter.
#[inline(always)]
fn find<S: Lanes, const P: usize>(
    simd: S,
    pair: &Pair,
    blocks: Range<usize>,
    filters: RowFilters,
    noted: &mut [Noted],
) -> usize {
    let lanes = S::u8s::LEN;
    // Equal lengths spare a bounds check at each access.
    let (first, pixels) = (MARGIN + blocks.start * lanes - 1, blocks.len() * lanes);
    let rows = within(pair.rows, first, pixels);
    let mut count = 0;
    let mut begin = 0;
    for index in blocks {
        if begin + lanes > pixels {
            break;
        }
        let colors = rough_colors::<S, P>(simd, within(rows, begin, lanes));
        let passing = passing_of_rows(simd, colors, pair.has_red, &filters.of_block(index).rgb);
        noted[count] = Noted { index, passing };
        count += usize::from(is_any(passing));
        begin += lanes;
    }
    count
}

/// For each row, in even and odd columns, a bit for each pixel that passes the prefilter.
#[inline(always)]
fn passing_of_rows<S: Lanes>(
    simd: S,
    [[upper_even, upper_odd], [lower_even, lower_odd]]: [[[S::u8s; 3]; 2]; 2],
    has_red: bool,
    Prefilter([red, green, blue]): &Prefilter,
) -> Passing {
    let (own, other) = if has_red { (red, blue) } else { (blue, red) };
    let (own, green, other) = (simd.table(own), simd.table(green), simd.table(other));
    let upper_even = simd.passing(upper_even, [own, green, other]);
    let upper_odd = simd.passing(upper_odd, [own, green, other]);
    // A red site in one row has a blue site's column in the other.
    let lower_even = simd.passing(lower_even, [other, green, own]);
    let lower_odd = simd.passing(lower_odd, [other, green, own]);
    [[upper_even, upper_odd], [lower_even, lower_odd]]
}

#[inline(always)]
fn is_any([[a, b], [c, d]]: Passing) -> bool {
    a | b | c | d != 0
}

/// A range of each plane of four rows, and one more pixel before and behind it.
#[inline(always)]
fn within(rows: [Planes; 4], begin: usize, pixels: usize) -> [Planes; 4] {
    let [row0, row1, row2, row3] = rows;
    let part = begin..begin + pixels + 2;
    [
        [&row0[0][part.clone()], &row0[1][part.clone()]],
        [&row1[0][part.clone()], &row1[1][part.clone()]],
        [&row2[0][part.clone()], &row2[1][part.clone()]],
        [&row3[0][part.clone()], &row3[1][part]],
    ]
}

/// A row with its neighbours, for step 2.
#[derive(Clone, Copy)]
pub(super) struct Row<'a> {
    /// The row above, the row, and the row below.
    pub rows: [Planes<'a>; 3],
    /// The row has red and green sites; otherwise blue and green ones.
    pub has_red: bool,
    /// Columns to classify.
    pub spans: &'a [Span],
    pub width: usize,
    pub setup: Setup<'a>,
    /// Corrects pixels before they are tested.
    pub light: Option<&'a RowLight>,
    /// Boxes; for corrected pixels where `light` is set.
    tables: &'a ClassTables,
}

/// [`classify_row`], not inlined, so that it has all registers to itself.
#[inline(never)]
fn classify_row_outlined<S: Lanes, const P: usize>(
    simd: S,
    row: &Row,
    noted: &[Noted],
    index: usize,
    colors: &mut Colors,
    runs: &mut RowRuns,
) {
    simd.vectorize(
        #[inline(always)]
        || classify_row::<S, P>(simd, row, noted, index, colors, runs),
    );
}

/// Step 2 for one row of the pair: classifies the noted blocks that have passing pixels in it. `P` is the
/// column parity of the row's coloured sites.
#[inline(always)]
fn classify_row<S: Lanes, const P: usize>(
    simd: S,
    row: &Row,
    noted: &[Noted],
    index: usize,
    colors: &mut Colors,
    runs: &mut RowRuns,
) {
    let lanes = S::u8s::LEN;
    for noted in noted {
        let mut passing = noted.passing[index];
        if passing == [0; 2] {
            continue;
        }
        let start = 2 * lanes * noted.index;
        let block = Span { begin: start, end: row.width.min(start + 2 * lanes) };
        let [mut even, mut odd] = exact_colors::<S, P>(simd, row, noted.index);
        if let Some(light) = row.light {
            let light = light.load(simd, lanes * noted.index);
            (even, odd) = (light.corrected(simd, even), light.corrected(simd, odd));
            // Drops pixels that passed only because another zone's prefilter let them: half of them where
            // light is twice as strong on one side.
            let Prefilter([red, green, blue]) = &row.setup.second_looks.boxes.rgb;
            let tables = [simd.table(red), simd.table(green), simd.table(blue)];
            passing[0] &= simd.passing(even, tables);
            passing[1] &= simd.passing(odd, tables);
            if passing == [0; 2] {
                continue;
            }
        }
        for channel in 0..3 {
            even[channel].store_slice(&mut colors.0[0][channel][..lanes]);
            odd[channel].store_slice(&mut colors.0[1][channel][..lanes]);
        }
        let mut classes = Classes::new();
        for span in row.spans {
            row.classify(colors, passing, start, span.within(block), &mut classes);
        }
        classes.append_to_row(simd, start, block.end - start, runs);
    }
}

/// Red, green and blue of a block's pixels in even and in odd columns; `index` is the block's number.
#[inline(always)]
pub(super) fn exact_colors<S: Lanes, const P: usize>(
    simd: S,
    row: &Row,
    index: usize,
) -> [[S::u8s; 3]; 2] {
    let at = MARGIN + S::u8s::LEN * index;
    let colored = rgb::<S>(at_colored_sites(simd, row.rows, P, at), row.has_red);
    let green = rgb::<S>(at_green_sites(simd, row.rows, 1 - P, at), row.has_red);
    if P == 0 { [colored, green] } else { [green, colored] }
}

/// Swaps a row's own colour and the other one into the order red, green, blue.
#[inline(always)]
fn rgb<S: Lanes>([own, green, other]: [S::u8s; 3], has_red: bool) -> [S::u8s; 3] {
    if has_red { [own, green, other] } else { [other, green, own] }
}

impl Row<'_> {
    /// Classifies the pixels of a block that pass and are in a span.
    #[inline(always)]
    fn classify(
        &self,
        Colors(colors): &Colors,
        passing: [u64; 2],
        start: usize,
        span: Span,
        classes: &mut Classes,
    ) {
        for parity in 0..2 {
            let mut pixels = passing[parity] & every_other(span, start, parity);
            while pixels != 0 {
                let lane = pixels.trailing_zeros() as usize % MAX_LANES;
                pixels &= pixels - 1;
                let [red, green, blue] = &colors[parity];
                let class = self.tables.classify([red[lane], green[lane], blue[lane]]);
                classes.set(2 * lane + parity, class);
            }
        }
    }
}

/// Bit i is set for each column `start + 2 i + parity` that is in the span; the span lies in the block that
/// begins in column `start`.
#[inline(always)]
pub(super) fn every_other(span: Span, start: usize, parity: usize) -> u64 {
    let index = |column: usize| (column.saturating_sub(start) + 1 - parity) / 2;
    let (begin, end) = (index(span.begin), index(span.end));
    debug_assert!(span.end <= start + 2 * MAX_LANES);
    if begin < end { !0 >> (64 - (end - begin)) << begin } else { 0 }
}
