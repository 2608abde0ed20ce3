//! Directories and files that belong to this user alone, even in places where other users can create
//! files.
//!
//! In a place like `/tmp` or `/dev/shm` everybody can create files under any name. Files there are
//! therefore created exclusively (O_EXCL), or checked through their descriptor after opening, so that
//! they cannot be replaced between check and use; links are never followed (O_NOFOLLOW). A directory is
//! checked together with every directory above it: a user that can write to one of those can replace
//! it.

use rustix::fs::{FileType, Mode, OFlags};
use std::fs::{self, DirBuilder, File, Permissions};
use std::io;
use std::os::fd::AsFd;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};

/// Reason why a directory is refused.
#[derive(Debug, thiserror::Error)]
pub enum PrivacyError {
    /// It, or a directory above it, is accessible to other users.
    #[error("{path} {problem}{}", advice(path, directory, problem))]
    Exposed {
        /// The directory at fault.
        path: PathBuf,
        /// The problem.
        problem: Problem,
        /// The directory that was to be used.
        directory: PathBuf,
    },
    /// It cannot be inspected or created.
    #[error("{path}: {source}")]
    Io {
        /// Path concerned.
        path: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
}

/// Problem of a directory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Problem {
    /// It is a symbolic link, which its owner can redirect.
    Link,
    /// It is not a directory.
    NoDirectory,
    /// It belongs to the user with this id.
    Foreign(u32),
    /// Its mode lets others write.
    Writable,
}

impl std::fmt::Display for Problem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Link => write!(f, "is a symbolic link"),
            Self::NoDirectory => write!(f, "is not a directory"),
            Self::Foreign(uid) => write!(f, "belongs to another user (uid {uid})"),
            Self::Writable => write!(f, "can be written by other users"),
        }
    }
}

fn advice(path: &Path, directory: &Path, problem: &Problem) -> String {
    let above = match path == directory {
        true => String::new(),
        false => format!(", who could put something else in the place of {}", directory.display()),
    };
    let remedy = match problem {
        Problem::Writable => format!("; `chmod go-w {}`, or choose another place", path.display()),
        _ if path == directory => "; remove it or choose another place".into(),
        _ => "; choose another place".into(),
    };
    above + &remedy
}

/// Access that other users may have to a directory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OthersMay {
    /// They may not write.
    Read,
    /// They may add entries of their own, as in `/tmp`.
    Add,
}

/// Checks that a directory belongs to this user and gives other users no more access than this.
pub fn check_directory(path: &Path, others: OthersMay) -> Result<(), PrivacyError> {
    let exposed =
        |problem| Err(PrivacyError::Exposed { path: path.into(), problem, directory: path.into() });
    let Some(data) = look_at(path)? else { return Ok(()) };
    match problem_of(&data) {
        Some(problem) => exposed(problem),
        None if data.uid() != own_uid() => exposed(Problem::Foreign(data.uid())),
        None if can_be_exchanged(&data, others) => exposed(Problem::Writable),
        None => Ok(()),
    }
}

/// Checks that only root and this user can replace a directory: all directories above it belong to one
/// of them, and other users can at most add entries. Missing directories are not checked.
pub fn check_ancestors(directory: &Path) -> Result<(), PrivacyError> {
    let Some(parent) = directory.parent() else { return Ok(()) };
    check_above(parent, directory)?;
    // Links on the path lead to other places, which must pass the same check.
    match fs::canonicalize(parent) {
        Ok(real) if real != parent => check_above(&real, directory),
        _ => Ok(()),
    }
}

fn check_above(parent: &Path, directory: &Path) -> Result<(), PrivacyError> {
    // In a user namespace, root of the machine, which owns the root directory, has another user id.
    let root = fs::metadata("/").map_or(0, |data| data.uid());
    let ancestors: Vec<&Path> = parent.ancestors().collect();
    for path in ancestors.into_iter().rev() {
        let Some(data) = look_at(path)? else { return Ok(()) };
        let problem = if ![0, root, own_uid()].contains(&data.uid()) {
            Problem::Foreign(data.uid())
        } else if data.is_dir() && can_be_exchanged(&data, OthersMay::Add) {
            Problem::Writable
        } else {
            continue;
        };
        return Err(PrivacyError::Exposed {
            path: path.into(),
            problem,
            directory: directory.into(),
        });
    }
    Ok(())
}

fn look_at(path: &Path) -> Result<Option<fs::Metadata>, PrivacyError> {
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(PrivacyError::Io { path: path.into(), source }),
        Ok(data) => Ok(Some(data)),
    }
}

fn problem_of(data: &fs::Metadata) -> Option<Problem> {
    match data.is_dir() {
        true => None,
        false if data.is_symlink() => Some(Problem::Link),
        false => Some(Problem::NoDirectory),
    }
}

fn can_be_exchanged(data: &fs::Metadata, others: OthersMay) -> bool {
    const STICKY: u32 = 0o1000;
    let is_sticky = data.mode() & STICKY != 0;
    let is_writable = data.mode() & 0o022 != 0 && !is_for_own_group(data);
    is_writable && !(is_sticky && others == OthersMay::Add)
}

/// Whether only this user and the user's own group may write: many systems give every user a group with
/// the user's id, and make directories writable for it.
fn is_for_own_group(data: &fs::Metadata) -> bool {
    let own_gid = rustix::process::getegid().as_raw();
    data.mode() & 0o002 == 0 && data.gid() == own_gid && own_gid == own_uid()
}

fn own_uid() -> u32 {
    rustix::process::geteuid().as_raw()
}

/// Creates a directory accessible to this user alone, and missing ones above it, and checks it and the
/// path to it.
pub fn create_directory(path: &Path) -> Result<(), PrivacyError> {
    check_ancestors(path)?;
    let made = DirBuilder::new().recursive(true).mode(0o700).create(path);
    match made {
        // If something other than a directory exists there, the check has the better error.
        Err(source) if fs::symlink_metadata(path).is_err() => {
            Err(PrivacyError::Io { path: path.into(), source })
        }
        _ => check_directory(path, OthersMay::Read),
    }
}

/// Opens a file for reading and writing; a missing file is created for this user alone. Refuses a file
/// that other users can reach: one that belongs to another user, has a second hard link or is writable
/// for others.
pub fn open_file(path: &Path) -> io::Result<File> {
    let flags =
        OFlags::RDWR | OFlags::CREATE | OFlags::CLOEXEC | OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let file = rustix::fs::open(path, flags, Mode::RUSR | Mode::WUSR)?;
    check_file(&file)?;
    Ok(file.into())
}

/// Like [`open_file`], but for reading only, and without creating the file.
pub fn read_file(path: &Path) -> io::Result<File> {
    let flags = OFlags::RDONLY | OFlags::CLOEXEC | OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let file = rustix::fs::open(path, flags, Mode::empty())?;
    check_file(&file)?;
    Ok(file.into())
}

/// Like [`open_file`], but empties the file.
pub fn create_file(path: &Path) -> io::Result<File> {
    let file = open_file(path)?;
    file.set_len(0)?;
    Ok(file)
}

/// Creates a file that must not exist yet, for this user alone.
pub fn create_new_file(path: &Path) -> io::Result<File> {
    let flags = OFlags::WRONLY | OFlags::CREATE | OFlags::EXCL | OFlags::CLOEXEC | OFlags::NOFOLLOW;
    Ok(rustix::fs::open(path, flags, Mode::RUSR | Mode::WUSR)?.into())
}

fn check_file(file: &impl AsFd) -> io::Result<()> {
    let data = rustix::fs::fstat(file)?;
    let problem = if FileType::from_raw_mode(data.st_mode) != FileType::RegularFile {
        "it is not a regular file".into()
    } else if data.st_uid != own_uid() {
        format!("it belongs to another user (uid {})", data.st_uid)
    } else if data.st_nlink > 1 {
        "it has a second name".into()
    } else if data.st_mode & 0o022 != 0 {
        "other users can write to it".into()
    } else {
        return Ok(());
    };
    Err(io::Error::new(io::ErrorKind::PermissionDenied, problem))
}

/// Creates a datagram socket to which only this user can send.
pub fn bind_datagram(path: &Path) -> io::Result<UnixDatagram> {
    let socket = UnixDatagram::bind(path)?;
    fs::set_permissions(path, Permissions::from_mode(0o600))?;
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    struct Scratch(PathBuf);

    impl Scratch {
        fn new(name: &str) -> Self {
            let path =
                std::env::temp_dir().join(format!("tl-private-{name}-{}", std::process::id()));
            DirBuilder::new().mode(0o700).create(&path).unwrap();
            Self(path)
        }

        fn directory(&self, name: &str, mode: u32) -> PathBuf {
            let path = self.0.join(name);
            fs::create_dir(&path).unwrap();
            fs::set_permissions(&path, Permissions::from_mode(mode)).unwrap();
            path
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    #[test]
    fn every_directory_on_the_way_is_looked_at() {
        let scratch = Scratch::new("way");
        let open = scratch.directory("open", 0o777);
        let inner = open.join("a");
        fs::create_dir(&inner).unwrap();
        let deep = inner.join("b/c");
        let refusal = create_directory(&deep).unwrap_err().to_string();
        assert!(refusal.starts_with(&format!("{} can be written", open.display())), "{refusal}");
        assert!(refusal.contains("chmod go-w") && refusal.contains(deep.to_str().unwrap()));
        assert!(!deep.exists() && !inner.join("b").exists(), "something was made there");

        let link = scratch.0.join("link");
        symlink(&inner, &link).unwrap();
        let refusal = check_ancestors(&link.join("b")).unwrap_err().to_string();
        assert!(refusal.starts_with(&format!("{} can", open.display())), "links: {refusal}");

        // Like /tmp.
        fs::set_permissions(&open, Permissions::from_mode(0o1777)).unwrap();
        create_directory(&deep).unwrap();
        assert_eq!(fs::metadata(&deep).unwrap().mode() & 0o777, 0o700);
        check_ancestors(&link.join("b")).unwrap();
    }

    #[test]
    fn files_that_others_can_reach_are_refused() {
        let scratch = Scratch::new("files");
        let (file, second) = (scratch.0.join("file"), scratch.0.join("second"));
        drop(open_file(&file).unwrap());
        assert_eq!(fs::metadata(&file).unwrap().mode() & 0o777, 0o600);
        drop((create_file(&file).unwrap(), read_file(&file).unwrap()));
        assert_eq!(create_new_file(&file).unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        fs::hard_link(&file, &second).unwrap();
        for open in [open_file, create_file, read_file] {
            let refusal = open(&file).unwrap_err().to_string();
            assert!(refusal.contains("second name"), "{refusal}");
        }
        fs::remove_file(&second).unwrap();
        symlink(&file, &second).unwrap();
        for open in [open_file, create_file, read_file, create_new_file] {
            open(&second).unwrap_err();
        }
        fs::set_permissions(&file, Permissions::from_mode(0o666)).unwrap();
        let refusal = open_file(&file).unwrap_err().to_string();
        assert!(refusal.contains("can write"), "{refusal}");
    }

    #[test]
    #[ignore = "needs root, to make what belongs to another user"]
    fn files_of_another_user_are_refused() {
        const NOBODY: u32 = 65_534;
        let scratch = Scratch::new("foreign");
        let theirs = scratch.directory("theirs", 0o755);
        let (file, inner) = (scratch.0.join("file"), theirs.join("inner"));
        fs::create_dir(&inner).unwrap();
        fs::write(&file, "").unwrap();
        for path in [&theirs, &file] {
            std::os::unix::fs::chown(path, Some(NOBODY), Some(NOBODY)).unwrap();
        }
        for refusal in [
            check_directory(&theirs, OthersMay::Add).unwrap_err().to_string(),
            check_ancestors(&inner).unwrap_err().to_string(),
            open_file(&file).unwrap_err().to_string(),
            read_file(&file).unwrap_err().to_string(),
        ] {
            assert!(refusal.contains("belongs to another user (uid 65534)"), "{refusal}");
        }
    }

    #[test]
    fn only_its_owner_can_send_to_a_socket() {
        let scratch = Scratch::new("socket");
        let path = scratch.0.join("socket");
        let _socket = bind_datagram(&path).unwrap();
        assert_eq!(fs::symlink_metadata(&path).unwrap().mode() & 0o777, 0o600);
    }
}
