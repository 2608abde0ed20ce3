//! The cost of light correction in the classifier: frames of a synthetic match under uneven lamps,
//! classified without correction and with one correction after the other switched on.

use super::pictures::match_frames;
use super::{FEWEST_ROUNDS, median, timed};
use crate::TrialError;
use classifier::{Classifier, SimdChoice, SimdLevel};
use config::{Config, LightConfig};
use messages::{FrameHeader, MAX_RUNS, Run, RunsHeader};
use serde::Serialize;
use std::hint::black_box;
use std::io;
use std::time::{Duration, Instant};

/// Classification time of a frame with some corrections, in microseconds.
#[derive(Debug, Serialize)]
pub struct LightRow {
    pub corrections: &'static str,
    pub classifier_us: f64,
    /// 99th percentile.
    pub p99_us: f64,
    /// Ratio to the time without corrections.
    pub ratio: f64,
    /// Runs found in the first frame.
    pub runs: usize,
    /// Share of the frames whose gains differ from those of the frame before.
    pub changed: f64,
}

/// Corrections, each added to the ones before it. No pixel of these frames is under glare, as in most
/// frames.
const CORRECTIONS: [&str; 5] = ["none", "lamps", "unevenness", "glare", FLICKER];
/// All corrections, but the brightness alternates from frame to frame so much that all tables have to be
/// recomputed.
const FLICKER: &str = "all, flicker";
const BRIGHTER: f64 = 1.25;

/// Measures all corrections, taking turns on each frame.
pub fn measure(budget: Duration) -> Result<Vec<LightRow>, TrialError> {
    let mut config = Config::default();
    config.synthetic.gradient = 0.4;
    config.synthetic.vignette = 0.5;
    let frames = match_frames(&config)?;
    let brighter: Vec<Vec<u8>> = frames
        .iter()
        .map(|frame| frame.iter().map(|&value| (f64::from(value) * BRIGHTER) as u8).collect())
        .collect();
    let header = FrameHeader { t_capture_ns: 1_000_000_000, ..config.camera.frame_header() };
    let mut runs_header = RunsHeader::default();
    let mut runs = vec![Run::default(); MAX_RUNS];

    let mut classifiers = Vec::new();
    let mut counts = Vec::new();
    for number in 0..CORRECTIONS.len() {
        config.light = LightConfig {
            follow: number > 0,
            brightness: 1.0,
            unevenness: if number > 1 { 1.0 } else { 0.0 },
            glare: number > 2,
            ..config.light
        };
        let mut classifier = Classifier::new(&config)?;
        let mut specified = Classifier::with_level(&config, SimdLevel::Scalar)?;
        let [found, expected] = [&mut classifier, &mut specified].map(|classifier| {
            let step = classifier.step(&header, &frames[0], &mut runs_header, &mut runs);
            step.map(|()| runs_header.valid(&runs).to_vec())
        });
        let (found, expected) = (found?, expected?);
        if found != expected {
            let level = SimdChoice::of_process().level;
            return Err(format!("{level} gives other runs than the scalar code").into());
        }
        counts.push(found.len());
        classifiers.push((classifier, Vec::new()));
    }

    let started = Instant::now();
    let mut rounds = 0;
    while started.elapsed() < budget || rounds < FEWEST_ROUNDS {
        for (index, (classifier, times)) in classifiers.iter_mut().enumerate() {
            // Each gets a frame that the others have not just brought into the caches.
            let number = (rounds + index * frames.len() / CORRECTIONS.len()) % frames.len();
            let is_brighter = CORRECTIONS[index] == FLICKER && rounds % 2 == 1;
            let frame = if is_brighter { &brighter[number] } else { &frames[number] };
            times.push(timed(|| {
                // Checked to succeed above.
                let _ = classifier.step(&header, black_box(frame), &mut runs_header, &mut runs);
            }));
        }
        rounds += 1;
    }
    let as_it_is = median(&mut classifiers[0].1);
    let rows = CORRECTIONS.into_iter().zip(classifiers).zip(counts);
    let rows = rows.map(|((corrections, (classifier, mut times)), runs)| {
        let classifier_us = median(&mut times);
        LightRow {
            corrections,
            classifier_us,
            p99_us: times[(times.len() - 1) * 99 / 100],
            ratio: classifier_us / as_it_is,
            runs,
            changed: classifier.light().changes as f64 / times.len() as f64,
        }
    });
    Ok(rows.collect())
}

/// Prints the rows as text.
pub fn show(rows: &[LightRow]) -> io::Result<()> {
    runtime::say_line!(
        "a match frame under uneven lamps, cold: the classifier, one correction after the other"
    )?;
    for row in rows {
        runtime::say_line!(
            "    {:<12} {:>9.1} µs ({:>4.2}×), 99 % below {:>6.1}; {} runs; gains changed in {:.0} % of frames",
            row.corrections,
            row.classifier_us,
            row.ratio,
            row.p99_us,
            row.runs,
            100.0 * row.changed,
        )?;
    }
    Ok(())
}
