//! Reading a recording, finished or not.

use crate::writer::into_error;
use crate::{Channel, RecordingError};
use mcap::McapError;
use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;
use std::borrow::Cow;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// What a complete file begins and ends with.
const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";
/// The recorder empties one topic after the other, so the file is out of order, but never by more.
const DISORDER_NS: u64 = 500_000_000;

/// One message of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// Its channel.
    pub channel: Channel,
    /// When it was sent, nanoseconds since 1970.
    pub t_sent_ns: u64,
    /// As written by the `encode_*` functions.
    pub data: Cow<'static, [u8]>,
}

/// Gives the messages of a recording in the order in which they were sent. It reads the file from
/// the front and holds little of it at a time, so it needs no index, and reads what there is of a
/// recording that was never finished.
pub struct Reader {
    path: PathBuf,
    messages: MessageReader<BufReader<File>>,
    /// Read ahead: earliest first; those of the same time as in the file.
    ahead: BinaryHeap<Reverse<Queued>>,
    newest_ns: u64,
    count: u64,
    at_end: bool,
    damage: Option<String>,
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
        (self.entry.t_sent_ns, self.number).cmp(&(other.entry.t_sent_ns, other.number))
    }
}

impl Reader {
    /// Opens a recording.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let io = |source| RecordingError::Io { path: path.into(), action: "open", source };
        let mut file = File::open(path).map_err(io)?;
        let Some(is_finished) = is_finished(&mut file).map_err(io)? else {
            let problem = "not a recording: it is no MCAP file".into();
            return Err(RecordingError::Format { path: path.into(), problem });
        };
        // Check sums say where a damaged file stops making sense.
        let options =
            LinearReaderOptions::default().with_skip_end_magic(true).with_validate_chunk_crcs(true);
        Ok(Self {
            path: path.into(),
            messages: MessageReader::new_with_options(BufReader::new(file), options),
            ahead: BinaryHeap::new(),
            newest_ns: 0,
            count: 0,
            at_end: false,
            damage: (!is_finished).then(|| "it has no end".into()),
        })
    }

    /// Once everything was read: why the file ends before its end, if it does.
    pub fn damage(&self) -> Option<&str> {
        self.damage.as_deref()
    }

    fn read_ahead(&mut self) -> Result<(), RecordingError> {
        match self.messages.next() {
            None => self.at_end = true,
            Some(Ok(message)) => {
                // Channels of other programs are theirs.
                let Some(channel) = Channel::from_name(&message.channel.topic) else {
                    return Ok(());
                };
                self.newest_ns = self.newest_ns.max(message.log_time);
                self.count += 1;
                let entry = Entry { channel, t_sent_ns: message.log_time, data: message.data };
                self.ahead.push(Reverse(Queued { number: self.count, entry }));
            }
            Some(Err(McapError::Io(source)))
                if source.kind() != std::io::ErrorKind::UnexpectedEof =>
            {
                self.at_end = true;
                return Err(into_error(&self.path, "read", McapError::Io(source)));
            }
            Some(Err(error)) => {
                self.at_end = true;
                self.damage = Some(error.to_string());
            }
        }
        Ok(())
    }
}

impl Iterator for Reader {
    type Item = Result<Entry, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let earliest = self.ahead.peek().map(|Reverse(queued)| queued.entry.t_sent_ns);
            let is_next =
                earliest.is_some_and(|t_ns| self.at_end || self.newest_ns - t_ns >= DISORDER_NS);
            if is_next {
                return self.ahead.pop().map(|Reverse(queued)| Ok(queued.entry));
            }
            if self.at_end {
                return None;
            }
            if let Err(error) = self.read_ahead() {
                return Some(Err(error));
            }
        }
    }
}

/// Whether a file is a recording that was finished; `None` when it is no recording at all.
pub(crate) fn is_finished(file: &mut File) -> std::io::Result<Option<bool>> {
    let length = file.seek(SeekFrom::End(0))?;
    let mut magic = [0; MAGIC.len()];
    file.rewind()?;
    if length < MAGIC.len() as u64 {
        return Ok(None);
    }
    file.read_exact(&mut magic)?;
    if &magic != MAGIC {
        return Ok(None);
    }
    file.seek(SeekFrom::End(-(MAGIC.len() as i64)))?;
    file.read_exact(&mut magic)?;
    file.rewind()?;
    Ok(Some(length > MAGIC.len() as u64 && &magic == MAGIC))
}
