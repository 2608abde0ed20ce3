//! Where the time goes: from pixels to runs.
//!
//! [`scalar`] is the specification. `bayer` and `color` give the same runs, bit for bit, with whichever
//! instruction set the machine has; which one that is, [`SimdLevel`] knows.

mod bayer;
mod buckets;
mod classes;
mod color;
mod demosaic;
mod filters;
mod lanes;
mod level;
mod light;
mod look_rows;
mod looks;
mod planes;
mod prefilter;
pub mod scalar;
mod self_test;

use crate::mask::FieldMask;
use crate::picture::Picture;
use crate::zones::ZonedTables;
use crate::{BACKGROUND, ClassTables};
use buckets::Buckets;
use common::messages::Run;
use looks::LookFilter;
use prefilter::Prefilter;

pub use level::{SimdChoice, SimdLevel};

/// So many rows before they are needed, rows are asked for: far enough for them to come, and not so
/// many that the first are gone again.
const ROWS_AHEAD: usize = 4;

/// From pictures to runs with the instructions of one [`SimdLevel`].
#[derive(Debug, Clone)]
pub struct Kernel {
    level: SimdLevel,
    buckets: [Buckets; 2],
    /// By zone.
    prefilters: Vec<Prefilters>,
    looks: Looks,
    scratch: Scratch,
}

impl Kernel {
    /// A level that this machine does not have is as good as [`SimdLevel::Scalar`]. It gives the right
    /// runs for any tables, and is quick with such as are like these: of the same colours under any light.
    pub fn new(level: SimdLevel, tables: &ClassTables) -> Self {
        let buckets = [Buckets::new(tables.rgb(), demosaic::EXCESS), Buckets::new(tables.yuv(), 0)];
        let prefilters = vec![Prefilters::new(tables, &buckets)];
        let looks = Looks::new(tables, &buckets);
        Self { level, buckets, prefilters, looks, scratch: Scratch::default() }
    }

    /// Whose instructions it uses.
    pub fn level(&self) -> SimdLevel {
        self.level
    }

    /// As [`scalar::classify`]. Other tables than last time cost a microsecond each (those of other
    /// colours with second looks ten), a wider picture or more zones an allocation.
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
        if self.looks.boxes.version != colors.version() {
            self.looks = Looks::new(colors, &self.buckets);
        }
        let (prefilters, looks) = (&self.prefilters, &self.looks);
        let setup = Setup { zoned, prefilters, looks, buckets: &self.buckets[0], mask };
        self.level.classify(picture, setup, &mut self.scratch, out)
    }
}

/// Memory that the fast kernels reuse.
#[derive(Debug, Clone, Default)]
struct Scratch {
    bayer: bayer::Scratch,
    color: color::Scratch,
}

/// What the fast kernels work with besides the picture.
#[derive(Clone, Copy)]
struct Setup<'a> {
    /// Decide in the end.
    zoned: ZonedTables<'a>,
    /// By zone.
    prefilters: &'a [Prefilters],
    looks: &'a Looks,
    /// Tables for colours in RGB.
    buckets: &'a Buckets,
    /// The pixels to look at.
    mask: &'a FieldMask,
}

/// What belongs to a version of the tables.
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
    /// Lets pass what the other does, too.
    fn add(&mut self, other: &Self) {
        self.rgb.add(&other.rgb);
        self.yuv.add(&other.yuv);
    }
}

/// Data for colours with second looks, under the light in which they were set.
#[derive(Debug, Clone)]
struct Looks {
    boxes: Prefilters,
    rgb: LookFilter,
    yuv: LookFilter,
}

impl Looks {
    fn new(colors: &ClassTables, buckets: &[Buckets; 2]) -> Self {
        let [rgb, yuv] = buckets;
        let tables = &colors.second_looks().tables;
        Self {
            boxes: Prefilters::new(colors, buckets),
            rgb: LookFilter::new(tables, rgb),
            yuv: LookFilter::new(tables, yuv),
        }
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

/// Fills a list of runs up to its capacity. A run is written in two steps, where it begins and where it
/// ends: so neither needs to know of the other, and no branch depends on what comes after what.
struct RunWriter<'a> {
    out: &'a mut [Run],
    /// So many runs have begun …
    begun: usize,
    /// … and so many have ended: as many, or one less.
    ended: usize,
    is_cut_off: bool,
}

impl<'a> RunWriter<'a> {
    fn new(out: &'a mut [Run]) -> Self {
        Self { out, begun: 0, ended: 0, is_cut_off: false }
    }

    /// Columns and rows of a picture fit 16 bits.
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

    /// What found no room to begin has none to end.
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

/// Joins the classified pixels of one row, handed in from left to right, to runs.
struct RowRuns<'w, 'a> {
    runs: &'w mut RunWriter<'a>,
    row: usize,
    /// Of the run that is still open; none if it is background.
    class: u8,
    /// All columns before this one have been handed in.
    reached: usize,
}

impl<'w, 'a> RowRuns<'w, 'a> {
    #[inline(always)]
    fn new(runs: &'w mut RunWriter<'a>, row: usize) -> Self {
        Self { runs, row, class: BACKGROUND, reached: 0 }
    }

    /// Hands in a pixel. Those left out are background.
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

    /// A run begins here.
    #[inline(always)]
    fn begin(&mut self, column: usize, class: u8) {
        self.runs.begin(self.row, column, class);
        self.class = class;
    }

    /// From the column reached so far to this one there is background, if there is anything.
    #[inline(always)]
    fn skip_to(&mut self, column: usize) {
        if column != self.reached {
            self.finish();
            self.reached = column;
        }
    }

    /// A run ends here, before what may begin here.
    #[inline(always)]
    fn end(&mut self, column: usize) {
        self.runs.end(column);
        self.class = BACKGROUND;
    }

    /// Ends the run that is still open, if there is one. To be called at the end of the row.
    #[inline(always)]
    fn finish(&mut self) {
        if self.class != BACKGROUND {
            self.end(self.reached);
        }
    }
}
