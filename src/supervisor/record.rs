//! The supervisor's record of its group, from which a later supervisor continues.
//!
//! It is written after every change and read only when a supervisor takes over from a dead one or
//! from one of another version, so it may lack the changes just before the old supervisor died.
//! Heartbeats, and whether a process is alive, therefore take precedence over it.

use super::sys::{self, Call};
use super::{Launch, Overrides};
use client::instance::Instance;
use client::private;
use control::Event;
use messages::stages::StageId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Write};
use std::path::PathBuf;

/// State of a group that is neither in its configuration nor in shared memory.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Source of the frames, as on the command line.
    pub source: String,
    /// Number of frames to capture.
    pub frames: Option<u64>,
    /// Time at which the group is to end, on the machine's monotonic clock.
    #[serde(default)]
    pub ends_at_ns: Option<u64>,
    /// The configuration file of the command line.
    #[serde(default)]
    pub config_file: Option<PathBuf>,
    /// What the command line changes in it.
    #[serde(default)]
    pub overrides: Overrides,
    /// The processes.
    pub members: Vec<Member>,
    /// Number of replaced processes, by stage.
    pub restarts: BTreeMap<String, u64>,
    /// The newest events.
    pub events: Vec<Event>,
}

/// A process of the group.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Member {
    /// Name of its stage.
    pub stage: String,
    /// Its process id.
    pub pid: u32,
    /// Whether it was a spare at the time of writing.
    pub spare: bool,
}

impl Record {
    /// Record of a group without processes.
    pub fn new(launch: &Launch) -> Self {
        Self {
            source: launch.source.to_string(),
            frames: launch.frames,
            ends_at_ns: launch.ends_at_ns,
            config_file: launch.config_file.clone(),
            overrides: launch.overrides.clone(),
            ..Self::default()
        }
    }

    /// Whether the recorded group matches the requested launch. The end time may differ: the new
    /// one counts.
    pub fn serves(&self, launch: &Launch) -> bool {
        self.source == launch.source.to_string() && self.frames == launch.frames
    }

    /// Whether a process is recorded as a spare; `None` when it is not recorded.
    pub fn is_spare(&self, stage: StageId, pid: u32) -> Option<bool> {
        let stage = stage.to_string();
        let it = |member: &&Member| member.pid == pid && member.stage == stage;
        self.members.iter().find(it).map(|member| member.spare)
    }

    /// Replaces the record atomically: a reader finds either the old one or the new one.
    pub fn write(&self, instance: &Instance) -> io::Result<()> {
        let path = instance.record_path();
        let new = path.with_extension("new");
        let text = serde_json::to_vec_pretty(self)?;
        sys::ask(Call::WriteRecord, || private::create_file(&new)?.write_all(&text))?;
        sys::ask(Call::ReplaceRecord, || fs::rename(&new, &path))
    }

    /// Record of an earlier supervisor; `None` if there is no readable one.
    pub fn read(instance: &Instance) -> Option<Self> {
        serde_json::from_slice(&fs::read(instance.record_path()).ok()?).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{EventKind, ProcessKind};

    #[test]
    fn a_written_record_is_read_and_an_invalid_one_is_ignored() {
        let base = std::env::temp_dir().join(format!("tl-record-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        assert_eq!(Record::read(&instance), None);
        let record = Record {
            source: "synthetic".into(),
            frames: Some(7),
            ends_at_ns: Some(8_000_000_000),
            config_file: Some("/etc/match.toml".into()),
            overrides: Overrides {
                fps: Some(60.0),
                publish: vec!["ssl".into()],
                no_console: true,
                for_console: true,
            },
            members: vec![Member { stage: "tracker".into(), pid: 12, spare: true }],
            restarts: [("tracker".to_string(), 3)].into(),
            events: vec![Event::new(EventKind::TakenOver, "tracker", 12, "taken over", "")],
        };
        record.write(&instance).unwrap();
        assert_eq!(Record::read(&instance), Some(record.clone()));
        assert_eq!(record.is_spare(ProcessKind::Tracker.into(), 12), Some(true));
        assert_eq!(record.is_spare(StageId::FILTER, 12), None, "the number is used again");
        fs::write(instance.record_path(), b"{\"source\":").unwrap();
        assert_eq!(Record::read(&instance), None);
        instance.remove_directory().unwrap();
    }
}
