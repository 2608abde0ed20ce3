//! Closing file descriptors in started programs.
//!
//! iceoryx2 opens its files and shared memory without the close-on-exec flag. Without this module a
//! stage would inherit everything its supervisor had open: the memory of processes that died long ago
//! would stay allocated, and the number of a stage's descriptors would depend on when it was started.

/// Marks every descriptor of this process except the three standard ones as close-on-exec; they stay
/// open here. To be called just before a program is started: descriptors opened later are not marked.
///
/// Linux before 5.11 does not support it; there the started program keeps what it inherits.
pub fn keep_from_programs_run_now() {
    const FIRST: libc::c_uint = libc::STDERR_FILENO as libc::c_uint + 1;
    // SAFETY: with this flag the call closes nothing and touches no memory; it sets a flag of
    // descriptors that matters only at `exec`. Called by number, because the C library has the function
    // only from glibc 2.34 on.
    #[allow(unsafe_code)] // neither `std` nor rustix marks a whole range at once
    unsafe {
        libc::syscall(libc::SYS_close_range, FIRST, libc::c_uint::MAX, libc::CLOSE_RANGE_CLOEXEC);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::fd::AsRawFd;
    use rustix::io::{FdFlags, fcntl_setfd};
    use std::fs::File;
    use std::process::Command;

    /// Whether a program started from this one has the descriptor with this number.
    fn inherited(descriptor: i32) -> bool {
        let path = format!("/proc/self/fd/{descriptor}");
        Command::new("test").args(["-e", &path]).status().expect("test can be run").success()
    }

    #[test]
    fn programs_do_not_inherit_what_was_open() {
        let file = File::open("/dev/null").expect("a file");
        fcntl_setfd(&file, FdFlags::empty()).expect("can be inherited now");
        assert!(inherited(file.as_raw_fd()));
        keep_from_programs_run_now();
        assert!(!inherited(file.as_raw_fd()));
        assert!(file.metadata().is_ok(), "still open here");
    }
}
