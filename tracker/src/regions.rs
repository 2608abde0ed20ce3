//! From runs to regions: the segmentation of section 5 of the paper, on runs instead of pixels.
//!
//! Runs come sorted by row and column. Two fingers, one on the row above and one on the current
//! row, move right together and find every pair of runs that share a column; pairs of the same
//! class belong to one region (4-connectivity: a pixel looks at its upper and its left neighbour,
//! as in Fig. 6). Regions that turn out to be one are joined in a union-find forest, always to the
//! one whose first pixel comes first. So a parent stands before its children, and once all rows are
//! done a single pass from front to back leads every run to its root. There pixels and runs are
//! counted; what is too small is noise, and only for the rest the sums are taken, in another pass.
//! Every run is looked at a constant number of times, and no pixel is looked at at all.
//!
//! The paper joins the region of fewer pixels to the one of more, since it relabels pixels. Nothing
//! is relabelled here, so which way round does not matter for the result.

use common::messages::{DetectionFrame, MAX_REGIONS, MAX_RUNS, Region, Run};
use std::cmp::Reverse;
use std::ops::Range;

/// Finds the regions of a picture. Keeps its tables from frame to frame to spare the allocator.
#[derive(Debug, Clone)]
pub struct RegionFinder {
    width: u32,
    height: u32,
    class_count: u32,
    min_region_px: u32,
    /// The usable runs, in the order given.
    runs: Vec<Run>,
    forest: Forest,
    /// For each node of the forest that is a root: the region it stands for.
    regions: Vec<Count>,
    /// Roots of the regions to publish, by their first pixel.
    kept: Vec<u32>,
    /// Of the regions to publish.
    sums: Vec<Sums>,
    by_size: Vec<(Reverse<u32>, u32)>,
}

/// A union-find forest over runs. Several runs can share a node.
#[derive(Debug, Clone, Default)]
struct Forest {
    /// For each run, its node; first as it was found, in the end the root.
    nodes: Vec<u32>,
    /// For each node, one that stands before it in the same tree, or itself if it is the root.
    parents: Vec<u32>,
}

/// How large a region is.
#[derive(Debug, Clone, Copy)]
struct Count {
    pixels: u32,
    runs: u32,
    /// Index in the output, or [`UNPUBLISHED`].
    number: u32,
}

/// What is gathered over the runs of a region that is published.
#[derive(Debug, Clone, Copy)]
struct Sums {
    /// Twice the sum of the columns.
    double_x: u64,
    y: u64,
    /// Where its next run goes.
    next_run: u32,
    class: u32,
    // Wider than needed: the compiler puts minima and maxima of 16 bits into vectors, whose loads then
    // wait for the narrower stores of the run before, at twice the price of all the rest.
    left: u32,
    top: u32,
    right: u32,
    bottom: u32,
}

/// Node of a run that has none yet.
const NONE: u32 = u32::MAX;
/// Number of a region that is too small to be published, or did not fit.
const UNPUBLISHED: u32 = u32::MAX;

impl RegionFinder {
    /// For pictures of `width` × `height` pixels and classes below `class_count`. Regions of fewer
    /// than `min_region_px` pixels are noise and not published.
    pub fn new(width: u32, height: u32, class_count: u32, min_region_px: u32) -> Self {
        Self {
            width,
            height,
            class_count,
            min_region_px,
            runs: Vec::with_capacity(MAX_RUNS),
            forest: Forest {
                nodes: Vec::with_capacity(MAX_RUNS),
                parents: Vec::with_capacity(MAX_RUNS),
            },
            regions: Vec::with_capacity(MAX_RUNS),
            kept: Vec::with_capacity(MAX_RUNS),
            sums: Vec::with_capacity(MAX_REGIONS),
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
    /// Runs are outside input. Empty and inverted ones, those beyond the picture or of an unknown
    /// class, and those that begin before the end of the run to their left are skipped; a row that
    /// does not follow the one before it starts afresh, connected to nothing; what exceeds
    /// [`MAX_RUNS`] is not looked at.
    pub fn find(&mut self, runs: &[Run], out: &mut DetectionFrame) {
        self.connect(&runs[..runs.len().min(MAX_RUNS)]);
        self.count();
        self.select(out);
        self.publish(out);
    }

    /// Takes over the usable runs and gives each its node.
    fn connect(&mut self, runs: &[Run]) {
        let Self { runs: taken, forest, .. } = self;
        let (width, height, class_count) = (self.width, self.height, self.class_count);
        taken.clear();
        forest.nodes.clear();
        forest.parents.clear();
        let mut above: Range<usize> = 0..0;
        let mut row_begin = 0;
        let mut finger = 0;
        for &run in runs {
            let is_valid = (run.begin < run.end)
                & (u32::from(run.end) <= width)
                & (u32::from(run.row) < height)
                & (u32::from(run.class) < class_count);
            if !is_valid {
                continue;
            }
            let here = taken.len();
            let mut node = NONE;
            if let Some(last) = taken.last() {
                if last.row != run.row {
                    let follows = last.row + 1 == run.row;
                    above = if follows { row_begin..here } else { here..here };
                    row_begin = here;
                    finger = above.start;
                } else if run.begin < last.end {
                    continue;
                } else if (run.begin == last.end) & (run.class == last.class) {
                    // A classifier has no reason to cut a run in two, but nothing forbids it.
                    node = forest.root(forest.nodes[here - 1]);
                }
            }

            while finger < above.end && taken[finger].end <= run.begin {
                finger += 1;
            }
            // The last run that overlaps may also overlap the next one: the finger stays on it.
            for (upper, upper_run) in taken[..above.end].iter().enumerate().skip(finger) {
                if upper_run.begin >= run.end {
                    break;
                }
                if upper_run.class == run.class {
                    let root = forest.root(forest.nodes[upper]);
                    node = if node == NONE { root } else { forest.join(node, root) };
                }
            }
            if node == NONE {
                node = forest.parents.len() as u32;
                forest.parents.push(node);
            }
            forest.nodes.push(node);
            taken.push(Run { reserved: 0, ..run });
        }
    }

    /// Leads every run to its root, and counts there.
    fn count(&mut self) {
        let Forest { nodes, parents } = &mut self.forest;
        self.regions.clear();
        self.regions.resize(parents.len(), Count { pixels: 0, runs: 0, number: UNPUBLISHED });
        let mut known = 0;
        for (run, node) in self.runs.iter().zip(nodes) {
            if *node == known {
                // The first run of this node. Its parent stands before it and is done.
                parents[known as usize] = parents[parents[known as usize] as usize];
                known += 1;
            }
            *node = parents[*node as usize];
            let region = &mut self.regions[*node as usize];
            // No overflow: at most MAX_RUNS runs of at most 65,535 pixels.
            region.pixels += run.pixels();
            region.runs += 1;
        }
    }

    /// Decides which regions are published and in which order.
    fn select(&mut self, out: &mut DetectionFrame) {
        self.kept.clear();
        let least = self.min_region_px.max(1);
        // What is not a root has no pixels.
        let nodes = (0u32..).zip(&self.regions);
        self.kept.extend(nodes.filter(|(_, count)| count.pixels >= least).map(|(node, _)| node));
        out.flags &= !DetectionFrame::REGIONS_OVERFLOW;
        if self.kept.len() > MAX_REGIONS {
            out.flags |= DetectionFrame::REGIONS_OVERFLOW;
            self.by_size.clear();
            let regions = &self.regions;
            self.by_size.extend(
                (0u32..)
                    .zip(&self.kept)
                    .map(|(order, &root)| (Reverse(regions[root as usize].pixels), order)),
            );
            let (_, &mut last, _) = self.by_size.select_nth_unstable(MAX_REGIONS - 1);
            let mut order = 0;
            self.kept.retain(|&root| {
                let rank = (Reverse(regions[root as usize].pixels), order);
                order += 1;
                rank <= last
            });
        }
        for (number, &root) in (0..).zip(&self.kept) {
            self.regions[root as usize].number = number;
        }
    }

    /// Sorts the runs into their regions, gathers what there is to know of these on the way, and
    /// writes them.
    fn publish(&mut self, out: &mut DetectionFrame) {
        self.sums.clear();
        let mut first_run = 0;
        for &root in &self.kept {
            self.sums.push(Sums::of_none(first_run));
            first_run += self.regions[root as usize].runs;
        }
        for (&run, &root) in self.runs.iter().zip(&self.forest.nodes) {
            let number = self.regions[root as usize].number;
            if let Some(sums) = self.sums.get_mut(number as usize) {
                out.runs[sums.next_run as usize] = run;
                sums.add(run);
            }
        }
        for ((region, &root), sums) in out.regions.iter_mut().zip(&self.kept).zip(&self.sums) {
            let count = &self.regions[root as usize];
            let pixels = f64::from(count.pixels);
            *region = Region {
                class: sums.class,
                pixel_count: count.pixels,
                x_px: ((sums.double_x / 2) as f64 / pixels) as f32,
                y_px: (sums.y as f64 / pixels) as f32,
                left: sums.left as u16,
                top: sums.top as u16,
                right: sums.right as u16,
                bottom: sums.bottom as u16,
                first_run: sums.next_run - count.runs,
                run_count: count.runs,
            };
        }
        out.region_count = self.kept.len() as u32;
        out.run_count = first_run;
    }
}

impl Sums {
    fn of_none(first_run: u32) -> Self {
        let (left, top) = (u32::MAX, u32::MAX);
        Self { double_x: 0, y: 0, next_run: first_run, class: 0, left, top, right: 0, bottom: 0 }
    }

    fn add(&mut self, run: Run) {
        let (row, begin, end) = (u32::from(run.row), u32::from(run.begin), u32::from(run.end));
        let pixels = u64::from(end - begin);
        // First and last column times the number of columns: always even.
        self.double_x += u64::from(begin + end - 1) * pixels;
        self.y += u64::from(row) * pixels;
        self.next_run += 1;
        self.class = u32::from(run.class);
        self.left = self.left.min(begin);
        self.top = self.top.min(row);
        self.right = self.right.max(end - 1);
        self.bottom = self.bottom.max(row);
    }
}

impl Forest {
    /// Makes the trees of two roots one; returns its root.
    fn join(&mut self, a: u32, b: u32) -> u32 {
        let (first, second) = (a.min(b), a.max(b));
        self.parents[second as usize] = first;
        first
    }

    /// The root of a node's tree; halves the path on its way.
    fn root(&mut self, mut node: u32) -> u32 {
        loop {
            let parent = self.parents[node as usize];
            if parent == node {
                return node;
            }
            let grandparent = self.parents[parent as usize];
            self.parents[node as usize] = grandparent;
            node = grandparent;
        }
    }
}

#[cfg(test)]
mod tests;
