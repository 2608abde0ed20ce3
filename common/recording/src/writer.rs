//! Writing a recording.

use crate::chunk::OpenChunk;
use crate::summary::{ChunkIndex, Summary, schema_body};
use crate::wire::{Encoder, MAGIC, MessageHeader, body, op};
use crate::{Channel, RecordingError};
use mcap::records;
use rustix::fs::{FlockOperation, Mode, OFlags, flock};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Largest chunk before compression; normally a chunk ends by time.
const CHUNK_BYTES: usize = 4 << 20;

/// Writes one file. Messages are collected in a chunk, which is compressed and written as a whole by
/// [`flush`](Self::flush): flushed messages survive the death of the process.
///
/// After an error the file is cut off after the last complete chunk and closed. It can be read, and
/// [`recover`](crate::recover::recover) makes it a proper recording.
///
/// The index of chunks, which belongs at the end of the file, grows with the recording: some 20 MB in an
/// hour. It waits in a file without a name on the same disk, not in memory.
#[derive(Debug)]
pub struct Writer {
    path: PathBuf,
    /// `None` after an error.
    open: Option<Open>,
    /// Bytes in the file.
    bytes: u64,
}

struct Open {
    file: File,
    ids: BTreeMap<Channel, u16>,
    sequences: BTreeMap<Channel, u32>,
    chunk: OpenChunk,
    summary: Summary,
    /// Records of the index of chunks, in a file without a name.
    index: File,
    chunks: u32,
}

impl std::fmt::Debug for Open {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Open").field("ids", &self.ids).finish_non_exhaustive()
    }
}

impl Writer {
    /// Starts a recording with these channels. An existing file is never touched. The file stays locked
    /// (flock) while it is written, so that no process takes it for an abandoned one.
    pub fn create(path: &Path, channels: &[Channel]) -> Result<Self, RecordingError> {
        let io = |source| RecordingError::Io { path: path.into(), action: "create", source };
        let file =
            OpenOptions::new().read(true).write(true).create_new(true).open(path).map_err(io)?;
        flock(&file, FlockOperation::NonBlockingLockExclusive).map_err(|error| io(error.into()))?;
        let open = Open {
            file,
            ids: BTreeMap::new(),
            sequences: BTreeMap::new(),
            chunk: OpenChunk::new().map_err(io)?,
            summary: Summary::default(),
            index: nameless_file(path).map_err(io)?,
            chunks: 0,
        };
        let mut writer = Self { path: path.into(), open: Some(open), bytes: 0 };
        writer.attempt("write", |open, bytes| {
            open.begin(bytes)?;
            channels.iter().for_each(|&channel| open.describe(channel));
            open.flush(bytes)
        })?;
        Ok(writer)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes in the file so far.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Whether there are messages that are not in the file yet.
    pub fn is_pending(&self) -> bool {
        self.open.as_ref().is_some_and(|open| open.chunk.length() > 0)
    }

    /// Adds a message. Times are nanoseconds since 1970: of its sending, and of the event it describes.
    /// Messages of a channel that was not requested are ignored.
    pub fn write(
        &mut self,
        channel: Channel,
        t_sent_ns: u64,
        t_about_ns: u64,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        self.attempt("write", |open, bytes| {
            let Some(&channel_id) = open.ids.get(&channel) else { return Ok(()) };
            let sequence = open.sequences.entry(channel).or_default();
            *sequence = sequence.wrapping_add(1);
            let header = MessageHeader { channel_id, log_ns: t_sent_ns };
            open.chunk.add_message(header, *sequence, t_about_ns, data);
            open.summary.count(channel_id, t_sent_ns);
            if open.chunk.length() < CHUNK_BYTES { Ok(()) } else { open.flush(bytes) }
        })
    }

    /// Writes everything to the file. It is then with the operating system and survives the death of
    /// the process; for power failures see [`sync_handle`](Self::sync_handle).
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.attempt("write", Open::flush)
    }

    /// A handle for regular `sync_data` calls on another thread, since these may take long. `None`
    /// after an error.
    pub fn sync_handle(&self) -> Option<File> {
        self.open.as_ref()?.file.try_clone().ok()
    }

    /// Completes the file and syncs it to the disk; returns its size.
    pub fn finish(mut self) -> Result<u64, RecordingError> {
        self.flush()?;
        self.attempt("complete", |open, bytes| {
            open.index.seek(SeekFrom::Start(0))?;
            let index = ChunkIndex { records: &open.index, count: open.chunks };
            open.summary.write(*bytes, index, &open.file)?;
            *bytes = open.file.metadata()?.len();
            open.file.sync_all()
        })?;
        Ok(self.bytes)
    }

    /// Acts on the open file and the number of bytes in it.
    fn attempt(
        &mut self,
        action: &'static str,
        act: impl FnOnce(&mut Open, &mut u64) -> io::Result<()>,
    ) -> Result<(), RecordingError> {
        let outcome = match &mut self.open {
            Some(open) => act(open, &mut self.bytes),
            None => Err(io::Error::other("the recording ended with an earlier error")),
        };
        outcome.map_err(|source| {
            self.abandon();
            RecordingError::Io { path: self.path.clone(), action, source }
        })
    }

    /// Cuts off what the failed attempt has written.
    fn abandon(&mut self) {
        let Some(open) = self.open.take() else { return };
        // If even this fails, a reader stops at the incomplete chunk.
        let _ = open.file.set_len(self.bytes);
    }
}

/// A recorder that is dropped still writes what it has.
impl Drop for Writer {
    fn drop(&mut self) {
        let _ = self.flush();
    }
}

impl Open {
    /// Writes the beginning of the file.
    fn begin(&mut self, bytes: &mut u64) -> io::Result<()> {
        let library = concat!("touchline ", env!("CARGO_PKG_VERSION")).into();
        let header = records::Header { profile: String::new(), library };
        let mut beginning = Encoder(MAGIC.to_vec());
        beginning.record(op::HEADER, &body(&header));
        self.append(&beginning.0, bytes)
    }

    /// Adds the records that describe a channel.
    fn describe(&mut self, channel: Channel) {
        if self.ids.contains_key(&channel) {
            return;
        }
        let description = channel.description();
        let id = self.ids.len() as u16 + 1;
        let schema = records::SchemaHeader {
            id,
            name: description.schema_name.to_string(),
            encoding: description.schema_encoding.to_string(),
        };
        let schema = schema_body(schema, &description.schema);
        let described = body(&records::Channel {
            id,
            schema_id: id,
            topic: channel.name().to_string(),
            message_encoding: description.message_encoding.to_string(),
            metadata: BTreeMap::new(),
        });
        self.chunk.add(op::SCHEMA, &schema);
        self.chunk.add(op::CHANNEL, &described);
        self.summary.schemas.insert(id, schema);
        self.summary.channels.insert(id, described);
        self.ids.insert(channel, id);
    }

    /// Writes the chunk, if there is anything in it.
    fn flush(&mut self, bytes: &mut u64) -> io::Result<()> {
        if self.chunk.length() == 0 {
            return Ok(());
        }
        let (chunk, location) = self.chunk.finish(*bytes)?;
        self.file.write_all(chunk)?;
        *bytes += chunk.len() as u64;
        self.index.write_all(&location.record())?;
        self.chunks += 1;
        Ok(())
    }

    fn append(&mut self, data: &[u8], bytes: &mut u64) -> io::Result<()> {
        self.file.write_all(data)?;
        *bytes += data.len() as u64;
        Ok(())
    }
}

/// A file without a name on the disk of another one; the system removes it with its last descriptor.
fn nameless_file(beside: &Path) -> io::Result<File> {
    let directory = beside.parent().filter(|parent| !parent.as_os_str().is_empty());
    let directory = directory.unwrap_or(Path::new("."));
    let flags = OFlags::TMPFILE | OFlags::RDWR | OFlags::CLOEXEC;
    if let Ok(file) = rustix::fs::open(directory, flags, Mode::RUSR | Mode::WUSR) {
        return Ok(file.into());
    }
    // Not every file system has files without names.
    let mut name = std::ffi::OsString::from(".");
    name.push(beside.file_name().unwrap_or_default());
    name.push(format!(".index-{}", std::process::id()));
    let path = directory.join(name);
    let file = OpenOptions::new().read(true).write(true).create_new(true).open(&path)?;
    std::fs::remove_file(&path)?;
    Ok(file)
}
