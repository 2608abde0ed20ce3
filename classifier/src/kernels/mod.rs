//! Where the time goes: from Bayer pixels to runs.
//!
//! [`scalar`] is the specification. Faster implementations take the same arguments, live beside it
//! in a file per instruction set, and must give the same runs bit for bit.

pub mod scalar;

use common::messages::{BayerOrder, Run};

/// A Bayer picture whose dimensions are known to be consistent.
#[derive(Debug, Clone, Copy)]
pub struct BayerImage<'a> {
    pixels: &'a [u8],
    width: usize,
    height: usize,
    stride: usize,
    order: BayerOrder,
}

impl<'a> BayerImage<'a> {
    /// `stride` is the distance between the starts of two rows in bytes; the last row may end
    /// after `width`. `None` unless 2 ≤ `width` ≤ `stride`, 2 ≤ `height`, both at most 65,535, and
    /// `pixels` holds all rows.
    pub fn new(
        pixels: &'a [u8],
        width: u32,
        height: u32,
        stride: u32,
        order: BayerOrder,
    ) -> Option<Self> {
        let possible = 2..=u32::from(u16::MAX);
        if !possible.contains(&width) || !possible.contains(&height) || stride < width {
            return None;
        }
        let needed = u64::from(stride) * u64::from(height - 1) + u64::from(width);
        if (pixels.len() as u64) < needed {
            return None;
        }
        let [width, height, stride] = [width, height, stride].map(|value| value as usize);
        Some(Self { pixels, width, height, stride, order })
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Colours of the top-left 2×2 pixels.
    pub fn order(&self) -> BayerOrder {
        self.order
    }

    /// The pixels of a row, without padding.
    ///
    /// # Panics
    /// If there is no such row.
    pub fn row(&self, row: usize) -> &'a [u8] {
        assert!(row < self.height, "row {row} of {}", self.height);
        &self.pixels[row * self.stride..][..self.width]
    }
}

/// What a kernel has written to its list of runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Written {
    /// Valid runs at the beginning of the list.
    pub count: u32,
    /// The picture has more runs than the list has room.
    pub is_cut_off: bool,
}

/// Fills a list of runs up to its capacity.
struct RunWriter<'a> {
    out: &'a mut [Run],
    count: usize,
    is_cut_off: bool,
}

impl<'a> RunWriter<'a> {
    fn new(out: &'a mut [Run]) -> Self {
        Self { out, count: 0, is_cut_off: false }
    }

    /// Columns and rows of a [`BayerImage`] fit 16 bits.
    fn push(&mut self, row: usize, begin: usize, end: usize, class: u8) {
        match self.out.get_mut(self.count) {
            Some(slot) => {
                let [row, begin, end] = [row, begin, end].map(|value| value as u16);
                *slot = Run { row, begin, end, class, reserved: 0 };
                self.count += 1;
            }
            None => self.is_cut_off = true,
        }
    }

    fn written(&self) -> Written {
        // At most 65,535 × 65,535 runs.
        Written { count: self.count as u32, is_cut_off: self.is_cut_off }
    }
}
