//! Arguments of `calibrate`.

use super::FromGroupArgs;
use clap::{ArgGroup, Args};
use std::path::PathBuf;

/// Arguments of `calibrate`.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("shown").args(["picture", "from_group"]))]
pub struct CalibrateArgs {
    /// File of points (TOML)
    #[arg(long, value_name = "FILE")]
    pub points: Option<PathBuf>,
    /// A point: its name, or its millimetres on the pitch (and above it), and its pixel. Again for
    /// each point
    #[arg(long, value_name = "PLACE=X,Y", allow_hyphen_values = true)]
    pub at: Vec<String>,
    /// The picture the points were marked in; the pitch's lines are looked for in it, near where the
    /// points predict them, and the calibration is refined on them. Without any points, the pitch is found by its
    /// lines
    #[arg(long, value_name = "FILE")]
    pub picture: Option<PathBuf>,
    /// Do not look for lines: the points alone count
    #[arg(long)]
    pub marks_only: bool,
    /// Configuration with the pitch's size; all but its geometry is kept
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Where to write the configuration with this geometry [default: print the geometry alone]
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Overwrite existing files
    #[arg(long)]
    pub force: bool,
    /// Write the picture, with pitch and points drawn over it, to this file (PNG)
    #[arg(long, value_name = "FILE", requires = "shown")]
    pub overlay: Option<PathBuf>,
    /// Largest allowed error of a point
    #[arg(long, value_name = "PX", default_value = "3", value_parser = super::parse_tolerance)]
    pub within_px: f64,
    /// Height of the camera above the floor, if it was measured
    #[arg(long, value_name = "MM", value_parser = super::parse_tolerance)]
    pub camera_height_mm: Option<f64>,
    /// Height of the wall, for points named "wall …"
    #[arg(long, value_name = "MM", value_parser = super::parse_tolerance)]
    pub wall_height_mm: Option<f64>,
    /// Frames of a running group instead of a picture file.
    #[command(flatten)]
    pub from_group: FromGroupArgs,
}

pub const EXAMPLES: &str = "\
Examples:
  touchline calibrate --picture pitch.png --config match.toml -o calibrated.toml --overlay check.png
      finds a pitch with border, centre line and circle painted as configured; look at check.png
  touchline calibrate --at corner-tl=111.1,6.7 --at corner-tr=597.7,11.9 \\
      --at corner-br=580.1,399.7 --at corner-bl=117.9,393.1 --config match.toml
      four corners are the least if there is no picture; prints a [geometry] to put into the configuration
  touchline calibrate --points points.toml --config match.toml -o calibrated.toml \\
      --picture pitch.png --overlay check.png
      four rough clicks are enough where the pitch has lines: these are found in the picture. The
      pitch is drawn over it: do the lines lie on each other?
  touchline calibrate --points points.toml --from-group default --overlay check.png --apply
      with the frames of a running group, which goes over to the result";
