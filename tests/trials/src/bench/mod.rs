//! `touchline bench`: measures processing times of a frame on this machine, relative to a plain copy of
//! it.
//!
//! Answers are verified first. Then all candidates take turns, so that changes of the machine's speed
//! affect all of them alike, and medians are reported. "Hot" repeats the same frame; "cold" cycles
//! through so many frames that none is in a cache, as when a camera has just written it.
//!
//! Painted pictures have ideal colours: boxes that overlap neither each other nor the background. On
//! request, the configuration's own colours are measured on pictures of its own camera instead.

mod light;
mod own;
mod pictures;
mod stages;

use crate::TrialError;
use crate::args::BenchArgs;
use classifier::{Classifier, SimdLevel};
use config::Config;
use light::LightRow;
use messages::{DetectionFrame, MAX_RUNS, Run, RunsHeader};
use own::PictureRow;
use pictures::{Content, Picture};
use runtime::output::Reader;
use runtime::user_config::load_config;
use serde::Serialize;
use stages::Stages;
use std::hint::black_box;
use std::io;
use std::process::ExitCode;
use std::time::{Duration, Instant};
use tracker::regions::RegionFinder;

/// Most frames, and most bytes of them, that a cold measurement cycles through.
const COLD_FRAMES: usize = 256;
const COLD_BYTES: usize = 128 << 20;
/// Fewest rounds of a measurement, regardless of the time.
const FEWEST_ROUNDS: usize = 7;

/// The measured subjects: size, classes, content.
const SUBJECTS: [(u32, u32, usize, Content); 9] = [
    (640, 480, 13, Content::Foreground(0.005)),
    (1280, 960, 13, Content::Foreground(0.005)),
    (1920, 1200, 13, Content::Foreground(0.005)),
    (2448, 2048, 13, Content::Foreground(0.005)),
    (640, 480, 1, Content::Foreground(0.005)),
    (640, 480, 8, Content::Foreground(0.005)),
    (640, 480, 32, Content::Foreground(0.005)),
    (640, 480, 13, Content::Foreground(0.12)),
    (640, 480, 13, Content::Noise),
];

/// All results.
#[derive(Debug, Serialize)]
struct Outcome {
    cpu: String,
    processors: usize,
    rows: Vec<Row>,
    stages: Stages,
    light: Vec<LightRow>,
}

/// All results for a configuration and pictures of its own.
#[derive(Debug, Serialize)]
struct OwnOutcome {
    cpu: String,
    processors: usize,
    pictures: Vec<PictureRow>,
}

/// The results for one picture.
#[derive(Debug, Serialize)]
struct Row {
    width: u32,
    height: u32,
    classes: usize,
    content: String,
    runs: usize,
    /// Copy of the same frame every time, and of another frame every time.
    copy_hot_us: f64,
    copy_cold_us: f64,
    levels: Vec<LevelRow>,
    /// Merging the runs into regions.
    merging_us: f64,
    merging_ns_per_run: f64,
}

/// Classification at one SIMD level.
#[derive(Debug, Serialize)]
struct LevelRow {
    level: &'static str,
    hot_us: f64,
    cold_us: f64,
    /// Ratio to a copy of the frame.
    hot_ratio: f64,
    cold_ratio: f64,
    /// The same, with the merging of runs into regions.
    regions_hot_ratio: f64,
    regions_cold_ratio: f64,
}

/// Runs the benchmark.
pub fn bench(args: BenchArgs) -> Result<ExitCode, TrialError> {
    let budget = Duration::from_millis(if args.full { 2500 } else { 300 });
    let (cpu, processors) =
        (cpu_name(), std::thread::available_parallelism().map_or(1, usize::from));
    if !args.json {
        runtime::say_line!(
            "{cpu}, {processors} processors; medians, one core; × is times a copy of the frame"
        )?;
    }
    if args.config.is_some() || !args.pictures.is_empty() {
        let config = load_config(args.config.as_deref())?;
        let shown_for = (!args.json).then_some(processors);
        let (pictures, all_good) = own::measure(&config, &args.pictures, budget, shown_for)?;
        if args.json {
            let outcome = OwnOutcome { cpu, processors, pictures };
            runtime::say_line!("{}", serde_json::to_string_pretty(&outcome)?)?;
        }
        return Ok(if all_good { ExitCode::SUCCESS } else { ExitCode::FAILURE });
    }
    if !args.json {
        runtime::say_line!(
            "painted pictures, ideal colours; --config FILE PICTURE … measures your own"
        )?;
    }
    let mut rows = Vec::new();
    for (number, &(width, height, classes, content)) in SUBJECTS.iter().enumerate() {
        if !args.json {
            runtime::tell_part!("\r{} of {} …\r", number + 1, SUBJECTS.len());
        }
        let row = measure(&Picture::new(width, height, classes, content), budget)?;
        if !args.json && show(&row)? == Reader::Gone {
            return Ok(ExitCode::SUCCESS);
        }
        rows.push(row);
    }
    let config = Config::default();
    let stages = stages::measure(&config, &pictures::match_frames(&config)?, budget)?;
    let light = light::measure(4 * budget)?;
    if args.json {
        let outcome = Outcome { cpu, processors, rows, stages, light };
        runtime::say_line!("{}", serde_json::to_string_pretty(&outcome)?)?;
    } else {
        stages.show("a match frame", processors)?;
        light::show(&light)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn measure(picture: &Picture, budget: Duration) -> Result<Row, TrialError> {
    let Picture { width, height, classes, content, config, header, .. } = picture;
    let levels = SimdLevel::available();
    let mut classifiers = levels
        .iter()
        .map(|&level| Classifier::with_level(config, level))
        .collect::<Result<Vec<_>, _>>()?;
    // Room for all runs: noise has more of them than a message holds, and all are to be measured.
    let mut runs =
        vec![Run { row: 0, begin: 0, end: 0, class: 0, reserved: 0 }; picture.pixels.len()];
    let mut out_header = RunsHeader::default();

    // The last level is the scalar code, which is the specification.
    let mut expected: Option<Vec<Run>> = None;
    for (classifier, level) in classifiers.iter_mut().zip(&levels).rev() {
        classifier.step(header, &picture.pixels, &mut out_header, &mut runs)?;
        let found = out_header.valid(&runs);
        match &expected {
            Some(expected) if expected == found => {}
            Some(_) => return Err(format!("{level} gives other runs than the scalar code").into()),
            None => expected = Some(found.to_vec()),
        }
    }
    let mut found = expected.unwrap_or_default();
    found.truncate(MAX_RUNS);
    let mut finder = RegionFinder::new(*width, *height, *classes as u32, 1);
    let mut detections: Box<DetectionFrame> = Box::new(bytemuck::Zeroable::zeroed());
    finder.find(&found, &mut detections);
    let regions = detections.regions().len();
    if regions != picture.count_regions(&found).min(detections.regions.len()) {
        return Err("the merging of runs gives other regions than a flood fill".into());
    }
    // With the configured threshold: smaller regions are noise.
    let least = Config::default().tracker.min_region_px;
    let mut finder = RegionFinder::new(*width, *height, *classes as u32, least);

    let bytes = picture.pixels.len();
    let count = (COLD_BYTES / bytes).clamp(3, COLD_FRAMES);
    let cold = vec![picture.pixels.clone(); count];
    // Placed at another offset in a page than its source: at the same offset, copying takes many times
    // as long.
    let mut copy = vec![0u8; bytes + 2048];
    let copy = &mut copy[2048..];
    let (mut copy_hot, mut copy_cold, mut merging) = (Vec::new(), Vec::new(), Vec::new());
    let mut hot_us = vec![Vec::new(); levels.len()];
    let mut cold_us = vec![Vec::new(); levels.len()];
    let started = Instant::now();
    let mut next = 0;
    let mut other = || {
        next = (next + 1) % count;
        &cold[next]
    };
    while started.elapsed() < budget || merging.len() < FEWEST_ROUNDS {
        copy.copy_from_slice(&picture.pixels);
        copy_hot
            .push(timed(|| black_box(&mut copy[..]).copy_from_slice(black_box(&picture.pixels))));
        let source = other();
        copy_cold.push(timed(|| black_box(&mut copy[..]).copy_from_slice(black_box(source))));
        for (index, classifier) in classifiers.iter_mut().enumerate() {
            let mut classify = |pixels: &[u8]| {
                timed(|| {
                    // Checked to succeed above.
                    let _ = classifier.step(header, black_box(pixels), &mut out_header, &mut runs);
                })
            };
            classify(&picture.pixels);
            hot_us[index].push(classify(&picture.pixels));
            cold_us[index].push(classify(other()));
        }
        finder.find(&found, &mut detections);
        merging.push(timed(|| finder.find(black_box(&found), &mut detections)));
    }

    let (copy_hot_us, copy_cold_us) = (median(&mut copy_hot), median(&mut copy_cold));
    let merging_us = median(&mut merging);
    let levels = levels
        .iter()
        .zip(hot_us.iter_mut().zip(&mut cold_us))
        .map(|(level, (hot, cold))| {
            let (hot_us, cold_us) = (median(hot), median(cold));
            LevelRow {
                level: level.name(),
                hot_us,
                cold_us,
                hot_ratio: hot_us / copy_hot_us,
                cold_ratio: cold_us / copy_cold_us,
                regions_hot_ratio: (hot_us + merging_us) / copy_hot_us,
                regions_cold_ratio: (cold_us + merging_us) / copy_cold_us,
            }
        })
        .collect();
    Ok(Row {
        width: *width,
        height: *height,
        classes: *classes,
        content: content.to_string(),
        runs: found.len(),
        copy_hot_us,
        copy_cold_us,
        levels,
        merging_us,
        merging_ns_per_run: 1000.0 * merging_us / found.len().max(1) as f64,
    })
}

fn show(row: &Row) -> io::Result<Reader> {
    let mut reader = runtime::say_line!(
        "{}×{}, {} classes, {}: copy {:.1} µs hot, {:.1} cold; {} runs, merging {:.1} µs ({:.1} ns a run)",
        row.width,
        row.height,
        row.classes,
        row.content,
        row.copy_hot_us,
        row.copy_cold_us,
        row.runs,
        row.merging_us,
        row.merging_ns_per_run,
    )?;
    for level in &row.levels {
        reader = runtime::say_line!(
            "    {:<8} {:>9.1} µs hot ({:>6.1}×)  {:>9.1} µs cold ({:>6.1}×)  with merging {:>6.1}× hot, {:>5.1}× cold",
            level.level,
            level.hot_us,
            level.hot_ratio,
            level.cold_us,
            level.cold_ratio,
            level.regions_hot_ratio,
            level.regions_cold_ratio,
        )?;
    }
    Ok(reader)
}

/// Duration in microseconds.
fn timed(work: impl FnOnce()) -> f64 {
    let start = Instant::now();
    work();
    start.elapsed().as_secs_f64() * 1e6
}

fn median(times: &mut [f64]) -> f64 {
    times.sort_unstable_by(f64::total_cmp);
    times.get(times.len() / 2).copied().unwrap_or(0.0)
}

fn cpu_name() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info.lines().find_map(|line| line.strip_prefix("model name"));
    name.map_or("unknown processor".into(), |name| name.trim_start_matches(['\t', ' ', ':']).into())
}
