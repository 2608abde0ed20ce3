//! Arguments of the commands for still pictures: `detect`, `learn`, `score`.

use super::FromGroupArgs;
use clap::{ArgGroup, Args};
use std::path::PathBuf;

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
    /// Overwrite overlays that are there
    #[arg(long, requires = "overlay")]
    pub force: bool,
}

/// Arguments of `learn`.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("shown").args(["pictures", "from_group"]))]
pub struct LearnArgs {
    /// Pictures to learn from; folders stand for all pictures in them [default: all labelled ones]
    #[arg(value_name = "PICTURE")]
    pub pictures: Vec<PathBuf>,
    /// File of labels (JSON): robots, balls, or marked places
    #[arg(
        long,
        value_name = "FILE",
        required_unless_present = "auto",
        conflicts_with = "from_group"
    )]
    pub samples: Option<PathBuf>,
    /// Find the colours without labels, from robots on the pitch: starts with the colours' configured
    /// appearance (`looks`), and maximises how well robots fit the layout
    #[arg(long, conflicts_with = "samples", requires = "shown")]
    pub auto: bool,
    /// Configuration with geometry, layout, and the colours' names
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Where to write the configuration with the colours learned [default: print the colours alone]
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Overwrite an existing file
    #[arg(long)]
    pub force: bool,
    /// Do not follow the light: the pictures show every lamp that will be used
    #[arg(long)]
    pub fixed_light: bool,
    /// Frames of a running group instead of picture files, with --auto.
    #[command(flatten)]
    pub from_group: FromGroupArgs,
}

/// Shown below the options of `learn`.
pub const LEARN_EXAMPLES: &str = "\
Examples:
  touchline learn --samples labels.json --config match.toml -o learned.toml
  touchline learn a.png b.png --samples labels.json --config match.toml -o learned.toml
      from two of the labelled pictures; `touchline score` then tells how it does on the others
  touchline learn --auto pictures/ --config match.toml -o learned.toml
      without labels, from pictures of robots that stand about; the more the better
  touchline learn --auto --from-group default --apply
      from robots that drive now; the group goes over to the colours without losing a frame";

/// Arguments of `score`.
#[derive(Debug, Args)]
pub struct ScoreArgs {
    /// Files of labels (JSON); the pictures are looked for beside them
    #[arg(required_unless_present = "synthetic", value_name = "LABELS")]
    pub labels: Vec<PathBuf>,
    /// Play the list of synthetic scenes instead: light, lamps, glare, noise, blur, a fisheye,
    /// crowds
    #[arg(long, conflicts_with = "labels")]
    pub synthetic: bool,
    /// Only synthetic scenes whose names contain one of these, separated by commas
    #[arg(long, value_name = "NAMES", value_delimiter = ',', requires = "synthetic")]
    pub scenes: Vec<String>,
    /// Frames to look at in each synthetic scene, a quarter of a second apart
    #[arg(long, value_name = "N", default_value = "40", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub frames: u32,
    /// Configuration file
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Print one JSON document instead of text
    #[arg(long)]
    pub json: bool,
    /// A robot may be this far from its label
    #[arg(long, value_name = "PX", default_value = "3", value_parser = super::parse_tolerance)]
    pub within_px: f64,
    /// A robot's heading may be this far from its label
    #[arg(long, value_name = "DEG", default_value = "6", value_parser = super::parse_tolerance)]
    pub within_deg: f64,
    /// The ball may be this far from its label
    #[arg(long, value_name = "PX", default_value = "2", value_parser = super::parse_tolerance)]
    pub ball_within_px: f64,
}

/// Shown below the options of `score`.
pub const SCORE_EXAMPLES: &str = "\
Examples:
  touchline score labels.json --config match.toml          what was found and what not, and why
  touchline score a.json b.json --config match.toml --json  all figures as one JSON document
  touchline score --synthetic                               scenes of the synthetic match
  touchline score --synthetic --scenes light,lamp --json    some of them, one JSON line each";
