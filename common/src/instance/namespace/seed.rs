//! The one iceoryx2 segment that has a fixed name after the prefix.
//!
//! Every process that joins a group draws a number from it. The first process creates it, readable and
//! writable for all users, so another user that opens it at that moment could truncate it later, while
//! a process joins. So the segment is created under another prefix, and copied to its final name for
//! this user alone before the prefix is used.

use super::{config_for, free_prefix};
use crate::memory::SHARED_MEMORY;
use crate::private;
use iceoryx2::prelude::*;
use std::fs;
use std::io::{self, Write};
use std::path::{Path as FilePath, PathBuf};

/// End of the segment's name.
const SUFFIX: &str = ".global_mgmt";

/// Whether a file is such a segment.
pub fn is_seed(path: &FilePath) -> bool {
    path.to_string_lossy().ends_with(SUFFIX)
}

/// The iceoryx2 version that created it, which is part of its name: `…node.0_10_0.global_mgmt`.
pub fn version(path: &FilePath) -> Option<String> {
    let name = path.file_name()?.to_str()?.strip_suffix(SUFFIX)?;
    let (_, version) = name.rsplit_once('.')?;
    Some(version.replace('_', "."))
}

/// Number of races that another user must win to change the copy.
const ATTEMPTS: u32 = 100;

/// Creates the segment for a prefix, with the help of a directory that is empty before and after. Its
/// content says only that one process has joined, so two new segments are equal unless another user
/// changed one before it was read; the first two equal ones in a row are accepted. With a truncated
/// segment, or one filled with garbage, iceoryx2 would wait for ever.
pub fn make(directory: &FilePath, prefix: &str) -> io::Result<()> {
    let mut last = None;
    for _ in 0..ATTEMPTS {
        let made = Some(made_apart(directory)?);
        if made == last
            && let Some((suffix, bytes)) = made
        {
            let target = FilePath::new(SHARED_MEMORY).join(format!("{prefix}{suffix}"));
            return private::create_new_file(&target)?.write_all(&bytes);
        }
        last = made;
    }
    Err(io::Error::other(format!(
        "another program keeps changing the new segment in {SHARED_MEMORY}"
    )))
}

/// Creates a segment under an unused prefix and removes it again. Returns its name without the prefix,
/// and its bytes.
fn made_apart(directory: &FilePath) -> io::Result<(String, Vec<u8>)> {
    let prefix = free_prefix()?;
    let place = directory.join("seed");
    let made = make_under(&place, &prefix).and_then(|()| {
        let path = of_prefix(&prefix)?.pop();
        let path = path.ok_or_else(|| io::Error::other("iceoryx2 has made no such segment"))?;
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok((name.replacen(&prefix, "", 1), fs::read(&path)?))
    });
    for path in of_prefix(&prefix)? {
        let _ = fs::remove_file(path);
    }
    let _ = fs::remove_dir_all(&place);
    made
}

/// Lets a node join and leave, which creates the segment.
fn make_under(place: &FilePath, prefix: &str) -> io::Result<()> {
    set_log_level(LogLevel::Fatal);
    let config = config_for(place, prefix).map_err(io::Error::other)?;
    let node = NodeBuilder::new()
        .config(&config)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<ipc::Service>();
    node.map(drop).map_err(|error| io::Error::other(format!("{error:?}")))
}

fn of_prefix(prefix: &str) -> io::Result<Vec<PathBuf>> {
    let entries = fs::read_dir(SHARED_MEMORY)?.flatten();
    let names = entries.filter(|entry| entry.file_name().to_string_lossy().starts_with(prefix));
    Ok(names.map(|entry| entry.path()).filter(|path| is_seed(path)).collect())
}
