//! `touchline stress`: measures the frame rate that this machine sustains.
//!
//! Groups run one after the other, each at a higher rate, fed by an injector of negligible cost, until
//! one loses a frame. Rates in between narrow down, to within a few per cent, the highest that loses
//! none.

use crate::TrialError;
use crate::args::StressArgs;
use config::{Config, GeometryConfig, commented_toml};
use control::Report;
use control::report::{Breakdown, Percentiles};
use grabber::source::{LOOP_FRAMES, Source};
use runtime::user_config::load_config;
use serde::Serialize;
use std::fs::{self, DirBuilder};
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;
use std::process::ExitCode;

/// Rates rise by this factor …
const STEP: f64 = 1.5;
/// … and are then bisected geometrically until the ratio of the bounds is this small.
const PRECISION: f64 = 1.06;
/// Highest rate that a configuration allows.
const HIGHEST_FPS: f64 = 10_000.0;
/// Memory limit for the frames painted in advance.
const LOOP_BYTES: usize = 128 << 20;
/// Fewest frames for a result.
const FEWEST_FRAMES: f64 = 100.0;

/// The results.
#[derive(Debug, Serialize)]
struct Outcomes {
    width: u32,
    height: u32,
    /// Highest rate without any loss; 0 if there was none.
    sustained_fps: f64,
    /// The runs, by rate.
    runs: Vec<Run>,
}

/// The results at one rate.
#[derive(Debug, Clone, Serialize)]
struct Run {
    fps: f64,
    seconds: f64,
    frames: u64,
    /// Captured, but missing in `world`.
    missing: u64,
    /// Never captured: the injector itself could not keep up.
    not_captured: u64,
    latency_us: Percentiles,
    breakdown_us: Breakdown,
    /// Processor time relative to one processor: the injector, the other stages, supervisor and monitor.
    injector_cpu_percent: f64,
    stages_cpu_percent: f64,
    supervisor_cpu_percent: f64,
    memory_bytes: u64,
    robots_found: u32,
}

impl Run {
    fn is_lossless(&self) -> bool {
        self.missing + self.not_captured == 0 && self.frames > 0
    }
}

/// Runs the measurement.
pub fn stress(args: StressArgs) -> Result<ExitCode, TrialError> {
    let mut config = load_config(args.config.as_deref())?;
    if let Some((width, height)) = args.size {
        (config.camera.width, config.camera.height) = (width, height);
        let camera_height_mm = config.geometry.camera_mm[2];
        config.geometry =
            GeometryConfig::above(&config.field, config.camera.picture_px(), camera_height_mm);
    }
    let runs = search(args.from, |fps| {
        let run = run_at(&config, &args, fps)?;
        if !args.json {
            show(&run)?;
        }
        Ok(run)
    })?;
    let lossless = runs.iter().filter(|run| run.is_lossless());
    let sustained_fps = lossless.map(|run| run.fps).fold(0.0, f64::max);
    let (width, height) = (config.camera.width, config.camera.height);
    if args.json {
        let outcomes = Outcomes { width, height, sustained_fps, runs };
        runtime::say_line!("{}", serde_json::to_string_pretty(&outcomes)?)?;
    } else {
        runtime::say_line!(
            "{width}×{height}: {sustained_fps:.0} frames a second without losing one"
        )?;
    }
    Ok(if sustained_fps > 0.0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Searches for the highest rate: upwards from `first`, then between the highest without and the lowest
/// with losses.
fn search(
    first: f64,
    mut run: impl FnMut(f64) -> Result<Run, TrialError>,
) -> Result<Vec<Run>, TrialError> {
    let mut runs = Vec::new();
    let (mut good, mut bad): (Option<f64>, Option<f64>) = (None, None);
    loop {
        let fps = match (good, bad) {
            (None, None) => first,
            (Some(good), None) if good < HIGHEST_FPS => (good * STEP).min(HIGHEST_FPS),
            (None, Some(bad)) if bad > 2.0 => bad / 2.0,
            (Some(good), Some(bad)) if bad / good > PRECISION => f64::sqrt(good * bad),
            _ => return Ok(runs),
        };
        let fps = fps.round();
        let outcome = run(fps)?;
        if outcome.is_lossless() {
            good = Some(fps);
        } else {
            bad = Some(fps);
        }
        runs.push(outcome);
    }
}

fn run_at(config: &Config, args: &StressArgs, fps: f64) -> Result<Run, TrialError> {
    let mut config = config.clone();
    config.camera.fps = fps;
    let affordable = (LOOP_BYTES / config.camera.frame_bytes().max(1)).max(1) as u32;
    let source = Source::Loop(LOOP_FRAMES.min(affordable));
    let frames = (fps * args.seconds).max(FEWEST_FRAMES) as u64;
    let place = Place::create()?;
    let (config_file, report_file) = (place.0.join("config.toml"), place.0.join("report.json"));
    fs::write(&config_file, commented_toml(&config))?;
    let ended = Command::new("/proc/self/exe")
        .arg0("touchline")
        .args(["run", "--quiet", "--no-console", "--instance", &args.instance])
        .args(["--source", &source.to_string(), "--frames", &frames.to_string(), "--config"])
        .arg(&config_file)
        .arg("--report")
        .arg(&report_file)
        .status()?;
    let report = fs::read(&report_file).ok().filter(|_| ended.success());
    let report = report.ok_or("the group did not end as it should; its messages are above")?;
    let report: Report = serde_json::from_slice(&report)?;
    Ok(Run::of(&report, fps, frames))
}

/// A directory for the files of one run, removed in the end.
struct Place(PathBuf);

impl Place {
    fn create() -> io::Result<Self> {
        let place = std::env::temp_dir().join(format!("tl-stress-{}", std::process::id()));
        DirBuilder::new().mode(0o700).create(&place)?;
        Ok(Self(place))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

impl Run {
    fn of(report: &Report, fps: f64, asked_frames: u64) -> Self {
        let seconds = report.elapsed_s.max(0.001);
        let percent = |cpu_seconds: f64| (cpu_seconds / seconds * 1000.0).round() / 10.0;
        let of_stage = |stage: &str| report.stages.get(stage).map_or(0.0, |s| s.cpu_seconds);
        let all: f64 = report.stages.values().map(|stage| stage.cpu_seconds).sum();
        let injector = of_stage("grabber");
        Self {
            fps,
            seconds,
            frames: report.frames.captured,
            missing: report.frames.missing_in_world,
            not_captured: asked_frames.saturating_sub(report.frames.captured),
            latency_us: report.latency_us.capture_to_world.clone(),
            breakdown_us: report.latency_us.breakdown.clone(),
            injector_cpu_percent: percent(injector),
            stages_cpu_percent: percent(all - injector),
            supervisor_cpu_percent: percent(report.resources.supervisor_cpu_seconds),
            memory_bytes: report.resources.memory_bytes,
            robots_found: report.found.robots,
        }
    }
}

fn show(run: &Run) -> io::Result<()> {
    let Percentiles { p50, p99, max, .. } = run.latency_us;
    let verdict = match (run.missing, run.not_captured) {
        (0, 0) => "nothing lost".to_string(),
        (missing, 0) => format!("{missing} lost"),
        (missing, late) => format!("{missing} lost, {late} not captured in time"),
    };
    runtime::say_line!(
        "{:>6.0} fps  {:>7} frames  {verdict:<32}  world after {p50:>6.0} µs (p99 {p99:.0}, max {max:.0})  \
         CPU: injector {:.0} %, stages {:.0} %, supervisor {:.0} %  {} MB",
        run.fps,
        run.frames,
        run.injector_cpu_percent,
        run.stages_cpu_percent,
        run.supervisor_cpu_percent,
        run.memory_bytes / 1_000_000,
    )?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(fps: f64, is_lossless: bool) -> Run {
        let report = Report::default();
        let mut run = Run::of(&report, fps, 0);
        (run.frames, run.missing) = (1000, u64::from(!is_lossless));
        run
    }

    fn sustained(first: f64, limit: f64) -> (f64, usize) {
        let runs = search(first, |fps| Ok(at(fps, fps <= limit))).unwrap();
        let lossless = runs.iter().filter(|run| run.is_lossless());
        (lossless.map(|run| run.fps).fold(0.0, f64::max), runs.len())
    }

    #[test]
    fn the_highest_rate_is_found_from_below_and_from_above() {
        for limit in [95.0, 300.0, 2999.0] {
            for first in [80.0, 1000.0] {
                let (found, runs) = sustained(first, limit);
                assert!(found <= limit && found * 1.07 >= limit, "{found} of {limit} from {first}");
                assert!(runs < 20, "{runs} runs");
            }
        }
    }

    #[test]
    fn it_ends_at_the_highest_rate_there_is_and_when_nothing_works() {
        assert_eq!(sustained(80.0, f64::INFINITY).0, HIGHEST_FPS);
        let (found, runs) = sustained(80.0, 0.0);
        assert!(found == 0.0 && runs < 12);
    }
}
