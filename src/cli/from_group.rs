//! Arguments of commands that take their pictures from a running group.

use clap::Args;

/// Frames of a running group as pictures.
#[derive(Debug, Args)]
pub struct FromGroupArgs {
    /// Take the pictures from the group of this name while it runs, and, without --config, its
    /// configuration too; it loses no frame
    #[arg(long, value_name = "NAME")]
    pub from_group: Option<String>,
    /// How many frames to take [default: 20 for `learn`, a quarter of a second apart; 9 for `calibrate`, whose
    /// median is used, so that what moves vanishes]
    #[arg(long, value_name = "N", requires = "from_group",
        value_parser = clap::value_parser!(u16).range(1..=200))]
    pub frames: Option<u16>,
    /// Have the group go over to the result, as `touchline reload` does; without --config only
    #[arg(long, requires = "from_group", conflicts_with = "config")]
    pub apply: bool,
}
