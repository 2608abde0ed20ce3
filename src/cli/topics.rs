//! Arguments of `topics`.

use super::{InstanceArgs, parse_seconds};
use clap::{Args, ValueEnum};

/// Arguments of `topics`.
#[derive(Debug, Args)]
pub struct TopicsArgs {
    /// Print the table, and more, as JSON
    #[arg(long, conflicts_with = "format")]
    pub json: bool,
    /// Print this instead of the table
    #[arg(long, value_name = "FORMAT", value_enum)]
    pub format: Option<TopicsFormat>,
    /// Measure for so long
    #[arg(long, value_name = "S", default_value = "1", value_parser = parse_seconds)]
    pub seconds: f64,
    /// The group.
    #[command(flatten)]
    pub instance: InstanceArgs,
}

/// What `topics` prints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum TopicsFormat {
    /// An iceoryx2 configuration file with which other programs find the group
    Config,
    /// The messages as a Python module (scripts/python/touchline_messages.py)
    Python,
    /// The messages as a header file for C and C++ (scripts/touchline.h)
    C,
}
