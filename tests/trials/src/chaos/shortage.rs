//! Temporary lack of descriptors or of shared memory.
//!
//! A full `/dev/shm` would affect every program of the machine. So a match that needs one gets its own:
//! the whole of `chaos` runs in a mount namespace with another file system mounted there.

use crate::TrialError;
use client::memory::{GroupMemory, SHARED_MEMORY};
use config::Config;
use grabber::source::Source;
use rustix::process::{Pid, Resource, Rlimit, getrlimit, prlimit};
use std::fs::{self, File};
use std::io::Write;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

/// Set if the program's shared memory is its own.
const OWN_PLACE_VARIABLE: &str = "TOUCHLINE_CHAOS_OWN_SHM";
/// Standard input, output and error: all that a process without descriptors may have.
const NO_DESCRIPTORS: u64 = 3;

/// A shortage until a given time. Dropping it ends the shortage.
pub struct Shortage {
    until: Instant,
    _undo: Undo,
}

enum Undo {
    Limit { pid: Pid, before: Rlimit },
    File(PathBuf),
}

impl Shortage {
    /// Denies a process all descriptors that it has not opened yet. Only the soft limit changes.
    pub fn of_descriptors(pid: u32, until: Instant) -> Result<Self, TrialError> {
        let pid = Pid::from_raw(pid as i32).ok_or("no process")?;
        // This process has started the other, which has the same hard limit.
        let maximum = getrlimit(Resource::Nofile).maximum;
        let none = Rlimit { current: Some(NO_DESCRIPTORS), maximum };
        let before = prlimit(Some(pid), Resource::Nofile, none)?;
        Ok(Self { until, _undo: Undo::Limit { pid, before } })
    }

    /// Fills the shared memory.
    pub fn of_shared_memory(until: Instant) -> Result<Self, TrialError> {
        let path = Path::new(SHARED_MEMORY).join(format!("chaos-{}-fill", std::process::id()));
        let mut file = File::create(&path)?;
        for bytes in [1 << 20, 4096] {
            while file.write_all(&vec![1; bytes]).is_ok() {}
        }
        Ok(Self { until, _undo: Undo::File(path) })
    }

    /// Whether its time is over.
    pub fn is_over(&self, now: Instant) -> bool {
        now >= self.until
    }
}

impl Drop for Undo {
    fn drop(&mut self) {
        match self {
            // The process may have died since.
            Self::Limit { pid, before } => {
                let _ = prlimit(Some(*pid), Resource::Nofile, *before);
            }
            Self::File(path) => {
                let _ = fs::remove_file(path);
            }
        }
    }
}

/// Executes this program again in a mount namespace with its own shared memory; returns at once if that
/// has been done already.
pub fn enter_own_place(config: &Config, source: &Source) -> Result<(), TrialError> {
    if std::env::var_os(OWN_PLACE_VARIABLE).is_some() {
        return Ok(());
    }
    // Enough for the old and the new processes of every stage.
    let frame_bytes = source.frame_capacity(&config.camera);
    let bytes =
        GroupMemory::with_larger_frames(config.camera.frame_bytes(), frame_bytes).ample_bytes() * 2;
    let megabytes = (bytes >> 20) + 64;
    let script =
        format!("mount -t tmpfs -o size={megabytes}m tmpfs {SHARED_MEMORY} && exec \"$@\"");
    let mut command = Command::new("unshare");
    command.arg("--mount");
    if !rustix::process::getuid().is_root() {
        command.arg("--map-root-user");
    }
    command.args(["sh", "-c", &script, "sh"]);
    command.arg(std::env::current_exe()?).args(std::env::args_os().skip(1));
    let error = command.env(OWN_PLACE_VARIABLE, "1").exec();
    Err(format!(
        "enospc and outsider need a /dev/shm of the match's own, which takes the programs unshare and \
         mount: {error}; leave them out with --signals"
    )
    .into())
}
