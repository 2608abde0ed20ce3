//! Directories and files that are this user's alone, whatever other users of the machine put in the way.
//!
//! A place like `/tmp` or `/dev/shm` lets everybody make things under any name. Whatever is made there is
//! therefore made new (O_EXCL) or checked after it was opened, by the descriptor, so that nothing can be
//! exchanged between the look and the use; links are never followed (O_NOFOLLOW). A directory is checked
//! together with every directory above it: whoever can write to one of those can put another one in its
//! place.

use rustix::fs::{FileType, Mode, OFlags};
use std::fs::{self, DirBuilder, File, Permissions};
use std::io;
use std::os::fd::AsFd;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};

/// Why a directory is not used.
#[derive(Debug, thiserror::Error)]
pub enum PrivacyError {
    /// It, or one above it, is not this user's alone.
    #[error("{path} {problem}{}", advice(path, directory, problem))]
    Exposed {
        /// The one that is not.
        path: PathBuf,
        /// What is wrong with it.
        problem: Problem,
        /// The one that was to be used.
        directory: PathBuf,
    },
    /// It cannot be looked at or made.
    #[error("{path}: {source}")]
    Io {
        /// What was touched.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// What is wrong with a directory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Problem {
    /// It is a link, which its owner can turn elsewhere.
    Link,
    /// It is something else.
    NoDirectory,
    /// It belongs to the user with this number.
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

/// How much others may do in a directory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Others {
    /// They may not write.
    Read,
    /// They may add what is theirs, as in `/tmp`.
    Add,
}

/// Checks that a directory belongs to this user and that others can do no more in it than that.
pub fn check_directory(path: &Path, others: Others) -> Result<(), PrivacyError> {
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

/// Checks that nobody but the system's administrator and this user can put another directory in the place
/// of this one: all above it belong to one of them, and others can at most add to them. What does not
/// exist is not looked at.
pub fn check_way(directory: &Path) -> Result<(), PrivacyError> {
    let Some(parent) = directory.parent() else { return Ok(()) };
    check_above(parent, directory)?;
    // Links on the way lead elsewhere, where the same holds.
    match fs::canonicalize(parent) {
        Ok(real) if real != parent => check_above(&real, directory),
        _ => Ok(()),
    }
}

fn check_above(parent: &Path, directory: &Path) -> Result<(), PrivacyError> {
    // In a user namespace the administrator of the machine, who owns the root directory, has another
    // number.
    let root = fs::metadata("/").map_or(0, |data| data.uid());
    let ancestors: Vec<&Path> = parent.ancestors().collect();
    for path in ancestors.into_iter().rev() {
        let Some(data) = look_at(path)? else { return Ok(()) };
        let problem = if ![0, root, own_uid()].contains(&data.uid()) {
            Problem::Foreign(data.uid())
        } else if data.is_dir() && can_be_exchanged(&data, Others::Add) {
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

fn can_be_exchanged(data: &fs::Metadata, others: Others) -> bool {
    const STICKY: u32 = 0o1000;
    let is_sticky = data.mode() & STICKY != 0;
    let is_writable = data.mode() & 0o022 != 0 && !is_for_own_group(data);
    is_writable && !(is_sticky && others == Others::Add)
}

/// Whether only this user and the group that is this user's alone may write: many systems give every user
/// a group of the same number, and make directories that it may write to.
fn is_for_own_group(data: &fs::Metadata) -> bool {
    let own_gid = rustix::process::getegid().as_raw();
    data.mode() & 0o002 == 0 && data.gid() == own_gid && own_gid == own_uid()
}

fn own_uid() -> u32 {
    rustix::process::geteuid().as_raw()
}

/// Makes a directory that nobody else can read, with those above it that are missing, and checks it and
/// the way to it.
pub fn create_directory(path: &Path) -> Result<(), PrivacyError> {
    check_way(path)?;
    let made = DirBuilder::new().recursive(true).mode(0o700).create(path);
    match made {
        // Something that is there and no directory is described better by the check.
        Err(source) if fs::symlink_metadata(path).is_err() => {
            Err(PrivacyError::Io { path: path.into(), source })
        }
        _ => check_directory(path, Others::Read),
    }
}

/// Opens a file for reading and writing, which is made if it is not there, for nobody else to read.
/// Refuses one that others can reach: that belongs to another user, has a second name or is open to
/// others.
pub fn open_file(path: &Path) -> io::Result<File> {
    let flags =
        OFlags::RDWR | OFlags::CREATE | OFlags::CLOEXEC | OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let file = rustix::fs::open(path, flags, Mode::RUSR | Mode::WUSR)?;
    check_file(&file)?;
    Ok(file.into())
}

/// As [`open_file`], for reading, and not made.
pub fn read_file(path: &Path) -> io::Result<File> {
    let flags = OFlags::RDONLY | OFlags::CLOEXEC | OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let file = rustix::fs::open(path, flags, Mode::empty())?;
    check_file(&file)?;
    Ok(file.into())
}

/// As [`open_file`], and empties the file.
pub fn create_file(path: &Path) -> io::Result<File> {
    let file = open_file(path)?;
    file.set_len(0)?;
    Ok(file)
}

/// Makes a file that is not there yet, for nobody else to read.
pub fn create_new_file(path: &Path) -> io::Result<File> {
    let flags = OFlags::WRONLY | OFlags::CREATE | OFlags::EXCL | OFlags::CLOEXEC | OFlags::NOFOLLOW;
    Ok(rustix::fs::open(path, flags, Mode::RUSR | Mode::WUSR)?.into())
}

fn check_file(file: &impl AsFd) -> io::Result<()> {
    let data = rustix::fs::fstat(file)?;
    let problem = if FileType::from_raw_mode(data.st_mode) != FileType::RegularFile {
        "it is no ordinary file".into()
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

/// Makes a socket for datagrams on which only this user can send.
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
        let refusal = check_way(&link.join("b")).unwrap_err().to_string();
        assert!(refusal.starts_with(&format!("{} can", open.display())), "links: {refusal}");

        // As /tmp.
        fs::set_permissions(&open, Permissions::from_mode(0o1777)).unwrap();
        create_directory(&deep).unwrap();
        assert_eq!(fs::metadata(&deep).unwrap().mode() & 0o777, 0o700);
        check_way(&link.join("b")).unwrap();
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
    fn what_belongs_to_another_user_is_refused() {
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
            check_directory(&theirs, Others::Add).unwrap_err().to_string(),
            check_way(&inner).unwrap_err().to_string(),
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
