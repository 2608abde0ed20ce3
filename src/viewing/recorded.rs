//! A recording and its configurations, and everything that was recorded of one frame.

use super::ViewingError;
use crate::console::picture::Frame;
use crate::console::scene::Scene;
use config::change::changes;
use config::snapshot::Snapshot;
use messages::{DetectionFrame, FrameHeader, Run, RunsHeader, WorldFrame};
use recording::{
    Archive, Channel, Entry, Moment, Setup, decode_frame, decode_list, decode_message,
};
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::mem::offset_of;
use std::path::Path;
use std::rc::Rc;

/// Chunks kept in memory, each with some frames.
const KEPT_CHUNKS: usize = 12;
/// Chunks around that of a frame in which its results may be: a recorder empties one topic after the other, after a
/// pause with many frames, and a large frame fills a chunk.
const AROUND: usize = 64;
/// Longest time after a frame in which its results were sent.
const RESULTS_NS: u64 = 300_000_000;
/// Most keys told of a changed configuration.
const MOST_KEYS: usize = 40;

/// An opened recording.
pub struct Recorded {
    archive: Archive,
    /// Chunks that were read last, newest first.
    kept: VecDeque<(usize, Rc<Vec<Entry>>)>,
    configurations: Vec<Configuration>,
}

/// A configuration in a recording.
pub struct Configuration {
    /// When it came, nanoseconds since 1970.
    pub t_ns: u64,
    /// The group that had it.
    pub setup: Setup,
    /// Ready for drawing.
    pub scene: Scene,
}

/// Everything that was recorded of a frame.
pub struct At {
    /// Number of the moment.
    pub index: usize,
    /// Time of sending, nanoseconds since 1970.
    pub t_ns: u64,
    /// Number of the frame.
    pub seq: u64,
    /// The picture.
    pub frame: Option<Frame>,
    /// What the tracker found.
    pub detections: Option<Box<DetectionFrame>>,
    /// What the filter made of it.
    pub world: Option<Box<WorldFrame>>,
    /// Classified pixels, if they were recorded.
    pub runs: Option<(RunsHeader, Vec<Run>)>,
}

impl Recorded {
    /// Opens a recording of a group.
    pub fn open(path: &Path) -> Result<Self, ViewingError> {
        let archive = Archive::open(path)?;
        let mut recorded = Self { archive, kept: VecDeque::new(), configurations: Vec::new() };
        for chunk in 0..recorded.archive.chunks() {
            if recorded.archive.has(chunk, Channel::Setup) {
                let entries = recorded.chunk(chunk)?;
                let setups = entries.iter().filter(|entry| entry.channel == Channel::Setup);
                recorded.configurations.extend(setups.filter_map(Configuration::of));
            }
        }
        // A later file of a recording repeats configurations that its first outputs name.
        recorded.configurations.sort_by_key(|it| (it.setup.revision, it.t_ns));
        recorded
            .configurations
            .dedup_by_key(|it| (it.setup.revision, it.setup.config_toml.clone()));
        if recorded.configurations.is_empty() {
            return Err(
                "no configuration was recorded with it: it is no recording of a group".into()
            );
        }
        if recorded.archive.moments().is_empty() {
            return Err("it has neither frames nor results".into());
        }
        Ok(recorded)
    }

    /// Where everything is.
    pub fn archive(&self) -> &Archive {
        &self.archive
    }

    /// Time of the first frame, nanoseconds since 1970, from which everything is counted.
    pub fn begin_ns(&self) -> u64 {
        self.archive.moments().first().map_or(0, |moment| moment.t_sent_ns)
    }

    /// Seconds since the first frame; what precedes it is at 0.
    pub fn after_s(&self, t_ns: u64) -> f64 {
        t_ns.saturating_sub(self.begin_ns()) as f64 / 1e9
    }

    /// Number of the frame that is nearest to a time, seconds since the first one.
    pub fn nearest(&self, time_s: f64) -> usize {
        let t_ns = self.begin_ns().saturating_add((time_s.max(0.0) * 1e9) as u64);
        self.archive.nearest(t_ns).unwrap_or(0)
    }

    /// The messages of a chunk.
    pub fn chunk(&mut self, chunk: usize) -> std::io::Result<Rc<Vec<Entry>>> {
        if let Some(at) = self.kept.iter().position(|(known, _)| *known == chunk)
            && let Some(found) = self.kept.remove(at)
        {
            self.kept.push_front(found);
        } else {
            let entries = Rc::new(self.archive.read(chunk)?);
            self.kept.push_front((chunk, entries));
            self.kept.truncate(KEPT_CHUNKS);
        }
        Ok(self.kept.front().map(|(_, entries)| Rc::clone(entries)).unwrap_or_default())
    }

    /// The configuration that outputs of this revision were made with; without revisions, that of the time.
    pub fn configuration(&self, revision: u32, t_ns: u64) -> &Configuration {
        let all = &self.configurations;
        let of_revision = all.iter().rev().find(|it| it.setup.revision <= revision);
        let found = match revision {
            0 => all.iter().rev().find(|it| it.t_ns <= t_ns),
            _ => of_revision,
        };
        // There is at least one.
        found.unwrap_or(&all[0])
    }

    /// All configurations, the first one first.
    pub fn configurations(&self) -> &[Configuration] {
        &self.configurations
    }

    /// Everything of the frame with this number; `None` beyond the last one, or where the file is damaged.
    pub fn at(&mut self, index: usize) -> std::io::Result<Option<At>> {
        let Some(&moment) = self.archive.moments().get(index) else { return Ok(None) };
        let (lead, chunk) = (self.archive.lead(), moment.chunk as usize);
        let entries = self.chunk(chunk)?;
        let is_it = |it: &&Entry| it.channel == lead && it.t_sent_ns == moment.t_sent_ns;
        let Some(seq) = entries.iter().find(is_it).and_then(frame_seq) else { return Ok(None) };
        let mut at = At {
            index,
            t_ns: moment.t_sent_ns,
            seq,
            frame: None,
            detections: None,
            world: None,
            runs: None,
        };
        for chunk in self.around(moment) {
            for entry in self.chunk(chunk)?.iter() {
                at.take(entry);
            }
            if at.world.is_some() && at.detections.is_some() {
                break;
            }
        }
        Ok(Some(at))
    }

    /// Chunks with messages that were sent soon after a frame, that of the frame first.
    fn around(&self, moment: Moment) -> Vec<usize> {
        let (own, t_ns) = (moment.chunk as usize, moment.t_sent_ns);
        let is_in_time = |&chunk: &usize| {
            let times_ns = self.archive.chunk_times_ns(chunk);
            times_ns.is_some_and(|(from, to)| to >= t_ns && from <= t_ns + RESULTS_NS)
        };
        let range = own.saturating_sub(AROUND)..=own + AROUND;
        let mut near: Vec<usize> =
            range.filter(|chunk| *chunk == own || is_in_time(chunk)).collect();
        near.sort_by_key(|chunk| chunk.abs_diff(own));
        near
    }

    /// What does not change from frame to frame.
    pub fn describe(&self) -> Value {
        let moments = self.archive.moments();
        let end_ns = moments.last().map_or(0, |moment| moment.t_sent_ns);
        let mut before: Option<&Configuration> = None;
        let configurations = self.configurations.iter().map(|it| {
            let differences = before.map(|old| changes(&old.scene.config, &it.scene.config));
            let differences = differences.unwrap_or_default();
            let words = differences.iter().take(MOST_KEYS).map(ToString::to_string);
            before = Some(it);
            json!({
                "revision": it.setup.revision, "after_s": self.after_s(it.t_ns),
                "changes": words.collect::<Vec<_>>(),
            })
        });
        let first = &self.configurations[0];
        json!({
            "frames": moments.len(), "seconds": self.after_s(end_ns),
            "begins_s": self.begin_ns() as f64 * 1e-9,
            "has_pictures": self.archive.lead() == Channel::Frames,
            "instance": first.setup.instance, "version": first.setup.touchline_version,
            "revision": first.setup.revision,
            "configurations": configurations.collect::<Vec<_>>(),
        })
    }
}

/// Number of the frame that a message is about, without decoding all of it.
pub fn frame_seq(entry: &Entry) -> Option<u64> {
    // Each of them begins with the header of its frame, and that with the number.
    const _: () = assert!(offset_of!(DetectionFrame, frame) == 0);
    const _: () = assert!(offset_of!(WorldFrame, frame) == 0);
    const _: () = assert!(offset_of!(RunsHeader, frame) == 0);
    const _: () = assert!(offset_of!(FrameHeader, seq) == 0);
    match entry.channel {
        Channel::Frames => Some(decode_frame(&entry.data)?.header.seq),
        Channel::Detections | Channel::World | Channel::Runs => {
            // Zeros at the end of a message are left out.
            let mut bytes = [0; 8];
            let there = entry.data.len().min(bytes.len());
            bytes[..there].copy_from_slice(&entry.data[..there]);
            Some(u64::from_le_bytes(bytes))
        }
        _ => None,
    }
}

impl Configuration {
    /// The configuration in a message; `None` if it cannot be read or drawn.
    fn of(entry: &Entry) -> Option<Self> {
        let setup = Setup::decode(&entry.data)?;
        let snapshot = Snapshot::parse(&setup.config_toml, "recorded").ok()?;
        Some(Self { t_ns: entry.t_sent_ns, setup, scene: Scene::new(&snapshot)? })
    }
}

impl At {
    /// Takes a message if it is about this frame.
    fn take(&mut self, entry: &Entry) {
        if frame_seq(entry) != Some(self.seq) {
            return;
        }
        match entry.channel {
            Channel::Frames => {
                let frame = decode_frame(&entry.data);
                self.frame = frame.and_then(|frame| {
                    let size_px = [frame.header.width, frame.header.height];
                    Frame::copy(&frame.header, frame.pixels, size_px)
                });
            }
            Channel::Detections => self.detections = decode_message(&entry.data),
            Channel::World => self.world = decode_message(&entry.data),
            Channel::Runs => self.runs = decode_list(&entry.data),
            _ => {}
        }
    }

    /// Revision of the configuration that made the results; 0 if there are none, or they name none.
    pub fn revision(&self) -> u32 {
        let of_detections = self.detections.as_ref().map(|it| it.revision);
        of_detections.or(self.world.as_ref().map(|it| it.revision)).unwrap_or_default()
    }
}
