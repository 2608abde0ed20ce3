//! A group's name, and everything that separates two groups on one machine: a private runtime
//! directory, a [namespace] in shared memory, and a [lock] that shows whether its supervisor lives.

pub mod lock;
pub mod namespace;

pub use namespace::{ForeignFile, Namespace};

use crate::memory::PlaceError;
use crate::private::{self, OthersMay, PrivacyError, Problem};
use std::fs;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// Overrides the directory below which instances have their runtime directories.
pub const RUNTIME_DIR_VARIABLE: &str = "TOUCHLINE_RUNTIME_DIR";
/// The instance used when no name is given.
pub const DEFAULT_INSTANCE: &str = "default";
/// Longest name, bytes.
const MAX_NAME: usize = 20;
/// Longest runtime directory, bytes. The system limits a socket's path to 107 bytes; the longest socket
/// name in the directory is that of a program that sends the supervisor a request.
const MAX_DIRECTORY: usize = 107 - "/control-4294967295".len();

/// Reason why an instance cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum InstanceError {
    /// The name is not valid in file names.
    #[error("instance name {0:?}: use 1 to {MAX_NAME} of a-z, 0-9 and '-', not beginning with '-'")]
    Name(String),
    /// A directory is accessible to other users.
    #[error("{exposed} with {RUNTIME_DIR_VARIABLE}{}", attach_as_owner(exposed))]
    Directory {
        /// Directory and reason.
        exposed: PrivacyError,
    },
    /// A file in the runtime directory could not be created, opened or removed.
    #[error("{path}: {source}")]
    Io {
        /// Path concerned.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
    /// Shared memory is unusable on this machine.
    #[error(transparent)]
    Memory(#[from] PlaceError),
    /// The group uses another version of iceoryx2.
    #[error(
        "the group {name:?} uses iceoryx2 {group}, and this program {own}, which do not understand each \
         other; build this program with iceoryx2 {group}, or start the group with this version of \
         touchline"
    )]
    Version {
        /// Name of the group.
        name: String,
        /// The group's version.
        group: String,
        /// This program's version.
        own: &'static str,
    },
    /// The resulting path is too long for iceoryx2.
    #[error(
        "{0} is too long or has unusual characters; choose another place with {RUNTIME_DIR_VARIABLE}"
    )]
    Path(PathBuf),
}

impl From<PrivacyError> for InstanceError {
    fn from(error: PrivacyError) -> Self {
        match error {
            PrivacyError::Io { path, source } => Self::Io { path, source },
            exposed => Self::Directory { exposed },
        }
    }
}

fn attach_as_owner(error: &PrivacyError) -> &'static str {
    match error {
        PrivacyError::Exposed { problem: Problem::Foreign(_), .. } => {
            "; to attach to a group of its owner, do so as that user"
        }
        _ => "",
    }
}

/// A named group of processes on this machine, belonging to one user.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Instance {
    name: String,
    directory: PathBuf,
    /// Directory below which other users can reach the gateway's socket.
    gateway_base: PathBuf,
}

impl Instance {
    /// The instance with this name. Nothing is created yet.
    pub fn new(name: &str) -> Result<Self, InstanceError> {
        Self::below(&runtime_base(), name)
    }

    /// The instance with this name and a runtime directory below `base`, for programs that manage
    /// several.
    pub fn below(base: &Path, name: &str) -> Result<Self, InstanceError> {
        let valid = (1..=MAX_NAME).contains(&name.len())
            // Programs that get the name as an argument would take a leading dash for an option.
            && !name.starts_with('-')
            && name.bytes().all(|byte| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-'));
        if !valid {
            return Err(InstanceError::Name(name.into()));
        }
        // The path must mean the same place in every process of the group, whatever its working
        // directory.
        let base = std::path::absolute(base).unwrap_or_else(|_| base.into());
        let directory = base.join(name);
        match directory.to_str() {
            Some(text) if text.len() <= MAX_DIRECTORY => {
                Ok(Self { name: name.into(), directory, gateway_base: gateway_base(&base) })
            }
            _ => Err(InstanceError::Path(directory)),
        }
    }

    /// All instances with a runtime directory below `base`.
    pub fn all_below(base: &Path) -> Vec<Self> {
        let entries = fs::read_dir(base).into_iter().flatten().flatten();
        let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
        let mut all: Vec<Self> = names.filter_map(|name| Self::below(base, &name).ok()).collect();
        all.sort_by(|a, b| a.name.cmp(&b.name));
        all.retain(|instance| instance.directory.is_dir());
        all
    }

    /// The instance's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Directory of the lock, the configuration snapshot and the sockets.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// Configuration used by the running group.
    pub fn config_path(&self) -> PathBuf {
        self.directory.join("config.toml")
    }

    /// Directory of the last accepted configurations.
    pub fn revisions_directory(&self) -> PathBuf {
        self.directory.join("revisions")
    }

    /// The configuration of this revision.
    pub fn revision_path(&self, number: u32) -> PathBuf {
        self.revisions_directory().join(format!("{number}.toml"))
    }

    /// A configuration that a program asks the supervisor to take over.
    pub fn candidate_path(&self, pid: u32) -> PathBuf {
        self.directory.join(format!("candidate-{pid}.toml"))
    }

    /// The supervisor's record for its successor.
    pub fn record_path(&self) -> PathBuf {
        self.directory.join("group.json")
    }

    /// Socket for requests to the supervisor.
    pub fn control_path(&self) -> PathBuf {
        self.directory.join("control")
    }

    /// Where the console is reached, and its tokens.
    pub fn console_path(&self) -> PathBuf {
        self.directory.join("console.json")
    }

    /// Socket for requests to a grabber that plays a recording step by step.
    pub fn step_path(&self) -> PathBuf {
        self.directory.join("step")
    }

    /// Directory of the socket for other users. It is beside the runtime directory, which is closed to
    /// them; or in /tmp if that whole place is closed to them.
    pub fn gateway_directory(&self) -> PathBuf {
        self.gateway_base.join(format!("{}.gateway", self.name))
    }

    /// Socket for other users.
    pub fn gateway_path(&self) -> PathBuf {
        self.gateway_directory().join("socket")
    }

    /// Creates the directory of the socket for other users. Members of the group with this id can use
    /// files in it but not list it; other users cannot even do that. The directory above it becomes
    /// passable for everybody, but neither listable nor writable; it stays closed if this would expose
    /// anything else in it.
    pub fn create_gateway_directory(&self, group: u32) -> Result<(), InstanceError> {
        let directory = self.gateway_directory();
        let places = [self.gateway_base.as_path(), &directory];
        // Private until its group is set.
        make(places)?;
        let mode = fs::symlink_metadata(&self.gateway_base).map_err(io_error(places[0]))?.mode();
        if mode & 0o001 == 0 && holds_only_closed(&self.gateway_base, &directory) {
            set_mode(&self.gateway_base, mode & 0o7777 | 0o011)?;
        }
        set_mode(&directory, 0o700)?;
        std::os::unix::fs::chown(&directory, None, Some(group)).map_err(io_error(&directory))?;
        set_mode(&directory, 0o710)
    }

    /// Removes the directory of the socket for other users.
    pub fn remove_gateway_directory(&self) -> Result<(), InstanceError> {
        let directory = self.gateway_directory();
        if !is_ours(&directory) {
            return Ok(());
        }
        remove(fs::remove_dir_all(&directory), &directory)?;
        remove_if_made(&self.gateway_base);
        Ok(())
    }

    /// Creates the runtime directory, accessible to this user alone, and checks its owner: in a
    /// world-writable place another user could have put a directory or a link there first.
    pub fn create_directory(&self) -> Result<(), InstanceError> {
        make(self.places())?;
        // It may have been made by a service manager, with a wider mode than necessary. Its content
        // must stay private.
        let mode = fs::symlink_metadata(&self.directory).map_err(io_error(&self.directory))?.mode();
        if mode & 0o077 != 0 {
            let private = fs::Permissions::from_mode(0o700);
            fs::set_permissions(&self.directory, private).map_err(io_error(&self.directory))?;
        }
        Ok(())
    }

    /// Checks that the runtime directory and the one above it, as far as they exist, are this user's
    /// alone.
    pub fn check_directory(&self) -> Result<(), InstanceError> {
        check_places(self.places())
    }

    /// The directory of all instances, and the directory of this one.
    fn places(&self) -> [&Path; 2] {
        [self.directory.parent().unwrap_or(Path::new("/")), &self.directory]
    }

    /// Whether a group is or was in the runtime directory. If the user's own directory serves as the
    /// place of all groups, it also has unrelated directories.
    pub fn has_files(&self) -> bool {
        let names = [MADE, lock::NAME, namespace::NOTE, "config.toml", "group.json"];
        names.iter().any(|name| self.directory.join(name).exists())
    }

    /// Removes the runtime directory, the lock and the namespace at the end of a group's life. A
    /// directory that existed before the group stays, without the group's files.
    pub fn remove_directory(&self) -> Result<(), InstanceError> {
        self.remove_namespace()?;
        if self.directory.join(MADE).exists() {
            remove(fs::remove_dir_all(&self.directory), &self.directory)?;
        } else {
            self.remove_files()?;
        }
        if let Some(base) = self.directory.parent() {
            remove_if_made(base);
        }
        Ok(())
    }

    fn remove_files(&self) -> Result<(), InstanceError> {
        let names =
            [lock::NAME, namespace::NOTE, "config.toml", "config.new", "group.json", "group.new"];
        let others = ["console.json", "console.new", "control", "step"];
        for path in names.into_iter().chain(others).map(|name| self.directory.join(name)) {
            remove(fs::remove_file(&path), &path)?;
        }
        let revisions = self.revisions_directory();
        if revisions.exists() {
            remove(fs::remove_dir_all(&revisions), &revisions)?;
        }
        // Sockets of programs that died while they waited for an answer.
        for entry in fs::read_dir(&self.directory).into_iter().flatten().flatten() {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            if name.starts_with("control-") || name.starts_with("candidate-") {
                let path = entry.path();
                remove(fs::remove_file(&path), &path)?;
            }
        }
        Ok(())
    }
}

/// Marks every directory that was created for groups. Only marked directories are removed with the last
/// group, since a user or a service manager that creates one expects it to stay.
const MADE: &str = ".made-by-touchline";

/// Creates two directories, the second inside the first, accessible to this user alone, and checks
/// their owners: in a world-writable place another user could have put a directory or a link there
/// first.
fn make(places: [&Path; 2]) -> Result<(), InstanceError> {
    check_places(places)?;
    for path in places {
        if let Some(parent) = path.parent() {
            let above = fs::DirBuilder::new().recursive(true).mode(0o700).create(parent);
            above.map_err(io_error(parent))?;
        }
        match fs::DirBuilder::new().mode(0o700).create(path) {
            Ok(()) => {
                check_places(places)?;
                private::open_file(&path.join(MADE)).map_err(io_error(path))?;
            }
            // If something other than a directory exists there, the check has the better error.
            Err(error) if fs::symlink_metadata(path).is_err() => {
                return Err(io_error(path)(error));
            }
            Err(_) => check_places(places)?,
        }
    }
    Ok(())
}

/// Removes a directory that was created for groups if it is otherwise empty.
fn remove_if_made(path: &Path) {
    let mark = path.join(MADE);
    let has_others = fs::read_dir(path).is_ok_and(|mut entries| {
        entries.any(|entry| entry.is_ok_and(|entry| entry.file_name() != MADE))
    });
    // If a group starts at this moment, the mark is put back.
    if !has_others && fs::remove_file(&mark).is_ok() && fs::remove_dir(path).is_err() {
        let _ = private::open_file(&mark);
    }
}

/// Checks that two directories, the second inside the first, are this user's alone as far as they
/// exist, and that no other user can replace them.
fn check_places([base, directory]: [&Path; 2]) -> Result<(), InstanceError> {
    private::check_ancestors(base)?;
    // In a directory like /tmp other users can add entries, but not remove ours.
    private::check_directory(base, OthersMay::Add)?;
    Ok(private::check_directory(directory, OthersMay::Read)?)
}

/// Whether everything in a directory, except directories for other users, is closed to others by its
/// own mode: the place for groups may be a user's home.
fn holds_only_closed(base: &Path, gateway: &Path) -> bool {
    fs::read_dir(base).is_ok_and(|entries| {
        entries.flatten().all(|entry| {
            let is_for_others = entry.path().extension() == gateway.extension();
            is_for_others || entry.metadata().is_ok_and(|data| data.mode() & 0o077 == 0)
        })
    })
}

fn is_ours(path: &Path) -> bool {
    let uid = rustix::process::getuid().as_raw();
    fs::symlink_metadata(path).is_ok_and(|data| data.is_dir() && data.uid() == uid)
}

fn set_mode(path: &Path, mode: u32) -> Result<(), InstanceError> {
    fs::set_permissions(path, fs::Permissions::from_mode(mode)).map_err(io_error(path))
}

fn io_error(path: &Path) -> impl FnOnce(std::io::Error) -> InstanceError {
    move |source| InstanceError::Io { path: path.into(), source }
}

fn remove(result: std::io::Result<()>, path: &Path) -> Result<(), InstanceError> {
    match result {
        Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
            Err(InstanceError::Io { path: path.into(), source })
        }
        _ => Ok(()),
    }
}

/// The directory of all runtime directories of this user.
pub fn runtime_base() -> PathBuf {
    let from = |variable| std::env::var_os(variable).filter(|value| !value.is_empty());
    if let Some(directory) = from(RUNTIME_DIR_VARIABLE) {
        return directory.into();
    }
    match from("XDG_RUNTIME_DIR") {
        Some(directory) => PathBuf::from(directory).join("touchline"),
        None => base_in_tmp(),
    }
}

fn base_in_tmp() -> PathBuf {
    format!("/tmp/touchline-{}", rustix::process::getuid().as_raw()).into()
}

/// The directory of the directories for other users. XDG_RUNTIME_DIR is closed to all but its owner.
fn gateway_base(base: &Path) -> PathBuf {
    let closed = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
    match closed {
        Some(closed) if !closed.as_os_str().is_empty() && base.starts_with(&closed) => {
            base_in_tmp()
        }
        _ => base.into(),
    }
}

/// FNV-1a hash (Fowler, Noll, Vo): short, stable between builds, good enough to distinguish names and
/// tables.
pub fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, &byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

#[cfg(test)]
mod tests;
