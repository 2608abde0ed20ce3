//! The kernels: from pixels to runs.
//!
//! [`scalar`] is the specification. `bayer` and `color` give the same runs, bit for bit, with the machine's
//! vector instructions; [`SimdLevel`] chooses them.

mod bayer;
mod buckets;
mod classes;
mod color;
mod demosaic;
mod filters;
mod lanes;
mod level;
mod light;
mod planes;
mod prefilter;
pub mod scalar;
mod second_look;
mod second_look_rows;
mod self_test;

use crate::mask::FieldMask;
use crate::picture::Picture;
use crate::zones::ZonedTables;
use crate::{BACKGROUND, ClassTables};
use buckets::Buckets;
use messages::Run;
use prefilter::Prefilter;
use second_look::SecondLookFilter;

pub use level::{SimdChoice, SimdLevel};

/// Prefetch distance, rows: far enough for a row to arrive, and near enough for it not to be evicted again.
const ROWS_AHEAD: usize = 4;

/// Turns pictures into runs with the instructions of one [`SimdLevel`].
#[derive(Debug, Clone)]
pub struct Kernel {
    level: SimdLevel,
    buckets: [Buckets; 2],
    /// Indexed by zone.
    prefilters: Vec<Prefilters>,
    second_looks: SecondLookSetup,
    scratch: Scratch,
}

impl Kernel {
    /// Replaces a level that this machine does not have by [`SimdLevel::Scalar`]. Gives the right runs for
    /// any tables, and is fast for tables of the same colours under any light.
    pub fn new(level: SimdLevel, tables: &ClassTables) -> Self {
        let buckets = [Buckets::new(tables.rgb(), demosaic::EXCESS), Buckets::new(tables.yuv(), 0)];
        let prefilters = vec![Prefilters::new(tables, &buckets)];
        let second_looks = SecondLookSetup::new(tables, &buckets);
        Self { level, buckets, prefilters, second_looks, scratch: Scratch::default() }
    }

    /// The instruction set in use.
    pub fn level(&self) -> SimdLevel {
        self.level
    }

    /// Classifies a picture, with the result of [`scalar::classify`]. Each table that differs from the last
    /// call costs a microsecond (ten for other colours with second looks), a wider picture or more zones an
    /// allocation.
    pub fn classify(
        &mut self,
        picture: &Picture,
        zoned: ZonedTables,
        mask: &FieldMask,
        out: &mut [Run],
    ) -> Written {
        let ZonedTables { colors, tables, .. } = zoned;
        let known = self.prefilters.len();
        let new = |tables| Prefilters::new(tables, &self.buckets);
        self.prefilters.extend(tables.iter().skip(known).map(new));
        for (prefilters, tables) in self.prefilters.iter_mut().zip(tables) {
            if prefilters.version != tables.version() {
                *prefilters = new(tables);
            }
        }
        if self.second_looks.boxes.version != colors.version() {
            self.second_looks = SecondLookSetup::new(colors, &self.buckets);
        }
        let (prefilters, second_looks) = (&self.prefilters, &self.second_looks);
        let setup = Setup { zoned, prefilters, second_looks, buckets: &self.buckets[0], mask };
        self.level.classify(picture, setup, &mut self.scratch, out)
    }
}

/// Reused allocations of the vector kernels.
#[derive(Debug, Clone, Default)]
struct Scratch {
    bayer: bayer::Scratch,
    color: color::Scratch,
}

/// Input of the vector kernels besides the picture.
#[derive(Clone, Copy)]
struct Setup<'a> {
    /// The exact tables, which decide.
    zoned: ZonedTables<'a>,
    /// Indexed by zone.
    prefilters: &'a [Prefilters],
    second_looks: &'a SecondLookSetup,
    /// Assignment of colours in RGB to prefilter bits.
    buckets: &'a Buckets,
    /// The pixels to classify.
    mask: &'a FieldMask,
}

/// Prefilters of one version of the tables.
#[derive(Debug, Clone, Copy)]
struct Prefilters {
    version: u64,
    rgb: Prefilter,
    yuv: Prefilter,
}

impl Prefilters {
    fn new(tables: &ClassTables, [rgb, yuv]: &[Buckets; 2]) -> Self {
        Self {
            version: tables.version(),
            rgb: Prefilter::new(tables.rgb(), rgb, demosaic::EXCESS),
            yuv: Prefilter::new(tables.yuv(), yuv, 0),
        }
    }
}

impl Prefilters {
    /// Also passes every pixel that `other` passes.
    fn add(&mut self, other: &Self) {
        self.rgb.add(&other.rgb);
        self.yuv.add(&other.yuv);
    }
}

/// Data for colours with second looks, for the light in which they were set.
#[derive(Debug, Clone)]
struct SecondLookSetup {
    boxes: Prefilters,
    rgb: SecondLookFilter,
    yuv: SecondLookFilter,
}

impl SecondLookSetup {
    fn new(colors: &ClassTables, buckets: &[Buckets; 2]) -> Self {
        let [rgb, yuv] = buckets;
        let tables = &colors.second_looks().tables;
        Self {
            boxes: Prefilters::new(colors, buckets),
            rgb: SecondLookFilter::new(tables, rgb),
            yuv: SecondLookFilter::new(tables, yuv),
        }
    }
}

/// Result of a kernel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Written {
    /// Valid runs at the beginning of the list.
    pub count: u32,
    /// The picture has more runs than the list has room.
    pub is_cut_off: bool,
}

/// Fills a list of runs up to its capacity. A run's begin and its end are written separately, so neither
/// needs to know of the other, and no branch depends on their order.
struct RunWriter<'a> {
    out: &'a mut [Run],
    /// Number of runs begun.
    begun: usize,
    /// Number of runs ended: equal to `begun`, or one less.
    ended: usize,
    is_cut_off: bool,
}

impl<'a> RunWriter<'a> {
    fn new(out: &'a mut [Run]) -> Self {
        Self { out, begun: 0, ended: 0, is_cut_off: false }
    }

    /// Columns and rows of a picture fit into 16 bits.
    #[inline(always)]
    fn begin(&mut self, row: usize, column: usize, class: u8) {
        match self.out.get_mut(self.begun) {
            Some(slot) => {
                let [row, begin] = [row, column].map(|value| value as u16);
                *slot = Run { row, begin, end: begin, class, reserved: 0 };
                self.begun += 1;
            }
            None => self.is_cut_off = true,
        }
    }

    /// A run that found no room to begin has none to end.
    #[inline(always)]
    fn end(&mut self, column: usize) {
        if let Some(slot) = self.out.get_mut(self.ended) {
            slot.end = column as u16;
            self.ended += 1;
        }
    }

    fn written(&self) -> Written {
        debug_assert_eq!(self.begun, self.ended);
        // At most 65,535 × 65,535 runs.
        Written { count: self.begun as u32, is_cut_off: self.is_cut_off }
    }
}

/// Joins the classified pixels of one row, added from left to right, into runs.
struct RowRuns<'w, 'a> {
    runs: &'w mut RunWriter<'a>,
    row: usize,
    /// Class of the open run; background if there is none.
    class: u8,
    /// All columns before this one have been added.
    reached: usize,
}

impl<'w, 'a> RowRuns<'w, 'a> {
    #[inline(always)]
    fn new(runs: &'w mut RunWriter<'a>, row: usize) -> Self {
        Self { runs, row, class: BACKGROUND, reached: 0 }
    }

    /// Adds a pixel. Skipped pixels are background.
    #[inline(always)]
    fn add(&mut self, column: usize, class: u8) {
        self.skip_to(column);
        if class != self.class {
            self.finish();
            if class != BACKGROUND {
                self.begin(column, class);
            }
        }
        self.reached = column + 1;
    }

    /// Begins a run.
    #[inline(always)]
    fn begin(&mut self, column: usize, class: u8) {
        self.runs.begin(self.row, column, class);
        self.class = class;
    }

    /// Declares the columns from the last one reached to this one as background, if there are any.
    #[inline(always)]
    fn skip_to(&mut self, column: usize) {
        if column != self.reached {
            self.finish();
            self.reached = column;
        }
    }

    /// Ends a run; called before the run that may begin in the same column.
    #[inline(always)]
    fn end(&mut self, column: usize) {
        self.runs.end(column);
        self.class = BACKGROUND;
    }

    /// Ends the open run, if there is one. Must be called at the end of the row.
    #[inline(always)]
    fn finish(&mut self) {
        if self.class != BACKGROUND {
            self.end(self.reached);
        }
    }
}
