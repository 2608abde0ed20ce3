//! How long the merging of runs takes, and the whole tracker: `cargo bench -p touchline-tracker`.
//! Answers are verified first; the pictures take turns, so that a change of the machine's mood meets
//! all of them. 640×480, eight classes, beside a plain copy of the same runs.

use bytemuck::Zeroable;
use config::Config;
use messages::{DetectionFrame, MAX_RUNS, Run, RunsHeader};
use std::hint::black_box;
use std::time::Instant;
use touchline_tracker::Tracker;
use touchline_tracker::regions::RegionFinder;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
const ROUNDS: usize = 200;

type Labels = Vec<Option<u8>>;

/// A picture, its runs, and the measurements.
struct Subject {
    name: &'static str,
    runs: Vec<Run>,
    regions: usize,
    copy_ns: Vec<u64>,
    merge_ns: Vec<u64>,
    track_ns: Vec<u64>,
}

fn main() {
    let mut subjects = [
        subject("match", match_picture()),
        subject("noise", picture(|_, _, draw| Some((draw % 8) as u8))),
        subject(
            "sparse noise",
            picture(|_, _, draw| (draw % 8 == 0).then_some((draw / 8 % 8) as u8)),
        ),
        subject("checkerboard", picture(|x, y, _| ((x + y) % 2 == 0).then_some(0))),
        subject("spiral", spiral()),
        // Teeth that nothing joins but the last row.
        subject("comb", picture(|x, y, _| (x % 2 == 0 || y + 1 == HEIGHT).then_some(0))),
        // The other way round, and with arms of all lengths.
        subject("steps", picture(|x, y, _| (x % 2 == 0 && x <= y || y + 1 == HEIGHT).then_some(0))),
    ];
    let config = Config::default();
    let finder = |least| RegionFinder::new(WIDTH as u32, HEIGHT as u32, 8, least);
    let mut all = finder(1);
    let mut finder = finder(config.tracker.min_region_px);
    let mut tracker = Tracker::new(&config).expect("the default configuration is usable");
    let mut out = Box::new(DetectionFrame::zeroed());
    let mut copy = vec![Run::zeroed(); MAX_RUNS];
    for subject in &subjects {
        all.find(&subject.runs, &mut out);
        let expected = subject.regions.min(out.regions.len());
        assert_eq!(out.regions().len(), expected, "{}: wrong number of regions", subject.name);
    }
    for _ in 0..ROUNDS {
        for subject in &mut subjects {
            let runs = &subject.runs[..];
            let header = RunsHeader { run_count: runs.len() as u32, ..RunsHeader::default() };
            // Once without a clock, as the frame before would have been one like it.
            finder.find(runs, &mut out);
            subject.merge_ns.push(timed(|| finder.find(black_box(runs), &mut out)));
            let copy = &mut copy[..runs.len()];
            subject.copy_ns.push(timed(|| black_box(copy).copy_from_slice(black_box(runs))));
            subject.track_ns.push(timed(|| tracker.step(&header, runs, None, None, &mut out)));
        }
    }
    println!(
        "{:<14} {:>7} {:>8} {:>12} {:>10} {:>10} {:>14} {:>14}",
        "picture", "runs", "regions", "merging µs", "p99", "ns a run", "copy of runs", "tracker µs"
    );
    for Subject { name, runs, regions, copy_ns, merge_ns, track_ns } in &mut subjects {
        let merge = percentile(merge_ns, 50);
        let copy = percentile(copy_ns, 50);
        println!(
            "{name:<14} {:>7} {regions:>8} {merge:>12.1} {:>10.1} {:>10.1} {:>13.1}× {:>14.1}",
            runs.len(),
            percentile(merge_ns, 99),
            1000.0 * merge / runs.len() as f64,
            merge / copy,
            percentile(track_ns, 50),
        );
    }
}

fn timed(work: impl FnOnce()) -> u64 {
    let start = Instant::now();
    work();
    start.elapsed().as_nanos() as u64
}

fn percentile(times_ns: &mut [u64], percent: usize) -> f64 {
    times_ns.sort_unstable();
    times_ns[(times_ns.len() - 1) * percent / 100] as f64 / 1000.0
}

fn subject(name: &'static str, labels: Labels) -> Subject {
    let mut runs = runs_of(&labels);
    runs.truncate(MAX_RUNS);
    let rows = runs.last().map_or(0, |run| usize::from(run.row) + 1);
    let mut seen = labels[..rows * WIDTH].to_vec();
    // The last row may have been cut.
    let end = runs.last().map_or(0, |run| usize::from(run.end));
    seen[(rows - 1) * WIDTH + end..].fill(None);
    let regions = count_regions(&mut seen);
    let (copy_ns, merge_ns, track_ns) = Default::default();
    Subject { name, runs, regions, copy_ns, merge_ns, track_ns }
}

fn picture(mut label: impl FnMut(usize, usize, u64) -> Option<u8>) -> Labels {
    let mut state = 1u64;
    (0..WIDTH * HEIGHT)
        .map(|index| {
            // The high bits of a linear congruential generator (Knuth's MMIX) are random enough.
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            label(index % WIDTH, index / WIDTH, state >> 33)
        })
        .collect()
}

/// Squares of nine pixels: two for each of ten robots, a ball, and a few specks.
fn match_picture() -> Labels {
    picture(|x, y, draw| {
        let (column, row) = (x / 120, y / 150);
        let patch = |dx: usize, dy: usize| {
            (20 + dx..29 + dx).contains(&(x % 120)) && (30 + dy..39 + dy).contains(&(y % 150))
        };
        let number = row * 5 + column;
        match number {
            0..10 if patch(0, 0) => Some(1 + (number % 2) as u8),
            0..10 if patch(10, 10) => Some(3 + (number / 2) as u8),
            12 if patch(0, 0) => Some(0),
            _ => (draw % 5000 == 0).then_some((draw / 5000 % 8) as u8),
        }
    })
}

/// One line that winds from the outside to the middle: every row joins regions that began apart.
fn spiral() -> Labels {
    let mut labels = vec![None; WIDTH * HEIGHT];
    let (mut left, mut top, mut right, mut bottom) = (0, 0, WIDTH - 1, HEIGHT - 1);
    let mut paint = |xs: std::ops::RangeInclusive<usize>, ys: std::ops::RangeInclusive<usize>| {
        for y in ys {
            labels[y * WIDTH..][xs.clone()].fill(Some(0));
        }
    };
    while left + 4 < right && top + 4 < bottom {
        paint(left..=right, top..=top);
        paint(right..=right, top..=bottom);
        paint(left..=right, bottom..=bottom);
        paint(left..=left, top + 2..=bottom);
        // The next turn begins where this one ends.
        paint(left..=left + 2, top + 2..=top + 2);
        (left, top, right, bottom) = (left + 2, top + 2, right - 2, bottom - 2);
    }
    labels
}

fn runs_of(labels: &Labels) -> Vec<Run> {
    let mut runs = Vec::new();
    for (row, line) in (0u16..).zip(labels.chunks(WIDTH)) {
        let mut begin = 0u16;
        for stretch in line.chunk_by(|a, b| a == b) {
            let end = begin + stretch.len() as u16;
            if let Some(class) = stretch[0] {
                runs.push(Run { row, begin, end, class, reserved: 0 });
            }
            begin = end;
        }
    }
    runs
}

/// By plain flood fill, which takes the labels away.
fn count_regions(labels: &mut Labels) -> usize {
    let mut count = 0;
    let mut pending = Vec::new();
    for start in 0..labels.len() {
        let Some(class) = labels[start] else { continue };
        count += 1;
        pending.push(start);
        while let Some(pixel) = pending.pop() {
            if labels[pixel] != Some(class) {
                continue;
            }
            labels[pixel] = None;
            let x = pixel % WIDTH;
            pending.extend((x > 0).then(|| pixel - 1));
            pending.extend((x + 1 < WIDTH).then(|| pixel + 1));
            pending.extend(pixel.checked_sub(WIDTH));
            pending.extend((pixel + WIDTH < labels.len()).then(|| pixel + WIDTH));
        }
    }
    count
}
