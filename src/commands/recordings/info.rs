//! `touchline info`: shows the contents of a recording.

use super::configurations::{Configuration, Configurations};
use super::{size_text, tell_damages, time_text};
use crate::cli::InfoArgs;
use crate::commands::CommandError;
use recording::{Channel, Damages, Reader, Setup, decode_frame};
use serde::Serialize;
use std::collections::BTreeMap;
use std::process::ExitCode;

/// Contents of a recording.
#[derive(Debug, Default, Serialize)]
struct Info {
    bytes: u64,
    seconds: f64,
    begins_wall_ns: u64,
    is_complete: bool,
    damage: Damages,
    touchline_version: Option<String>,
    instance: Option<String>,
    configurations: Vec<Configuration>,
    picture: Option<Picture>,
    channels: BTreeMap<String, Content>,
}

#[derive(Debug, Serialize)]
struct Picture {
    width: u32,
    height: u32,
    first_seq: u64,
    last_seq: u64,
    missing: u64,
}

#[derive(Debug, Default, Serialize)]
struct Content {
    messages: u64,
    bytes: u64,
    per_second: f64,
}

/// Prints the contents of a recording.
pub fn info(args: InfoArgs) -> Result<ExitCode, CommandError> {
    if super::ssl_log::is_log(&args.file) {
        return super::ssl_log::info(&args);
    }
    let mut reader = Reader::open(&args.file)?;
    let mut info = Info { bytes: args.file.metadata()?.len(), ..Default::default() };
    let (mut begin, mut end) = (u64::MAX, 0);
    let mut configurations = Configurations::default();
    let mut frames = 0;
    for entry in reader.by_ref() {
        let entry = entry?;
        (begin, end) = (begin.min(entry.t_sent_ns), end.max(entry.t_sent_ns));
        let content = info.channels.entry(entry.channel.name().into()).or_default();
        content.messages += 1;
        content.bytes += entry.data.len() as u64;
        match entry.channel {
            Channel::Setup => {
                if let Some(setup) = Setup::decode(&entry.data) {
                    info.touchline_version = Some(setup.touchline_version.clone());
                    info.instance = Some(setup.instance.clone());
                    configurations.add(entry.t_sent_ns, setup);
                }
            }
            Channel::Frames => {
                if let Some(frame) = decode_frame(&entry.data) {
                    frames += 1;
                    let header = frame.header;
                    let picture = info.picture.get_or_insert(Picture {
                        width: header.width,
                        height: header.height,
                        first_seq: header.seq,
                        last_seq: header.seq,
                        missing: 0,
                    });
                    picture.last_seq = picture.last_seq.max(header.seq);
                    picture.missing =
                        (picture.last_seq - picture.first_seq + 1).saturating_sub(frames);
                }
            }
            _ => {}
        }
    }
    info.damage = reader.damages().clone();
    info.is_complete = !info.damage.is_recoverable();
    info.seconds = end.saturating_sub(begin) as f64 / 1e9;
    info.begins_wall_ns = if begin == u64::MAX { 0 } else { begin };
    info.configurations = configurations.list(info.begins_wall_ns);
    for content in info.channels.values_mut() {
        if info.seconds > 0.0 {
            content.per_second = (content.messages as f64 / info.seconds * 10.0).round() / 10.0;
        }
    }
    if args.config {
        runtime::say!("{}", configurations.text(args.revision)?)?;
    } else if args.json {
        runtime::say_line!("{}", serde_json::to_string_pretty(&info)?)?;
    } else {
        runtime::say!("{}", text(&info))?;
    }
    tell_damages(&args.file, &info.damage);
    Ok(ExitCode::SUCCESS)
}

fn text(info: &Info) -> String {
    let mut text = format!("  {} in {}\n", size_text(info.bytes), time_text(info.seconds));
    if let (Some(version), Some(instance)) = (&info.touchline_version, &info.instance) {
        text += &format!("  of the group {instance:?}, by touchline {version}\n");
    }
    if let Some(Picture { width, height, first_seq, last_seq, missing }) = info.picture {
        text += &format!(
            "  frames {first_seq} to {last_seq}, {width}×{height} pixels, {missing} missing\n"
        );
    }
    text += &super::configurations::text(&info.configurations);
    text += &format!("  {:<12}{:>10}{:>10}{:>12}\n", "", "messages", "a second", "size");
    for (name, content) in &info.channels {
        text += &format!(
            "  {name:<12}{:>10}{:>10.1}{:>12}\n",
            content.messages,
            content.per_second,
            size_text(content.bytes)
        );
    }
    text
}
