//! Sleeping until something is published: an event count in shared memory, after Reed and Kanodia,
//! *Synchronization with eventcounts and sequencers* (1979).
//!
//! A reader reads the count and looks for messages. If there are none, it sleeps until the count differs
//! from the value it has read. A writer publishes first, and then advances the count and wakes all sleepers:
//!
//! ```text
//! reader: seen = count; look for messages; if none: futex_wait(count, seen)
//! writer: publish; count += 1; futex_wake(count)
//! ```
//!
//! An advance between the reader's look and its sleep changes the count, so the kernel does not let it
//! sleep, and no message is missed.
//!
//! The cost to a writer is one system call however many processes read, and less than a microsecond if
//! none of them sleeps. A spare that only stands by costs nothing. A reader needs no registration, so a
//! successor can sleep at once, and a dead reader leaves nothing behind.

use crate::shared_page::SharedPage;
use rustix::thread::{Timespec, futex};
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// A number in shared memory that only rises (and wraps to 0), and on which processes can sleep.
pub struct EventCount {
    count: SharedPage<AtomicU32>,
}

impl EventCount {
    /// Opens the count in a file below `/dev/shm`, and creates the file if there is none.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(Self { count: SharedPage::open(path)? })
    }

    /// The present count.
    pub fn read(&self) -> u32 {
        self.count.get().load(Ordering::Acquire)
    }

    /// Advances the count and wakes all sleepers.
    pub fn advance(&self) {
        self.count.get().fetch_add(1, Ordering::Release);
        // Cannot fail for an address that is mapped.
        let _ = futex::wake(self.count.get(), futex::Flags::empty(), i32::MAX as u32);
    }

    /// Sleeps while the count is still `seen`: until it advances, for at most `timeout`, or until a
    /// signal comes. The caller reads the count to find out which.
    pub fn sleep(&self, seen: u32, timeout: Duration) {
        let timeout =
            Timespec { tv_sec: timeout.as_secs() as _, tv_nsec: timeout.subsec_nanos().into() };
        // Possible errors: the count has changed already (EAGAIN), timeout, signal.
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
    fn every_process_sees_the_same_count() {
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
    fn an_advance_wakes_all_sleepers_and_one_before_the_sleep_is_not_lost() {
        const SLEEPERS: u32 = 3;
        let file = File::new("wake");
        let writer = EventCount::open(&file.0).unwrap();
        std::thread::scope(|scope| {
            for _ in 0..SLEEPERS {
                scope.spawn(|| {
                    let reader = EventCount::open(&file.0).unwrap();
                    let started = Instant::now();
                    // The result must not depend on whether this happens before the advance or after
                    // it.
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
