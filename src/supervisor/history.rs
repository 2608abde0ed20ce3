//! The history of a group's configuration: what was accepted when, and why. It is kept in a file beside the
//! revisions, so that it outlives the supervisor and an upgrade.

use super::sys::{self, Call};
use client::instance::Instance;
use client::private;
use control::Revised;
use std::fs;
use std::io::{self, Write};
use std::path::PathBuf;

/// Changes kept.
pub const KEPT_CHANGES: usize = 20;

fn path(instance: &Instance) -> PathBuf {
    instance.revisions_directory().join("history.json")
}

/// The history that an earlier supervisor has left, oldest first; empty if there is no readable one.
pub fn read(instance: &Instance) -> Vec<Revised> {
    let text = fs::read(path(instance)).unwrap_or_default();
    serde_json::from_slice(&text).unwrap_or_default()
}

/// Replaces the history atomically.
pub fn write(instance: &Instance, history: &[Revised]) -> io::Result<()> {
    let path = path(instance);
    let new = path.with_extension("new");
    let text = serde_json::to_vec(history)?;
    sys::ask(Call::WriteConfig, || {
        private::create_file(&new)?.write_all(&text)?;
        fs::rename(&new, &path)
    })
}
