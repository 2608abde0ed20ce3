//! The command line.

use clap::{Args, Parser, Subcommand};
use common::config::Preset;
use common::instance::DEFAULT_INSTANCE;
use grabber::camera::LastFrame;
use grabber::source::Source;
use std::path::PathBuf;

/// Global vision for robot soccer: from Bayer frames to filtered robot and ball poses.
///
/// Without arguments: a synthetic match at 80 frames a second, until Ctrl-C.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 100, disable_help_subcommand = true)]
pub struct Cli {
    /// What to do; `run` when nothing is said.
    #[command(subcommand)]
    pub command: Option<Command>,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Runs a group: camera to poses, in supervised processes.
    ///
    /// Ctrl-C ends it and leaves nothing behind. On a terminal a display is kept up to date; into
    /// a pipe goes a line a second. A bounded run (--frames, --seconds) prints a summary.
    Run(RunArgs),
    /// Finds robots and ball on still pictures, one JSON line each.
    ///
    /// The same code as in a running group, in one process. Pixels: the centre of the top-left
    /// pixel is (0, 0). Angles in the picture: 0 right, 90 up on the screen.
    Detect(DetectArgs),
    /// Shows a running group.
    Status(StatusArgs),
    /// Ends a running group.
    Stop(InstanceArgs),
    /// Writes, checks and describes configurations.
    #[command(subcommand)]
    Config(ConfigCommand),
    /// The grabber stage alone: camera → frames.
    Grabber(GrabberArgs),
    /// The classifier stage alone: frames → runs.
    Classifier(StageArgs),
    /// The tracker stage alone: runs → detections.
    Tracker(StageArgs),
    /// The filter stage alone: detections → world.
    Filter(StageArgs),
}

/// Arguments of `run`.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// Configuration file [default: MiroSot middle league on a synthetic pitch]
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Where frames come from: `synthetic`, or `images:PATH` with a picture or a folder of them
    #[arg(long, default_value = "synthetic")]
    pub source: Source,
    /// Frames a second [default: as configured]
    #[arg(long, value_name = "N", value_parser = parse_fps)]
    pub fps: Option<f64>,
    /// End after so many frames
    #[arg(long, value_name = "N", conflicts_with = "seconds", value_parser = clap::value_parser!(u64).range(1..))]
    pub frames: Option<u64>,
    /// End after so many seconds
    #[arg(long, value_name = "S", value_parser = parse_seconds)]
    pub seconds: Option<f64>,
    /// Name of the group; groups of different names never meet
    #[arg(long, value_name = "NAME", default_value = DEFAULT_INSTANCE)]
    pub instance: String,
    /// Write the report to this file (JSON) at the end
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Show nothing while running
    #[arg(long)]
    pub quiet: bool,
}

/// Arguments of `detect`.
#[derive(Debug, Args)]
pub struct DetectArgs {
    /// PNG or JPEG pictures, or folders of them
    #[arg(required = true, value_name = "IMAGE")]
    pub images: Vec<PathBuf>,
    /// Configuration file
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Print JSON lines instead of text
    #[arg(long)]
    pub json: bool,
    /// Write the pictures, with what was found drawn over them, to this folder
    #[arg(long, value_name = "DIR")]
    pub overlay: Option<PathBuf>,
}

/// Which group.
#[derive(Debug, Args)]
pub struct InstanceArgs {
    /// Name of the group
    #[arg(long, value_name = "NAME", default_value = DEFAULT_INSTANCE)]
    pub instance: String,
}

/// Arguments of `status`.
#[derive(Debug, Args)]
pub struct StatusArgs {
    /// Which group.
    #[command(flatten)]
    pub instance: InstanceArgs,
    /// Print the whole report as JSON
    #[arg(long)]
    pub json: bool,
}

/// What to do with configurations.
#[derive(Debug, Subcommand)]
pub enum ConfigCommand {
    /// Writes a configuration with every key, its default and what it means.
    Init {
        /// Where to [default: standard output]
        #[arg(value_name = "FILE")]
        output: Option<PathBuf>,
        /// League to start from
        #[arg(long, default_value = "mirosot-5v5", value_parser = parse_preset)]
        preset: Preset,
        /// Overwrite an existing file
        #[arg(long)]
        force: bool,
    },
    /// Says whether a configuration can be used, and if not, why, with line numbers.
    Check {
        /// The file
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
    /// Prints the JSON schema of configurations, for editors.
    Schema,
}

/// Arguments of a stage.
#[derive(Debug, Args)]
pub struct StageArgs {
    /// Which group.
    #[command(flatten)]
    pub instance: InstanceArgs,
    /// Configuration file
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Connect, then wait for SIGUSR1 before working
    #[arg(long)]
    pub spare: bool,
}

/// Arguments of the grabber stage.
#[derive(Debug, Args)]
pub struct GrabberArgs {
    /// As for every stage.
    #[command(flatten)]
    pub stage: StageArgs,
    /// Where frames come from: `synthetic` or `images:PATH`
    #[arg(long, default_value = "synthetic")]
    pub source: Source,
    /// Capture so many frames, then wait to be ended
    #[arg(long, value_name = "N")]
    pub frames: Option<u64>,
    /// Continue after a predecessor's frame of this number and capture time (nanoseconds)
    #[arg(long, value_name = "SEQ@TIME", value_parser = parse_last_frame)]
    pub resume_after: Option<LastFrame>,
}

/// `touchline run` without arguments.
pub fn default_run() -> RunArgs {
    match Cli::parse_from(["touchline", "run"]).command {
        Some(Command::Run(args)) => args,
        _ => unreachable!("`touchline run` parses as the command run"),
    }
}

fn parse_fps(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(fps) if (1.0..=10_000.0).contains(&fps) => Ok(fps),
        _ => Err("use a number from 1 to 10000".into()),
    }
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if seconds > 0.0 && seconds <= 1e9 => Ok(seconds),
        _ => Err("use a positive number".into()),
    }
}

fn parse_preset(text: &str) -> Result<Preset, String> {
    let names: Vec<&str> = Preset::ALL.iter().map(|preset| preset.name()).collect();
    Preset::ALL
        .into_iter()
        .find(|preset| preset.name() == text)
        .ok_or_else(|| format!("use one of {}", names.join(", ")))
}

fn parse_last_frame(text: &str) -> Result<LastFrame, String> {
    let parse = || {
        let (seq, time) = text.split_once('@')?;
        Some(LastFrame { seq: seq.parse().ok()?, t_capture_ns: time.parse().ok()? })
    };
    parse().ok_or_else(|| "use NUMBER@NANOSECONDS".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn a_predecessors_frame_is_read_as_written() {
        let last = parse_last_frame("12@345").unwrap();
        assert_eq!((last.seq, last.t_capture_ns), (12, 345));
        assert!(parse_last_frame("12").is_err() && parse_last_frame("@").is_err());
    }
}
