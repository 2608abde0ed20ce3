//! The specification: plain code, one pixel after the other.

use super::{BayerImage, RunWriter, Written};
use crate::{BACKGROUND, ClassTables};
use common::messages::Run;

/// Lists the runs of a picture, as many as fit into `out`; what lies behind them is untouched.
pub fn classify(image: &BayerImage, tables: &ClassTables, out: &mut [Run]) -> Written {
    let mut runs = RunWriter::new(out);
    for row in 0..image.height() {
        let mut class = BACKGROUND;
        let mut begin = 0;
        for_each_pixel(image, row, |column, rgb| {
            let class_here = tables.classify(rgb);
            if class_here != class {
                if class != BACKGROUND {
                    runs.push(row, begin, column, class);
                }
                class = class_here;
                begin = column;
            }
        });
        if class != BACKGROUND {
            runs.push(row, begin, image.width(), class);
        }
        if runs.is_cut_off {
            break;
        }
    }
    runs.written()
}

/// Replaces `rgb` by the demosaiced picture, three bytes a pixel, row by row without padding: what
/// the classifier sees, for overlays and for choosing colours.
pub fn demosaic(image: &BayerImage, rgb: &mut Vec<u8>) {
    rgb.clear();
    rgb.reserve(3 * image.width() * image.height());
    for row in 0..image.height() {
        for_each_pixel(image, row, |_, pixel| rgb.extend_from_slice(&pixel));
    }
}

/// Hands out column and interpolated colour of every pixel of a row, from left to right.
///
/// The colours of a row alternate between green and one other, so the inner loop goes by pairs and
/// has no decisions to make; the columns before and behind the pairs go the slow way.
#[inline(always)]
fn for_each_pixel(image: &BayerImage, row: usize, mut pixel: impl FnMut(usize, [u8; 3])) {
    let rows = ThreeRows::around(image, row);
    let width = image.width();
    let mut column = if rows.colored_parity == 1 { 1 } else { 2 };
    for column in 0..column {
        pixel(column, rows.pixel(column));
    }
    // Both pixels of the pair have a neighbour to the right.
    while column + 2 < width {
        pixel(column, rows.at_colored_site(column - 1, column, column + 1));
        pixel(column + 1, rows.at_green_site(column, column + 1, column + 2));
        column += 2;
    }
    for column in column..width {
        pixel(column, rows.pixel(column));
    }
}

/// A row and its neighbours. Beyond the edges the picture is mirrored without repeating the edge
/// itself (−1 → 1, n → n − 2), which puts the colours where the pattern would continue.
struct ThreeRows<'a> {
    above: &'a [u8],
    here: &'a [u8],
    below: &'a [u8],
    /// The row has red and green sites; otherwise blue and green ones.
    has_red: bool,
    /// Whether its red or blue sites are in even columns (0) or odd ones (1).
    colored_parity: usize,
}

impl<'a> ThreeRows<'a> {
    fn around(image: &BayerImage<'a>, row: usize) -> Self {
        let (red_column, red_row) = image.order().red_site();
        let has_red = row % 2 == red_row;
        Self {
            above: image.row(before(row)),
            here: image.row(row),
            below: image.row(after(row, image.height())),
            has_red,
            colored_parity: if has_red { red_column } else { 1 - red_column },
        }
    }

    /// The colour of any pixel of the row.
    fn pixel(&self, column: usize) -> [u8; 3] {
        let (left, right) = (before(column), after(column, self.here.len()));
        if column % 2 == self.colored_parity {
            self.at_colored_site(left, column, right)
        } else {
            self.at_green_site(left, column, right)
        }
    }

    /// Where red or blue is known: green is the mean of the four direct neighbours (eq. 1), the
    /// other colour that of the four diagonal ones (eq. 3).
    #[inline(always)]
    fn at_colored_site(&self, left: usize, column: usize, right: usize) -> [u8; 3] {
        let Self { above, here, below, .. } = self;
        let green = mean4(above[column], here[left], here[right], below[column]);
        let other = mean4(above[left], above[right], below[left], below[right]);
        self.rgb(here[column], green, other)
    }

    /// Where green is known: the row's colour is the mean of the neighbours left and right, the
    /// other one that of those above and below (eq. 2; which of the two the paper writes down
    /// depends on the row).
    #[inline(always)]
    fn at_green_site(&self, left: usize, column: usize, right: usize) -> [u8; 3] {
        let Self { above, here, below, .. } = self;
        let own = mean2(here[left], here[right]);
        let other = mean2(above[column], below[column]);
        self.rgb(own, here[column], other)
    }

    /// Sorts the row's own colour and the other one into red and blue.
    #[inline(always)]
    fn rgb(&self, own: u8, green: u8, other: u8) -> [u8; 3] {
        if self.has_red { [own, green, other] } else { [other, green, own] }
    }
}

/// The row or column before, mirrored at the edge.
fn before(index: usize) -> usize {
    if index == 0 { 1 } else { index - 1 }
}

/// The row or column behind, mirrored at the edge.
fn after(index: usize, count: usize) -> usize {
    if index + 1 == count { count - 2 } else { index + 1 }
}

/// Mean, a half rounded up.
#[inline(always)]
fn mean2(a: u8, b: u8) -> u8 {
    ((u16::from(a) + u16::from(b) + 1) >> 1) as u8
}

/// Mean, a half rounded up.
#[inline(always)]
fn mean4(a: u8, b: u8, c: u8, d: u8) -> u8 {
    ((u16::from(a) + u16::from(b) + u16::from(c) + u16::from(d) + 2) >> 2) as u8
}
