//! Writing a recording.

use crate::{Channel, RecordingError};
use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions};
use rustix::fs::{FlockOperation, flock};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// The fastest level: 800 MB/s on camera noise, at half its size. The default level stalls for 80 ms.
const LEVEL: u32 = 1;
/// Largest chunk before compression; normally a chunk ends by time.
const CHUNK_BYTES: u64 = 4 << 20;

/// Writes one file. Messages are collected in a chunk, which is compressed and written as a whole by
/// [`flush`](Self::flush): flushed messages survive the death of the process.
///
/// After an error the file is cut off after the last complete chunk and closed. It can be read, and
/// [`recover`](crate::recover::recover) makes it a proper recording.
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

/// Options of this program's recordings.
pub(crate) fn options() -> WriteOptions {
    WriteOptions::new()
        .library(concat!("touchline ", env!("CARGO_PKG_VERSION")))
        .compression(Some(Compression::Zstd))
        .compression_level(LEVEL)
        .compression_threads(0)
        .chunk_size(Some(CHUNK_BYTES))
        // Chunks are assembled in memory and written at once, so that the file nearly always ends after
        // a complete one.
        .disable_seeking(true)
        // Chunks have their own checksums.
        .calculate_data_section_crc(false)
}

impl Writer {
    /// Starts a recording with these channels. An existing file is never touched. The file stays locked
    /// (flock) while it is written, so that no process takes it for an abandoned one.
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

    /// Adds a message. Times are nanoseconds since 1970: of its sending, and of the event it describes.
    /// Messages of a channel that was not requested are ignored.
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

    /// Writes everything to the file. It is then with the operating system and survives the death of
    /// the process; for power failures see [`sync_handle`](Self::sync_handle).
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.attempt("write", |open| {
            open.is_pending = false;
            open.mcap.flush()
        })?;
        self.measure()
    }

    /// A handle for regular `sync_data` calls on another thread, since these may take long. `None`
    /// after an error.
    pub fn sync_handle(&self) -> Option<File> {
        self.open.as_ref()?.file.try_clone().ok()
    }

    /// Completes the file and syncs it to the disk; returns its size.
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
            let source = std::io::Error::other("the recording ended with an earlier error");
            return Err(RecordingError::Io { path: self.path.clone(), action, source });
        };
        act(open).map_err(|error| {
            self.abandon();
            into_error(&self.path, action, error)
        })
    }

    /// Cuts off what the failed attempt has written.
    fn abandon(&mut self) {
        let Some(open) = self.open.take() else { return };
        let mut file = open.mcap.into_inner();
        // If even this fails, a reader stops at the incomplete chunk.
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
