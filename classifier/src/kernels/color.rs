//! The vector kernel for RGB and YUV pictures, whose pixels have all three channels.

use super::classes::Classes;
use super::filters::BlockFilters;
use super::lanes::{Lanes, MAX_LANES};
use super::light::Light;
use super::prefilter::Prefilter;
use super::second_look::{self, SecondLookClassifier};
use super::{ROWS_AHEAD, RowRuns, RunWriter, Setup, Written};
use crate::mask::Span;
use crate::picture::{ColorImage, ColorRow};
use crate::yuv::rgb_from_yuv;
use fearless_simd::prelude::*;
use messages::Run;
use runtime::prefetch::prefetch;

/// Allocations reused from row to row and frame to frame.
#[derive(Debug, Clone, Default)]
pub struct Scratch {
    /// A row's three channels, and the same converted to RGB.
    channels: [Vec<u8>; 6],
    filters: BlockFilters,
}

impl Scratch {
    /// Forgets the last picture, and makes room for one of this width: for whole blocks, and for pixels in
    /// pairs.
    fn fit(&mut self, width: usize) {
        self.filters.begin();
        for channel in &mut self.channels {
            channel.resize(width.next_multiple_of(MAX_LANES), 0);
        }
    }
}

/// Classifies an RGB or YUV picture, with the result of [`scalar::classify`](super::scalar::classify).
#[inline(always)]
pub fn classify<S: Lanes>(
    simd: S,
    image: &ColorImage,
    setup: Setup,
    scratch: &mut Scratch,
    out: &mut [Run],
) -> Written {
    let Setup { zoned, prefilters, mask, .. } = setup;
    let lanes = S::u8s::LEN;
    let mut runs = RunWriter::new(out);
    let is_yuv = image.is_yuv();
    let has_rgb_boxes = is_yuv && zoned.colors.has_colors_without_yuv();
    let has_looks = is_yuv && zoned.colors.has_second_looks();
    let second_looks = SecondLookClassifier::new(setup);
    scratch.fit(image.width());
    let Scratch { channels: [a, b, c, red, green, blue], filters } = scratch;
    for row in 0..image.height() {
        let spans = mask.spans(row);
        let Some(around) = Span::hull(spans) else { continue };
        if row + ROWS_AHEAD < image.height() {
            image.row(row + ROWS_AHEAD).parts().into_iter().for_each(prefetch);
        }
        separate(simd, image.row(row), [a, b, c]);
        if has_rgb_boxes || has_looks {
            convert(simd, [a, b, c], [red, green, blue]);
        }
        let blocks = around.begin / lanes..around.end.div_ceil(lanes);
        let filters =
            filters.of_row(prefilters, zoned.zones, row, image.width().div_ceil(lanes), lanes);
        let mut row_runs = RowRuns::new(&mut runs, row);
        for index in blocks {
            let filters = filters.of_block(index);
            let start = index * lanes;
            let pixels = match is_yuv {
                false => passing_at(simd, [a, b, c], start, &filters.rgb),
                true if has_rgb_boxes => {
                    passing_at(simd, [a, b, c], start, &filters.yuv)
                        | passing_at(simd, [red, green, blue], start, &filters.rgb)
                }
                true => passing_at(simd, [a, b, c], start, &filters.yuv),
            };
            if pixels == 0 {
                continue;
            }
            let block = Span { begin: start, end: image.width().min(start + lanes) };
            let mut classes = Classes::new();
            for span in spans {
                for (span, zone) in zoned.zones.divide(row, span.within(block)) {
                    let tables = &zoned.tables[zone];
                    let mut pixels = pixels & span.bits(start, lanes);
                    if pixels != 0 && tables.has_second_looks() {
                        if !is_yuv {
                            let light = Light::everywhere(simd, tables.correction());
                            let rgb = light.corrected(simd, load(simd, [a, b, c], start));
                            if let Some(found) = second_looks.classify(simd, rgb, pixels) {
                                classes.set_all(simd, 0, found);
                            }
                            continue;
                        }
                        let own_and_rgb = [[&*a, &*b, &*c], [&*red, &*green, &*blue]];
                        pixels &= passing_looks_yuv(simd, own_and_rgb, start, zone, setup);
                    }
                    while pixels != 0 {
                        let lane = pixels.trailing_zeros() as usize % MAX_LANES;
                        let color = [&a, &b, &c].map(|channel| channel[start + lane]);
                        let class = if is_yuv {
                            tables.classify_yuv(color)
                        } else {
                            tables.classify(color)
                        };
                        classes.set(lane, class);
                        pixels &= pixels - 1;
                    }
                }
            }
            classes.append_to_row(simd, start, block.end - start, &mut row_runs);
        }
        row_runs.finish();
        if runs.is_cut_off {
            break;
        }
    }
    runs.written()
}

/// A bit for each pixel that passes the prefilter, in a block that begins in column `start`.
#[inline(always)]
fn passing_at<S: Lanes>(
    simd: S,
    channels: [&Vec<u8>; 3],
    start: usize,
    prefilter: &Prefilter,
) -> u64 {
    simd.any_bucket(buckets(simd, load(simd, channels, start), prefilter))
}

/// A bit for each pixel of a YUV picture that passes the prefilter and that the zone's second looks may
/// admit, from its channels and those in RGB.
#[inline(always)]
fn passing_looks_yuv<S: Lanes>(
    simd: S,
    [yuv, rgb]: [[&Vec<u8>; 3]; 2],
    start: usize,
    zone: usize,
    setup: Setup,
) -> u64 {
    let (yuv, rgb) = (load(simd, yuv, start), load(simd, rgb, start));
    let light = Light::everywhere(simd, setup.zoned.tables[zone].correction());
    let keys = second_look::keys(simd, light.corrected(simd, rgb));
    let (prefilters, second_looks) = (&setup.prefilters[zone], setup.second_looks);
    let in_yuv = buckets(simd, yuv, &prefilters.yuv) & second_looks.yuv.admitting(simd, keys);
    let in_rgb = buckets(simd, rgb, &prefilters.rgb) & second_looks.rgb.admitting(simd, keys);
    simd.any_bucket(in_yuv) | simd.any_bucket(in_rgb)
}

/// A register full of each channel, from column `start`.
#[inline(always)]
fn load<S: Lanes>(simd: S, channels: [&Vec<u8>; 3], start: usize) -> [S::u8s; 3] {
    let block = start..start + S::u8s::LEN;
    let [a, b, c] = channels;
    [
        S::u8s::from_slice(simd, &a[block.clone()]),
        S::u8s::from_slice(simd, &b[block.clone()]),
        S::u8s::from_slice(simd, &c[block]),
    ]
}

/// The buckets for which a prefilter passes pixels.
#[inline(always)]
fn buckets<S: Lanes>(simd: S, values: [S::u8s; 3], Prefilter(filter): &Prefilter) -> S::u8s {
    let [first, second, third] = filter;
    simd.buckets(values, [simd.table(first), simd.table(second), simd.table(third)])
}

/// Converts a row of YUV pixels to RGB.
#[inline(always)]
fn convert<S: Lanes>(_: S, yuv: [&Vec<u8>; 3], rgb: [&mut Vec<u8>; 3]) {
    let ([ys, us, vs], [reds, greens, blues]) = (yuv, rgb);
    let yuv = ys.iter().zip(us).zip(vs);
    for (((&y, &u), &v), ((red, green), blue)) in yuv.zip(reds.iter_mut().zip(greens).zip(blues)) {
        [*red, *green, *blue] = rgb_from_yuv([y, u, v]);
    }
}

/// Separates a row into its three channels, with plain loops that the compiler turns into shuffles.
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

/// Separates pixels that come in pairs of four bytes, which `sorted` puts in the order Y, Y, U, V.
#[inline(always)]
fn separate_pairs(row: &[u8], channels: [&mut Vec<u8>; 3], sorted: impl Fn([u8; 4]) -> [u8; 4]) {
    let [ys, us, vs] = channels.map(|channel| channel.as_chunks_mut::<2>().0);
    for (((y, u), v), &pair) in ys.iter_mut().zip(us).zip(vs).zip(row.as_chunks::<4>().0) {
        let [first_y, second_y, both_u, both_v] = sorted(pair);
        (*y, *u, *v) = ([first_y, second_y], [both_u; 2], [both_v; 2]);
    }
}
