//! Writing a recording.

use crate::{Channel, RecordingError};
use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions};
use rustix::fs::{FlockOperation, flock};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// The fastest level: 800 MB/s on camera noise, half its size; the default level stalls for 80 ms.
const LEVEL: u32 = 1;
/// A chunk never holds more than this, before compression; normally the clock ends it.
const CHUNK_BYTES: u64 = 4 << 20;

/// Writes one file. Messages are collected in a chunk, which is compressed and written as a whole by
/// [`flush`](Self::flush): what was flushed survives the death of the process.
///
/// After an error the file is cut off behind the last complete chunk and closed: it can be read, and
/// [`recover`](crate::recover::recover) makes a proper recording of it.
#[derive(Debug)]
pub struct Writer {
    path: PathBuf,
    /// `None` after an error.
    open: Option<Open>,
    bytes: u64,
}

struct Open {
    mcap: mcap::Writer<File>,
    /// A second handle on the same file.
    file: File,
    ids: BTreeMap<Channel, u16>,
    sequences: BTreeMap<Channel, u32>,
    is_pending: bool,
}

impl std::fmt::Debug for Open {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Open").field("ids", &self.ids).finish_non_exhaustive()
    }
}

/// How recordings of this program are written.
pub(crate) fn options() -> WriteOptions {
    WriteOptions::new()
        .library(concat!("touchline ", env!("CARGO_PKG_VERSION")))
        .compression(Some(Compression::Zstd))
        .compression_level(LEVEL)
        .compression_threads(0)
        .chunk_size(Some(CHUNK_BYTES))
        // Chunks are put together in memory and written at once, so that the file nearly always ends
        // behind a complete one.
        .disable_seeking(true)
        // Chunks have their own check sums.
        .calculate_data_section_crc(false)
}

impl Writer {
    /// Begins a recording with these channels. An existing file is never touched. While it is
    /// written the file is locked (flock), so that nobody takes it for one that was left behind.
    pub fn create(path: &Path, channels: &[Channel]) -> Result<Self, RecordingError> {
        let io = |source| RecordingError::Io { path: path.into(), action: "create", source };
        let file =
            OpenOptions::new().read(true).write(true).create_new(true).open(path).map_err(io)?;
        flock(&file, FlockOperation::NonBlockingLockExclusive).map_err(|error| io(error.into()))?;
        let handle = file.try_clone().map_err(io)?;
        let format = |error: McapError| into_error(path, "create", error);
        let mut mcap = options().create(file).map_err(format)?;
        let mut ids = BTreeMap::new();
        for &channel in channels {
            let description = channel.description();
            let schema = mcap
                .add_schema(
                    &description.schema_name,
                    description.schema_encoding,
                    &description.schema,
                )
                .map_err(format)?;
            let id = mcap
                .add_channel(schema, channel.name(), description.message_encoding, &BTreeMap::new())
                .map_err(format)?;
            ids.insert(channel, id);
        }
        let open = Open { mcap, file: handle, ids, sequences: BTreeMap::new(), is_pending: true };
        let mut writer = Self { path: path.into(), open: Some(open), bytes: 0 };
        writer.flush()?;
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
        self.open.as_ref().is_some_and(|open| open.is_pending)
    }

    /// Adds a message. Times are nanoseconds since 1970: when it was sent, and when what it is about
    /// happened. Messages of a channel that was not asked for are left out.
    pub fn write(
        &mut self,
        channel: Channel,
        t_sent_ns: u64,
        t_about_ns: u64,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        self.attempt("write", |open| {
            let Some(&channel_id) = open.ids.get(&channel) else { return Ok(()) };
            let sequence = open.sequences.entry(channel).or_default();
            *sequence = sequence.wrapping_add(1);
            let header = MessageHeader {
                channel_id,
                sequence: *sequence,
                log_time: t_sent_ns,
                publish_time: t_about_ns,
            };
            open.is_pending = true;
            open.mcap.write_to_known_channel(&header, data)
        })
    }

    /// Puts everything into the file. It is then in the hands of the system, and safe from the death
    /// of the process; for safety from a loss of power see [`sync_handle`](Self::sync_handle).
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.attempt("write", |open| {
            open.is_pending = false;
            open.mcap.flush()
        })?;
        self.measure()
    }

    /// A handle for whoever brings the file to the disk (`sync_data`) now and then, on another
    /// thread, since that may take long. `None` after an error.
    pub fn sync_handle(&self) -> Option<File> {
        self.open.as_ref()?.file.try_clone().ok()
    }

    /// Completes the file and brings it to the disk; returns its size.
    pub fn finish(mut self) -> Result<u64, RecordingError> {
        self.attempt("complete", |open| {
            open.mcap.finish()?;
            Ok(open.file.sync_all()?)
        })?;
        self.measure()?;
        Ok(self.bytes)
    }

    fn measure(&mut self) -> Result<(), RecordingError> {
        let mut bytes = 0;
        self.attempt("look at", |open| {
            bytes = open.file.metadata()?.len();
            Ok(())
        })?;
        self.bytes = bytes;
        Ok(())
    }

    fn attempt(
        &mut self,
        action: &'static str,
        act: impl FnOnce(&mut Open) -> Result<(), McapError>,
    ) -> Result<(), RecordingError> {
        let Some(open) = &mut self.open else {
            let source = std::io::Error::other("an earlier error has ended it");
            return Err(RecordingError::Io { path: self.path.clone(), action, source });
        };
        act(open).map_err(|error| {
            self.abandon();
            into_error(&self.path, action, error)
        })
    }

    /// Cuts off what the last attempt has left behind.
    fn abandon(&mut self) {
        let Some(open) = self.open.take() else { return };
        let mut file = open.mcap.into_inner();
        // Nothing more can be done if even this fails; a reader stops at the incomplete chunk.
        let _ = file.set_len(self.bytes);
        let _ = file.seek(SeekFrom::End(0)).and_then(|_| file.flush());
    }
}

pub(crate) fn into_error(path: &Path, action: &'static str, error: McapError) -> RecordingError {
    match error {
        McapError::Io(source) => RecordingError::Io { path: path.into(), action, source },
        other => RecordingError::Format { path: path.into(), problem: other.to_string() },
    }
}
