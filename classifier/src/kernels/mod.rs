//! Where the time goes: from pixels to runs.
//!
//! [`scalar`] is the specification. Faster implementations take the same arguments, live beside it
//! and must give the same runs bit for bit.

pub mod scalar;

use common::messages::Run;

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

    /// Columns and rows of a picture fit 16 bits.
    #[inline(always)]
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

/// Joins the classified pixels of one row, handed in from left to right, to runs.
struct RowRuns<'w, 'a> {
    runs: &'w mut RunWriter<'a>,
    row: usize,
    begin: usize,
    end: usize,
    class: u8,
}

impl<'w, 'a> RowRuns<'w, 'a> {
    #[inline(always)]
    fn new(runs: &'w mut RunWriter<'a>, row: usize) -> Self {
        Self { runs, row, begin: 0, end: 0, class: 0 }
    }

    /// Background pixels are not handed in.
    #[inline(always)]
    fn add(&mut self, column: usize, class: u8) {
        if class != self.class || column != self.end {
            self.finish();
            (self.begin, self.class) = (column, class);
        }
        self.end = column + 1;
    }

    /// Writes the run that is still open. To be called at the end of the row.
    #[inline(always)]
    fn finish(&mut self) {
        if self.begin < self.end {
            self.runs.push(self.row, self.begin, self.end, self.class);
        }
        self.begin = self.end;
    }
}
