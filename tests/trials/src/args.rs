//! The arguments of the commands.

use crate::chaos::Disturbance;
use clap::Args;
use client::instance::DEFAULT_INSTANCE;
use grabber::source::Source;
use messages::ProcessKind;
use std::path::PathBuf;

/// A program that attaches to a group, for `chaos`.
#[derive(Debug, Args)]
pub struct BystanderArgs {
    /// Name of the group
    #[arg(long, value_name = "NAME", default_value = DEFAULT_INSTANCE)]
    pub instance: String,
    /// Publishes rubbish on the topics of the stages for so many milliseconds, instead of reading.
    #[arg(long, value_name = "MS")]
    pub rubbish: Option<u64>,
}

/// Arguments of `chaos`.
#[derive(Debug, Args)]
pub struct ChaosArgs {
    /// Disturb for so many seconds; warming up and settling come on top
    #[arg(long, value_name = "S", default_value = "60", value_parser = parse_seconds)]
    pub seconds: f64,
    /// Time between two disturbances; a stage without a spare is given the time to start one
    #[arg(long, value_name = "MS", default_value = "500", value_parser = clap::value_parser!(u64).range(1..=3_600_000))]
    pub every: u64,
    /// Kinds of disturbance, separated by commas
    #[arg(long, value_name = "KINDS", value_delimiter = ',', default_value = "kill,stop,pause")]
    pub signals: Vec<Disturbance>,
    /// Stages to disturb, separated by commas: any of grabber, classifier, tracker, filter
    #[arg(long, value_name = "STAGES", value_delimiter = ',', default_value = "classifier,tracker,filter", value_parser = parse_stage)]
    pub stages: Vec<ProcessKind>,
    /// Frames a second [default: as configured]
    #[arg(long, value_name = "N", value_parser = parse_fps)]
    pub fps: Option<f64>,
    /// Where frames come from, as for `run`; `synthetic-loop` costs an injector little at high rates
    #[arg(long, default_value = "synthetic")]
    pub source: Source,
    /// Repeat the sequence of an earlier run, which prints its seed [default: a new one]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Meanwhile have two programs attach that read poses and behave badly: one freezes for ten
    /// seconds at a time, one is killed every 100 ms
    #[arg(long)]
    pub bystanders: bool,
    /// Configuration file [default: MiroSot middle league on a synthetic pitch]
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Write everything that was done and seen to this file (JSON); an earlier report is replaced
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
}

/// Arguments of `bench`.
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// Pictures to measure, as `detect` takes them; folders stand for all pictures in them [default: with
    /// `--config`, frames of the synthetic match]
    #[arg(value_name = "PICTURE")]
    pub pictures: Vec<PathBuf>,
    /// Configuration to measure: its colours, layout and camera, stage by stage
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Print everything as JSON
    #[arg(long)]
    pub json: bool,
    /// Take some seconds, the default
    #[arg(long, conflicts_with = "full")]
    pub quick: bool,
    /// Take half a minute, for steadier figures
    #[arg(long)]
    pub full: bool,
}

/// Arguments of `stress`.
#[derive(Debug, Args)]
pub struct StressArgs {
    /// Picture size; a camera above the middle that sees the whole field [default: as configured]
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<(u32, u32)>,
    /// How long each rate is held
    #[arg(long, value_name = "S", default_value = "5", value_parser = parse_seconds)]
    pub seconds: f64,
    /// Rate to begin with
    #[arg(long, value_name = "FPS", default_value = "80", value_parser = parse_fps)]
    pub from: f64,
    /// Configuration file [default: MiroSot middle league on a synthetic pitch]
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Name of the group
    #[arg(long, value_name = "NAME", default_value = "stress")]
    pub instance: String,
    /// Print everything as JSON
    #[arg(long)]
    pub json: bool,
}

/// A frame rate on the command line.
pub fn parse_fps(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(fps) if (1.0..=10_000.0).contains(&fps) => Ok(fps),
        _ => Err("use a number from 1 to 10000".into()),
    }
}

/// A picture size on the command line: width and height in pixels.
pub fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let parse = |side: &str| side.parse().ok().filter(|side| (16..=16_384).contains(side));
    text.split_once(['x', 'X', '×'])
        .and_then(|(width, height)| Some((parse(width)?, parse(height)?)))
        .ok_or_else(|| "use WIDTHxHEIGHT, for example 640x480".into())
}

/// A time on the command line.
pub fn parse_seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if seconds > 0.0 && seconds <= 1e9 => Ok(seconds),
        _ => Err("use a positive number".into()),
    }
}

/// A stage on the command line.
pub fn parse_stage(text: &str) -> Result<ProcessKind, String> {
    ProcessKind::from_name(text)
        .ok_or_else(|| format!("use {}", ProcessKind::ALL.map(ProcessKind::name).join(", ")))
}
