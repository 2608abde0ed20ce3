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

/// The contract of [`RegionFinder::find`] implemented literally: the runs of each region.
fn plainly_connected(width: u16, height: u16, runs: &[Run]) -> Vec<Vec<Run>> {
    let mut usable: Vec<Run> = Vec::new();
    for run in runs.iter().map(|&run| Run { reserved: 0, ..run }) {
        let is_valid = run.begin < run.end && run.end <= width && run.row < height && run.class < 5;
        let overlaps = |left: &Run| left.row == run.row && left.end > run.begin;
        if is_valid && !usable.last().is_some_and(overlaps) {
            usable.push(run);
        }
    }
    let rows: Vec<&[Run]> = usable.chunk_by(|a, b| a.row == b.row).collect();
    // For each run, by row, the region's number; those of one region are made equal as they meet.
    let mut numbers: Vec<usize> = (0..usable.len()).collect();
    let mut first = 0;
    let mut first_above = 0;
    for (index, row) in rows.iter().enumerate() {
        let above = index.checked_sub(1).map_or(&[][..], |above| rows[above]);
        for (here, run) in (first..).zip(*row) {
            let is_one = |(node, other): (usize, &Run)| {
                let touches = if other.row == run.row {
                    other.end == run.begin
                } else {
                    other.row + 1 == run.row && other.begin < run.end && run.begin < other.end
                };
                (touches && other.class == run.class).then_some(node)
            };
            let others = (first_above..).zip(above).chain((first..here).zip(*row));
            for other in others.filter_map(is_one) {
                let (a, b) = (numbers[other], numbers[here]);
                numbers.iter_mut().filter(|n| **n == a.max(b)).for_each(|n| *n = a.min(b));
            }
        }
        (first_above, first) = (first, first + row.len());
    }
    let region = |number: usize| -> Vec<Run> {
        let own = usable.iter().zip(&numbers).filter(|&(_, &n)| n == number);
        own.map(|(run, _)| *run).collect()
    };
    (0..usable.len()).map(region).filter(|runs| !runs.is_empty()).collect()
}

fn regions_of(frame: &DetectionFrame) -> Vec<Vec<Run>> {
    frame.regions().iter().map(|region| frame.runs_of(region).to_vec()).collect()
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
        ),
        sorted in any::<bool>(),
    ) {
        let mut runs: Vec<Run> = runs
            .into_iter()
            .map(|(row, begin, end, class, wild, any)| {
                let rubbish = Run { reserved: class, ..run(any[0], any[1], any[2], class) };
                if wild { rubbish } else { run(row, begin, end, class) }
            })
            .collect();
        if sorted {
            runs.sort_by_key(|run| (run.row, run.begin));
        }
        let frame = found(12, 10, 1, &runs);
        prop_assert_eq!(regions_of(&frame), plainly_connected(12, 10, &runs));
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
    let corners: Vec<_> = frame.regions().iter().map(|region| (region.top, region.left)).collect();
    assert!(corners.is_sorted());
    assert_eq!(frame.run_count as usize, MAX_REGIONS);
}
