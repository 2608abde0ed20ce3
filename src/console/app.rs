//! What the tasks that serve clients share.

use super::access::Policy;
use super::desk::Desk;
use super::recording::Recordings;
use super::viewers::Viewers;
use client::instance::Instance;
use config::ConsoleConfig;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::Semaphore;

/// Most web sockets of clients that may change something, and of those that only watch: spectators cannot keep
/// the owner out.
const SOCKETS: usize = 32;
const WATCHING_SOCKETS: usize = 48;
/// Most jobs of the set-up that wait.
const WAITING_JOBS: usize = 8;

/// The group, and who may do what.
pub struct App {
    /// The group.
    pub instance: Instance,
    /// Where the newest of every topic lies.
    pub desk: Arc<Desk>,
    /// Who may do what.
    pub policy: Policy,
    /// Free web sockets for those that may change something.
    pub sockets: Arc<Semaphore>,
    /// Free web sockets for spectators.
    pub watching_sockets: Arc<Semaphore>,
    /// Free jobs of the set-up: one at a time.
    pub jobs: Semaphore,
    /// Free places of jobs that wait for their turn.
    pub waiting_jobs: Semaphore,
    /// Held by the request that changes something: one at a time.
    pub changes: tokio::sync::Mutex<()>,
    /// The recording that was started here.
    pub recordings: Recordings,
    /// Recordings that are looked at.
    pub viewers: Viewers,
    /// Directories whose recordings may be looked at, besides the console's own.
    pub recording_directories: Vec<PathBuf>,
    /// Free exports: one at a time.
    pub exports: Arc<Semaphore>,
    /// The file that a group without a file was saved to.
    saved_to: Mutex<Option<PathBuf>>,
}

impl App {
    /// The group's console at this place.
    pub fn new(instance: &Instance, place: super::Place, config: &ConsoleConfig) -> Self {
        let owner = rustix::process::getuid().as_raw();
        Self {
            instance: instance.clone(),
            desk: Arc::new(Desk::new()),
            policy: Policy { place, allow_hosts: config.allow_hosts.clone(), owner },
            sockets: Arc::new(Semaphore::new(SOCKETS)),
            watching_sockets: Arc::new(Semaphore::new(WATCHING_SOCKETS)),
            jobs: Semaphore::new(1),
            waiting_jobs: Semaphore::new(WAITING_JOBS),
            changes: tokio::sync::Mutex::new(()),
            recordings: Recordings::new(instance),
            viewers: Viewers::new(instance),
            recording_directories: config.recordings.iter().map(PathBuf::from).collect(),
            exports: Arc::new(Semaphore::new(1)),
            saved_to: Mutex::default(),
        }
    }

    /// The file that a group without a file was saved to last.
    pub fn saved_to(&self) -> Option<PathBuf> {
        self.saved_to.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// From now on the group is saved to this file, if it has none of its own.
    pub fn save_to(&self, path: &Path) {
        *self.saved_to.lock().unwrap_or_else(PoisonError::into_inner) = Some(path.into());
    }
}
