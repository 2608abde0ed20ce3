//! Measures the stages on frames, and derives the frame rate.

use super::{FEWEST_ROUNDS, median, timed};
use crate::TrialError;
use classifier::{Classifier, SimdLevel};
use config::Config;
use messages::{FrameHeader, MAX_RUNS, Run, RunsHeader};
use offline::chain::Chain;
use runtime::output::Reader;
use serde::Serialize;
use std::hint::black_box;
use std::io;
use std::time::{Duration, Instant};

/// Time of each stage for a frame, in microseconds.
#[derive(Debug, Serialize)]
pub struct Stages {
    pub width: u32,
    pub height: u32,
    /// SIMD level of the classifier.
    pub level: &'static str,
    /// Copying a frame into shared memory, as an injector does.
    pub copy_us: f64,
    pub classifier_us: f64,
    pub tracker_us: f64,
    pub filter_us: f64,
    /// Sum of all stages, without transport between them.
    pub sum_us: f64,
    /// 99th percentile of that sum.
    pub sum_p99_us: f64,
    /// Runs in the last frame.
    pub runs: usize,
    pub robots_found: usize,
}

/// Bookkeeping and wake-ups on the way of a frame, for all stages together: the difference between
/// `touchline stress` and the sum of the stages.
const WAYS_US: f64 = 60.0;

impl Stages {
    /// Sustained frame rate, limited by the slowest stage and by the processors together.
    fn sustained_fps(&self, processors: usize) -> f64 {
        let slowest = [self.copy_us, self.classifier_us, self.tracker_us, self.filter_us]
            .into_iter()
            .fold(0.0, f64::max);
        let together_us = (self.sum_us + WAYS_US) / processors as f64;
        1e6 / together_us.max(slowest + WAYS_US / 4.0)
    }

    /// Prints the row as text.
    pub fn show(&self, name: &str, processors: usize) -> io::Result<Reader> {
        runtime::say_line!(
            "{name}, {}×{}, cold: copy {:.1}, classifier ({}) {:.1}, tracker {:.1}, filter {:.1}: \
             {:.1} µs in all (99 % below {:.1}); {} runs, {} robots found",
            self.width,
            self.height,
            self.copy_us,
            self.level,
            self.classifier_us,
            self.tracker_us,
            self.filter_us,
            self.sum_us,
            self.sum_p99_us,
            self.runs,
            self.robots_found,
        )?;
        runtime::say_line!(
            "on {processors} processors that is some {:.0} frames a second; `touchline stress` measures it",
            self.sustained_fps(processors)
        )
    }
}

/// Runs frames through the stages, one after the other: enough frames that none is still in a cache when
/// its turn comes again.
pub fn measure(
    config: &Config,
    frames: &[Vec<u8>],
    budget: Duration,
) -> Result<Stages, TrialError> {
    let (count, bytes) = (frames.len(), config.camera.frame_bytes());
    let mut chain = Chain::new(config)?;
    let mut copy = vec![0; bytes];
    verify(config, &frames[0], &mut chain)?;
    let mut times: [Vec<f64>; 4] = Default::default();
    let started = Instant::now();
    let mut seq = 0;
    while started.elapsed() < budget || times[0].len() < FEWEST_ROUNDS {
        // Forwards and backwards, so that nothing jumps.
        let period = (2 * (count as u64 - 1)).max(1);
        let frame = &frames[(seq % period).min(period - seq % period) as usize];
        let header = FrameHeader {
            seq,
            t_capture_ns: (1_000_000_000.0 * (1.0 + seq as f64 / config.camera.fps)) as u64,
            ..config.camera.frame_header()
        };
        times[0].push(timed(|| black_box(&mut copy).copy_from_slice(black_box(frame))));
        let mut fault = None;
        times[1].push(timed(|| {
            fault = chain.classify(&header, black_box(frame)).err();
        }));
        if let Some(fault) = fault {
            return Err(fault.into());
        }
        times[2].push(timed(|| chain.track(frame)));
        times[3].push(timed(|| chain.filter(header.t_capture_ns)));
        seq += 1;
    }
    let last = times[0].len() - 1;
    let mut sums: Vec<f64> = (0..=last).map(|i| times.iter().map(|times| times[i]).sum()).collect();
    sums.sort_unstable_by(f64::total_cmp);
    let [copy_us, classifier_us, tracker_us, filter_us] =
        times.each_mut().map(|times| median(times));
    Ok(Stages {
        width: config.camera.width,
        height: config.camera.height,
        level: chain.classifier().level().name(),
        copy_us,
        classifier_us,
        tracker_us,
        filter_us,
        sum_us: copy_us + classifier_us + tracker_us + filter_us,
        sum_p99_us: sums[last * 99 / 100],
        runs: chain.runs().len(),
        robots_found: chain.detections().robots().len(),
    })
}

/// Whether the classifier's output equals that of the scalar code, which is the specification.
fn verify(config: &Config, frame: &[u8], chain: &mut Chain) -> Result<(), TrialError> {
    let header = config.camera.frame_header();
    let mut runs_header = RunsHeader::default();
    let mut runs = vec![Run { row: 0, begin: 0, end: 0, class: 0, reserved: 0 }; MAX_RUNS];
    let mut specified = Classifier::with_level(config, SimdLevel::Scalar)?;
    specified.step(&header, frame, &mut runs_header, &mut runs)?;
    chain.classify(&header, frame)?;
    if chain.runs() != runs_header.valid(&runs) {
        let level = chain.classifier().level();
        return Err(format!("{level} gives other runs than the scalar code").into());
    }
    Ok(())
}
