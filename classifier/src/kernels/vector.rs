//! The fast kernels, for every instruction set that [`Lanes`] is implemented for.
//!
//! They go over the rows in two steps.
//!
//! 1. Whole rows, a register full of pixels at a time: demosaic roughly, look up in the
//!    [prefilter](super::prefilter), and note the blocks where something may be, with a bit for each
//!    pixel. Nothing but these notes is written, and no branch depends on the picture.
//! 2. The noted blocks: demosaic exactly, classify the pixels whose bit is set with the same tables
//!    and the same code as [`scalar`](super::scalar), and find where the class changes by comparing
//!    the block's classes with themselves, shifted by one. From change to change is a run.

use super::Prefilters;
use super::demosaic::{ColoredLanes, colors, rough_colors};
use super::lanes::Lanes;
use super::prefilter::Prefilter;
use super::scalar::{Sites, ThreeRows, after, before};
use super::{RowRuns, RunWriter, Written};
use crate::mask::{FieldMask, Span};
use crate::picture::{BayerImage, ColorImage, ColorRow, narrowed};
use crate::yuv::rgb_from_yuv;
use crate::zones::ZonedTables;
use crate::{BACKGROUND, ClassTables};
use common::messages::Run;
use common::prefetch::prefetch;
use fearless_simd::prelude::*;

/// Widest register.
const MAX_LANES: usize = 64;

/// Narrowest register.
const MIN_LANES: usize = 16;

/// So many rows before they are needed, rows are asked for: far enough for them to come, and not so
/// many that the first are gone again.
const ROWS_AHEAD: usize = 4;

/// Memory that a kernel reuses from row to row and frame to frame.
#[derive(Debug, Clone, Default)]
pub struct Scratch {
    noted: Vec<Noted>,
    parts: Vec<Part>,
    /// Rows as bytes: the last four of a deep Bayer picture, or the channels of a colour one.
    rows: [Vec<u8>; 6],
}

/// A block in which something may be.
#[derive(Debug, Clone, Copy, Default)]
struct Noted {
    /// Its first column.
    start: usize,
    /// Bit i: column `start + i` has passed the prefilter; of one row or two.
    pixels: [u64; 2],
}

/// A part of one row, and what is needed to classify it.
#[derive(Clone, Copy)]
struct RowPart<'a> {
    /// Those of the whole row that are to be looked at.
    spans: &'a [Span],
    span: Span,
    tables: &'a ClassTables,
    noted: &'a [Noted],
    /// Which of the two rows it is in.
    index: usize,
}

/// A part of two rows that is in one zone.
#[derive(Debug, Clone, Copy)]
struct Part {
    span: Span,
    zone: usize,
    /// Where its noted blocks end in the list; they begin where those of the part before end.
    noted_end: usize,
}

impl Scratch {
    /// Makes room to note every block of a row of `width` pixels that is in so many parts at most.
    pub fn fit(&mut self, width: usize, parts: usize) {
        let blocks = width.div_ceil(MIN_LANES) + 2 * parts;
        if self.noted.len() < blocks {
            self.noted.resize(blocks, Noted::default());
        }
        self.parts.clear();
        self.parts.reserve(parts);
    }

    /// Row buffers with room for whole blocks, and for pixels in pairs.
    fn reserve_rows(&mut self, width: usize) {
        for row in &mut self.rows {
            row.resize(width.next_multiple_of(MAX_LANES), 0);
        }
    }
}

/// What the fast kernels work with besides the picture.
#[derive(Clone, Copy)]
pub struct Setup<'a> {
    /// Decide in the end.
    pub zoned: ZonedTables<'a>,
    /// By zone.
    pub prefilters: &'a [Prefilters],
    /// The pixels to look at.
    pub mask: &'a FieldMask,
}

/// As [`scalar::classify`](super::scalar::classify) of a Bayer picture.
#[inline(always)]
pub fn classify_bayer<S: Lanes>(
    simd: S,
    image: &BayerImage,
    setup: Setup,
    scratch: &mut Scratch,
    out: &mut [Run],
) -> Written {
    let mut runs = RunWriter::new(out);
    let (width, height) = (image.width(), image.height());
    let Setup { zoned, prefilters, mask } = setup;
    let mut filters = loaded(simd, &prefilters[0].rgb);
    let mut loaded_zone = 0;
    if image.shift().is_some() {
        scratch.reserve_rows(width);
    }
    let Scratch { noted, parts, rows: narrow } = scratch;
    // Which row of the picture is in each of the buffers.
    let mut held = [usize::MAX; 4];
    for upper in (0..height).step_by(2) {
        // The last row may be alone; then what is found in the one below it does not count.
        let lower = after(upper, height);
        let is_pair = upper + 1 < height;
        let spans = [mask.spans(upper), if is_pair { mask.spans(lower) } else { &[] }];
        let Some(around) = Span::around(spans.into_iter().flatten().copied()) else { continue };
        for next in [upper + ROWS_AHEAD, lower + ROWS_AHEAD] {
            if next < height {
                prefetch(image.row(next));
            }
        }
        let numbers = [before(upper), upper, lower, after(lower, height)];
        let rows = match image.shift() {
            None => numbers.map(|row| image.row(row)),
            Some(shift) => {
                for row in numbers {
                    if held[row % 4] != row {
                        narrow_row(simd, image.row(row), shift, &mut narrow[row % 4]);
                        held[row % 4] = row;
                    }
                }
                numbers.map(|row| &narrow[row % 4][..width])
            }
        };
        let sites = Sites::of(image, upper);
        parts.clear();
        let mut noted_end = 0;
        for (span, zone) in zoned.zones.divide(upper, around) {
            if zone != loaded_zone {
                filters = loaded(simd, &prefilters[zone].rgb);
                loaded_zone = zone;
            }
            let [red, green, blue] = filters;
            let filters = if sites.has_red { [red, green, blue] } else { [blue, green, red] };
            noted_end += find_apart(simd, rows, sites, span, &filters, &mut noted[noted_end..]);
            parts.push(Part { span, zone, noted_end });
        }
        for (index, spans) in spans.into_iter().enumerate() {
            let row = upper + index;
            let [above, here, below] = [rows[index], rows[index + 1], rows[index + 2]];
            let sites = Sites::of(image, row);
            let three = ThreeRows { above, here, below, sites };
            let mut row_runs = RowRuns::new(&mut runs, row);
            let mut noted_begin = 0;
            for &Part { span, zone, noted_end } in parts.iter() {
                let tables = &zoned.tables[zone];
                let noted = &noted[noted_begin..noted_end];
                let part = RowPart { spans, span, tables, noted, index };
                classify_row_apart(simd, &three, part, &mut row_runs);
                noted_begin = noted_end;
            }
            row_runs.finish();
        }
        if runs.is_cut_off {
            break;
        }
    }
    runs.written()
}

/// The prefilter in registers.
#[inline(always)]
fn loaded<S: Lanes>(simd: S, prefilter: &Prefilter) -> [S::Table; 3] {
    let [first, second, third] = &prefilter.0;
    [simd.table(first), simd.table(second), simd.table(third)]
}

/// One row of a deep picture as bytes.
#[inline(always)]
fn narrow_row<S: Lanes>(_: S, row: &[u8], shift: u32, out: &mut [u8]) {
    for (byte, &[low, high]) in out.iter_mut().zip(row.as_chunks::<2>().0) {
        *byte = narrowed(low, high, shift);
    }
}

/// [`find`] as a function of its own, which has all registers for itself.
#[inline(never)]
fn find_apart<S: Lanes>(
    simd: S,
    rows: [&[u8]; 4],
    sites: Sites,
    span: Span,
    filters: &[S::Table; 3],
    noted: &mut [Noted],
) -> usize {
    simd.vectorize(
        #[inline(always)]
        || find(simd, rows, sites, span, *filters, noted),
    )
}

/// Step 1 for two rows: notes blocks, returns how many. The sites are the upper row's, the filters
/// in the order of its colours.
#[inline(always)]
fn find<S: Lanes>(
    simd: S,
    rows: [&[u8]; 4],
    sites: Sites,
    span: Span,
    filters: [S::Table; 3],
    noted: &mut [Noted],
) -> usize {
    let lanes = S::u8s::LEN;
    let width = rows[1].len();
    // The first and the last pixel lack a neighbour.
    let (begin, end) = (span.begin.max(1), span.end.min(width - 1));
    if width < lanes + 2 || begin >= end {
        return 0;
    }
    let mut count = 0;
    let at_colored = ColoredLanes::new(simd, sites, begin);
    // All of the same length, which spares a check at each access.
    let [row0, row1, row2, row3] = rows.map(|row| &row[begin - 1..width]);
    let mut done = 0;
    while begin + done < end && done + lanes + 2 <= row0.len() {
        let block = done..done + lanes + 2;
        let rows = [&row0[block.clone()], &row1[block.clone()], &row2[block.clone()], &row3[block]];
        let pixels = passing_of_two_rows(simd, rows, at_colored, filters);
        noted[count] = Noted { start: begin + done, pixels };
        count += usize::from(pixels[0] | pixels[1] != 0);
        done += lanes;
    }
    if begin + done < end {
        // The last block ends where the row does, and overlaps the one before.
        let start = width - 1 - lanes;
        let overlap = begin + done - start;
        let at_colored = ColoredLanes::new(simd, sites, start);
        let rows = rows.map(|row| &row[start - 1..]);
        let [upper, lower] = passing_of_two_rows(simd, rows, at_colored, filters);
        let pixels = [upper & (!0 << overlap), lower & (!0 << overlap)];
        noted[count] = Noted { start, pixels };
        count += usize::from(pixels[0] | pixels[1] != 0);
    }
    count
}

/// A bit for each pixel that passes the prefilter, of a block in two rows.
#[inline(always)]
fn passing_of_two_rows<S: Lanes>(
    simd: S,
    rows: [&[u8]; 4],
    at_colored: ColoredLanes<S>,
    filters: [S::Table; 3],
) -> [u64; 2] {
    let [upper, lower] = rough_colors(simd, rows, at_colored);
    // What is red in one row is blue in the other.
    let lower = [lower[2], lower[1], lower[0]];
    [passing(simd, upper, filters), passing(simd, lower, filters)]
}

/// A bit for each pixel that passes the prefilter.
#[inline(always)]
fn passing<S: Lanes>(simd: S, colors: [S::u8s; 3], filters: [S::Table; 3]) -> u64 {
    let [a, b, c] = colors;
    let buckets =
        simd.look_up(filters[0], a) & simd.look_up(filters[1], b) & simd.look_up(filters[2], c);
    !buckets.simd_eq(0).to_bitmask() & (!0 >> (64 - S::u8s::LEN))
}

/// A bit for each pixel that passes the prefilter, of a block that begins in column `start`.
#[inline(always)]
fn passing_at<S: Lanes>(
    simd: S,
    [a, b, c]: [&Vec<u8>; 3],
    start: usize,
    filters: [S::Table; 3],
) -> u64 {
    let block = start..start + S::u8s::LEN;
    let a = S::u8s::from_slice(simd, &a[block.clone()]);
    let b = S::u8s::from_slice(simd, &b[block.clone()]);
    let c = S::u8s::from_slice(simd, &c[block]);
    passing(simd, [a, b, c], filters)
}

/// [`classify_row`] as a function of its own, which has all registers for itself.
#[inline(never)]
fn classify_row_apart<S: Lanes>(
    simd: S,
    rows: &ThreeRows<&[u8]>,
    part: RowPart,
    runs: &mut RowRuns,
) {
    simd.vectorize(
        #[inline(always)]
        || classify_row(simd, rows, part, runs),
    );
}

/// Step 2 for a part of one row: its blocks among those noted, and what step 1 has left out: the first
/// and the last pixel, or all of a row too short for blocks.
#[inline(always)]
fn classify_row<S: Lanes>(simd: S, rows: &ThreeRows<&[u8]>, part: RowPart, runs: &mut RowRuns) {
    let RowPart { spans, span: part, tables, noted, index } = part;
    let (Some(first_span), Some(last_span)) = (spans.first(), spans.last()) else { return };
    let lanes = S::u8s::LEN;
    let width = rows.here.len();
    let one_by_one = |span: Span, runs: &mut RowRuns| {
        for column in span.begin..span.end {
            runs.add(column, tables.classify(rows.pixel(column)));
        }
    };
    if width < lanes + 2 {
        spans.iter().for_each(|span| one_by_one(span.within(part), runs));
        return;
    }
    if first_span.begin == 0 && part.begin == 0 {
        one_by_one(Span { begin: 0, end: 1 }, runs);
    }
    let mut bytes = [[0; MAX_LANES]; 3];
    for noted in noted {
        let Some(pixels) = noted.pixels_within(spans, part, index, lanes) else { continue };
        let from = noted.start - 1;
        let at_colored = ColoredLanes::new(simd, rows.sites, noted.start);
        let three = [&rows.above[from..], &rows.here[from..], &rows.below[from..]];
        let colors = colors(simd, three, at_colored);
        let [own, green, other] = &mut bytes;
        colors[0].store_slice(&mut own[..lanes]);
        colors[1].store_slice(&mut green[..lanes]);
        colors[2].store_slice(&mut other[..lanes]);
        let (red, blue) = if rows.sites.has_red { (own, other) } else { (other, own) };
        noted.classify(simd, pixels, part.end, runs, |lane| {
            tables.classify([red[lane], green[lane], blue[lane]])
        });
    }
    if last_span.end == width && part.end == width {
        one_by_one(Span { begin: width - 1, end: width }, runs);
    }
}

impl Noted {
    /// The pixels to classify in one of the rows; `None` if there are none.
    #[inline(always)]
    fn pixels_within(&self, spans: &[Span], part: Span, index: usize, lanes: usize) -> Option<u64> {
        let pixels = self.pixels[index] & part.bits(self.start, lanes);
        if pixels == 0 {
            return None;
        }
        let bits = spans.iter().fold(0, |bits, span| bits | span.bits(self.start, lanes));
        (pixels & bits != 0).then_some(pixels & bits)
    }

    /// Classifies pixels of the block and hands them in, up to column `end`.
    #[inline(always)]
    fn classify<S: Lanes>(
        &self,
        simd: S,
        mut pixels: u64,
        end: usize,
        runs: &mut RowRuns,
        class_of: impl Fn(usize) -> u8,
    ) {
        let lanes = S::u8s::LEN;
        // The last block of a row may begin within the one before.
        let overlap = runs.reached.saturating_sub(self.start);
        runs.skip_to(self.start + overlap);
        // One place before the block: the class of the pixel before.
        let mut classes = [BACKGROUND; MAX_LANES + 1];
        classes[overlap] = runs.class;
        while pixels != 0 {
            let lane = pixels.trailing_zeros() as usize % MAX_LANES;
            classes[lane + 1] = class_of(lane);
            pixels &= pixels - 1;
        }
        let before = S::u8s::from_slice(simd, &classes[..lanes]);
        let here = S::u8s::from_slice(simd, &classes[1..lanes + 1]);
        let mut changes = !here.simd_eq(before).to_bitmask();
        let count = lanes.min(end - self.start);
        changes &= (!0 >> (64 - count)) & (!0 << overlap);
        while changes != 0 {
            let lane = changes.trailing_zeros() as usize % MAX_LANES;
            runs.change(self.start + lane, classes[lane + 1]);
            changes &= changes - 1;
        }
        runs.reached = self.start + count;
    }
}

/// As [`scalar::classify`](super::scalar::classify) of a picture in RGB or YUV.
#[inline(always)]
pub fn classify_color<S: Lanes>(
    simd: S,
    image: &ColorImage,
    setup: Setup,
    scratch: &mut Scratch,
    out: &mut [Run],
) -> Written {
    let Setup { zoned, prefilters, mask } = setup;
    let lanes = S::u8s::LEN;
    let mut runs = RunWriter::new(out);
    let mut filters = [&prefilters[0].rgb, &prefilters[0].yuv].map(|filter| loaded(simd, filter));
    let mut loaded_zone = 0;
    // All zones have the same colours.
    let (is_yuv, needs_rgb) = (image.is_yuv(), zoned.tables[0].needs_rgb());
    scratch.reserve_rows(image.width());
    let Scratch { noted, rows: [a, b, c, red, green, blue], .. } = scratch;
    for row in 0..image.height() {
        let spans = mask.spans(row);
        let Some(around) = Span::around(spans.iter().copied()) else { continue };
        if row + ROWS_AHEAD < image.height() {
            image.row(row + ROWS_AHEAD).parts().into_iter().for_each(prefetch);
        }
        separate(simd, image.row(row), [a, b, c]);
        if is_yuv && needs_rgb {
            convert(simd, [a, b, c], [red, green, blue]);
        }
        let mut row_runs = RowRuns::new(&mut runs, row);
        for (part, zone) in zoned.zones.divide(row, around) {
            if zone != loaded_zone {
                let Prefilters { rgb, yuv, .. } = &prefilters[zone];
                filters = [rgb, yuv].map(|filter| loaded(simd, filter));
                loaded_zone = zone;
            }
            let [rgb_filters, yuv_filters] = filters;
            let tables = &zoned.tables[zone];
            let mut count = 0;
            let mut start = part.begin / lanes * lanes;
            while start < part.end {
                let mut pixels = 0;
                if is_yuv {
                    pixels |= passing_at(simd, [a, b, c], start, yuv_filters);
                    if needs_rgb {
                        pixels |= passing_at(simd, [red, green, blue], start, rgb_filters);
                    }
                } else {
                    pixels |= passing_at(simd, [a, b, c], start, rgb_filters);
                }
                noted[count] = Noted { start, pixels: [pixels, 0] };
                count += usize::from(pixels != 0);
                start += lanes;
            }
            for noted in &noted[..count] {
                let Some(pixels) = noted.pixels_within(spans, part, 0, lanes) else { continue };
                noted.classify(simd, pixels, part.end, &mut row_runs, |lane| {
                    let column = noted.start + lane;
                    let color = [a[column], b[column], c[column]];
                    if is_yuv { tables.classify_yuv(color) } else { tables.classify(color) }
                });
            }
        }
        row_runs.finish();
        if runs.is_cut_off {
            break;
        }
    }
    runs.written()
}

/// A row of YUV pixels in RGB.
#[inline(always)]
fn convert<S: Lanes>(_: S, yuv: [&Vec<u8>; 3], rgb: [&mut Vec<u8>; 3]) {
    let ([ys, us, vs], [reds, greens, blues]) = (yuv, rgb);
    let yuv = ys.iter().zip(us).zip(vs);
    for (((&y, &u), &v), ((red, green), blue)) in yuv.zip(reds.iter_mut().zip(greens).zip(blues)) {
        [*red, *green, *blue] = rgb_from_yuv([y, u, v]);
    }
}

/// A row's three channels, each on its own. Plain loops that the compiler turns into shuffles.
#[inline(always)]
fn separate<S: Lanes>(_: S, row: ColorRow, channels: [&mut Vec<u8>; 3]) {
    let [first, second, third] = channels;
    match row {
        ColorRow::Rgb(row) => {
            let channels = first.iter_mut().zip(second).zip(third);
            for (((red, green), blue), color) in channels.zip(row.as_chunks::<3>().0) {
                [*red, *green, *blue] = *color;
            }
        }
        ColorRow::Yuyv(row) => {
            separate_pairs(row, [first, second, third], |[y, u, next_y, v]| [y, next_y, u, v])
        }
        ColorRow::Uyvy(row) => {
            separate_pairs(row, [first, second, third], |[u, y, v, next_y]| [y, next_y, u, v])
        }
        ColorRow::Nv12(y, uv) => {
            first[..y.len()].copy_from_slice(y);
            let pairs = second.as_chunks_mut::<2>().0.iter_mut().zip(third.as_chunks_mut::<2>().0);
            for ((us, vs), &[u, v]) in pairs.zip(uv.as_chunks::<2>().0) {
                (*us, *vs) = ([u; 2], [v; 2]);
            }
        }
        ColorRow::I420(y, u, v) => {
            first[..y.len()].copy_from_slice(y);
            for (doubled, single) in [(second, u), (third, v)] {
                for (pair, &value) in doubled.as_chunks_mut::<2>().0.iter_mut().zip(single) {
                    *pair = [value; 2];
                }
            }
        }
    }
}

/// Pixels that come in pairs of four bytes, which `sorted` puts in the order Y, Y, U, V.
#[inline(always)]
fn separate_pairs(row: &[u8], channels: [&mut Vec<u8>; 3], sorted: impl Fn([u8; 4]) -> [u8; 4]) {
    let [ys, us, vs] = channels.map(|channel| channel.as_chunks_mut::<2>().0);
    for (((y, u), v), &pair) in ys.iter_mut().zip(us).zip(vs).zip(row.as_chunks::<4>().0) {
        let [first_y, second_y, both_u, both_v] = sorted(pair);
        (*y, *u, *v) = ([first_y, second_y], [both_u; 2], [both_v; 2]);
    }
}
