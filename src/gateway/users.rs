//! Groups of users, as the system knows them.

use std::ffi::{CString, c_char};
use std::io;
use std::mem::MaybeUninit;
use std::ptr;

/// No group has so many members that its entry would not fit.
const MOST_BYTES: usize = 1 << 24;

/// The system's number for a group of users; `None` when there is none of that name. Asks whatever the
/// system is set up to ask: `/etc/group`, or a directory service.
#[allow(unsafe_code)] // there is no safe way to the system's name services
pub fn group_number(name: &str) -> io::Result<Option<u32>> {
    let Ok(name) = CString::new(name) else { return Ok(None) };
    let mut texts: Vec<c_char> = vec![0; 1024];
    loop {
        let mut entry = MaybeUninit::<libc::group>::uninit();
        let mut found = ptr::null_mut();
        // SAFETY: the name ends with a zero; `entry` and `texts` are ours, as large as said, and
        // outlive the call, which writes to nothing else but `found`.
        let status = unsafe {
            libc::getgrnam_r(
                name.as_ptr(),
                entry.as_mut_ptr(),
                texts.as_mut_ptr(),
                texts.len(),
                &mut found,
            )
        };
        match status {
            0 if found.is_null() => return Ok(None),
            // SAFETY: where something was found the entry was filled in. Its number is a plain field.
            0 => return Ok(Some(unsafe { entry.assume_init() }.gr_gid)),
            libc::ERANGE if texts.len() < MOST_BYTES => texts.resize(texts.len() * 4, 0),
            // What name services say of a name that they do not have.
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
        assert_eq!(group_number("no-such-group-at-all").unwrap(), None);
        assert_eq!(group_number("with\0zero").unwrap(), None);
        assert!(may_give_to(rustix::process::getegid().as_raw()));
    }
}
