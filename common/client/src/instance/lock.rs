//! The supervisor's lock: the process that holds it supervises the group.
//!
//! The kernel releases the lock when its holder dies for any reason. But the lock belongs to a file,
//! and files get removed: a program that tidies up `/tmp` knows nothing of a match that has run for
//! days. Another process would then find no lock, or create a new one and take it. So the lock is two
//! files, one in the runtime directory and one in shared memory. A supervisor lives while either is
//! held; a process that holds both becomes the supervisor, and restores a file that was removed.

use super::{Instance, InstanceError, Namespace, io_error};
use crate::private;
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A lock that stays held for longer is held by a supervisor. A process that only queries it holds it
/// for an instant, and so does a process that a dying supervisor was just starting.
const PATIENCE: Duration = Duration::from_millis(500);
/// Time between two attempts to take it.
const RETRY: Duration = Duration::from_millis(2);
/// Name of the lock file, in both places.
pub const NAME: &str = "supervisor.lock";

/// The held lock of a group.
#[derive(Debug)]
pub struct SupervisorLock {
    held: Vec<Held>,
    namespace: Namespace,
}

#[derive(Debug)]
struct Held {
    path: PathBuf,
    file: File,
}

impl SupervisorLock {
    /// The group's names in shared memory.
    pub fn namespace(&self) -> &Namespace {
        &self.namespace
    }

    /// Recreates and takes lock files that were removed; returns whether any was missing. To be called
    /// regularly. The runtime directory must exist.
    pub fn restore(&mut self) -> io::Result<bool> {
        let mut restored = false;
        for held in &mut self.held {
            if !is_at(&held.file, &held.path) {
                let taken = take(&held.path, Duration::ZERO)?;
                held.file = taken.ok_or(io::ErrorKind::WouldBlock)?;
                restored = true;
            }
        }
        Ok(restored)
    }
}

impl Instance {
    /// Takes the supervisor's lock; `None` when a living supervisor holds it.
    pub fn lock(&self) -> Result<Option<SupervisorLock>, InstanceError> {
        let own = self.directory().join(NAME);
        let taken = match take(&own, PATIENCE) {
            // A supervisor that ends removes the directory together with the lock.
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                self.create_directory()?;
                take(&own, PATIENCE)
            }
            taken => taken,
        };
        let Some(file) = taken.map_err(io_error(&own))? else { return Ok(None) };
        let mut held = vec![Held { path: own, file }];
        let namespace = self.create_namespace()?;
        let path = namespace.lock_path();
        let Some(file) = take(&path, PATIENCE).map_err(io_error(&path))? else { return Ok(None) };
        held.push(Held { path, file });
        Ok(Some(SupervisorLock { held, namespace }))
    }

    /// Whether a supervisor is alive.
    pub fn is_supervised(&self) -> bool {
        places(self).iter().any(|path| {
            private::read_file(path).is_ok_and(|file| {
                flock(&file, FlockOperation::NonBlockingLockShared) == Err(Errno::WOULDBLOCK)
            })
        })
    }

    /// Process id of the holder of the lock, if there is one.
    pub fn supervisor_pid(&self) -> Option<u32> {
        if !self.is_supervised() {
            return None;
        }
        let read = |path: &PathBuf| fs::read_to_string(path).ok()?.trim().parse().ok();
        places(self).iter().find_map(read)
    }
}

/// Both lock files, as far as they exist.
fn places(instance: &Instance) -> Vec<PathBuf> {
    let namespace = instance.namespace().ok().flatten();
    let in_memory = namespace.map(|namespace| namespace.lock_path());
    [instance.directory().join(NAME)].into_iter().chain(in_memory).collect()
}

/// Takes the lock file; `None` if it stays locked for longer than `patience`.
fn take(path: &Path, patience: Duration) -> io::Result<Option<File>> {
    let deadline = Instant::now() + patience;
    loop {
        let mut file = private::open_file(path)?;
        match flock(&file, FlockOperation::NonBlockingLockExclusive) {
            // Its last holder may have removed it between the two calls.
            Ok(()) if is_at(&file, path) => {
                // The process id is also in the other file, and is optional: a full disk is no reason
                // to run without a supervisor.
                let _ = file.set_len(0).and_then(|()| writeln!(file, "{}", std::process::id()));
                return Ok(Some(file));
            }
            Ok(()) => continue,
            Err(Errno::WOULDBLOCK) if Instant::now() >= deadline => return Ok(None),
            Err(Errno::WOULDBLOCK) => std::thread::sleep(RETRY),
            Err(error) => return Err(error.into()),
        }
    }
}

/// Whether an open file still has this name.
pub(super) fn is_at(file: &File, path: &Path) -> bool {
    let identity = |data: fs::Metadata| (data.dev(), data.ino());
    match (file.metadata(), fs::symlink_metadata(path)) {
        (Ok(file), Ok(named)) => identity(file) == identity(named),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A separate instance for each test, removed at the end.
    struct Scratch(Instance);

    impl Scratch {
        fn new(name: &str) -> Self {
            let base = std::env::temp_dir().join(format!("tl-{name}-{}", std::process::id()));
            let instance = Instance::below(&base, "lock").unwrap();
            instance.create_directory().unwrap();
            Self(instance)
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = self.0.remove_directory();
        }
    }

    #[test]
    fn a_query_does_not_keep_a_supervisor_from_starting() {
        let scratch = Scratch::new("lock-asked");
        let instance = &scratch.0;
        drop(instance.lock().unwrap());
        let asking: Vec<File> =
            places(instance).iter().map(|path| private::read_file(path).unwrap()).collect();
        for file in &asking {
            flock(file, FlockOperation::NonBlockingLockShared).unwrap();
        }
        let asks = std::thread::spawn(move || {
            std::thread::sleep(PATIENCE / 10);
            drop(asking);
        });
        let lock = instance.lock().unwrap();
        assert!(lock.is_some());
        asks.join().unwrap();
        assert!(instance.lock().unwrap().is_none(), "held by a supervisor");
        assert_eq!(instance.supervisor_pid(), Some(std::process::id()));
        drop(lock);
        assert_eq!(instance.supervisor_pid(), None, "the number is still in the files");
    }

    #[test]
    fn a_removed_lock_file_still_counts_as_held_and_is_restored() {
        let scratch = Scratch::new("lock-removed");
        let instance = &scratch.0;
        let mut lock = instance.lock().unwrap().unwrap();
        assert!(!lock.restore().unwrap(), "nothing is missing");
        for path in places(instance) {
            fs::remove_file(&path).unwrap();
            assert!(instance.is_supervised(), "without {}", path.display());
            assert!(instance.lock().unwrap().is_none(), "a second one, without {}", path.display());
            assert!(lock.restore().unwrap());
            assert!(is_at(&lock.held[0].file, &places(instance)[0]));
            assert!(is_at(&lock.held[1].file, &places(instance)[1]));
        }
        fs::remove_dir_all(instance.directory()).unwrap();
        assert!(instance.is_supervised());
        assert!(lock.restore().is_err(), "its directory is gone");
        instance.create_directory().unwrap();
        assert!(instance.lock().unwrap().is_none(), "a second one, without the directory");
        assert!(lock.restore().unwrap());
        drop(lock);
        assert!(!instance.is_supervised());
    }
}
