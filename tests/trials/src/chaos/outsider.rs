//! The outsider: another, malicious user of the machine. It takes names in shared memory as soon as it
//! can predict them, truncates its files while another process has them open, and tries to open, remove
//! and contact what belongs to the match.
//!
//! It is a thread of this program with the credentials of another user, which the kernel keeps per
//! thread. Since it would attack every match on the machine, it runs only in a shared memory that the
//! match has to itself ([`super::shortage`]).

use crate::TrialError;
use client::instance::Instance;
use client::memory::SHARED_MEMORY;
use rustix::process::{Gid, Uid};
use rustix::thread::{set_thread_groups, set_thread_res_gid, set_thread_res_uid};
use serde::Serialize;
use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// `nobody`, on every Linux.
const NOBODY: u32 = 65_534;
/// Time between two rounds.
const ROUND: Duration = Duration::from_micros(500);
/// Most files that it has at a time.
const MOST_FILES: usize = 400;
/// Length of the common beginning of this program's names.
const BEGIN_LENGTH: usize = "tl_12345678".len();
/// Predictable ends of names: those of this program, in this and earlier versions, and the one name of
/// iceoryx2 without a number.
const ENDS: [&str; 12] = [
    ".group",
    "_ipc",
    "_supervisor.lock",
    "_world.count",
    "_events.count",
    "_commands.count",
    "_camera.count",
    "_grabber.page",
    "_tracker.page",
    "_filter.page",
    "_memory",
    "_9204dd183d1c4d8e1ff592a30766ffa6765aa8b5_node.0_10_0.global_mgmt",
];

/// Counts of its actions.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Deeds {
    /// Files created under names like the match's.
    pub made: u64,
    /// Attempts to open, remove or contact something of the match's.
    pub attempts: u64,
    /// Attempts that succeeded.
    pub succeeded: u64,
}

impl Deeds {
    /// The sum of both.
    pub fn and(self, other: Self) -> Self {
        Self {
            made: self.made + other.made,
            attempts: self.attempts + other.attempts,
            succeeded: self.succeeded + other.succeeded,
        }
    }
}

/// A running outsider.
pub struct Outsider {
    until: Instant,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Deeds>,
}

impl Outsider {
    /// Starts it against a match, or against one that is still to start.
    pub fn start(instance: Option<&Instance>, until: Instant) -> io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let control = instance.map(Instance::control_path);
        let work = move || match become_nobody() {
            Ok(()) => work(control.as_deref(), &stopped),
            Err(_) => Deeds::default(),
        };
        let thread = std::thread::Builder::new().name("outsider".into()).spawn(work)?;
        Ok(Self { until, stop, thread })
    }

    /// Whether its time is over.
    pub fn is_over(&self, now: Instant) -> bool {
        now >= self.until
    }

    /// Ends it and removes its files.
    pub fn end(self) -> Deeds {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap_or_default()
    }
}

/// Whether this process has the right to act as another user.
pub fn check() -> Result<(), TrialError> {
    let attempt = std::thread::spawn(become_nobody).join();
    attempt.unwrap_or(Err(io::ErrorKind::Other.into())).map_err(|error| {
        format!("outsider is another user, which only root can be ({error}); leave it out with --signals")
            .into()
    })
}

/// Gives the credentials of another user to the calling thread only.
fn become_nobody() -> io::Result<()> {
    let (uid, gid) = (Uid::from_raw(NOBODY), Gid::from_raw(NOBODY));
    set_thread_groups(&[])?;
    set_thread_res_gid(gid, gid, gid)?;
    Ok(set_thread_res_uid(uid, uid, uid)?)
}

fn work(control: Option<&Path>, stop: &AtomicBool) -> Deeds {
    let mut deeds = Deeds::default();
    let mut begins = BTreeSet::new();
    let mut own: Vec<PathBuf> = Vec::new();
    while !stop.load(Ordering::Relaxed) {
        for entry in fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let Some(begin) = name.get(..BEGIN_LENGTH).filter(|begin| begin.starts_with("tl_"))
            else {
                continue;
            };
            // Files of its own or of another outsider are skipped.
            if entry.metadata().is_ok_and(|data| data.uid() == NOBODY) {
                continue;
            }
            if begins.insert(begin.to_string()) {
                own.extend(ENDS.iter().filter_map(|end| make(&format!("{begin}{end}"))));
            }
            attack(&entry.path(), &mut deeds);
        }
        if let Some(control) = control {
            count(&mut deeds, send(control));
        }
        for path in &own {
            let _ = set_len(path, 0).and_then(|()| set_len(path, 4096));
        }
        deeds.made = deeds.made.max(own.len() as u64);
        while own.len() > MOST_FILES {
            let _ = fs::remove_file(own.remove(0));
        }
        std::thread::sleep(ROUND);
    }
    for path in own {
        let _ = fs::remove_file(path);
    }
    deeds
}

/// Creates a file that everybody can open.
fn make(name: &str) -> Option<PathBuf> {
    let path = Path::new(SHARED_MEMORY).join(name);
    OpenOptions::new().write(true).create_new(true).mode(0o666).open(&path).ok()?;
    fs::set_permissions(&path, fs::Permissions::from_mode(0o666)).ok()?;
    Some(path)
}

fn attack(path: &Path, deeds: &mut Deeds) {
    match path.is_dir() {
        true => {
            count(deeds, fs::read_dir(path));
            count(deeds, File::create(path.join("world.count")));
        }
        false => count(deeds, set_len(path, 0)),
    }
    count(deeds, fs::remove_file(path));
    count(deeds, fs::rename(path, path.with_extension("taken")));
}

fn set_len(path: &Path, bytes: u64) -> io::Result<()> {
    OpenOptions::new().write(true).open(path)?.set_len(bytes)
}

fn send(control: &Path) -> io::Result<usize> {
    UnixDatagram::unbound()?.send_to(b"{}", control)
}

/// Counts an attempt. A target that has just disappeared is neither a success nor a failure.
fn count<T>(deeds: &mut Deeds, outcome: io::Result<T>) {
    match outcome {
        Ok(_) => (deeds.attempts, deeds.succeeded) = (deeds.attempts + 1, deeds.succeeded + 1),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        Err(_) => deeds.attempts += 1,
    }
}
