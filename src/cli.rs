//! The command line.

mod calibrate;
mod console;
mod from_group;
mod operate;
mod pictures;
mod recordings;
mod stages;
mod topics;

pub use calibrate::CalibrateArgs;
pub use console::ConsoleArgs;
pub use from_group::FromGroupArgs;
pub use operate::{ReloadArgs, RestartArgs, RollbackArgs, UpgradeArgs};
pub use pictures::{DetectArgs, LearnArgs, ScoreArgs};
pub use recordings::{
    ExportArgs, InfoArgs, RecordArgs, RecordingViewerArgs, RecoverArgs, ReplayArgs,
};
pub use stages::{AttendantArgs, GrabberArgs, StageArgs};
pub use topics::{TopicsArgs, TopicsFormat};

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use client::instance::DEFAULT_INSTANCE;
use config::Preset;
use grabber::source::Source;
use std::path::PathBuf;
use touchline::attendants::{self, Row};
use trials::args::{BenchArgs, BystanderArgs, ChaosArgs, StressArgs, parse_fps, parse_seconds};

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

/// The action that the command line requests.
pub enum Invocation {
    /// A command for people, or a stage's process.
    Cli(Cli),
    /// An attendant's process.
    Attendant(&'static Row, AttendantArgs),
}

/// Parses the command line; prints errors and ends the program if it is invalid.
pub fn parse() -> Invocation {
    let matches = command().get_matches();
    let attendant = matches
        .subcommand()
        .filter(|(name, _)| !Cli::command().get_subcommands().any(|it| it.get_name() == *name))
        .and_then(|(name, rest)| Some((attendants::named(name)?, rest)));
    match attendant {
        Some((row, rest)) => {
            let args = AttendantArgs::from_arg_matches(rest).unwrap_or_else(|error| error.exit());
            Invocation::Attendant(row, args)
        }
        None => {
            Invocation::Cli(Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit()))
        }
    }
}

/// The whole command line: each attendant has a subcommand of its name.
fn command() -> clap::Command {
    let attendant =
        |row: &Row| AttendantArgs::augment_args(clap::Command::new(row.name()).about(row.about));
    let cli = Cli::command();
    // `console` is a command for people as well: [`Command::Console`].
    let is_new = |row: &&Row| cli.find_subcommand(row.name()).is_none();
    let rows: Vec<_> = attendants::TABLE.iter().filter(is_new).map(attendant).collect();
    cli.subcommands(rows)
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Runs a group: camera to poses, in supervised processes.
    ///
    /// Ctrl-C ends it and leaves nothing behind. On a terminal a display is kept up to date; into
    /// a pipe goes a line a second. A bounded run (--frames, --seconds) prints a summary.
    Run(RunArgs),
    /// Says where a group's page for browsers is; starts the group if it is not running.
    ///
    /// The page shows the camera's picture with everything that was found on it, leads through setting up
    /// camera, field, colours and robots, and watches a match. It takes the same options as `run`, with
    /// which the group is started.
    Console(ConsoleArgs),
    /// Finds robots and ball on still pictures, one JSON line each.
    ///
    /// The same code as in a running group, in one process. Pixels: the centre of the top-left
    /// pixel is (0, 0). Angles in the picture: 0 right, 90 up on the screen.
    Detect(DetectArgs),
    /// Computes the camera's geometry from points of the pitch marked in a picture.
    ///
    /// Computes homography, distortion of the lens and its place from at least four points, by least
    /// squares; says how far each point is off, and which look wrong or swapped. Points at different
    /// heights, such as floor and upper edge of the wall at the corners, determine the height of the
    /// camera. docs/calibration.md lists the points that have names, and describes the file of points.
    #[command(after_long_help = calibrate::EXAMPLES)]
    Calibrate(CalibrateArgs),
    /// Learns colours from labelled pictures.
    ///
    /// Computes, from labelled robots and balls (the layout says which colour is where on a robot) or
    /// from marked places, boxes and bounds of hue and saturation that separate the colours from each
    /// other and from the background with the widest margins. Prints which colours are taken for which,
    /// and warns of colours too alike. With the pitch's own colour, which is written down too, colours
    /// learned under some lamps hold under others. docs/labels.md describes the file of labels.
    #[command(after_long_help = pictures::LEARN_EXAMPLES)]
    Learn(LearnArgs),
    /// Tells how well robots and ball are found on labelled pictures.
    ///
    /// Looks at every labelled picture as `detect` does and compares: robots under their right names
    /// within the tolerances, wrong identities, misses with their reason and the colours seen there,
    /// robots where there is none, the ball. docs/labels.md describes the file of labels.
    #[command(after_long_help = pictures::SCORE_EXAMPLES)]
    Score(ScoreArgs),
    /// Lists the cameras of this machine, with formats, sizes, rates and controls.
    Cameras(CamerasArgs),
    /// Shows the next frames of a recording that is played step by step, and what was found on them.
    ///
    /// For a group that was started with `touchline run --source recording:FILE,step`. Its stages
    /// work on a frame as they did in the match, however long the pause before it.
    Step(StepArgs),
    /// Shows a running group.
    Status(StatusArgs),
    /// Ends a running group.
    Stop(InstanceArgs),
    /// Replaces the processes of stages in the middle of a match, without losing a frame.
    ///
    /// Each stage's spare takes over from its active process, which ends in order. A stage whose
    /// starts have failed again and again is tried once more, at once. The grabber has no spare:
    /// restarting it costs the frames until the camera is open again, and they are counted.
    Restart(RestartArgs),
    /// Goes over to another version of this program in the middle of a match.
    ///
    /// Asks the new program first whether it understands the messages and the configuration of the
    /// running group; if not, nothing is changed. Then the supervisor goes on as the new program, and
    /// stage after stage is handed over to a process of it: no frame is lost until at last the
    /// grabber is started anew, and what that costs is counted.
    Upgrade(UpgradeArgs),
    /// Goes over to another configuration in the middle of a match.
    ///
    /// Checks the file (by default the one the group was started with), tells what differs from what the
    /// group runs with, and replaces the stages that this concerns by processes with the new
    /// configuration: spares first, then the working ones, so that no frame is lost. Only a new setting of
    /// the camera costs frames, and is announced. A configuration with which processes fail is taken back
    /// by itself; `touchline rollback` takes it back by hand.
    #[command(after_long_help = operate::RELOAD_EXAMPLES)]
    Reload(ReloadArgs),
    /// Goes back to the configuration before the last `reload`.
    Rollback(RollbackArgs),
    /// Prints, as JSON, what programs must agree on to work in one group.
    #[command(hide = true)]
    Interface,
    /// Answers a request of the console about setting up: JSON on standard input and output.
    #[command(hide = true)]
    SetupWorker(SetupWorkerArgs),
    /// Answers questions of the console about a recording: standard input and output.
    #[command(hide = true)]
    RecordingViewer(RecordingViewerArgs),
    /// Disturbs a match of its own at random, and checks that nothing is lost.
    ///
    /// Starts a match that no other group notices, kills, freezes and otherwise troubles
    /// its processes, and watches with subscribers of its own: does every captured frame reach
    /// `world`, once and in order? How long is each disturbance felt? Do shared memory, files,
    /// processes or memory pile up? Run it on the match computer before a tournament, with nothing
    /// else running. The exit status is 0 when every promise was kept; times are reported beside
    /// what they should be, but break no promise, since they depend on the machine.
    #[command(after_long_help = CHAOS_EXAMPLES)]
    Chaos(ChaosArgs),
    /// Says whether this computer is fit for a match, and what to do where it is not.
    ///
    /// Looks at shared memory, rights, processors, clock, directories and disk, and for what
    /// groups have left that did not end in order. The exit status is 0 unless there is a problem,
    /// that is, something with which a match cannot run.
    Doctor(DoctorArgs),
    /// Attaches to a group and reads, for `chaos`.
    #[command(hide = true)]
    Bystander(BystanderArgs),
    /// Lists the topics: rates, sizes, who is connected, and what a program needs to attach.
    Topics(TopicsArgs),
    /// Records a running group: every frame, and what the group made of it.
    ///
    /// Attaches as a consumer that the group does not feel, waits for the group if need be, and goes
    /// on in another file when it is started again. Ctrl-C ends it in order. What was recorded up to a
    /// tenth of a second before a crash can be read; `recover` makes a proper file of it, and so does
    /// the next `record` of that name. The file is an MCAP file: `replay` computes everything again,
    /// `run --source recording:FILE` plays it, Foxglove and its kin draw it.
    Record(RecordArgs),
    /// Says what is in a recording.
    Info(InfoArgs),
    /// Computes a recording again, and says whether the results are the recorded ones.
    ///
    /// With the recorded configuration. An output whose inputs are not all in the recording (its first
    /// and last moments, dropped messages) is not checked, and counted as such. The exit status is 0
    /// when nothing is different.
    Replay(ReplayArgs),
    /// Writes what is in a recording as a table or as pictures.
    Export(ExportArgs),
    /// Mends recordings in place: completes those that were never finished (killed, disk full, power
    /// lost), and fences off what is damaged.
    Recover(RecoverArgs),
    /// Measures what this machine makes of a frame, beside a plain copy of it.
    ///
    /// Classification at every SIMD level and the merging of runs, by picture size, number of colours
    /// and content, and all stages on a frame of a match: painted pictures, whose colours are ideal. With
    /// `--config` or pictures, every stage with your own colours on your own pictures instead. Answers are
    /// verified first.
    #[command(after_help = BENCH_EXAMPLES)]
    Bench(BenchArgs),
    /// Finds the highest frame rate that this machine sustains without losing a frame.
    ///
    /// Runs one group after the other, each at a higher rate, until one loses a frame, and narrows
    /// the limit down. Frames come from an injector that costs little more than a copy. For each rate:
    /// latency from capture to `world`, processor time and memory. Let nothing else run meanwhile.
    Stress(StressArgs),
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
    /// Where frames come from: `synthetic`; `v4l2:/dev/videoN` or `genicam` with a camera (`touchline
    /// cameras` lists them); `images:PATH` with a picture or a folder of them;
    /// `recording:FILE[,fast|,step][,loop][,from=SECONDS]`; `synthetic-loop:N`, N frames painted in
    /// advance, shown to and fro; or `external`, another program that `access.publishers` names
    #[arg(long, default_value = "synthetic")]
    pub source: Source,
    /// Frames a second [default: as configured]
    #[arg(long, value_name = "N", value_parser = parse_fps)]
    pub fps: Option<f64>,
    /// End after so many frames
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub frames: Option<u64>,
    /// End after so many seconds of the clock, whatever the camera does
    #[arg(long, value_name = "S", value_parser = parse_seconds)]
    pub seconds: Option<f64>,
    /// Switch on protocols of the leagues besides those that the configuration enables, separated by
    /// commas: ssl, tracked, firasim, vss and json are sent, commands are received
    #[arg(long, value_name = "PROTOCOLS", value_delimiter = ',',
        value_parser = PossibleValuesParser::new(PROTOCOLS))]
    pub publish: Vec<String>,
    /// Serve no page for browsers, whatever the configuration says; the variable TOUCHLINE_NO_CONSOLE has
    /// the same effect
    #[arg(long)]
    pub no_console: bool,
    /// Name of the group; groups of different names never meet
    #[arg(long, value_name = "NAME", default_value = DEFAULT_INSTANCE)]
    pub instance: String,
    /// Write the report to this file (JSON) at the end; an earlier report is replaced
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Show nothing while running
    #[arg(long)]
    pub quiet: bool,
    /// Go over to the configuration file whenever it is changed, as `touchline reload` does
    #[arg(long)]
    pub watch: bool,
    /// Take over the group that a dead supervisor has left behind, with its configuration and source
    #[arg(long, conflicts_with_all = ["config", "source", "fps", "frames", "seconds", "publish"])]
    pub adopt: bool,
}

/// Names for `run --publish`.
const PROTOCOLS: [&str; 6] = ["ssl", "tracked", "firasim", "vss", "json", "commands"];

/// Arguments of `cameras`.
#[derive(Debug, Args)]
pub struct CamerasArgs {
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
}

/// The group that a command addresses.
#[derive(Debug, Args)]
pub struct InstanceArgs {
    /// Name of the group
    #[arg(long, value_name = "NAME", default_value = DEFAULT_INSTANCE)]
    pub instance: String,
}

/// Arguments of `step`.
#[derive(Debug, Args)]
pub struct StepArgs {
    /// How many frames
    #[arg(value_name = "N", default_value = "1", value_parser = clap::value_parser!(u64).range(1..))]
    pub frames: u64,
    /// The group.
    #[command(flatten)]
    pub instance: InstanceArgs,
}

/// Arguments of `status`.
#[derive(Debug, Args)]
pub struct StatusArgs {
    /// The group.
    #[command(flatten)]
    pub instance: InstanceArgs,
    /// Print the whole report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `setup-worker`.
#[derive(Debug, Args)]
pub struct SetupWorkerArgs {
    /// find-field, calibrate, learn or try
    pub kind: String,
    /// The group.
    #[command(flatten)]
    pub instance: InstanceArgs,
}

/// Arguments of `doctor`.
#[derive(Debug, Args)]
pub struct DoctorArgs {
    /// Configuration file of the match that is to run [default: MiroSot middle league]
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Where frames will come from, as for `run`: memory is laid aside for whatever format a camera
    /// chooses
    #[arg(long, default_value = "synthetic")]
    pub source: Source,
    /// The group.
    #[command(flatten)]
    pub instance: InstanceArgs,
    /// Remove what dead groups of yours have left; nothing of a living one is touched
    #[arg(long)]
    pub clean: bool,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
}

const CHAOS_EXAMPLES: &str = "\
Examples:
  touchline chaos                                    a minute of kills, freezes and pauses
  touchline chaos --signals kill --every 200         kills only, as fast as spares can be started
  touchline chaos --signals double --every 3000      stage and spare at once: losses are counted
  touchline chaos --stages grabber --signals kill    the camera's process; its gaps are counted
  touchline chaos --signals kill,hup,emfile,enospc   besides kills, a closed terminal and shortages
  touchline chaos --signals kill,rubbish             besides kills, a program that publishes rubbish
  touchline chaos --signals kill,outsider            as root: besides, another user who takes its names
  touchline chaos --bystanders                       besides, programs that attach and behave badly
  touchline chaos --fps 1000 --report report.json    a faster camera; all figures as JSON
  touchline chaos --source v4l2:/dev/video0          with your own camera";

const BENCH_EXAMPLES: &str = "\
Examples:
  touchline bench                                   this machine, on painted pictures
  touchline bench --config match.toml pictures/     your colours on your pictures, stage by stage
  touchline bench --config match.toml               your colours on the synthetic match as configured";

/// What to do with configurations.
#[derive(Debug, Subcommand)]
pub enum ConfigCommand {
    /// Writes a configuration with every key, its default and what it means.
    Init {
        /// Where to [default: standard output]
        #[arg(value_name = "FILE")]
        output: Option<PathBuf>,
        /// League to start from
        #[arg(long, default_value = "mirosot-5v5", value_parser = presets())]
        preset: Preset,
        /// Overwrite an existing file
        #[arg(long)]
        force: bool,
    },
    /// Says whether a configuration can be used, and if not, why, with line numbers; and what its
    /// colours cost the classifier.
    Check {
        /// The file
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// Pictures of the pitch to estimate that cost with, or folders of them [default: a floor of
        /// the colour `light.pitch_rgb`]
        #[arg(value_name = "PICTURE")]
        pictures: Vec<PathBuf>,
    },
    /// Tells in which keys two configurations differ.
    Diff {
        /// The one
        #[arg(value_name = "FILE")]
        old: PathBuf,
        /// The other
        #[arg(value_name = "FILE")]
        new: PathBuf,
    },
    /// Prints the value of a key, as it is used: from the file, or its default.
    Get {
        /// The file
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// The key, with colours and robots by name: `colors.orange.red`
        #[arg(value_name = "KEY")]
        key: String,
    },
    /// Sets a key in a file; comments and order stay, and an invalid value changes nothing.
    Set {
        /// The file
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// The key, with colours and robots by name: `colors.orange.red`
        #[arg(value_name = "KEY")]
        key: String,
        /// The value as in the file; quotes around a text may be left out
        #[arg(value_name = "VALUE", allow_negative_numbers = true)]
        value: String,
    },
    /// Prints the JSON schema of configurations, for editors.
    Schema,
}

/// `touchline run` without arguments.
pub fn default_run() -> RunArgs {
    match Cli::parse_from(["touchline", "run"]).command {
        Some(Command::Run(args)) => args,
        _ => unreachable!("`touchline run` parses as the command run"),
    }
}

fn parse_tolerance(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(value) if value > 0.0 && value <= 1e6 => Ok(value),
        _ => Err("use a positive number".into()),
    }
}

/// Parses the name of a preset; `--help` lists them.
fn presets() -> impl TypedValueParser<Value = Preset> {
    let named = |preset: Preset| PossibleValue::new(preset.name()).help(preset.describe());
    PossibleValuesParser::new(Preset::ALL.map(named)).map(|name| {
        let mut all = Preset::ALL.into_iter();
        all.find(|preset| preset.name() == name).unwrap_or_default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        command().debug_assert();
    }
}
