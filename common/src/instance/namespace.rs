//! Where a group is in shared memory.
//!
//! `/dev/shm` lets every user make files under any name, and see all names. A name that can be foretold
//! can be taken before the group takes it: with a file that makes the group's start fail, or one that its
//! maker truncates under the process that has mapped it, which ends that process with a SIGBUS. So what
//! this program makes itself is in one directory that is closed to others, and iceoryx2, whose segments
//! have to lie beside it, gets a prefix. The names of both are random. Everything else in the names of the
//! segments are 128 bit numbers that iceoryx2 draws, but for one that has a fixed name (`seed.rs`), and
//! that is made before anybody can see the prefix.
//!
//! A file in the runtime directory says where this is ([`NOTE`]). When somebody has removed it, the
//! directory is found by the same note in itself.

mod seed;
mod services;

use super::{Instance, InstanceError, io_error, remove};
use crate::memory::{self, SHARED_MEMORY};
use crate::messages::ProcessKind;
use crate::private::{self, Others};
use iceoryx2::prelude::{Config as IpcConfig, FileName, Path as IpcPath, SemanticString};
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use std::fs::{self, DirBuilder, File};
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Name of the note that says where the group is: in its runtime directory, and in its directory in shared
/// memory.
pub const NOTE: &str = "memory";
/// How often another random name is tried.
const ATTEMPTS: usize = 16;
/// How long another process that makes the same namespace is waited for. It takes milliseconds.
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

/// The version of iceoryx2 that this program is built with. Others lay out their files in another way.
pub const IPC_VERSION: &str = "0.10.0";

/// A file in shared memory that has a name of a group's, but belongs to another user.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ForeignFile {
    /// Its path.
    pub path: PathBuf,
    /// The user's number.
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
    /// Closed to other users: iceoryx2's files that are no segments, and what this program makes itself.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// How the names of iceoryx2's segments begin.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// The runtime directory of the group.
    pub fn runtime_directory(&self) -> &Path {
        &self.runtime_directory
    }

    /// The iceoryx2 configuration of the group. Dead processes are cleaned up by the supervisor, off the
    /// critical path: a stage that cleans while it starts would cost tens of milliseconds.
    pub fn ipc_config(&self) -> Result<IpcConfig, InstanceError> {
        config_for(&self.directory, &self.prefix)
    }

    /// The page that a stage's processes and the supervisor share.
    pub fn stage_page_path(&self, stage: &str) -> PathBuf {
        self.directory.join(format!("{stage}.page"))
    }

    /// The page with the nodes of the group's own processes.
    pub fn roster_path(&self) -> PathBuf {
        self.directory.join("roster.page")
    }

    /// Where the count of a topic's messages is, on which its readers sleep.
    pub fn event_count_path(&self, topic: &str) -> PathBuf {
        self.directory.join(format!("{topic}.count"))
    }

    pub(super) fn lock_path(&self) -> PathBuf {
        self.directory.join(super::lock::NAME)
    }

    /// Whether this program understands what is there: an error says why not.
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

    /// What programs with other versions of iceoryx2 than the group's have made in it, in words: they and
    /// the group do not understand each other.
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

    /// The group's files beside the directory, and those of other users that have such names.
    pub fn segments(&self) -> io::Result<(Vec<PathBuf>, Vec<ForeignFile>)> {
        let (mut own, mut foreign) = (Vec::new(), Vec::new());
        for entry in fs::read_dir(SHARED_MEMORY)?.flatten() {
            if !entry.file_name().to_string_lossy().starts_with(&self.prefix) {
                continue;
            }
            // One that has gone since is nobody's.
            let Ok(data) = entry.metadata() else { continue };
            match data.uid() {
                uid if uid == rustix::process::geteuid().as_raw() => own.push(entry.path()),
                uid => foreign.push(ForeignFile { path: entry.path(), uid }),
            }
        }
        Ok((own, foreign))
    }

    /// Removes what says how far the stages of an earlier group have come.
    fn forget_progress(&self) -> Result<(), InstanceError> {
        for stage in ProcessKind::ALL.map(ProcessKind::name) {
            let path = self.stage_page_path(stage);
            remove(fs::remove_file(&path), &path)?;
        }
        Ok(())
    }

    /// Removes everything a group has left behind, but for the lock and what makes the namespace; returns
    /// what belongs to others and stays.
    fn wipe(&self) -> Result<Vec<ForeignFile>, InstanceError> {
        let (segments, foreign) = self.segments().map_err(io_error(Path::new(SHARED_MEMORY)))?;
        for path in segments.iter().filter(|path| !seed::is_seed(path)) {
            remove(fs::remove_file(path), path)?;
        }
        let kept = [NOTE, super::lock::NAME];
        for entry in fs::read_dir(&self.directory).map_err(io_error(&self.directory))?.flatten() {
            let path = entry.path();
            if kept.iter().any(|name| entry.file_name() == *name) {
                continue;
            }
            let is_directory = entry.file_type().is_ok_and(|kind| kind.is_dir());
            let removed =
                if is_directory { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
            remove(removed, &path)?;
        }
        Ok(foreign)
    }

    /// Removes the namespace itself, with all that is in it.
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
        // The last line is complete only with its end.
        text.ends_with('\n').then_some(())?;
        Some(Self {
            directory: value("root_path")?.into(),
            prefix: value("prefix")?.into(),
            runtime_directory: value("runtime_directory")?.into(),
            ipc_version: value("iceoryx2")?.into(),
        })
    }

    /// That of which a file tells, if its directory is there and this user's alone.
    fn read(note: &Path) -> io::Result<Option<Self>> {
        let mut text = String::new();
        match private::read_file(note).and_then(|mut file| file.read_to_string(&mut text)) {
            Err(error) if is_absence(&error) => return Ok(None),
            read => read?,
        };
        Ok(Self::from_note(&text).filter(|namespace| {
            let is_there = namespace.directory.is_dir();
            is_there && private::check_directory(&namespace.directory, Others::Read).is_ok()
        }))
    }

    /// All namespaces of this user, whatever groups they belong to.
    pub fn all() -> io::Result<Vec<Self>> {
        let mut all = Vec::new();
        for path in directories()? {
            match Self::read(&path.join(NOTE)) {
                Ok(read) => all.extend(read.filter(|namespace| namespace.directory == path)),
                // One that is not as it is made says nothing.
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
            seed::make(&directory, &prefix)?;
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

impl Instance {
    /// Where the group is in shared memory; `None` when it is not there.
    pub fn namespace(&self) -> Result<Option<Namespace>, InstanceError> {
        let note = self.directory().join(NOTE);
        if let Some(namespace) = Namespace::read(&note).map_err(io_error(&note))? {
            return Ok(Some(namespace));
        }
        let mut all = Namespace::all().map_err(io_error(Path::new(SHARED_MEMORY)))?;
        all.retain(|namespace| namespace.runtime_directory == self.directory());
        Ok(all.pop())
    }

    /// Where the group is in shared memory; a place is made when there is none. The runtime directory
    /// must be there.
    pub fn create_namespace(&self) -> Result<Namespace, InstanceError> {
        if let Some(namespace) = self.namespace()? {
            return Ok(namespace);
        }
        let note = self.directory().join(NOTE);
        // One process at a time; the others find what it has made.
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

    /// Puts back what somebody has removed of a namespace that is in use; returns whether there was
    /// anything. The runtime directory must be there.
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

    /// Removes everything a group has left behind in shared memory, but for the lock; returns files with
    /// its names that belong to others, and stay. Only for the holder of the lock, and only when none of
    /// the group's processes is alive: removing one half of what iceoryx2 keeps, or removing it under a
    /// living process, is worse than leaving it.
    pub fn wipe(&self) -> Result<Vec<ForeignFile>, InstanceError> {
        self.namespace()?.map_or(Ok(Vec::new()), |namespace| namespace.wipe())
    }

    /// Removes what says how far the stages of an earlier group have come, so that those of a new one
    /// begin at the beginning. Only when none of them is alive.
    pub fn forget_progress(&self) -> Result<(), InstanceError> {
        self.namespace()?.map_or(Ok(()), |namespace| namespace.forget_progress())
    }

    /// Removes everything of the group in shared memory, the lock and the namespace included.
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

/// Makes a directory in shared memory under a name that nobody can foretell.
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

/// The directories in shared memory of this user's groups.
pub fn directories() -> io::Result<Vec<PathBuf>> {
    let mut directories = Vec::new();
    for entry in fs::read_dir(SHARED_MEMORY)?.flatten() {
        let path = entry.path();
        let is_named = is_directory_name(&entry.file_name().to_string_lossy());
        if is_named && private::check_directory(&path, Others::Read).is_ok() && path.is_dir() {
            directories.push(path);
        }
    }
    Ok(directories)
}

/// Whether a name in shared memory is that of a group's directory.
fn is_directory_name(name: &str) -> bool {
    let digits = name.strip_prefix("tl_").and_then(|rest| rest.strip_suffix(".group"));
    digits
        .is_some_and(|digits| digits.len() == 8 && digits.bytes().all(|it| it.is_ascii_hexdigit()))
}

/// A prefix that nobody can foretell and with which no name begins yet.
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

/// Locks a file, which is made if it is not there.
fn lock(path: &Path) -> io::Result<File> {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let file = private::open_file(path)?;
        match flock(&file, FlockOperation::NonBlockingLockExclusive) {
            // Somebody may have removed it between the two calls.
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

/// Whether an error only says that something is not there.
fn is_absence(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory)
}

#[cfg(test)]
mod tests;
