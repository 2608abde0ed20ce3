//! Reading a recording, finished or not, damaged or not.

use crate::damage::{Damages, Fault};
use crate::scan::{Kind, Piece, Scanner};
use crate::wire::{Cursor, channel, message, op};
use crate::{Channel, RecordingError};
use config::input;
use std::borrow::Cow;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};
use std::path::{Path, PathBuf};

/// Largest disorder of messages in a file; the recorder empties one topic after the other.
const DISORDER_NS: u64 = 500_000_000;
/// Memory for messages read ahead, besides twice the size of the file. Half a second of our own
/// recordings takes less.
const AHEAD_BYTES: u64 = 24 << 20;
/// Upper limit of that memory for any file.
const MAX_AHEAD_BYTES: u64 = 2 << 30;
/// Memory for a message read ahead besides its data.
const ENTRY_BYTES: usize = 112;

/// Number of the first message of a file.
const FIRST: u64 = 1;

/// One message of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// The message's channel.
    pub channel: Channel,
    /// Time of sending, nanoseconds since 1970.
    pub t_sent_ns: u64,
    /// Encoded data, as written by the `encode_*` functions.
    pub data: Cow<'static, [u8]>,
}

/// Reads the messages of a recording in the order in which they were sent, after the configuration that the file
/// begins with.
///
/// It reads the file sequentially and holds little of it at a time, so it needs no index, and can read an unfinished
/// recording. Damaged parts are skipped and reported by [`damages`](Self::damages).
pub struct Reader {
    path: PathBuf,
    scanner: Scanner,
    /// `None` for channels of other programs.
    channels: HashMap<u16, Option<Channel>>,
    /// The piece read at the moment, and the position in its records.
    piece: Option<Piece>,
    walked: usize,
    /// Messages read ahead: earliest first, and in file order for equal times; before all others the configuration
    /// that the file begins with.
    ahead: BinaryHeap<Reverse<Queued>>,
    ahead_bytes: usize,
    most_ahead_bytes: usize,
    newest_ns: u64,
    count: u64,
    at_end: bool,
    damages: Damages,
}

#[derive(Debug, PartialEq, Eq)]
struct Queued {
    number: u64,
    entry: Entry,
}

impl PartialOrd for Queued {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Queued {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.place().cmp(&other.place())
    }
}

impl Queued {
    /// Sort key.
    ///
    /// A file begins with the configuration of what follows. Messages that were on their way when recording began
    /// were sent before that, but cannot be understood without it.
    fn place(&self) -> (bool, u64, u64) {
        let begins_the_file = self.number == FIRST && self.entry.channel == Channel::Setup;
        (!begins_the_file, self.entry.t_sent_ns, self.number)
    }
}

impl Reader {
    /// Opens a recording.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let io = |source| RecordingError::Io { path: path.into(), action: "open", source };
        let mut scanner = open(path, input::open(path).map_err(io)?)?;
        let mut channels = HashMap::new();
        for (opcode, body) in scanner.descriptions().map_err(io)? {
            if let Some((id, name)) = channel(&body).filter(|_| opcode == op::CHANNEL) {
                channels.insert(id, Channel::from_name(name));
            }
        }
        let most_ahead = (2 * scanner.length() + AHEAD_BYTES).min(MAX_AHEAD_BYTES);
        Ok(Self {
            path: path.into(),
            scanner,
            channels,
            piece: None,
            walked: 0,
            ahead: BinaryHeap::new(),
            ahead_bytes: 0,
            most_ahead_bytes: most_ahead as usize,
            newest_ns: 0,
            count: 0,
            at_end: false,
            damages: Damages::default(),
        })
    }

    /// Damage found so far; complete once everything has been read.
    pub fn damages(&self) -> &Damages {
        &self.damages
    }

    /// Reads the next record or, at the end of a piece, the next piece.
    fn read_ahead(&mut self) -> std::io::Result<()> {
        let records = self.scanner.records();
        let mut cursor = Cursor(&records[self.walked..]);
        let Some(piece) = self.piece.filter(|_| !cursor.0.is_empty()) else {
            return self.next_piece();
        };
        let record = cursor.record();
        self.walked = records.len() - cursor.0.len();
        match record {
            Some((op::MESSAGE, body)) => {
                let Some((header, data)) = message(body) else {
                    self.damages.add(Fault::Records, piece.at, piece.length);
                    return Ok(());
                };
                self.damages.note_time(header.log_ns);
                match self.channels.get(&header.channel_id) {
                    Some(&Some(channel)) => {
                        let data: Cow<'static, [u8]> = Cow::Owned(data.to_vec());
                        self.newest_ns = self.newest_ns.max(header.log_ns);
                        self.count += 1;
                        self.ahead_bytes += data.len() + ENTRY_BYTES;
                        let entry = Entry { channel, t_sent_ns: header.log_ns, data };
                        self.ahead.push(Reverse(Queued { number: self.count, entry }));
                    }
                    // Channels of other programs are skipped.
                    Some(None) => {}
                    None => self.damages.add(Fault::UnknownChannel, piece.at, piece.length),
                }
            }
            Some((op::CHANNEL, body)) => {
                if let Some((id, name)) = channel(body) {
                    self.channels.entry(id).or_insert_with(|| Channel::from_name(name));
                }
            }
            Some(_) => {}
            None => {
                self.walked = records.len();
                self.damages.add(Fault::Records, piece.at, piece.length);
            }
        }
        Ok(())
    }

    fn next_piece(&mut self) -> std::io::Result<()> {
        self.walked = 0;
        self.piece = self.scanner.next()?;
        let Some(piece) = self.piece else {
            self.at_end = true;
            return Ok(());
        };
        match piece.kind {
            Kind::Chunk { is_framed: false, .. } => {
                self.damages.add(Fault::Framing, piece.at, piece.length);
            }
            Kind::Damaged(fault) => self.damages.add(fault, piece.at, piece.length),
            Kind::End { is_marked } => {
                self.damages.is_finished = is_marked || self.scanner.has_summary();
                if is_marked && !self.scanner.has_summary() {
                    let rest = self.scanner.length() - piece.at;
                    self.damages.add(Fault::Index, piece.at, rest);
                }
            }
            Kind::Chunk { .. } | Kind::Loose | Kind::MessageIndex | Kind::Other => {}
        }
        if !matches!(piece.kind, Kind::Chunk { .. } | Kind::Loose) {
            // The buffer holds no messages.
            self.walked = self.scanner.records().len();
        }
        Ok(())
    }
}

impl Iterator for Reader {
    type Item = Result<Entry, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let earliest = self.ahead.peek().map(|Reverse(queued)| queued.entry.t_sent_ns);
            let is_next = earliest.is_some_and(|t_ns| {
                self.at_end
                    || self.newest_ns.saturating_sub(t_ns) >= DISORDER_NS
                    || self.ahead_bytes > self.most_ahead_bytes
            });
            if is_next {
                let Reverse(queued) = self.ahead.pop()?;
                self.ahead_bytes -= queued.entry.data.len() + ENTRY_BYTES;
                return Some(Ok(queued.entry));
            }
            if self.at_end {
                return None;
            }
            if let Err(source) = self.read_ahead() {
                self.at_end = true;
                let (path, action) = (self.path.clone(), "read");
                return Some(Err(RecordingError::Io { path, action, source }));
            }
        }
    }
}

/// Opens a file that must be a recording.
pub(crate) fn open(path: &Path, file: std::fs::File) -> Result<Scanner, RecordingError> {
    let io = |source| RecordingError::Io { path: path.into(), action: "read", source };
    Scanner::new(file).map_err(io)?.ok_or_else(|| RecordingError::Format {
        path: path.into(),
        problem: "not a recording: it is not an MCAP file".into(),
    })
}
