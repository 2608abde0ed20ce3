//! The roster: the iceoryx2 nodes that belong to processes of the group.
//!
//! Every program of the same user can publish on a topic, and the commonest bug of such a program is a
//! message on the wrong topic, for example a copy of the newest header with another number. Its content
//! cannot be told from that of a good message. But iceoryx2 stores the publishing node beside each
//! message, and a process of the group enters its node in the roster before it publishes anything. A
//! reader accepts a message if its node is on the roster ([`Subscriber`](crate::bus::Subscriber)).
//!
//! The roster is a page of shared memory: a counter and 511 keys of 64 bits, written without locks. To
//! enter a node, a process takes the next slot (`made.fetch_add(1) % 511`) and stores its key there
//! with a compare-and-exchange if the slot is empty or its process has ended; otherwise it tries the
//! next slot. After a whole round of living processes one of them is overwritten. To look a node up, a
//! reader scans the used slots. The page outlives spares, hand-overs and the supervisor. Messages of a
//! dead process stay trusted, since its successor and its readers still work through them; its entry is
//! overwritten only when the page is full.

use crate::instance::Instance;
use crate::shared_page::{Shareable, SharedPage};
use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::prelude::ipc;
use rustix::process::{Pid, test_kill_process};
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};

/// Entries that fit into the page besides the counter.
const ENTRIES: usize = 511;

/// Layout of the page.
#[repr(C)]
struct Entries {
    /// Entries made so far; the next one goes to this slot, modulo [`ENTRIES`].
    made: AtomicU64,
    /// [`NodeKey`]s; 0 in an empty slot.
    keys: [AtomicU64; ENTRIES],
}

const _: () = assert!(size_of::<Entries>() == 4096);

// SAFETY: atomic numbers only, exactly one page.
#[allow(unsafe_code)]
unsafe impl Shareable for Entries {}

/// A node as one number, which is read and written atomically: process id in the upper half, digest of
/// the time at which it joined in the lower.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeKey(u64);

impl NodeKey {
    /// The key of a node.
    pub fn of(node: &UniqueNodeId) -> Self {
        let pid = node.pid::<ipc::Service>().map_or(0, |pid| pid.value() as u32);
        let id = node.value();
        let [a, b, c, d] = [id, id >> 32, id >> 64, id >> 96].map(|part| part as u32);
        let digest = (a.rotate_left(30) ^ b ^ d.rotate_left(16)).wrapping_add(c);
        Self::new(pid, digest)
    }

    /// The key of a node made by this process; the digest distinguishes its nodes.
    pub fn new(pid: u32, digest: u32) -> Self {
        Self(u64::from(pid) << 32 | u64::from(digest))
    }

    /// Process id.
    pub fn pid(self) -> u32 {
        (self.0 >> 32) as u32
    }
}

/// The roster of an instance.
pub struct Roster {
    page: SharedPage<Entries>,
}

impl Roster {
    /// Opens the roster of an instance, and creates it if there is none.
    pub fn open(instance: &Instance) -> io::Result<Self> {
        let namespace = instance.create_namespace().map_err(io::Error::other)?;
        Ok(Self { page: SharedPage::open(&namespace.roster_path())? })
    }

    /// Enters a node; its messages are trusted from now on.
    pub fn enter(&self, node: NodeKey) {
        if self.has(node) {
            return;
        }
        let Entries { made, keys } = self.page.get();
        for attempt in 0.. {
            let place = &keys[made.fetch_add(1, Ordering::Relaxed) as usize % ENTRIES];
            let before = place.load(Ordering::Relaxed);
            // After a whole round of living processes one of them is overwritten.
            let is_free = before == 0 || attempt >= ENTRIES || !is_alive(NodeKey(before).pid());
            if is_free
                && place
                    .compare_exchange(before, node.0, Ordering::Release, Ordering::Relaxed)
                    .is_ok()
            {
                return;
            }
        }
    }

    /// Whether a node has been entered.
    pub fn has(&self, node: NodeKey) -> bool {
        let Entries { made, keys } = self.page.get();
        let used = (made.load(Ordering::Acquire) as usize).min(ENTRIES);
        // 0 marks an empty slot.
        node.0 != 0 && keys[..used].iter().any(|key| key.load(Ordering::Acquire) == node.0)
    }
}

fn is_alive(pid: u32) -> bool {
    Pid::from_raw(pid as i32).is_some_and(|pid| test_kill_process(pid).is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A process id above the system's highest.
    const NO_PID: u64 = 1 << 30;

    struct Place(Instance, std::path::PathBuf);

    impl Place {
        fn new(name: &str) -> Self {
            let base = std::env::temp_dir().join(format!("tl-{name}-{}", std::process::id()));
            let instance = Instance::below(&base, "roster").unwrap();
            instance.create_directory().unwrap();
            Self(instance, base)
        }
    }

    impl Drop for Place {
        fn drop(&mut self) {
            let _ = self.0.remove_namespace();
            let _ = std::fs::remove_dir_all(&self.1);
        }
    }

    #[test]
    fn every_process_sees_a_node_that_was_entered_and_no_other() {
        let place = Place::new("roster-known");
        let (one, other) = (Roster::open(&place.0).unwrap(), Roster::open(&place.0).unwrap());
        let key = NodeKey(u64::from(std::process::id()) << 32 | 7);
        assert!(!other.has(key) && !other.has(NodeKey(0)));
        one.enter(key);
        one.enter(key);
        assert!(other.has(key) && key.pid() == std::process::id());
        assert!(!other.has(NodeKey(key.0 + 1)), "another node of the same process");
        assert_eq!(other.page.get().made.load(Ordering::Relaxed), 1, "entered once");
    }

    #[test]
    fn the_living_stay_however_many_die() {
        let place = Place::new("roster-full");
        let roster = Roster::open(&place.0).unwrap();
        let living = NodeKey(u64::from(std::process::id()) << 32 | 7);
        roster.enter(living);
        for number in 0..3 * ENTRIES as u64 {
            let dead = NodeKey((NO_PID + number) << 32 | 9);
            roster.enter(dead);
            assert!(roster.has(dead) && roster.has(living), "{number}");
        }
    }

    #[test]
    fn a_page_full_of_the_living_takes_one_more() {
        let place = Place::new("roster-crowd");
        let roster = Roster::open(&place.0).unwrap();
        for number in 1..=ENTRIES as u64 + 1 {
            let key = NodeKey(u64::from(std::process::id()) << 32 | number);
            roster.enter(key);
            assert!(roster.has(key), "{number}");
        }
    }
}
