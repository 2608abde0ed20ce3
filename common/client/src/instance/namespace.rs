//! The group's names in shared memory.
//!
//! In `/dev/shm` every user can create files under any name and see all names. A predictable name could
//! be taken first by another user: with a file that makes the group's start fail, or with one that its
//! owner truncates later, which kills a process that has mapped it with a SIGBUS. So this program's own
//! files are in one directory that is closed to others, and iceoryx2, whose segments must be beside it,
//! gets a prefix. Directory name and prefix are random. The rest of the segments' names are 128-bit
//! numbers drawn by iceoryx2, except for one segment with a fixed name (`seed.rs`), which is created
//! before any user can see the prefix.
//!
//! A file in the runtime directory has the location ([`NOTE`]). If it was removed, the directory is
//! found by its own copy of that note.

mod seed;
mod services;

use super::{Instance, InstanceError, io_error, remove};
use crate::memory::{self, SHARED_MEMORY};
use crate::private::{self, OthersMay};
use iceoryx2::prelude::{Config as IpcConfig, FileName, Path as IpcPath, SemanticString};
use messages::stages::{MAX_LANES, StageGraph, StageId};
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use std::ffi::OsStr;
use std::fs::{self, DirBuilder, File};
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Name of the note with the group's location, both in its runtime directory and in its directory in
/// shared memory.
pub const NOTE: &str = "memory";
/// Number of random names tried.
const ATTEMPTS: usize = 16;
/// Time to wait for another process that creates the same namespace. It takes milliseconds.
const PATIENCE: Duration = Duration::from_secs(2);
const RETRY: Duration = Duration::from_millis(2);

/// The names of a group's shared memory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Namespace {
    directory: PathBuf,
    prefix: String,
    runtime_directory: PathBuf,
    ipc_version: String,
}

/// The iceoryx2 version this program is built with. Other versions have other file layouts.
pub const IPC_VERSION: &str = "0.10.0";

/// A file in shared memory that has a name of the group, but belongs to another user.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ForeignFile {
    /// Its path.
    pub path: PathBuf,
    /// User id.
    pub uid: u32,
}

impl std::fmt::Display for ForeignFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} has a name of this group's, but was made by another user (uid {})",
            self.path.display(),
            self.uid
        )
    }
}

impl Namespace {
    /// Directory closed to other users, with this program's files and iceoryx2's files other than
    /// segments.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// Prefix of the names of iceoryx2's segments.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// The runtime directory of the group.
    pub fn runtime_directory(&self) -> &Path {
        &self.runtime_directory
    }

    /// The iceoryx2 configuration of the group. Dead processes are cleaned up by the supervisor, off
    /// the critical path; a stage that cleaned up at its start would lose tens of milliseconds.
    pub fn ipc_config(&self) -> Result<IpcConfig, InstanceError> {
        config_for(&self.directory, &self.prefix)
    }

    /// Page shared by a stage's processes and the supervisor.
    pub fn stage_page_path(&self, stage: StageId) -> PathBuf {
        self.directory.join(format!("{stage}.page"))
    }

    /// Page with the nodes of the group's own processes.
    pub fn roster_path(&self) -> PathBuf {
        self.directory.join("roster.page")
    }

    /// Event count of a topic, on which its readers sleep.
    pub fn event_count_path(&self, topic: &str) -> PathBuf {
        self.directory.join(format!("{topic}.count"))
    }

    pub(super) fn lock_path(&self) -> PathBuf {
        self.directory.join(super::lock::NAME)
    }

    /// Checks that this program and the group use the same version of iceoryx2.
    pub fn check_version(&self) -> Result<(), InstanceError> {
        if self.ipc_version == IPC_VERSION {
            return Ok(());
        }
        let name = self.runtime_directory.file_name().unwrap_or_default();
        Err(InstanceError::Version {
            name: name.to_string_lossy().into_owned(),
            group: self.ipc_version.clone(),
            own: IPC_VERSION,
        })
    }

    /// Readable list of the attachments and topics made by programs with another iceoryx2 version than
    /// the group's. These programs and the group do not understand each other.
    pub fn strange_versions(&self) -> io::Result<Vec<String>> {
        let own = &self.ipc_version;
        let (segments, _) = self.segments()?;
        let versions = segments.iter().filter_map(|path| seed::version(path));
        let attached = versions.filter(|version| version != own).map(|version| {
            format!(
                "a program with iceoryx2 {version} has tried to attach; it needs iceoryx2 {own}, as this group"
            )
        });
        let made = services::read(&self.directory).into_iter().filter(|made| made.version != *own);
        let made = made.map(|services::Service { name, version }| {
            format!(
                "the topic {name:?} was made by a program with iceoryx2 {version}, or is damaged; this \
                 group needs iceoryx2 {own}: end that program, then stop and start the group"
            )
        });
        Ok(attached.chain(made).collect())
    }

    /// The group's segments, and files of other users with such names.
    pub fn segments(&self) -> io::Result<(Vec<PathBuf>, Vec<ForeignFile>)> {
        let (mut own, mut foreign) = (Vec::new(), Vec::new());
        for entry in fs::read_dir(SHARED_MEMORY)?.flatten() {
            if !entry.file_name().to_string_lossy().starts_with(&self.prefix) {
                continue;
            }
            // A file that has just been removed has no owner.
            let Ok(data) = entry.metadata() else { continue };
            match data.uid() {
                uid if uid == rustix::process::geteuid().as_raw() => own.push(entry.path()),
                uid => foreign.push(ForeignFile { path: entry.path(), uid }),
            }
        }
        Ok((own, foreign))
    }

    /// Removes the stage pages of an earlier group.
    fn forget_progress(&self) -> Result<(), InstanceError> {
        for stage in StageGraph::with_lanes(MAX_LANES).stages() {
            let path = self.stage_page_path(stage);
            remove(fs::remove_file(&path), &path)?;
        }
        Ok(())
    }

    /// Everything in the namespace, except the lock and the namespace itself.
    fn leftovers(&self) -> Result<Leftovers, InstanceError> {
        let (segments, foreign) = self.segments().map_err(io_error(Path::new(SHARED_MEMORY)))?;
        let mut paths: Vec<PathBuf> =
            segments.into_iter().filter(|path| !seed::is_seed(path)).collect();
        let kept = [NOTE, super::lock::NAME];
        let entries = fs::read_dir(&self.directory).map_err(io_error(&self.directory))?.flatten();
        let is_left = |name: &OsStr| kept.iter().all(|kept| name != *kept);
        paths.extend(entries.filter(|it| is_left(&it.file_name())).map(|entry| entry.path()));
        Ok(Leftovers { paths, foreign })
    }

    /// Removes the namespace and everything in it.
    fn remove(&self) -> Result<(), InstanceError> {
        let (segments, _) = self.segments().map_err(io_error(Path::new(SHARED_MEMORY)))?;
        for path in &segments {
            remove(fs::remove_file(path), path)?;
        }
        remove(fs::remove_dir_all(&self.directory), &self.directory)
    }

    fn note(&self) -> String {
        format!(
            "root_path={}\nprefix={}\niceoryx2={}\nruntime_directory={}\n",
            self.directory.display(),
            self.prefix,
            self.ipc_version,
            self.runtime_directory.display()
        )
    }

    fn from_note(text: &str) -> Option<Self> {
        let value =
            |key: &str| text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix('='));
        // The last line is complete only with its newline.
        text.ends_with('\n').then_some(())?;
        Some(Self {
            directory: value("root_path")?.into(),
            prefix: value("prefix")?.into(),
            runtime_directory: value("runtime_directory")?.into(),
            ipc_version: value("iceoryx2")?.into(),
        })
    }

    /// Reads a note; `None` if its directory does not exist or is not this user's alone.
    fn read(note: &Path) -> io::Result<Option<Self>> {
        let mut text = String::new();
        match private::read_file(note).and_then(|mut file| file.read_to_string(&mut text)) {
            Err(error) if is_absence(&error) => return Ok(None),
            read => read?,
        };
        Ok(Self::from_note(&text).filter(|namespace| {
            let is_there = namespace.directory.is_dir();
            is_there && private::check_directory(&namespace.directory, OthersMay::Read).is_ok()
        }))
    }

    /// All namespaces of this user, for all groups.
    pub fn all() -> io::Result<Vec<Self>> {
        let mut all = Vec::new();
        for path in directories()? {
            match Self::read(&path.join(NOTE)) {
                Ok(read) => all.extend(read.filter(|namespace| namespace.directory == path)),
                // A note with another mode or owner is ignored.
                Err(error) if error.kind() == io::ErrorKind::PermissionDenied => {}
                Err(error) => return Err(error),
            }
        }
        Ok(all)
    }

    fn make(runtime_directory: &Path) -> io::Result<Self> {
        if memory::check_margin().is_err() {
            return Err(Errno::NOSPC.into());
        }
        let directory = make_directory()?;
        let fill = || {
            let prefix = free_prefix()?;
            seed::make(&prefix)?;
            let namespace = Self {
                directory: directory.clone(),
                prefix,
                runtime_directory: runtime_directory.into(),
                ipc_version: IPC_VERSION.into(),
            };
            write_note(&directory.join(NOTE), &namespace)?;
            Ok(namespace)
        };
        fill().inspect_err(|_| {
            let _ = fs::remove_dir_all(&directory);
        })
    }
}

/// Files in a group's namespace that may be garbage.
#[derive(Debug, Default)]
pub struct Leftovers {
    paths: Vec<PathBuf>,
    foreign: Vec<ForeignFile>,
}

impl Leftovers {
    /// Removes them; returns files of other users with the group's names, which stay. Only for the holder of the
    /// lock, and only when no process of the group was alive after they were listed: removing half of iceoryx2's
    /// files, or removing them under a living process, is worse than leaving them.
    pub fn remove(self) -> Result<Vec<ForeignFile>, InstanceError> {
        for path in &self.paths {
            let is_directory = fs::symlink_metadata(path).is_ok_and(|data| data.is_dir());
            let removed =
                if is_directory { fs::remove_dir_all(path) } else { fs::remove_file(path) };
            remove(removed, path)?;
        }
        Ok(self.foreign)
    }
}

impl Instance {
    /// The group's names in shared memory; `None` if it has none.
    pub fn namespace(&self) -> Result<Option<Namespace>, InstanceError> {
        let note = self.directory().join(NOTE);
        if let Some(namespace) = Namespace::read(&note).map_err(io_error(&note))? {
            return Ok(Some(namespace));
        }
        let mut all = Namespace::all().map_err(io_error(Path::new(SHARED_MEMORY)))?;
        all.retain(|namespace| namespace.runtime_directory == self.directory());
        Ok(all.pop())
    }

    /// The group's names in shared memory, created if there are none. The runtime directory must exist.
    pub fn create_namespace(&self) -> Result<Namespace, InstanceError> {
        if let Some(namespace) = self.namespace()? {
            return Ok(namespace);
        }
        let note = self.directory().join(NOTE);
        // One process creates it; the others wait and find it.
        let locked = lock(&note).map_err(io_error(&note))?;
        if let Some(namespace) = self.namespace()? {
            return Ok(namespace);
        }
        memory::check_place()?;
        let made = Namespace::make(self.directory());
        let namespace = made.map_err(io_error(Path::new(SHARED_MEMORY)))?;
        let written = locked.set_len(0).and_then(|()| write_all(&locked, &namespace));
        if let Err(error) = written {
            let _ = namespace.remove();
            return Err(io_error(&note)(error));
        }
        Ok(namespace)
    }

    /// Restores removed parts of a namespace that is in use; returns whether any was missing. The
    /// runtime directory must exist.
    pub fn restore_namespace(&self, namespace: &Namespace) -> io::Result<bool> {
        let mut restored = false;
        match DirBuilder::new().mode(0o700).create(&namespace.directory) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            made => {
                made?;
                restored = true;
            }
        }
        for note in [&namespace.directory, self.directory()].map(|place| place.join(NOTE)) {
            if !note.exists() {
                write_note(&note, namespace)?;
                restored = true;
            }
        }
        Ok(restored)
    }

    /// Lists everything in shared memory with the group's names, except the lock.
    pub fn leftovers(&self) -> Result<Leftovers, InstanceError> {
        self.namespace()?.map_or(Ok(Leftovers::default()), |namespace| namespace.leftovers())
    }

    /// Removes everything a group left behind in shared memory, except the lock; see [`Leftovers::remove`].
    pub fn wipe(&self) -> Result<Vec<ForeignFile>, InstanceError> {
        self.leftovers()?.remove()
    }

    /// Removes the stage pages of an earlier group, so that the stages of a new one start from the
    /// beginning. Only when no process of the group is alive.
    pub fn forget_progress(&self) -> Result<(), InstanceError> {
        self.namespace()?.map_or(Ok(()), |namespace| namespace.forget_progress())
    }

    /// Removes everything of the group in shared memory, including the lock and the namespace.
    pub fn remove_namespace(&self) -> Result<(), InstanceError> {
        self.namespace()?.map_or(Ok(()), |namespace| namespace.remove())
    }
}

/// The iceoryx2 configuration for files below a directory and segments with a prefix.
fn config_for(directory: &Path, prefix: &str) -> Result<IpcConfig, InstanceError> {
    let too_long = || InstanceError::Path(directory.into());
    let mut config = IpcConfig::default();
    let root = directory.to_str().ok_or_else(too_long)?;
    config.global.set_root_path(&IpcPath::new(root.as_bytes()).map_err(|_| too_long())?);
    config.global.prefix = FileName::new(prefix.as_bytes()).map_err(|_| too_long())?;
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    config.global.service.cleanup_dead_nodes_on_open = false;
    Ok(config)
}

/// Creates a directory in shared memory under an unpredictable name.
fn make_directory() -> io::Result<PathBuf> {
    let mut outcome = Err(Errno::EXIST.into());
    for _ in 0..ATTEMPTS {
        let path = Path::new(SHARED_MEMORY).join(format!("tl_{:08x}.group", random()?));
        match DirBuilder::new().mode(0o700).create(&path) {
            Ok(()) => return Ok(path),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => outcome = Err(error),
            Err(error) => return Err(error),
        }
    }
    outcome
}

/// The directories of this user's groups in shared memory.
pub fn directories() -> io::Result<Vec<PathBuf>> {
    let mut directories = Vec::new();
    for entry in fs::read_dir(SHARED_MEMORY)?.flatten() {
        let path = entry.path();
        let is_named = is_directory_name(&entry.file_name().to_string_lossy());
        if is_named && private::check_directory(&path, OthersMay::Read).is_ok() && path.is_dir() {
            directories.push(path);
        }
    }
    Ok(directories)
}

/// Whether a name in shared memory has the form of a group's directory.
fn is_directory_name(name: &str) -> bool {
    let digits = name.strip_prefix("tl_").and_then(|rest| rest.strip_suffix(".group"));
    digits
        .is_some_and(|digits| digits.len() == 8 && digits.bytes().all(|it| it.is_ascii_hexdigit()))
}

/// An unpredictable prefix with which no name begins yet.
fn free_prefix() -> io::Result<String> {
    for _ in 0..ATTEMPTS {
        let prefix = format!("tl_{:08x}_", random()?);
        let mut names = fs::read_dir(SHARED_MEMORY)?.flatten().map(|entry| entry.file_name());
        if !names.any(|name| name.to_string_lossy().starts_with(&prefix)) {
            return Ok(prefix);
        }
    }
    Err(Errno::EXIST.into())
}

fn random() -> io::Result<u32> {
    let mut bytes = [0; 4];
    File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(u32::from_ne_bytes(bytes))
}

/// Opens or creates a file and locks it.
fn lock(path: &Path) -> io::Result<File> {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let file = private::open_file(path)?;
        match flock(&file, FlockOperation::NonBlockingLockExclusive) {
            // Another process may have removed it between the two calls.
            Ok(()) if super::lock::is_at(&file, path) => return Ok(file),
            Ok(()) => {}
            Err(Errno::WOULDBLOCK) if Instant::now() < deadline => std::thread::sleep(RETRY),
            Err(error) => return Err(error.into()),
        }
    }
}

fn write_note(path: &Path, namespace: &Namespace) -> io::Result<()> {
    write_all(&private::create_file(path)?, namespace)
}

fn write_all(mut file: &File, namespace: &Namespace) -> io::Result<()> {
    file.write_all(namespace.note().as_bytes())
}

/// Whether an error only means that the file does not exist.
fn is_absence(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory)
}

#[cfg(test)]
mod tests;
