//! Region merging: the segmentation of section 5 of the paper, on runs instead of pixels.
//!
//! Runs come sorted by row and column. Two indices, one in the row above and one in the current row, move
//! right together and find every pair of runs that share a column; pairs of one class belong to one region
//! (4-connectivity: a pixel is compared with its upper and its left neighbour, as in Fig. 6). Regions that
//! turn out to be one are joined in a union-find forest, always to the one whose first run comes first. So a
//! parent stands before its children, and after the last row
//!
//! 1. one pass from front to back numbers the regions and counts their pixels and runs,
//! 2. regions below the least size are dropped,
//! 3. one pass sorts the runs by region, and
//! 4. one pass sums up each region's runs.
//!
//! The time is linear in the runs; pixels are not visited.
//!
//! A processor cannot predict the place of the next run, and a mispredicted branch costs more than the rest
//! of the work. So there are few branches: row and column are compared as one number, the upper index takes
//! its first two steps without a branch, and one branch decides for the first two runs above together whether
//! a run joins any.
//!
//! The paper joins the region of fewer pixels to the one of more, since it relabels pixels. Nothing is
//! relabelled here, so the direction does not matter for the result.

pub(crate) mod bounds;
pub(crate) mod class_index;
pub(crate) mod measure;
pub(crate) mod measured_regions;
pub(crate) mod places;
pub(crate) mod vicinity;

use bytemuck::{Zeroable, zeroed_box};
use messages::{DetectionFrame, MAX_REGIONS, MAX_RUNS, Region, Run};
use std::cmp::Reverse;

/// Finds the regions of a picture, reusing its tables.
#[derive(Debug)]
pub struct RegionFinder {
    width: u32,
    height: u32,
    class_count: u32,
    min_region_px: u32,
    /// The valid runs in their order.
    runs: Box<ByRun<Run>>,
    run_count: usize,
    /// Span of each valid run, shifted to the row below, and [`NOWHERE`] after the last one.
    spans: Box<ByRun<Span>>,
    forest: Forest,
    /// For each run, the number of its region among all.
    numbers: Box<ByRun<u16>>,
    /// All regions, by their first run.
    regions: Box<ByRun<Count>>,
    region_count: usize,
    /// Numbers of the regions that are published.
    kept: Vec<u16>,
    by_size: Vec<(Reverse<u32>, u32)>,
}

/// A value for each run. Its length makes bounds checks of 16-bit indices unnecessary; unused pages take no
/// memory.
type ByRun<T> = [T; 1 << 16];
const _: () = assert!(MAX_RUNS < 1 << 16);

/// The pixels of a run, as [`place`]s.
#[derive(Debug, Clone, Copy, Zeroable)]
// 16 bytes, so that an address is a shift of the index.
#[repr(align(16))]
struct Span {
    begin: u32,
    end: u32,
    class: u32,
}

/// A union-find forest over runs: the parent of each run is an earlier run of its region, or the run itself
/// if it is the first.
#[derive(Debug)]
struct Forest(Box<ByRun<u16>>);

/// Pixels and runs of a region.
#[derive(Debug, Clone, Copy, Default, Zeroable)]
struct Count {
    pixels: u32,
    runs: u16,
    /// Index of its next run in the message.
    next_run: u16,
}

/// A span after all others.
const NOWHERE: Span = Span { begin: u32::MAX, end: u32::MAX, class: u32::MAX };
/// Difference between a place and the one below it.
const ROW: u32 = 1 << 16;

/// Row and column as one number, in the order of pixels.
fn place(row: u16, column: u16) -> u32 {
    u32::from(row) << 16 | u32::from(column)
}

impl RegionFinder {
    /// A finder for pictures of `width` × `height` pixels, at most 65,535 each way, and classes below
    /// `class_count`. Regions of fewer than `min_region_px` pixels are noise and not published.
    pub fn new(width: u32, height: u32, class_count: u32, min_region_px: u32) -> Self {
        Self {
            width,
            height: height.min(u16::MAX.into()),
            class_count,
            min_region_px,
            runs: zeroed_box(),
            run_count: 0,
            spans: zeroed_box(),
            forest: Forest(zeroed_box()),
            numbers: zeroed_box(),
            regions: zeroed_box(),
            region_count: 0,
            kept: Vec::with_capacity(MAX_RUNS),
            by_size: Vec::with_capacity(MAX_RUNS),
        }
    }

    /// Writes the regions that `runs` form, and their runs, into `out`, replacing what was there;
    /// regions in the order of their first pixels, each region's runs from top to bottom.
    ///
    /// Regions of fewer than `min_region_px` pixels are left out together with their runs. If more
    /// than [`MAX_REGIONS`] remain, the smallest are left out too, of equals the later ones, and
    /// [`DetectionFrame::REGIONS_OVERFLOW`] is set.
    ///
    /// Runs are outside input. Skipped are empty and inverted ones, those beyond the picture or of an unknown
    /// class, those that begin before the end of the run to their left, and those beyond [`MAX_RUNS`]. A row
    /// that is above the one before it begins anew, connected to nothing.
    pub fn find(&mut self, runs: &[Run], out: &mut DetectionFrame) {
        self.connect(&runs[..runs.len().min(MAX_RUNS)]);
        self.count();
        self.select(out);
        self.publish(out);
    }

    /// Takes over the valid runs, and builds the forest.
    fn connect(&mut self, runs: &[Run]) {
        let (width, height, class_count) = (self.width, self.height, self.class_count);
        let Self { runs: taken, spans, forest, .. } = self;
        let at = usize::from;
        let (mut here, mut above) = (0u16, 0u16);
        let mut last = Span { begin: 0, end: 0, class: u32::MAX };
        for &run in runs {
            let is_valid = (run.begin < run.end)
                & (u32::from(run.end) <= width)
                & (u32::from(run.row) < height)
                & (u32::from(run.class) < class_count);
            if !is_valid {
                continue;
            }
            let (begin, end) = (place(run.row, run.begin), place(run.row, run.end));
            let class = u32::from(run.class);
            if begin < last.end {
                let overlaps_last = begin / ROW == last.end / ROW;
                if overlaps_last {
                    continue;
                }
                // An earlier row: no run so far lies above it.
                above = here;
            }
            // Adjacent runs of one class: the message format does not forbid them.
            let is_cut = (begin == last.end) & (class == last.class);
            last = Span { begin, end, class };
            taken[at(here)] = Run { reserved: 0, ..run };
            spans[at(here)] = Span { begin: begin + ROW, end: end + ROW, class };
            spans[at(here + 1)] = NOWHERE;

            // Mostly there are at most two steps.
            let is_past = |upper: u16| spans[at(upper)].end <= begin;
            above += u16::from(is_past(above)) + u16::from(is_past(above + 1));
            while is_past(above) {
                above += 1;
            }
            let overlaps = |upper: u16| spans[at(upper)].begin < end;
            let is_same = |upper: u16| spans[at(upper)].class == class;
            let mut node = here - u16::from(is_cut);
            forest.0[at(here)] = node;
            if overlaps(above) & is_same(above) | overlaps(above + 1) {
                // `above` stays: the last run that overlaps may also overlap the next run of this row.
                let mut upper = above;
                while overlaps(upper) {
                    if is_same(upper) {
                        let root = forest.root(upper);
                        node = if node == here { root } else { forest.join(node, root) };
                    }
                    upper += 1;
                }
                forest.0[at(here)] = node;
            }
            here += 1;
        }
        self.run_count = at(here);
    }

    /// Numbers the regions, and counts their pixels and runs.
    fn count(&mut self) {
        let Self { runs, forest, numbers, regions, .. } = self;
        let mut count = 0u16;
        for (node, run) in (0u16..).zip(&runs[..self.run_count]) {
            // The parent comes first, so it already has the number of the region.
            let parent = forest.0[usize::from(node)];
            let is_first = parent == node;
            let number = if is_first { count } else { numbers[usize::from(parent)] };
            numbers[usize::from(node)] = number;
            count += u16::from(is_first);
            let region = &mut regions[usize::from(number)];
            let (pixels, runs) = if is_first { (0, 0) } else { (region.pixels, region.runs) };
            // No overflow: at most MAX_RUNS runs of at most 65,535 pixels.
            (region.pixels, region.runs) = (pixels + run.pixels(), runs + 1);
        }
        self.region_count = count.into();
    }

    /// Chooses the regions that are published, and the places of their runs in the message.
    fn select(&mut self, out: &mut DetectionFrame) {
        let Self { regions, kept, by_size, .. } = self;
        let regions = &mut regions[..self.region_count];
        kept.clear();
        let least = self.min_region_px;
        let numbers = (0u16..).zip(&*regions);
        kept.extend(numbers.filter(|(_, it)| it.pixels >= least).map(|(number, _)| number));
        out.flags &= !DetectionFrame::REGIONS_OVERFLOW;
        if kept.len() > MAX_REGIONS {
            out.flags |= DetectionFrame::REGIONS_OVERFLOW;
            let size = |number: u16| Reverse(regions[usize::from(number)].pixels);
            by_size.clear();
            by_size.extend((0..).zip(&*kept).map(|(order, &number)| (size(number), order)));
            let (_, &mut last, _) = by_size.select_nth_unstable(MAX_REGIONS - 1);
            let mut order = 0;
            kept.retain(|&number| {
                let rank = (size(number), order);
                order += 1;
                rank <= last
            });
        }
        let run_count: u32 =
            kept.iter().map(|&number| u32::from(regions[usize::from(number)].runs)).sum();
        // Runs of other regions are written behind all others, over each other, which spares a branch.
        for region in &mut *regions {
            region.next_run = run_count as u16;
        }
        let mut first_run = 0;
        for &number in &*kept {
            let region = &mut regions[usize::from(number)];
            region.next_run = first_run;
            first_run += region.runs;
        }
        (out.region_count, out.run_count) = (kept.len() as u32, run_count);
    }

    /// Writes the runs sorted by region, and the regions.
    fn publish(&mut self, out: &mut DetectionFrame) {
        let Self { runs, numbers, regions, .. } = self;
        for (&run, &number) in runs[..self.run_count].iter().zip(&numbers[..]) {
            let next_run = &mut regions[usize::from(number)].next_run;
            out.runs[usize::from(*next_run)] = run;
            *next_run += 1;
        }
        let mut first_run = 0;
        for (region, &number) in out.regions.iter_mut().zip(&self.kept) {
            let Count { pixels, runs, .. } = regions[usize::from(number)];
            let runs = &out.runs[first_run..][..usize::from(runs)];
            *region = summed_up(runs, pixels, first_run);
            first_run += runs.len();
        }
    }
}

/// The region of these runs, at least one, from top to bottom.
fn summed_up(runs: &[Run], pixel_count: u32, first_run: usize) -> Region {
    let (mut double_x, mut y) = (0, 0);
    let (mut left, mut right) = (u16::MAX, 0);
    for run in runs {
        let (row, begin, end) = (u64::from(run.row), u64::from(run.begin), u64::from(run.end));
        let pixels = end - begin;
        // Twice the sum of the columns: (first + last)·number.
        double_x += (begin + end - 1) * pixels;
        y += row * pixels;
        left = left.min(run.begin);
        right = right.max(run.end - 1);
    }
    let (first, last) = (runs[0], runs[runs.len() - 1]);
    let pixels = f64::from(pixel_count);
    Region {
        class: first.class.into(),
        pixel_count,
        x_px: ((double_x / 2) as f64 / pixels) as f32,
        y_px: (y as f64 / pixels) as f32,
        left,
        top: first.row,
        right,
        bottom: last.row,
        first_run: first_run as u32,
        run_count: runs.len() as u32,
    }
}

impl Forest {
    /// Joins the trees of two runs; returns the root.
    fn join(&mut self, a: u16, b: u16) -> u16 {
        let (a, b) = (self.root(a), self.root(b));
        let first = a.min(b);
        self.0[usize::from(a.max(b))] = first;
        first
    }

    /// The root of a run's tree, with path halving.
    fn root(&mut self, mut node: u16) -> u16 {
        loop {
            let parent = self.0[usize::from(node)];
            if parent == node {
                return node;
            }
            let grandparent = self.0[usize::from(parent)];
            self.0[usize::from(node)] = grandparent;
            node = grandparent;
        }
    }
}

#[cfg(test)]
mod tests;
