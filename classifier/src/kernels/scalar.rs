//! The specification of classification: plain code, one pixel after the other.
//!
//! Missing channels of a Bayer pixel are interpolated bilinearly, as means of two or four neighbours (eqs.
//! 1–3 of the paper); the tables of section 4.2 classify the result ([`ClassTables`]); and adjacent pixels of
//! one class in a row are joined into a run.

use super::{RowRuns, RunWriter, Written};
use crate::ClassTables;
use crate::mask::{FieldMask, Span};
use crate::picture::{BayerImage, ColorImage, Picture, narrowed};
use crate::yuv::rgb_from_yuv;
use crate::zones::ZonedTables;
use messages::Run;

/// Lists the runs of a picture, as many as fit into `out`; the rest of `out` is untouched. Pixels outside the
/// mask are background, though their neighbours are interpolated from them. Each pixel is classified with the
/// tables of its zone.
pub fn classify(
    picture: &Picture,
    zoned: ZonedTables,
    mask: &FieldMask,
    out: &mut [Run],
) -> Written {
    let mut runs = RunWriter::new(out);
    for row in 0..picture.height() {
        let mut row_runs = RowRuns::new(&mut runs, row);
        for &span in mask.spans(row) {
            for (span, zone) in zoned.zones.divide(row, span) {
                let tables = &zoned.tables[zone];
                let add = |column, class| row_runs.add(column, class);
                for_each_class(picture, tables, row, span, add);
            }
        }
        row_runs.finish();
        if runs.is_cut_off {
            break;
        }
    }
    runs.written()
}

/// Calls `pixel` with column and class of every pixel of a span, from left to right.
#[inline(always)]
fn for_each_class(
    picture: &Picture,
    tables: &ClassTables,
    row: usize,
    span: Span,
    mut pixel: impl FnMut(usize, u8),
) {
    match picture {
        Picture::Bayer(image) => {
            for_each_pixel(image, row, span, |column, rgb| pixel(column, tables.classify(rgb)));
        }
        Picture::Color(image) => {
            let colors = image.row(row);
            for column in span.begin..span.end {
                let color = colors.pixel(column);
                let class = match image.is_yuv() {
                    true => tables.classify_yuv(color),
                    false => tables.classify(color),
                };
                pixel(column, class);
            }
        }
    }
}

/// Replaces `rgb` by the demosaiced picture, three bytes per pixel, row by row without padding: the colours
/// that the classifier sees, for overlays and for choosing colours.
pub fn demosaic(image: &BayerImage, rgb: &mut Vec<u8>) {
    rgb.clear();
    rgb.reserve(3 * image.width() * image.height());
    let all = Span { begin: 0, end: image.width() };
    for row in 0..image.height() {
        for_each_pixel(image, row, all, |_, pixel| rgb.extend_from_slice(&pixel));
    }
}

/// Replaces `rgb` by the picture in red, green and blue, as [`demosaic`] does, for any format.
pub fn to_rgb(picture: &Picture, rgb: &mut Vec<u8>) {
    match picture {
        Picture::Bayer(image) => demosaic(image, rgb),
        Picture::Color(image) => {
            rgb.clear();
            rgb.reserve(3 * image.width() * image.height());
            for row in 0..image.height() {
                for column in 0..image.width() {
                    rgb.extend_from_slice(&color_at(image, column, row));
                }
            }
        }
    }
}

fn color_at(image: &ColorImage, column: usize, row: usize) -> [u8; 3] {
    let color = image.row(row).pixel(column);
    if image.is_yuv() { rgb_from_yuv(color) } else { color }
}

/// Calls `pixel` with column and interpolated colour of every pixel of a span, from left to right.
#[inline(always)]
fn for_each_pixel(image: &BayerImage, row: usize, span: Span, pixel: impl FnMut(usize, [u8; 3])) {
    match image.shift() {
        None => ThreeRows::around(image, row, |row| row).for_each_pixel(span, pixel),
        Some(shift) => {
            ThreeRows::around(image, row, |row| DeepRow { row, shift }).for_each_pixel(span, pixel)
        }
    }
}

/// The samples of a row, as bytes.
pub(super) trait Samples: Copy {
    /// Number of samples.
    fn count(self) -> usize;
    /// Value of a sample.
    fn at(self, column: usize) -> u8;
}

impl Samples for &[u8] {
    #[inline(always)]
    fn count(self) -> usize {
        self.len()
    }

    #[inline(always)]
    fn at(self, column: usize) -> u8 {
        self[column]
    }
}

/// A row with two bytes per sample.
#[derive(Clone, Copy)]
struct DeepRow<'a> {
    row: &'a [u8],
    shift: u32,
}

impl Samples for DeepRow<'_> {
    #[inline(always)]
    fn count(self) -> usize {
        self.row.len() / 2
    }

    #[inline(always)]
    fn at(self, column: usize) -> u8 {
        narrowed(self.row[2 * column], self.row[2 * column + 1], self.shift)
    }
}

/// A row and its neighbours. Beyond the edges the picture is mirrored without repeating the edge itself (−1 →
/// 1, n → n − 2), which continues the colour pattern.
#[derive(Clone, Copy)]
pub(super) struct ThreeRows<S> {
    pub above: S,
    pub here: S,
    pub below: S,
    pub sites: Sites,
}

/// Position of a row's colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sites {
    /// The row has red and green sites; otherwise blue and green ones.
    pub has_red: bool,
    /// Column parity of the red or blue sites: 0 for even, 1 for odd columns.
    pub colored_parity: usize,
}

impl Sites {
    pub fn of(image: &BayerImage, row: usize) -> Self {
        let (red_column, red_row) = image.order().red_site();
        let has_red = row % 2 == red_row;
        Self { has_red, colored_parity: if has_red { red_column } else { 1 - red_column } }
    }
}

impl<S: Samples> ThreeRows<S> {
    #[inline(always)]
    fn around<'a>(image: &BayerImage<'a>, row: usize, samples: impl Fn(&'a [u8]) -> S) -> Self {
        Self {
            above: samples(image.row(before(row))),
            here: samples(image.row(row)),
            below: samples(image.row(after(row, image.height()))),
            sites: Sites::of(image, row),
        }
    }

    /// The colours of a row alternate between green and one other, so the inner loop takes pairs and needs no
    /// decisions; columns before and behind the pairs are handled one by one.
    #[inline(always)]
    fn for_each_pixel(&self, span: Span, mut pixel: impl FnMut(usize, [u8; 3])) {
        let mut column = span.begin;
        // A pair begins at a coloured site with a neighbour to the left,
        while column < span.end && (column == 0 || column % 2 != self.sites.colored_parity) {
            pixel(column, self.pixel(column));
            column += 1;
        }
        // and ends at a green site with a neighbour to the right.
        while column + 1 < span.end && column + 2 < self.here.count() {
            pixel(column, self.at_colored_site(column - 1, column, column + 1));
            pixel(column + 1, self.at_green_site(column, column + 1, column + 2));
            column += 2;
        }
        for column in column..span.end {
            pixel(column, self.pixel(column));
        }
    }

    /// The colour of any pixel of the row.
    #[inline(always)]
    pub fn pixel(&self, column: usize) -> [u8; 3] {
        let (left, right) = (before(column), after(column, self.here.count()));
        if column % 2 == self.sites.colored_parity {
            self.at_colored_site(left, column, right)
        } else {
            self.at_green_site(left, column, right)
        }
    }

    /// At a site of red or blue: green is the mean of the four direct neighbours (eq. 1), the other colour
    /// the mean of the four diagonal ones (eq. 3).
    #[inline(always)]
    fn at_colored_site(&self, left: usize, column: usize, right: usize) -> [u8; 3] {
        let Self { above, here, below, .. } = self;
        let green = mean4(above.at(column), here.at(left), here.at(right), below.at(column));
        let other = mean4(above.at(left), above.at(right), below.at(left), below.at(right));
        self.rgb(here.at(column), green, other)
    }

    /// At a green site: the row's own colour is the mean of the left and right neighbours, the other colour
    /// the mean of those above and below (eq. 2; the paper writes down one of the two, which depends on the
    /// row).
    #[inline(always)]
    fn at_green_site(&self, left: usize, column: usize, right: usize) -> [u8; 3] {
        let Self { above, here, below, .. } = self;
        let own = mean2(here.at(left), here.at(right));
        let other = mean2(above.at(column), below.at(column));
        self.rgb(own, here.at(column), other)
    }

    /// Swaps a row's own colour and the other one into the order red, green, blue.
    #[inline(always)]
    fn rgb(&self, own: u8, green: u8, other: u8) -> [u8; 3] {
        if self.sites.has_red { [own, green, other] } else { [other, green, own] }
    }
}

/// Index of the row or column before, mirrored at the edge.
#[inline(always)]
pub(super) fn before(index: usize) -> usize {
    if index == 0 { 1 } else { index - 1 }
}

/// Index of the row or column behind, mirrored at the edge.
#[inline(always)]
pub(super) fn after(index: usize, count: usize) -> usize {
    if index + 1 == count { count - 2 } else { index + 1 }
}

/// Mean, rounded half up.
#[inline(always)]
fn mean2(a: u8, b: u8) -> u8 {
    ((u16::from(a) + u16::from(b) + 1) >> 1) as u8
}

/// Mean, rounded half up.
#[inline(always)]
fn mean4(a: u8, b: u8, c: u8, d: u8) -> u8 {
    ((u16::from(a) + u16::from(b) + u16::from(c) + u16::from(d) + 2) >> 2) as u8
}
