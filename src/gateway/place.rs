//! The gateway's directory and socket, and access to them.

use super::users;
use client::instance::{Instance, InstanceError};
use rustix::io::Errno;
use rustix::net::{
    AddressFamily, SocketAddrUnix, SocketFlags, SocketType, bind, connect, listen, socket_with,
};
use std::fs;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::path::{Path, PathBuf};

/// Most connections waiting to be accepted.
const BACKLOG: i32 = 16;

/// Reason for which other users cannot be admitted.
#[derive(Debug, thiserror::Error)]
pub enum PlaceError {
    /// The configured group does not exist.
    #[error(
        "access.group: there is no group {0:?} on this computer; make it with `sudo groupadd {0}`, or \
         leave the key empty"
    )]
    Unknown(String),
    /// A user that may command a team does not exist.
    #[error(
        "access.teams.{team}: there is no user {name:?} on this computer; give a name that `getent passwd` \
         knows, or the user's number"
    )]
    UnknownUser {
        /// The team.
        team: &'static str,
        /// The user.
        name: String,
    },
    /// This user may not give files to the group.
    #[error(
        "access.group: this user is not in the group {0:?} and cannot give it anything; `sudo usermod \
         -aG {0} $(id -un)` and log in again, or run the group as a service with \
         SupplementaryGroups={0}"
    )]
    NotMember(String),
    /// The directories are unusable.
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// Another gateway is running.
    #[error("{0}: another gateway is listening there")]
    Taken(PathBuf),
    /// The operating system refused something.
    #[error("{path}: {action}: {source}")]
    System {
        /// The file.
        path: PathBuf,
        /// The attempted action.
        action: &'static str,
        /// The system's answer.
        source: std::io::Error,
    },
}

/// Id of the configured group of users, if this user may give files to it.
pub fn group_number(name: &str) -> Result<u32, PlaceError> {
    let group = users::group_number(name).map_err(|source| PlaceError::System {
        path: name.into(),
        action: "look up the group",
        source,
    })?;
    let group = group.ok_or_else(|| PlaceError::Unknown(name.into()))?;
    if !users::may_give_to(group) {
        return Err(PlaceError::NotMember(name.into()));
    }
    Ok(group)
}

/// Creates the directory in which the gateway will listen. Returns the outermost directory on the
/// path that is closed to the group, if there is one.
pub fn prepare(instance: &Instance, name: &str) -> Result<Option<PathBuf>, PlaceError> {
    let group = group_number(name)?;
    instance.create_gateway_directory(group)?;
    Ok(closed(&instance.gateway_directory(), group))
}

/// The outermost directory of a path that members of a group cannot pass through. Access control
/// lists, which may permit it, are not checked.
pub fn closed(path: &Path, group: u32) -> Option<PathBuf> {
    let ways: Vec<&Path> = path.ancestors().collect();
    let is_closed = |path: &&&Path| {
        fs::metadata(path).is_ok_and(|data| {
            let bit = if data.gid() == group { 0o010 } else { 0o001 };
            data.mode() & bit == 0
        })
    };
    ways.iter().rev().find(is_closed).map(|path| path.to_path_buf())
}

/// Message about a closed directory, with the remedy.
pub fn advice(closed: &Path, name: &str) -> String {
    format!(
        "access.group: users of the group {name:?} cannot pass through {}; set {} to a place where \
         they can, below /tmp say",
        closed.display(),
        client::instance::RUNTIME_DIR_VARIABLE
    )
}

/// Opens the socket, replacing one that a dead gateway left.
pub fn open(instance: &Instance, group: u32) -> Result<OwnedFd, PlaceError> {
    let path = instance.gateway_path();
    let system = |action| {
        let path = path.clone();
        move |error: Errno| PlaceError::System { path, action, source: error.into() }
    };
    let socket = || {
        let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
        socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None)
            .map_err(system("make a socket"))
    };
    let address = SocketAddrUnix::new(&path).map_err(system("name the socket"))?;
    // A dead gateway's socket refuses; a full one asks to try again.
    if matches!(connect(&socket()?, &address), Ok(()) | Err(Errno::AGAIN)) {
        return Err(PlaceError::Taken(path));
    }
    let io = |action| {
        let path = path.clone();
        move |source| PlaceError::System { path, action, source }
    };
    match fs::remove_file(&path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            return Err(io("remove the old socket")(error));
        }
        _ => {}
    }
    let socket = socket()?;
    bind(&socket, &address).map_err(system("bind"))?;
    // No client can connect before the socket listens.
    chown(&path, None, Some(group)).map_err(io("give to the group"))?;
    fs::set_permissions(&path, fs::Permissions::from_mode(0o660)).map_err(io("set the mode"))?;
    listen(&socket, BACKLOG).map_err(system("listen"))?;
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_that_cannot_be_admitted_are_refused_with_advice() {
        let unknown = group_number("no-such-group").unwrap_err().to_string();
        assert!(unknown.contains("access.group") && unknown.contains("groupadd"), "{unknown}");
        let not_member = PlaceError::NotMember("strategies".into()).to_string();
        assert!(not_member.contains("usermod -aG strategies"), "{not_member}");
        assert!(not_member.contains("SupplementaryGroups=strategies"), "{not_member}");
    }

    #[test]
    fn the_outermost_closed_directory_is_found() {
        let base = std::env::temp_dir().join(format!("tl-closed-{}", std::process::id()));
        let inner = base.join("a/b");
        fs::create_dir_all(&inner).unwrap();
        let set = |path: &Path, mode| {
            fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
        };
        let group = fs::metadata(&inner).unwrap().gid();
        for path in [&base, &base.join("a"), &inner] {
            set(path, 0o711);
        }
        assert_eq!(closed(&inner, group), None);
        set(&base.join("a"), 0o701);
        assert_eq!(closed(&inner, group), Some(base.join("a")));
        assert_eq!(closed(&inner, group + 1), None, "for others it is open");
        set(&base, 0o710);
        assert_eq!(closed(&inner, group + 1), Some(base.clone()));
        fs::remove_dir_all(&base).unwrap();
    }
}
