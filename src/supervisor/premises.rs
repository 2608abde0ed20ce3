//! Upkeep of the runtime directory. A program or a user that tidies up `/tmp` may remove the lock, the
//! socket or the whole directory during a match. The match itself needs none of them, so it goes on, and
//! missing files are restored.

use super::requests::RequestSocket;
use super::sys::{self, Call};
use client::instance::Instance;
use client::instance::lock::SupervisorLock;
use client::private;
use rustix::fs::{FlockOperation, flock};
use std::collections::BTreeMap;
use std::fs::{self, DirBuilder, File};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Time between two looks.
const ROUND: Duration = Duration::from_millis(250);

/// The lock, the socket for requests, and the accepted configurations.
pub struct Premises {
    instance: Instance,
    /// The accepted configurations as they are on disk, for restoring them; empty before there is one.
    configurations: BTreeMap<PathBuf, String>,
    lock: SupervisorLock,
    control: Option<RequestSocket>,
    /// Held open and locked: `systemd-tmpfiles` leaves a locked directory alone.
    directory: Option<File>,
    looked: Instant,
    /// Files restored so far, while others could not be.
    restored: Vec<&'static str>,
}

impl Premises {
    /// Takes ownership of the held lock.
    pub fn new(instance: &Instance, lock: SupervisorLock) -> Self {
        Self {
            instance: instance.clone(),
            configurations: BTreeMap::new(),
            lock,
            control: None,
            directory: None,
            looked: Instant::now(),
            restored: Vec::new(),
        }
    }

    /// The socket for requests, unless it could not be opened.
    pub fn control(&self) -> Option<&RequestSocket> {
        self.control.as_ref()
    }

    /// Looks again at the accepted configurations on disk, which are restored when they are missing.
    pub fn configuration_has_changed(&mut self) {
        let numbered = fs::read_dir(self.instance.revisions_directory()).into_iter().flatten();
        let numbered = numbered.flatten().map(|entry| entry.path());
        let paths = numbered.chain([self.instance.config_path()]);
        let text_of = |path: PathBuf| Some((path.clone(), fs::read_to_string(path).ok()?));
        let found: BTreeMap<_, _> = paths.filter_map(text_of).collect();
        if found.contains_key(&self.instance.config_path()) {
            self.configurations = found;
        }
    }

    /// Whether a look is due.
    pub fn is_due(&self) -> bool {
        self.looked.elapsed() >= ROUND
    }

    /// Opens the socket and restores missing files. Returns their names once none is missing any
    /// more.
    pub fn restore(&mut self) -> io::Result<Vec<&'static str>> {
        self.looked = Instant::now();
        if !self.directory.as_ref().is_some_and(|held| is_at(held, &self.instance)) {
            let make = || {
                self.instance.create_directory().map_err(io::Error::other)?;
                File::open(self.instance.directory())
            };
            let directory = sys::ask(Call::MakeDirectory, make)?;
            let _ = flock(&directory, FlockOperation::NonBlockingLockShared);
            if self.directory.replace(directory).is_some() {
                self.restored.push("the directory");
            }
        }
        let namespace = self.lock.namespace();
        if sys::ask(Call::RestoreNamespace, || self.instance.restore_namespace(namespace))? {
            self.restored.push("the note of its place in shared memory");
        }
        if sys::ask(Call::TakeLock, || self.lock.restore())? {
            self.restored.push("the lock");
        }
        if self.configurations.is_empty() {
            self.configuration_has_changed();
        }
        let missing: Vec<_> =
            self.configurations.iter().filter(|(path, _)| !path.exists()).collect();
        if !missing.is_empty() {
            let write = || {
                make_private_directory(&self.instance.revisions_directory())?;
                missing.iter().try_for_each(|(path, text)| {
                    private::create_file(path)?.write_all(text.as_bytes())
                })
            };
            sys::ask(Call::WriteConfig, write)?;
            self.restored.push("the configuration");
        }
        if !self.control.as_ref().is_some_and(RequestSocket::is_reachable) {
            if self.control.take().is_some() {
                self.restored.push("the socket for requests");
            }
            self.control = Some(RequestSocket::open(&self.instance)?);
        }
        Ok(std::mem::take(&mut self.restored))
    }
}

/// Makes a directory that only this user can read, unless there is one.
pub fn make_private_directory(path: &Path) -> io::Result<()> {
    match DirBuilder::new().mode(0o700).create(path) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(error),
        _ => Ok(()),
    }
}

fn is_at(held: &File, instance: &Instance) -> bool {
    match (held.metadata(), fs::symlink_metadata(instance.directory())) {
        (Ok(held), Ok(named)) => (held.dev(), held.ino()) == (named.dev(), named.ino()),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn removed_files_are_restored() {
        let base = std::env::temp_dir().join(format!("tl-premises-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        let lock = instance.lock().unwrap().unwrap();
        fs::write(instance.config_path(), "# a comment").unwrap();
        let mut premises = Premises::new(&instance, lock);
        assert_eq!(premises.restore().unwrap(), Vec::<&str>::new(), "nothing was missing");
        assert!(premises.control().is_some());

        for (path, what) in [
            (instance.directory().join("supervisor.lock"), "the lock"),
            (instance.directory().join("memory"), "the note of its place in shared memory"),
            (instance.config_path(), "the configuration"),
            (instance.control_path(), "the socket for requests"),
        ] {
            fs::remove_file(&path).unwrap();
            assert_eq!(premises.restore().unwrap(), [what]);
            assert!(path.exists());
        }
        fs::remove_dir_all(instance.directory()).unwrap();
        assert_eq!(premises.restore().unwrap().len(), 5);
        assert_eq!(fs::read_to_string(instance.config_path()).unwrap(), "# a comment");
        assert!(instance.lock().unwrap().is_none(), "a second supervisor");
        assert_eq!(premises.restore().unwrap(), Vec::<&str>::new());
        drop(premises);
        instance.remove_directory().unwrap();
    }
}
