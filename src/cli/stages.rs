//! Arguments of a group's processes, started individually.

use super::InstanceArgs;
use clap::Args;
use grabber::camera::LastFrame;
use grabber::source::Source;
use messages::stages::MAX_LANES;
use std::path::PathBuf;

/// Arguments of a stage.
#[derive(Debug, Args)]
pub struct StageArgs {
    /// The group.
    #[command(flatten)]
    pub instance: InstanceArgs,
    /// Configuration file
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// The camera whose frames it works on, counted from 0
    #[arg(long, value_name = "NUMBER", default_value_t = 0,
          value_parser = clap::value_parser!(u8).range(..MAX_LANES as i64))]
    pub lane: u8,
    /// Connect, then wait for SIGUSR1 before working
    #[arg(long)]
    pub spare: bool,
    /// End some time (`supervisor.orphan_timeout_s`) after the group's supervisor is gone
    #[arg(long)]
    pub supervised: bool,
}

/// Arguments of an attendant.
#[derive(Debug, Args)]
pub struct AttendantArgs {
    /// The group.
    #[command(flatten)]
    pub instance: InstanceArgs,
    /// Configuration file [default: that of the running group]
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// End some time (`supervisor.orphan_timeout_s`) after the group's supervisor is gone
    #[arg(long)]
    pub supervised: bool,
}

/// Arguments of the grabber stage.
#[derive(Debug, Args)]
pub struct GrabberArgs {
    /// Arguments common to all stages.
    #[command(flatten)]
    pub stage: StageArgs,
    /// Where frames come from: `synthetic`, `synthetic-loop:N`, `images:PATH`, `recording:FILE`,
    /// `v4l2:/dev/videoN`, `genicam` or `external`
    #[arg(long, default_value = "synthetic")]
    pub source: Source,
    /// Capture so many frames, then wait to be ended
    #[arg(long, value_name = "N")]
    pub frames: Option<u64>,
    /// Continue after a predecessor's frame of this number and capture time (nanoseconds)
    #[arg(long, value_name = "SEQ@TIME", value_parser = parse_last_frame)]
    pub resume_after: Option<LastFrame>,
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

    #[test]
    fn a_predecessors_frame_is_read_as_written() {
        let last = parse_last_frame("12@345").unwrap();
        assert_eq!((last.seq, last.t_capture_ns), (12, 345));
        assert!(parse_last_frame("12").is_err() && parse_last_frame("@").is_err());
    }
}
