//! Making a proper recording of one that was never finished: its recorder was killed, the disk was
//! full, the power failed.
//!
//! Such a file is good up to its last complete chunk, but has no index, and viewers refuse it. What
//! is good is copied to a new file beside it, which then takes its place; so a recovery that is
//! itself interrupted loses nothing.

use crate::RecordingError;
use crate::reader::is_finished;
use crate::writer::{into_error, options};
use mcap::McapError;
use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;
use rustix::fs::{FlockOperation, flock};
use std::fs::File;
use std::io::{BufReader, BufWriter};
use std::path::{Path, PathBuf};

/// What a recovery has found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Recovery {
    /// The recording is complete; nothing was done.
    NotNeeded,
    /// Somebody is writing it right now; nothing was done.
    BeingWritten,
    /// It was completed with so many messages.
    Recovered(u64),
}

/// Recovers a recording, in its place or to another file.
pub fn recover(path: &Path, output: Option<&Path>) -> Result<Recovery, RecordingError> {
    let io = |action| move |source| RecordingError::Io { path: path.into(), action, source };
    let mut file = File::open(path).map_err(io("open"))?;
    match is_finished(&mut file).map_err(io("read"))? {
        Some(true) => return Ok(Recovery::NotNeeded),
        Some(false) => {}
        None => {
            let problem = "not a recording: it is no MCAP file".into();
            return Err(RecordingError::Format { path: path.into(), problem });
        }
    }
    match flock(&file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => {}
        Err(rustix::io::Errno::WOULDBLOCK) => return Ok(Recovery::BeingWritten),
        Err(error) => return Err(io("lock")(error.into())),
    }
    let copy = sibling(path);
    let count = copy_messages(file, path, &copy).inspect_err(|_| {
        // Half a copy is of no use, and may be what has filled the disk.
        let _ = std::fs::remove_file(&copy);
    })?;
    std::fs::rename(&copy, output.unwrap_or(path))
        .map_err(io("put the recovered file in place"))?;
    Ok(Recovery::Recovered(count))
}

fn sibling(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".recovering");
    path.with_file_name(name)
}

fn copy_messages(from: File, path: &Path, to: &Path) -> Result<u64, RecordingError> {
    let error = |error: McapError| into_error(to, "write", error);
    let file = File::create(to).map_err(|source| error(source.into()))?;
    let handle = file.try_clone().map_err(|source| error(source.into()))?;
    let mut writer = options().create(BufWriter::new(file)).map_err(error)?;
    let options = LinearReaderOptions::default()
        .with_skip_end_magic(true)
        // The whole chunk is checked before any of it is used.
        .with_prevalidate_chunk_crcs(true);
    let mut count = 0;
    for message in MessageReader::new_with_options(BufReader::new(from), options) {
        match message {
            Ok(message) => {
                writer.write(&message).map_err(error)?;
                count += 1;
            }
            // Here the file stops making sense; everything before it is kept.
            Err(McapError::Io(source)) if source.kind() != std::io::ErrorKind::UnexpectedEof => {
                return Err(into_error(path, "read", McapError::Io(source)));
            }
            Err(_) => break,
        }
    }
    writer.finish().map_err(error)?;
    drop(writer);
    handle.sync_all().map_err(|source| error(source.into()))?;
    Ok(count)
}
