//! Arguments of the commands that make and use recordings.

use super::{InstanceArgs, parse_seconds};
use clap::Args;
use recording::Channel;
use std::path::PathBuf;

/// Arguments of `record`.
#[derive(Debug, Args)]
pub struct RecordArgs {
    /// The recording; if it exists, a number is added, so that nothing is ever overwritten
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// What to record, separated by commas: frames, runs, detections, world, commands, truth, health,
    /// events, and scene, which is for viewers
    #[arg(long, value_name = "TOPICS", value_delimiter = ',', value_parser = parse_topic,
        default_value = "frames,detections,world,commands,truth,health,events,scene")]
    pub topics: Vec<Channel>,
    /// End after so many seconds
    #[arg(long, value_name = "S", value_parser = parse_seconds)]
    pub seconds: Option<f64>,
    /// Begin another file when one has this size, for example 500M or 2G; at least what a second of
    /// recording may take, 26M for 640×480 pixels and 80 frames a second
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    pub max_size: Option<u64>,
    /// Keep only the newest N files of this recording
    #[arg(long, value_name = "N", requires = "max_size", value_parser = parse_files)]
    pub keep: Option<usize>,
    /// Stop before less than this is free on the disk, and complete the file
    #[arg(long, value_name = "SIZE", default_value = "500M", value_parser = parse_size)]
    pub keep_free: u64,
    /// The group.
    #[command(flatten)]
    pub instance: InstanceArgs,
    /// Show no progress
    #[arg(long)]
    pub quiet: bool,
    /// Print progress on standard output as lines of JSON, twice a second
    #[arg(long, hide = true)]
    pub progress: bool,
}

/// Arguments of `recover`.
#[derive(Debug, Args)]
pub struct RecoverArgs {
    /// Recordings that were never finished, or are damaged
    #[arg(required = true, value_name = "FILE.mcap")]
    pub files: Vec<PathBuf>,
    /// Leave the file as it is, and write what is good in it to another one, without the damaged parts
    #[arg(long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Overwrite an existing file with --output
    #[arg(long, requires = "output")]
    pub force: bool,
}

/// Arguments of `info`.
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// The recording, or a log file of the SSL, compressed or not
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
    /// Print the recorded configuration, the newest if there are several, and nothing else
    #[arg(long, conflicts_with = "json")]
    pub config: bool,
    /// The configuration of this revision instead
    #[arg(long, value_name = "N", requires = "config")]
    pub revision: Option<u32>,
}

/// Arguments of `replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// The recording
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// Compute runs, detections and world again from what they were made from, and compare them with
    /// what was recorded, bit for bit
    #[arg(long)]
    pub verify: bool,
}

/// Arguments of `recording-viewer`.
#[derive(Debug, Args)]
pub struct RecordingViewerArgs {
    /// The recording
    pub file: PathBuf,
    /// The group.
    #[command(flatten)]
    pub instance: InstanceArgs,
}

/// Arguments of `export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// The recording
    #[arg(value_name = "FILE.mcap")]
    pub file: PathBuf,
    /// Write robots and ball of detections, world and truth to a table, one row each; - stands for standard
    /// output, also with --ssl-log
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Write detections and world as a log file of the SSL, with the field's geometry; compressed if the
    /// name ends in .gz
    #[arg(long, value_name = "FILE")]
    pub ssl_log: Option<PathBuf>,
    /// Write the frames to this folder; Bayer frames as grey pictures, as `detect` reads them
    #[arg(long, value_name = "DIR")]
    pub png: Option<PathBuf>,
    /// Write only every Nth frame
    #[arg(long, value_name = "N", default_value = "1", requires = "png",
        value_parser = clap::value_parser!(u64).range(1..))]
    pub every: u64,
    /// Overwrite existing files
    #[arg(long)]
    pub force: bool,
}

/// A channel by its name in recordings; `scene` stands for everything made for viewers.
fn parse_topic(text: &str) -> Result<Channel, String> {
    Channel::from_name(text)
        .filter(|&channel| {
            channel != Channel::Setup && (!channel.is_derived() || channel == Channel::Scene)
        })
        .ok_or_else(|| {
            "use frames, runs, detections, world, commands, truth, health, events or scene".into()
        })
}

fn parse_size(text: &str) -> Result<u64, String> {
    let complaint = || "use a number of bytes, with K, M, G or T for thousands of them".to_string();
    let (number, unit) = match text.find(|c: char| c.is_ascii_alphabetic()) {
        Some(at) => text.split_at(at),
        None => (text, ""),
    };
    let factor = match unit {
        "" | "B" => 1.0,
        "K" | "k" | "KB" | "kB" => 1e3,
        "M" | "MB" => 1e6,
        "G" | "GB" => 1e9,
        "T" | "TB" => 1e12,
        _ => return Err(complaint()),
    };
    match number.trim().parse::<f64>() {
        Ok(number) if number >= 0.0 && number * factor <= 1e18 => Ok((number * factor) as u64),
        _ => Err(complaint()),
    }
}

fn parse_files(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(number) if number >= 1 => Ok(number),
        _ => Err("use a number of files, at least 1".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_with_and_without_units() {
        assert_eq!(parse_size("1500"), Ok(1500));
        assert_eq!(parse_size("1.5G"), Ok(1_500_000_000));
        assert_eq!(parse_size("500M"), Ok(500_000_000));
        for wrong in ["", "M", "-1", "5X", "1e300", "nan"] {
            assert!(parse_size(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn topics_are_those_of_the_group_and_the_scene() {
        assert_eq!(parse_topic("runs"), Ok(Channel::Runs));
        assert_eq!(parse_topic("scene"), Ok(Channel::Scene));
        assert!(parse_topic("setup").is_err() && parse_topic("frame").is_err());
    }
}
