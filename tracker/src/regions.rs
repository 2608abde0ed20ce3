//! From runs to regions: the segmentation of section 5 of the paper, on runs instead of pixels.
//!
//! Runs come sorted by row and column. Two fingers, one on the row above and one on the current
//! row, move right together and find every pair of runs that share a column; pairs of the same
//! class belong to one region (4-connectivity: a pixel looks at its upper and its left neighbour,
//! as in Fig. 6). Regions that turn out to be one are joined in a union-find forest, the one of
//! fewer pixels into the one of more, and their sums with them. So every run is looked at a
//! constant number of times, and no pixel is looked at at all.

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
    runs: Vec<LabelledRun>,
    nodes: Vec<Node>,
    /// Roots of the regions to publish, by their first pixel.
    kept: Vec<u32>,
    by_size: Vec<(Reverse<u32>, u32)>,
}

#[derive(Debug, Clone, Copy)]
struct LabelledRun {
    run: Run,
    node: u32,
}

/// A region in the making; the sums are those of the whole tree while the node is a root.
#[derive(Debug, Clone, Copy)]
struct Node {
    parent: u32,
    class: u8,
    pixel_count: u32,
    run_count: u32,
    sum_x: u64,
    sum_y: u64,
    left: u16,
    top: u16,
    right: u16,
    bottom: u16,
    /// Index in the output, [`UNPUBLISHED`] or [`UNSEEN`].
    number: u32,
}

/// Number of a region that is too small to be published, or did not fit.
const UNPUBLISHED: u32 = u32::MAX;
/// Number of a region that the output has not come across yet.
const UNSEEN: u32 = u32::MAX - 1;

impl RegionFinder {
    /// For pictures of `width` × `height` pixels and classes below `class_count`. Regions of fewer
    /// than `min_region_px` pixels are noise and not published.
    pub fn new(width: u32, height: u32, class_count: u32, min_region_px: u32) -> Self {
        Self {
            width,
            height,
            class_count,
            min_region_px,
            runs: Vec::new(),
            nodes: Vec::new(),
            kept: Vec::new(),
            by_size: Vec::new(),
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
        self.label(&runs[..runs.len().min(MAX_RUNS)]);
        self.select(out);
        self.publish(out);
    }

    /// Gives every usable run its node.
    fn label(&mut self, runs: &[Run]) {
        self.runs.clear();
        self.nodes.clear();
        let mut above: Range<usize> = 0..0;
        let mut row_begin = 0;
        let mut finger = 0;
        for &run in runs {
            if !self.is_valid(&run) {
                continue;
            }
            let here = self.runs.len();
            let mut node = None;
            if let Some(&LabelledRun { run: last, node: last_node }) = self.runs.last() {
                if last.row != run.row {
                    let follows = u32::from(last.row) + 1 == u32::from(run.row);
                    above = if follows { row_begin..here } else { here..here };
                    row_begin = here;
                    finger = above.start;
                } else if run.begin < last.end {
                    continue;
                } else if run.begin == last.end && run.class == last.class {
                    // A classifier has no reason to cut a run in two, but nothing forbids it.
                    node = Some(self.root(last_node));
                }
            }

            while finger < above.end && self.runs[finger].run.end <= run.begin {
                finger += 1;
            }
            // The last run that overlaps may also overlap the next one: the finger stays on it.
            for upper in finger..above.end {
                let LabelledRun { run: upper_run, node: upper_node } = self.runs[upper];
                if upper_run.begin >= run.end {
                    break;
                }
                if upper_run.class == run.class {
                    let root = self.root(upper_node);
                    node = Some(node.map_or(root, |node| self.join(node, root)));
                }
            }

            let single = Node::of(&run, self.nodes.len() as u32);
            let node = match node {
                Some(node) => {
                    self.nodes[node as usize].absorb(&single);
                    node
                }
                None => {
                    self.nodes.push(single);
                    single.parent
                }
            };
            self.runs.push(LabelledRun { run, node });
        }
    }

    fn is_valid(&self, run: &Run) -> bool {
        run.begin < run.end
            && u32::from(run.end) <= self.width
            && u32::from(run.row) < self.height
            && u32::from(run.class) < self.class_count
    }

    /// The root of a node's tree; halves the path on its way.
    fn root(&mut self, mut node: u32) -> u32 {
        loop {
            let parent = self.nodes[node as usize].parent;
            if parent == node {
                return node;
            }
            let grandparent = self.nodes[parent as usize].parent;
            self.nodes[node as usize].parent = grandparent;
            node = grandparent;
        }
    }

    /// Makes two trees one and returns its root: the one with more pixels.
    fn join(&mut self, a: u32, b: u32) -> u32 {
        if a == b {
            return a;
        }
        let a_is_larger = self.nodes[a as usize].pixel_count >= self.nodes[b as usize].pixel_count;
        let (larger, smaller) = if a_is_larger { (a, b) } else { (b, a) };
        let absorbed = self.nodes[smaller as usize];
        self.nodes[larger as usize].absorb(&absorbed);
        self.nodes[smaller as usize].parent = larger;
        larger
    }

    /// Decides which regions are published and in which order.
    fn select(&mut self, out: &mut DetectionFrame) {
        self.kept.clear();
        for index in 0..self.runs.len() {
            let root = self.root(self.runs[index].node);
            self.runs[index].node = root;
            let node = &mut self.nodes[root as usize];
            if node.number == UNSEEN {
                node.number = UNPUBLISHED;
                if node.pixel_count >= self.min_region_px {
                    self.kept.push(root);
                }
            }
        }
        out.flags &= !DetectionFrame::REGIONS_OVERFLOW;
        if self.kept.len() > MAX_REGIONS {
            out.flags |= DetectionFrame::REGIONS_OVERFLOW;
            self.by_size.clear();
            let nodes = &self.nodes;
            self.by_size.extend(
                (0u32..)
                    .zip(&self.kept)
                    .map(|(order, &root)| (Reverse(nodes[root as usize].pixel_count), order)),
            );
            let (_, &mut last, _) = self.by_size.select_nth_unstable(MAX_REGIONS - 1);
            let mut order = 0;
            self.kept.retain(|&root| {
                let rank = (Reverse(nodes[root as usize].pixel_count), order);
                order += 1;
                rank <= last
            });
        }
        for (number, &root) in (0..).zip(&self.kept) {
            self.nodes[root as usize].number = number;
        }
    }

    /// Writes the regions, then sorts the runs into them by counting.
    fn publish(&mut self, out: &mut DetectionFrame) {
        let mut first_run = 0;
        for (region, &root) in out.regions.iter_mut().zip(&self.kept) {
            let node = &self.nodes[root as usize];
            let pixels = f64::from(node.pixel_count);
            *region = Region {
                class: u32::from(node.class),
                pixel_count: node.pixel_count,
                x_px: (node.sum_x as f64 / pixels) as f32,
                y_px: (node.sum_y as f64 / pixels) as f32,
                left: node.left,
                top: node.top,
                right: node.right,
                bottom: node.bottom,
                first_run,
                // Counts up to the node's number again while its runs are written below.
                run_count: 0,
            };
            first_run += node.run_count;
        }
        out.region_count = self.kept.len() as u32;
        out.run_count = first_run;
        for labelled in &self.runs {
            let number = self.nodes[labelled.node as usize].number;
            if number == UNPUBLISHED {
                continue;
            }
            let region = &mut out.regions[number as usize];
            out.runs[(region.first_run + region.run_count) as usize] =
                Run { reserved: 0, ..labelled.run };
            region.run_count += 1;
        }
    }
}

impl Node {
    /// The region that a run is on its own, at index `index` of the forest.
    fn of(run: &Run, index: u32) -> Self {
        let pixels = u64::from(run.pixels());
        Self {
            parent: index,
            class: run.class,
            pixel_count: run.pixels(),
            run_count: 1,
            // First and last column times half the number of columns: always a whole number.
            sum_x: (u64::from(run.begin) + u64::from(run.end) - 1) * pixels / 2,
            sum_y: u64::from(run.row) * pixels,
            left: run.begin,
            top: run.row,
            right: run.end - 1,
            bottom: run.row,
            number: UNSEEN,
        }
    }

    fn absorb(&mut self, other: &Self) {
        // No overflow: at most MAX_RUNS runs of at most 65,535 pixels.
        self.pixel_count += other.pixel_count;
        self.run_count += other.run_count;
        self.sum_x += other.sum_x;
        self.sum_y += other.sum_y;
        self.left = self.left.min(other.left);
        self.top = self.top.min(other.top);
        self.right = self.right.max(other.right);
        self.bottom = self.bottom.max(other.bottom);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use proptest::prelude::*;

    /// A picture of labels; `None` is background.
    #[derive(Debug, Clone)]
    struct Labels {
        width: usize,
        pixels: Vec<Option<u8>>,
    }

    impl Labels {
        fn height(&self) -> usize {
            self.pixels.len() / self.width
        }

        fn runs(&self) -> Vec<Run> {
            let mut runs: Vec<Run> = Vec::new();
            for (row, line) in self.pixels.chunks(self.width).enumerate() {
                let mut begin = 0;
                for stretch in line.chunk_by(|a, b| a == b) {
                    let end = begin + stretch.len();
                    if let Some(class) = stretch[0] {
                        runs.push(run(row as u16, begin as u16, end as u16, class));
                    }
                    begin = end;
                }
            }
            runs
        }

        /// Region number of every pixel, by plain flood fill in reading order.
        fn flood_fill(&self) -> Vec<Option<usize>> {
            let mut numbers = vec![None; self.pixels.len()];
            let mut next = 0;
            for start in 0..self.pixels.len() {
                if self.pixels[start].is_none() || numbers[start].is_some() {
                    continue;
                }
                let mut pending = vec![start];
                while let Some(pixel) = pending.pop() {
                    if numbers[pixel].is_some() || self.pixels[pixel] != self.pixels[start] {
                        continue;
                    }
                    numbers[pixel] = Some(next);
                    pending.extend(self.neighbours(pixel));
                }
                next += 1;
            }
            numbers
        }

        fn neighbours(&self, pixel: usize) -> impl Iterator<Item = usize> {
            let (x, y) = (pixel % self.width, pixel / self.width);
            [
                (x > 0).then(|| pixel - 1),
                (x + 1 < self.width).then(|| pixel + 1),
                (y > 0).then(|| pixel - self.width),
                (y + 1 < self.height()).then(|| pixel + self.width),
            ]
            .into_iter()
            .flatten()
        }
    }

    fn run(row: u16, begin: u16, end: u16, class: u8) -> Run {
        Run { row, begin, end, class, reserved: 0 }
    }

    fn found(width: u32, height: u32, min_region_px: u32, runs: &[Run]) -> Box<DetectionFrame> {
        let mut out = Box::new(DetectionFrame::zeroed());
        RegionFinder::new(width, height, 5, min_region_px).find(runs, &mut out);
        out
    }

    fn pixels_of(frame: &DetectionFrame, region: &Region, width: usize) -> Vec<usize> {
        frame
            .runs_of(region)
            .iter()
            .flat_map(|run| {
                (run.begin..run.end)
                    .map(move |column| usize::from(run.row) * width + usize::from(column))
            })
            .collect()
    }

    /// Pixels that mostly copy a neighbour make large, winding regions, others single pixels.
    fn labels() -> impl Strategy<Value = Labels> {
        (1usize..28, 1usize..28, 0.0..0.95f64).prop_flat_map(|(width, height, stickiness)| {
            let pixel = (prop::option::weighted(0.7, 0u8..4), 0.0..1.0f64, any::<bool>());
            prop::collection::vec(pixel, width * height).prop_map(move |draws| {
                let mut pixels: Vec<Option<u8>> = Vec::with_capacity(draws.len());
                for (index, (class, chance, from_above)) in draws.into_iter().enumerate() {
                    let neighbour = if from_above {
                        index.checked_sub(width)
                    } else {
                        (index % width > 0).then(|| index - 1)
                    };
                    pixels.push(match neighbour {
                        Some(neighbour) if chance < stickiness => pixels[neighbour],
                        _ => class,
                    });
                }
                Labels { width, pixels }
            })
        })
    }

    proptest! {
        /// The five conditions of section 5, one by one, and agreement with the flood fill.
        #[test]
        fn regions_meet_the_five_conditions(labels in labels()) {
            let (width, height) = (labels.width, labels.height());
            let frame = found(width as u32, height as u32, 1, &labels.runs());
            prop_assert_eq!(frame.flags, 0);

            let mut owner = vec![None; labels.pixels.len()];
            for (number, region) in frame.regions().iter().enumerate() {
                for pixel in pixels_of(&frame, region, width) {
                    // ii. disjoint.
                    prop_assert_eq!(owner[pixel], None, "pixel {} in two regions", pixel);
                    owner[pixel] = Some(number);
                    // iv. homogeneous.
                    prop_assert_eq!(labels.pixels[pixel].map(u32::from), Some(region.class));
                }
            }
            for pixel in 0..owner.len() {
                // i. together they are all pixels that have a class.
                prop_assert_eq!(owner[pixel].is_some(), labels.pixels[pixel].is_some());
                // v. maximal: neighbours of one class are in one region.
                for neighbour in labels.neighbours(pixel) {
                    if labels.pixels[pixel].is_some()
                        && labels.pixels[pixel] == labels.pixels[neighbour]
                    {
                        prop_assert_eq!(owner[pixel], owner[neighbour]);
                    }
                }
            }
            // iii. connected (and i, ii, v again): the same partition, in the same order, as the
            // flood fill, whose regions are connected by construction.
            prop_assert_eq!(owner, labels.flood_fill());
        }

        #[test]
        fn statistics_and_pixels_are_exact(labels in labels()) {
            let (width, height) = (labels.width, labels.height());
            let frame = found(width as u32, height as u32, 1, &labels.runs());
            let numbers = labels.flood_fill();
            for (number, region) in frame.regions().iter().enumerate() {
                let expected: Vec<usize> =
                    (0..numbers.len()).filter(|&p| numbers[p] == Some(number)).collect();
                let mut pixels = pixels_of(&frame, region, width);
                prop_assert!(pixels.is_sorted());
                pixels.dedup();
                prop_assert_eq!(&pixels, &expected);
                prop_assert_eq!(region.pixel_count as usize, expected.len());
                let count = expected.len() as f64;
                let columns = || expected.iter().map(|p| p % width);
                let rows = || expected.iter().map(|p| p / width);
                let x = columns().sum::<usize>() as f64 / count;
                let y = rows().sum::<usize>() as f64 / count;
                prop_assert_eq!((region.x_px, region.y_px), (x as f32, y as f32));
                prop_assert_eq!(Some(usize::from(region.left)), columns().min());
                prop_assert_eq!(Some(usize::from(region.right)), columns().max());
                prop_assert_eq!(Some(usize::from(region.top)), rows().min());
                prop_assert_eq!(Some(usize::from(region.bottom)), rows().max());
            }
        }

        #[test]
        fn small_regions_and_their_runs_are_left_out(labels in labels(), least in 2u32..9) {
            let (width, height) = (labels.width as u32, labels.height() as u32);
            let all = found(width, height, 1, &labels.runs());
            let large = found(width, height, least, &labels.runs());
            let expected: Vec<_> = all
                .regions()
                .iter()
                .filter(|region| region.pixel_count >= least)
                .map(|region| (*region, all.runs_of(region)))
                .collect();
            prop_assert_eq!(large.regions().len(), expected.len());
            for (region, (expected, runs)) in large.regions().iter().zip(&expected) {
                prop_assert_eq!(region.pixel_count, expected.pixel_count);
                prop_assert_eq!(large.runs_of(region), *runs);
            }
            let runs: usize = expected.iter().map(|(_, runs)| runs.len()).sum();
            prop_assert_eq!(large.run_count as usize, runs);
        }

        /// A finder that has seen another picture finds the same as a new one.
        #[test]
        fn nothing_is_left_of_the_frame_before(first in labels(), second in labels()) {
            let mut finder = RegionFinder::new(28, 28, 5, 1);
            let mut out = Box::new(DetectionFrame::zeroed());
            finder.find(&first.runs(), &mut out);
            finder.find(&second.runs(), &mut out);
            let fresh = found(28, 28, 1, &second.runs());
            prop_assert_eq!(out.regions(), fresh.regions());
            for region in fresh.regions() {
                prop_assert_eq!(out.runs_of(region), fresh.runs_of(region));
            }
        }

        #[test]
        fn rubbish_is_survived(
            runs in prop::collection::vec(
                (0u16..12, 0u16..14, 0u16..14, 0u8..8, any::<bool>(), any::<[u16; 3]>()),
                0..300,
            )
        ) {
            let runs: Vec<Run> = runs
                .into_iter()
                .map(|(row, begin, end, class, wild, any)| {
                    if wild { run(any[0], any[1], any[2], class) } else { run(row, begin, end, class) }
                })
                .collect();
            let frame = found(12, 10, 1, &runs);
            let mut total = 0;
            for region in frame.regions() {
                let runs = frame.runs_of(region);
                let pixels: u32 = runs.iter().map(Run::pixels).sum();
                prop_assert_eq!(pixels, region.pixel_count);
                prop_assert!(region.class < 5);
                prop_assert!((0.0..12.0).contains(&region.x_px));
                prop_assert!((0.0..10.0).contains(&region.y_px));
                prop_assert!(region.right < 12 && region.bottom < 10);
                total += runs.len();
            }
            prop_assert_eq!(total, frame.run_count as usize);
        }
    }

    #[test]
    fn overlapping_runs_of_a_row_share_no_pixel() {
        let frame = found(20, 10, 1, &[run(0, 2, 8, 1), run(0, 5, 12, 1), run(0, 8, 9, 2)]);
        let areas: Vec<u32> = frame.regions().iter().map(|region| region.pixel_count).collect();
        assert_eq!(areas, [6, 1]);
    }

    #[test]
    fn a_run_cut_in_two_is_one_region() {
        let frame = found(20, 10, 1, &[run(0, 2, 8, 1), run(0, 8, 12, 1)]);
        assert_eq!(frame.regions().len(), 1);
        assert_eq!(frame.regions()[0].pixel_count, 10);
    }

    #[test]
    fn rows_out_of_order_start_afresh() {
        let runs = [run(5, 0, 4, 1), run(6, 0, 4, 1), run(2, 0, 4, 1), run(3, 0, 4, 1)];
        let frame = found(20, 10, 1, &runs);
        let tops: Vec<u16> = frame.regions().iter().map(|region| region.top).collect();
        assert_eq!(tops, [5, 2]);
    }

    #[test]
    fn the_largest_regions_win_when_there_are_too_many() {
        // Every second pixel of every second row; a few of them two pixels wide.
        let mut runs = Vec::new();
        for row in (0..100u16).step_by(2) {
            for column in 0..40u16 {
                let wide = (row / 2 + column) % 7 == 0;
                runs.push(run(row, column * 4, column * 4 + 1 + u16::from(wide), 0));
            }
        }
        let frame = found(160, 100, 1, &runs);
        assert_eq!(frame.flags, DetectionFrame::REGIONS_OVERFLOW);
        assert_eq!(frame.regions().len(), MAX_REGIONS);
        let wide = runs.iter().filter(|run| run.pixels() == 2).count();
        assert!(wide > 100);
        let kept = frame.regions().iter().filter(|region| region.pixel_count == 2).count();
        assert_eq!(kept, wide);
        let corners: Vec<_> =
            frame.regions().iter().map(|region| (region.top, region.left)).collect();
        assert!(corners.is_sorted());
        assert_eq!(frame.run_count as usize, MAX_REGIONS);
    }
}
