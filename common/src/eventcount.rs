//! Sleeping until something is published: an event count, after Reed and Kanodia, *Synchronization
//! with eventcounts and sequencers* (1979), in shared memory.
//!
//! A writer counts what it publishes; a reader that finds nothing sleeps in the kernel until the
//! count is no longer the one it has seen. That costs a writer one system call however many
//! processes read, and less than a microsecond if none of them sleeps; a process that only keeps
//! itself ready costs nothing at all. A reader needs no registration, so one that takes over can
//! sleep at once, and one that dies leaves nothing behind.

use crate::shared_page::SharedPage;
use rustix::thread::{Timespec, futex};
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// A number in shared memory that only rises (and begins again at 0 after the highest), and on which
/// processes can sleep.
pub struct EventCount {
    count: SharedPage<AtomicU32>,
}

impl EventCount {
    /// Opens the count in a file in memory (below `/dev/shm`), which is made if there is none.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(Self { count: SharedPage::open(path)? })
    }

    /// The present count.
    pub fn read(&self) -> u32 {
        self.count.get().load(Ordering::Acquire)
    }

    /// Counts up and wakes all who sleep.
    pub fn advance(&self) {
        self.count.get().fetch_add(1, Ordering::Release);
        // Cannot fail for an address that is mapped.
        let _ = futex::wake(self.count.get(), futex::Flags::empty(), i32::MAX as u32);
    }

    /// Sleeps while the count is still `seen`: until it advances, for at most `timeout`, or until
    /// a signal comes. Why it has returned, the caller reads off the count.
    pub fn sleep(&self, seen: u32, timeout: Duration) {
        let timeout =
            Timespec { tv_sec: timeout.as_secs() as _, tv_nsec: timeout.subsec_nanos().into() };
        // Its errors are: too late, timeout, signal.
        let _ = futex::wait(self.count.get(), futex::Flags::empty(), seen, Some(&timeout));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::PathBuf;
    use std::time::Instant;

    struct File(PathBuf);

    impl File {
        fn new(name: &str) -> Self {
            Self(format!("/dev/shm/tl-test-{name}-{}", std::process::id()).into())
        }
    }

    impl Drop for File {
        fn drop(&mut self) {
            let _ = std::fs::remove_file(&self.0);
        }
    }

    #[test]
    fn whoever_opens_it_sees_the_same_count() {
        let file = File::new("same");
        let (writer, reader) =
            (EventCount::open(&file.0).unwrap(), EventCount::open(&file.0).unwrap());
        assert_eq!(reader.read(), 0);
        writer.advance();
        assert_eq!(reader.read(), 1);
        drop(writer);
        assert_eq!(EventCount::open(&file.0).unwrap().read(), 1, "opening does not reset it");
    }

    #[test]
    fn an_advance_wakes_everybody_and_one_before_the_sleep_is_not_lost() {
        const SLEEPERS: u32 = 3;
        let file = File::new("wake");
        let writer = EventCount::open(&file.0).unwrap();
        std::thread::scope(|scope| {
            for _ in 0..SLEEPERS {
                scope.spawn(|| {
                    let reader = EventCount::open(&file.0).unwrap();
                    let started = Instant::now();
                    // Whether this happens before the advance or after it must not matter.
                    while reader.read() == 0 {
                        reader.sleep(0, Duration::from_secs(60));
                    }
                    assert!(started.elapsed() < Duration::from_secs(30), "slept through it");
                });
            }
            writer.advance();
        });
    }

    #[test]
    fn a_sleep_ends_by_itself() {
        let file = File::new("timeout");
        let count = EventCount::open(&file.0).unwrap();
        count.sleep(0, Duration::from_millis(1));
        count.sleep(7, Duration::from_secs(3600));
        assert_eq!(count.read(), 0);
    }
}
