//! Upkeep of the runtime directory. A program or a user that tidies up `/tmp` may remove the lock, the
//! socket or the whole directory during a match. The match itself needs none of them, so it goes on, and
//! missing files are restored.

use super::control::Control;
use super::sys::{self, Call};
use client::instance::Instance;
use client::instance::lock::SupervisorLock;
use client::private;
use rustix::fs::{FlockOperation, flock};
use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::time::{Duration, Instant};

/// Time between two looks.
const ROUND: Duration = Duration::from_millis(250);

/// The lock, the socket for requests and the snapshot of the configuration.
pub struct Premises {
    instance: Instance,
    /// Content of the snapshot, for restoring it; `None` before there is one.
    config: Option<String>,
    lock: SupervisorLock,
    control: Option<Control>,
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
            config: None,
            lock,
            control: None,
            directory: None,
            looked: Instant::now(),
            restored: Vec::new(),
        }
    }

    /// The socket for requests, unless it could not be opened.
    pub fn control(&self) -> Option<&Control> {
        self.control.as_ref()
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
        let config_path = self.instance.config_path();
        match &self.config {
            None => self.config = fs::read_to_string(config_path).ok(),
            Some(config) if !config_path.exists() => {
                let write = || private::create_file(&config_path)?.write_all(config.as_bytes());
                sys::ask(Call::WriteConfig, write)?;
                self.restored.push("the configuration");
            }
            Some(_) => {}
        }
        if !self.control.as_ref().is_some_and(Control::is_reachable) {
            if self.control.take().is_some() {
                self.restored.push("the socket for requests");
            }
            self.control = Some(Control::open(&self.instance)?);
        }
        Ok(std::mem::take(&mut self.restored))
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
