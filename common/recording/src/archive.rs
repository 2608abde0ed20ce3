//! A recording to look around in: its moments by time, and any chunk without reading those before it.

use crate::reader::{Entry, open};
use crate::scan::{Kind, Scanner};
use crate::wire::{
    Cursor, HEAD_BYTES, Head, channel, chunk_index, chunk_times, message, message_index, op,
};
use crate::{Channel, RecordingError};
use config::input;
use std::borrow::Cow;
use std::collections::HashMap;
use std::io;
use std::path::Path;

/// Largest index of one channel's messages in a chunk: a recorder ends a chunk after 40 ms.
const MOST_INDEX_BYTES: u64 = 1 << 20;
/// Channels that have a message for each frame; the first of them that a recording has gives its moments.
const LEADS: [Channel; 3] = [Channel::Frames, Channel::Detections, Channel::World];

/// A frame, or what was made of it if frames were not recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Moment {
    /// Time of sending, nanoseconds since 1970.
    pub t_sent_ns: u64,
    /// Number of the chunk with the message.
    pub chunk: u32,
}

/// Random access to a recording.
///
/// A finished recording is opened by its index, however long it is. One without a valid index is read once from
/// the beginning to the end. What the recorder appends after that is not seen.
pub struct Archive {
    scanner: Scanner,
    /// `None` for channels of other programs.
    channels: HashMap<u16, Option<Channel>>,
    chunks: Vec<Chunk>,
    lead: Channel,
    moments: Vec<Moment>,
}

/// Place and contents of a chunk.
#[derive(Debug, Clone, Copy)]
struct Chunk {
    at: u64,
    times_ns: Option<(u64, u64)>,
    /// Bit set by the number of the channel.
    has: u32,
}

impl Archive {
    /// Opens a recording.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let io = |action| move |source| RecordingError::Io { path: path.into(), action, source };
        let scanner = open(path, input::open(path).map_err(io("open"))?)?;
        let mut archive = Self {
            scanner,
            channels: HashMap::new(),
            chunks: Vec::new(),
            lead: Channel::World,
            moments: Vec::new(),
        };
        archive.find().map_err(io("read"))?;
        Ok(archive)
    }

    /// The channel that gives the moments.
    pub fn lead(&self) -> Channel {
        self.lead
    }

    /// All frames in the order in which they were sent.
    pub fn moments(&self) -> &[Moment] {
        &self.moments
    }

    /// Number of the moment that is nearest to a time, nanoseconds since 1970; `None` if there is none at all.
    pub fn nearest(&self, t_ns: u64) -> Option<usize> {
        let after = self.moments.partition_point(|moment| moment.t_sent_ns < t_ns);
        let distance = |&at: &usize| self.moments[at].t_sent_ns.abs_diff(t_ns);
        let both = [after.checked_sub(1), Some(after).filter(|&at| at < self.moments.len())];
        both.into_iter().flatten().min_by_key(distance)
    }

    /// Number of chunks.
    pub fn chunks(&self) -> usize {
        self.chunks.len()
    }

    /// Times of the earliest and the latest message of a chunk, nanoseconds since 1970.
    pub fn chunk_times_ns(&self, chunk: usize) -> Option<(u64, u64)> {
        self.chunks.get(chunk)?.times_ns
    }

    /// Whether a chunk has messages of a channel, by the index.
    pub fn has(&self, chunk: usize, channel: Channel) -> bool {
        self.chunks.get(chunk).is_some_and(|it| it.has & bit(channel) != 0)
    }

    /// The messages of a chunk in the order of the file; none if it is damaged or there is no such chunk.
    pub fn read(&mut self, chunk: usize) -> io::Result<Vec<Entry>> {
        let Some(place) = self.chunks.get(chunk) else { return Ok(Vec::new()) };
        self.scanner.seek(place.at);
        let piece = self.scanner.next()?;
        if !piece.is_some_and(|piece| matches!(piece.kind, Kind::Chunk { .. } | Kind::Loose)) {
            return Ok(Vec::new());
        }
        let mut cursor = Cursor(self.scanner.records());
        let records = std::iter::from_fn(|| cursor.record());
        let messages = records.filter(|(opcode, _)| *opcode == op::MESSAGE);
        let entry = |(_, body): (u8, _)| {
            let (header, data) = message(body)?;
            let &channel = self.channels.get(&header.channel_id)?;
            let data: Cow<'static, [u8]> = Cow::Owned(<[u8]>::to_vec(data));
            Some(Entry { channel: channel?, t_sent_ns: header.log_ns, data })
        };
        Ok(messages.filter_map(entry).collect())
    }

    /// Finds all chunks and moments.
    fn find(&mut self) -> io::Result<()> {
        for (opcode, body) in self.scanner.descriptions()? {
            if let Some((id, name)) = channel(&body).filter(|_| opcode == op::CHANNEL) {
                self.channels.insert(id, Channel::from_name(name));
            }
        }
        let mut found = self.by_index()?;
        if found.is_none() {
            self.chunks.clear();
            found = Some(self.by_reading()?);
        }
        let mut found = found.unwrap_or_default();
        let lead = LEADS.into_iter().find(|lead| found.contains_key(lead));
        self.lead = lead.unwrap_or(Channel::World);
        self.moments = found.remove(&self.lead).unwrap_or_default();
        self.moments.sort_unstable();
        Ok(())
    }

    /// Chunks and moments by the index at the end of the file; `None` if there is none, or it contradicts the
    /// file.
    fn by_index(&mut self) -> io::Result<Option<Found>> {
        let mut index = Vec::new();
        self.scanner.read_summary(&[op::CHUNK_INDEX], |_, body| {
            index.push(chunk_index(body).zip(chunk_times(body)));
        })?;
        if index.is_empty() {
            return Ok(None);
        }
        let mut found = Found::new();
        for it in index {
            let Some(((at, indexes), times_ns)) = it else { return Ok(None) };
            let number = self.chunks.len() as u32;
            let mut has = 0;
            for (id, place) in indexes {
                let Some(&Some(channel)) = self.channels.get(&id) else { continue };
                has |= bit(channel);
                if !LEADS.contains(&channel) {
                    continue;
                }
                let Some(times) = self.message_times(place, id)? else { return Ok(None) };
                let moments =
                    times.into_iter().map(|t_sent_ns| Moment { t_sent_ns, chunk: number });
                found.entry(channel).or_default().extend(moments);
            }
            self.chunks.push(Chunk { at, times_ns: Some(times_ns).filter(|_| has != 0), has });
        }
        Ok(Some(found))
    }

    /// Times of a channel's messages in a chunk, from the record at this offset.
    fn message_times(&mut self, place: u64, id: u16) -> io::Result<Option<Vec<u64>>> {
        let bytes = self.scanner.bytes();
        let head = Head::parse(bytes.at(place, HEAD_BYTES as usize)?);
        let is_index =
            |head: &Head| head.opcode == op::MESSAGE_INDEX && head.length <= MOST_INDEX_BYTES;
        let Some(head) = head.filter(is_index) else { return Ok(None) };
        let body = bytes.at(place + HEAD_BYTES, head.length as usize)?;
        let entries = message_index(body).filter(|(named, _)| *named == id);
        Ok(entries.map(|(_, entries)| entries.into_iter().map(|(t_ns, _)| t_ns).collect()))
    }

    /// Chunks and moments of a file without a valid index, by reading all of it.
    fn by_reading(&mut self) -> io::Result<Found> {
        let mut found = Found::new();
        while let Some(piece) = self.scanner.next()? {
            if !matches!(piece.kind, Kind::Chunk { .. } | Kind::Loose) {
                continue;
            }
            let number = self.chunks.len() as u32;
            let mut chunk = Chunk { at: piece.at, times_ns: None, has: 0 };
            let mut cursor = Cursor(self.scanner.records());
            while let Some((opcode, body)) = cursor.record() {
                if let Some((id, name)) = channel(body).filter(|_| opcode == op::CHANNEL) {
                    self.channels.entry(id).or_insert_with(|| Channel::from_name(name));
                }
                let Some((header, _)) = message(body).filter(|_| opcode == op::MESSAGE) else {
                    continue;
                };
                let Some(&Some(channel)) = self.channels.get(&header.channel_id) else { continue };
                chunk.has |= bit(channel);
                chunk.times_ns = Some(crate::summary::widened(chunk.times_ns, header.log_ns));
                if LEADS.contains(&channel) {
                    let moment = Moment { t_sent_ns: header.log_ns, chunk: number };
                    found.entry(channel).or_default().push(moment);
                }
            }
            if chunk.has != 0 {
                self.chunks.push(chunk);
            }
        }
        Ok(found)
    }
}

/// Moments by their channel.
type Found = HashMap<Channel, Vec<Moment>>;

fn bit(channel: Channel) -> u32 {
    1 << channel as u32
}
