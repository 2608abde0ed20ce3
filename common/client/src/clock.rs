//! The two clocks: monotonic for intervals and message stamps, wall for reports.

use rustix::time::{ClockId, clock_gettime};

/// Nanoseconds of the monotonic clock; comparable between all processes of this machine until it
/// restarts.
pub fn monotonic_ns() -> u64 {
    nanoseconds(ClockId::Monotonic)
}

/// Nanoseconds since 1970 on the wall clock, which may jump.
pub fn wall_ns() -> u64 {
    nanoseconds(ClockId::Realtime)
}

fn nanoseconds(clock: ClockId) -> u64 {
    let time = clock_gettime(clock);
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}
