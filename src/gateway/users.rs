//! Users and groups of users, as the system knows them.

use std::ffi::{CString, c_char, c_int};
use std::io;
use std::mem::MaybeUninit;
use std::ptr;

/// Largest buffer for an entry; no group or user has a larger one.
const MOST_BYTES: usize = 1 << 24;

/// Id of a group of users; `None` if it does not exist. Asks the configured name services:
/// `/etc/group`, or a directory service.
pub fn group_number(name: &str) -> io::Result<Option<u32>> {
    look_up(name, libc::getgrnam_r, |entry: &libc::group| entry.gr_gid)
}

/// Id of a user; `None` if it does not exist.
pub fn user_number(name: &str) -> io::Result<Option<u32>> {
    look_up(name, libc::getpwnam_r, |entry: &libc::passwd| entry.pw_uid)
}

/// A system function that fills in the entry of a name, with its texts in the caller's buffer. It
/// returns a null pointer instead of the entry if there is none.
type LookUp<Entry> = unsafe extern "C" fn(
    name: *const c_char,
    entry: *mut Entry,
    texts: *mut c_char,
    texts_bytes: usize,
    found: *mut *mut Entry,
) -> c_int;

#[allow(unsafe_code)] // there is no safe way to the system's name services
fn look_up<Entry>(
    name: &str,
    ask: LookUp<Entry>,
    number: impl Fn(&Entry) -> u32,
) -> io::Result<Option<u32>> {
    let Ok(name) = CString::new(name) else { return Ok(None) };
    let mut texts: Vec<c_char> = vec![0; 1024];
    loop {
        let mut entry = MaybeUninit::<Entry>::uninit();
        let mut found = ptr::null_mut();
        // SAFETY: the name ends with a zero; `entry` and `texts` are ours, as large as said, and
        // outlive the call, which writes to nothing else but `found`.
        let status = unsafe {
            ask(name.as_ptr(), entry.as_mut_ptr(), texts.as_mut_ptr(), texts.len(), &mut found)
        };
        match status {
            0 if found.is_null() => return Ok(None),
            // SAFETY: the entry was found, so it is filled in. Its id is a plain field.
            0 => return Ok(Some(number(unsafe { entry.assume_init_ref() }))),
            libc::ERANGE if texts.len() < MOST_BYTES => texts.resize(texts.len() * 4, 0),
            // Errors of name services for an unknown name.
            libc::ENOENT | libc::ESRCH | libc::EBADF | libc::EPERM => return Ok(None),
            error => return Err(io::Error::from_raw_os_error(error)),
        }
    }
}

/// Whether this process may give files to a group: its user is in it, or is the superuser.
pub fn may_give_to(group: u32) -> bool {
    let groups = rustix::process::getgroups().unwrap_or_default();
    rustix::process::geteuid().is_root()
        || rustix::process::getegid().as_raw() == group
        || groups.iter().any(|gid| gid.as_raw() == group)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_system_is_asked() {
        assert_eq!(group_number("root").unwrap(), Some(0));
        assert_eq!(user_number("root").unwrap(), Some(0));
        assert_eq!(user_number("no-such-user-at-all").unwrap(), None);
        assert_eq!(group_number("no-such-group-at-all").unwrap(), None);
        assert_eq!(group_number("with\0zero").unwrap(), None);
        assert!(may_give_to(rustix::process::getegid().as_raw()));
    }
}
