//! Whether the clock of this computer is synchronised. Receivers compare our times with their own.

/// Whether something keeps the clock right (chrony, systemd-timesyncd, PTP), as it has told the kernel; also if
/// the kernel does not say.
#[allow(unsafe_code)] // neither `std` nor rustix asks the kernel
pub fn is_synchronised() -> bool {
    // SAFETY: a `timex` is made of numbers, for which zeros are valid.
    let mut state: libc::timex = unsafe { std::mem::zeroed() };
    // SAFETY: the kernel only writes into the structure; with `modes` 0 it changes nothing.
    let answer = unsafe { libc::adjtimex(&mut state) };
    answer < 0 || state.status & libc::STA_UNSYNC == 0
}
