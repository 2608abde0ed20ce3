//! A group's name, and everything that keeps two groups on one machine apart: a private runtime
//! directory, a [namespace] in shared memory, and a [lock] that says whether its supervisor lives.

pub mod lock;
pub mod namespace;

pub use namespace::{ForeignFile, Namespace};

use crate::memory::PlaceError;
use crate::private::{self, Others, PrivacyError, Problem};
use std::fs;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// Overrides the directory under which instances keep their runtime directories.
pub const RUNTIME_DIR_VARIABLE: &str = "TOUCHLINE_RUNTIME_DIR";
/// The instance used when none is named.
pub const DEFAULT_INSTANCE: &str = "default";
/// Longest name.
const MAX_NAME: usize = 20;
/// Longest runtime directory. The system limits the path of a socket to 107 bytes; the longest name of
/// one in it is that of who asks the supervisor for something.
const MAX_DIRECTORY: usize = 107 - "/control-4294967295".len();

/// Why an instance cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum InstanceError {
    /// The name does not fit into file names.
    #[error("instance name {0:?}: use 1 to {MAX_NAME} of a-z, 0-9 and '-', not beginning with '-'")]
    Name(String),
    /// A directory is not ours alone.
    #[error("{exposed} with {RUNTIME_DIR_VARIABLE}{}", attach_as_owner(exposed))]
    Directory {
        /// Which, and why.
        exposed: PrivacyError,
    },
    /// Something in the runtime directory could not be made, opened or removed.
    #[error("{path}: {source}")]
    Io {
        /// What was touched.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Processes cannot share memory here.
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
    /// Where other users can get at what is meant for them.
    gateway_base: PathBuf,
}

impl Instance {
    /// The instance of that name. Nothing is created yet.
    pub fn new(name: &str) -> Result<Self, InstanceError> {
        Self::below(&runtime_base(), name)
    }

    /// The instance of that name whose runtime directory lies below `base`, for programs that look
    /// after several.
    pub fn below(base: &Path, name: &str) -> Result<Self, InstanceError> {
        let valid = (1..=MAX_NAME).contains(&name.len())
            // A name that begins with a dash looks like an option to the programs that get it.
            && !name.starts_with('-')
            && name.bytes().all(|byte| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-'));
        if !valid {
            return Err(InstanceError::Name(name.into()));
        }
        // Every process of the group must mean the same place, wherever it was started.
        let base = std::path::absolute(base).unwrap_or_else(|_| base.into());
        let directory = base.join(name);
        match directory.to_str() {
            Some(text) if text.len() <= MAX_DIRECTORY => {
                Ok(Self { name: name.into(), directory, gateway_base: gateway_base(&base) })
            }
            _ => Err(InstanceError::Path(directory)),
        }
    }

    /// All instances that have a runtime directory below `base`.
    pub fn all_below(base: &Path) -> Vec<Self> {
        let entries = fs::read_dir(base).into_iter().flatten().flatten();
        let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
        let mut all: Vec<Self> = names.filter_map(|name| Self::below(base, &name).ok()).collect();
        all.sort_by(|a, b| a.name.cmp(&b.name));
        all.retain(|instance| instance.directory.is_dir());
        all
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Where its lock, configuration snapshot and logs are.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// The configuration that the running group uses.
    pub fn config_path(&self) -> PathBuf {
        self.directory.join("config.toml")
    }

    /// Where the supervisor keeps what its successor needs to know.
    pub fn record_path(&self) -> PathBuf {
        self.directory.join("group.json")
    }

    /// The socket on which the supervisor takes requests.
    pub fn control_path(&self) -> PathBuf {
        self.directory.join("control")
    }

    /// The socket on which a grabber that plays a recording step by step is asked for the next frames.
    pub fn step_path(&self) -> PathBuf {
        self.directory.join("step")
    }

    /// The directory of the socket for other users: not in the runtime directory, which is closed to
    /// them, but beside it; or, where all of that place is closed to them, in /tmp.
    pub fn gateway_directory(&self) -> PathBuf {
        self.gateway_base.join(format!("{}.gateway", self.name))
    }

    /// The socket for other users.
    pub fn gateway_path(&self) -> PathBuf {
        self.gateway_directory().join("socket")
    }

    /// Makes the directory of the socket for other users, so that a group of users (its number in the
    /// system) can get at what is in it, but not list it, and everybody else not even that. The place
    /// it is in can then be passed through by everybody, but neither listed nor written; it is left closed
    /// where there is something else in it that this would open as well.
    pub fn create_gateway_directory(&self, group: u32) -> Result<(), InstanceError> {
        let directory = self.gateway_directory();
        let places = [self.gateway_base.as_path(), &directory];
        // Nobody else's until it has its group.
        make(places)?;
        let mode = fs::symlink_metadata(&self.gateway_base).map_err(io_error(places[0]))?.mode();
        if mode & 0o001 == 0 && holds_only_closed(&self.gateway_base, &directory) {
            set_mode(&self.gateway_base, mode & 0o7777 | 0o011)?;
        }
        set_mode(&directory, 0o700)?;
        std::os::unix::fs::chown(&directory, None, Some(group)).map_err(io_error(&directory))?;
        set_mode(&directory, 0o710)
    }

    /// Removes that directory.
    pub fn remove_gateway_directory(&self) -> Result<(), InstanceError> {
        let directory = self.gateway_directory();
        if !is_ours(&directory) {
            return Ok(());
        }
        remove(fs::remove_dir_all(&directory), &directory)?;
        remove_if_made(&self.gateway_base);
        Ok(())
    }

    /// Makes the runtime directory, readable by nobody else, and checks that it is really ours: in
    /// a world-writable place somebody could have put a directory or a link there first.
    pub fn create_directory(&self) -> Result<(), InstanceError> {
        make(self.places())?;
        // Made for us by a service manager, say, and more open than need be. What is in it is nobody
        // else's business.
        let mode = fs::symlink_metadata(&self.directory).map_err(io_error(&self.directory))?.mode();
        if mode & 0o077 != 0 {
            let private = fs::Permissions::from_mode(0o700);
            fs::set_permissions(&self.directory, private).map_err(io_error(&self.directory))?;
        }
        Ok(())
    }

    /// Whether the runtime directory and the one it is in, as far as they exist, are ours alone.
    pub fn check_directory(&self) -> Result<(), InstanceError> {
        check_places(self.places())
    }

    /// The directory of all instances, and this one's.
    fn places(&self) -> [&Path; 2] {
        [self.directory.parent().unwrap_or(Path::new("/")), &self.directory]
    }

    /// Whether there is or was a group in the runtime directory: where the user's own directory serves
    /// as the place of all groups, there are others in it that have nothing to do with any.
    pub fn has_files(&self) -> bool {
        let names = [MADE, lock::NAME, namespace::NOTE, "config.toml", "group.json"];
        names.iter().any(|name| self.directory.join(name).exists())
    }

    /// Removes the runtime directory, the lock and the namespace, at the end of a group's life. A
    /// directory that was there before stays, without the files of the group.
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
        let names = [lock::NAME, namespace::NOTE, "config.toml", "group.json", "group.new"];
        let sockets = ["control", "step"];
        for path in names.into_iter().chain(sockets).map(|name| self.directory.join(name)) {
            remove(fs::remove_file(&path), &path)?;
        }
        // The sockets of those who were asking for something when they died.
        for entry in fs::read_dir(&self.directory).into_iter().flatten().flatten() {
            if entry.file_name().to_string_lossy().starts_with("control-") {
                let path = entry.path();
                remove(fs::remove_file(&path), &path)?;
            }
        }
        Ok(())
    }
}

/// A file in every directory that was made for groups. Only such a directory is removed with the last
/// of them: the user, or a service manager, may have made one and expects it to stay.
const MADE: &str = ".made-by-touchline";

/// Makes two directories, of which the second is in the first, readable by nobody else, and checks that
/// they are really ours: in a place that everybody can write to somebody could have put a directory or
/// a link there first.
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
            // Something that is there and no directory is described better by the check.
            Err(error) if fs::symlink_metadata(path).is_err() => {
                return Err(io_error(path)(error));
            }
            Err(_) => check_places(places)?,
        }
    }
    Ok(())
}

/// Removes a directory that was made for groups when there is nothing else in it.
fn remove_if_made(path: &Path) {
    let mark = path.join(MADE);
    let has_others = fs::read_dir(path).is_ok_and(|mut entries| {
        entries.any(|entry| entry.is_ok_and(|entry| entry.file_name() != MADE))
    });
    // A group that starts at this moment makes it again.
    if !has_others && fs::remove_file(&mark).is_ok() && fs::remove_dir(path).is_err() {
        let _ = private::open_file(&mark);
    }
}

/// Whether two directories, of which the second is in the first, are ours alone, as far as they exist, and
/// nobody else can exchange them.
fn check_places([base, directory]: [&Path; 2]) -> Result<(), InstanceError> {
    private::check_way(base)?;
    // In a directory like /tmp others can add theirs, but not take ours away.
    private::check_directory(base, Others::Add)?;
    Ok(private::check_directory(directory, Others::Read)?)
}

/// Whether everything in a directory is closed to others by its own mode, directories for other users
/// aside: somebody's home may have been named as the place for groups.
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

/// The directory in which all runtime directories of this user are.
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

/// Where the directories are that other users are let into. What is in XDG_RUNTIME_DIR is closed to
/// everybody but its owner.
fn gateway_base(base: &Path) -> PathBuf {
    let closed = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
    match closed {
        Some(closed) if !closed.as_os_str().is_empty() && base.starts_with(&closed) => {
            base_in_tmp()
        }
        _ => base.into(),
    }
}

/// FNV-1a: short, stable between builds, good enough to tell names and tables apart.
pub fn fnv1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, &byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

#[cfg(test)]
mod tests;
