//! Signals to the supervisor.
//!
//! SIGINT and SIGTERM end the group. SIGHUP means that the terminal is gone, which is no reason to end a
//! match; if it was ignored at the start (`nohup`), it stays ignored. SIGTTOU is ignored, since it would
//! stop a supervisor in the background for writing to its terminal.

use super::SupervisorError;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Receives signals as requests.
pub struct Signals {
    wake_up: UnixStream,
    stop: Arc<AtomicBool>,
    hang_up: Arc<AtomicBool>,
}

/// Requests since the last look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Asked {
    /// The group is to end.
    pub to_stop: bool,
    /// The terminal is gone.
    pub hung_up: bool,
}

impl Signals {
    /// Starts to receive signals.
    pub fn listen() -> Result<Self, SupervisorError> {
        let system = |source| SupervisorError::System { action: "handle signals".into(), source };
        let (wake_up, sender) = UnixStream::pair().map_err(system)?;
        wake_up.set_nonblocking(true).map_err(system)?;
        let (stop, hang_up) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        let on = |signal, flag: &Arc<AtomicBool>| {
            signal_hook::flag::register(signal, Arc::clone(flag))?;
            signal_hook::low_level::pipe::register(signal, sender.try_clone()?)?;
            io::Result::Ok(())
        };
        on(SIGINT, &stop).and_then(|()| on(SIGTERM, &stop)).map_err(system)?;
        if !is_ignored(SIGHUP) {
            on(SIGHUP, &hang_up).map_err(system)?;
        }
        ignore_writes_in_the_background();
        Ok(Self { wake_up, stop, hang_up })
    }

    /// Becomes readable when a signal comes.
    pub fn fd(&self) -> BorrowedFd<'_> {
        self.wake_up.as_fd()
    }

    /// Requests since the last call; a request to end the group stays set.
    pub fn take(&mut self) -> Asked {
        let mut bytes = [0; 64];
        while io::Read::read(&mut self.wake_up, &mut bytes).is_ok_and(|read| read > 0) {}
        Asked {
            to_stop: self.stop.load(Ordering::Relaxed),
            hung_up: self.hang_up.swap(false, Ordering::Relaxed),
        }
    }
}

/// Whether this process ignores a signal, as a process started by `nohup` does.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (signal - 1) & 1 == 1
}

#[allow(unsafe_code)] // neither `std` nor rustix nor signal-hook ignores a signal
fn ignore_writes_in_the_background() {
    // SAFETY: ignoring a signal runs no code of ours, and no other code handles this one.
    unsafe {
        libc::signal(libc::SIGTTOU, libc::SIG_IGN);
    }
}
