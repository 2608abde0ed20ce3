//! The supervisor: starts the group, watches it, replaces what fails, and cleans up at the end.
//!
//! [`policy`] decides, [`children`] does, [`progress`] looks, [`starvation`] sees who gets no
//! processor, [`control`] listens to requests, [`takeover`] deals with what an earlier supervisor has
//! left, of which [`record`] tells, [`evidence`] keeps what a bug report needs, [`drops`] tells which input
//! was dropped and why, [`janitor`] removes what the dead leave, [`gateway`] lets other users in;
//! [`group`] ties them together while a group lives, and this file is its beginning and
//! its end.

mod children;
mod control;
mod drops;
mod evidence;
mod gateway;
mod group;
mod janitor;
mod notify;
mod policy;
mod progress;
mod record;
mod starvation;
mod takeover;

pub use children::{Launch, is_same_program, program_of};
pub use control::{Request, ask};
pub use evidence::directory as evidence_directory;
pub use record::Record;

use crate::gateway::place::PlaceError;
use crate::monitor::{GroupView, Monitor, Report};
use common::bus::BusError;
use common::config::Config;
use common::instance::InstanceError;
use gateway::Gateway;
use group::{Ending, Group};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use takeover::Inheritance;

/// Why a group could not be run.
#[derive(Debug, thiserror::Error)]
pub enum SupervisorError {
    /// Shared memory.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Runtime directory.
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// Other users cannot be let in.
    #[error(transparent)]
    Access(#[from] PlaceError),
    /// Somebody else supervises it.
    #[error(
        "the group {0:?} is running already; look at it with `touchline status --instance {0}`, end \
         it with `touchline stop --instance {0}`, or give this one another name with --instance"
    )]
    AlreadyRunning(String),
    /// Stages of a dead supervisor that do not go away.
    #[error("processes {0:?} of an earlier group {1:?} do not end; end them by hand")]
    Undead(Vec<u32>, String),
    /// The operating system.
    #[error("{action}: {source}")]
    System {
        /// What was tried.
        action: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// There is not enough shared memory for a match.
    #[error(
        "a match with these pictures takes about {} MB of shared memory, but {} MB are free; {}",
        needed >> 20,
        free >> 20,
        common::memory::advice(*ample)
    )]
    NoMemory {
        /// Bytes without which it cannot begin.
        needed: u64,
        /// Bytes with which it is safe.
        ample: u64,
        /// Bytes that are free.
        free: u64,
    },
    /// A stage keeps failing at the start of the run.
    #[error("the {stage} does not start: {reason}")]
    NoStart {
        /// Which.
        stage: &'static str,
        /// What it said last.
        reason: String,
    },
}

/// How long processes have to end in order before they are killed.
const GRACE: Duration = Duration::from_secs(2);

/// How long a group runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Until {
    /// Somebody ends it.
    Stopped,
    /// The grabber has captured its frames, and their results are out.
    Finished,
}

/// How a group's supervisor has come to its end.
pub enum Outcome {
    /// With the group; this is what the run was like.
    Ended(Box<Report>),
    /// The group goes on, and this program is to take it over.
    Upgrade(PathBuf),
}

/// Runs the group. When it has ended nothing of it is left, neither a process nor shared memory.
pub fn run(
    launch: Launch,
    config: &Config,
    until: Until,
    start_monitor: impl FnOnce(Arc<GroupView>) -> Result<Monitor, BusError>,
) -> Result<Outcome, SupervisorError> {
    let instance = launch.instance.clone();
    instance.create_directory()?;
    let Some(lock) = instance.lock()? else {
        return Err(SupervisorError::AlreadyRunning(instance.name().into()));
    };
    let stop = stop_signals()?;
    let outcome = takeover::prepare(&launch, config)
        .and_then(|inheritance| supervise(launch, config, until, stop, inheritance, start_monitor));
    if matches!(outcome, Ok(Outcome::Upgrade(_))) {
        return outcome;
    }
    // Also after an error, which is of more interest than that something was left behind.
    let tidied = takeover::tidy_up(&instance);
    drop(lock);
    outcome.and_then(|outcome| tidied.map(|()| outcome))
}

fn supervise(
    launch: Launch,
    config: &Config,
    until: Until,
    stop: UnixStream,
    inheritance: Inheritance,
    start_monitor: impl FnOnce(Arc<GroupView>) -> Result<Monitor, BusError>,
) -> Result<Outcome, SupervisorError> {
    let view = Arc::new(GroupView::new(std::process::id()));
    let gateway = match Gateway::prepare(&launch.instance, config) {
        // A match that goes on is worth more than those who cannot watch it.
        Err(error) if !inheritance.stages.is_empty() => {
            common::tell!("touchline: {error}; nobody but the owner can attach");
            None
        }
        prepared => prepared?,
    };
    let mut group =
        Group::new(launch, config, Arc::clone(&view), stop, inheritance.record, gateway)?;
    let monitor = start_monitor(view)?;
    let ending = group.adopt(&inheritance.stages).and_then(|()| group.watch(until));
    match ending {
        Ok(Ending::Upgrade(program)) => {
            group.leave();
            monitor.finish();
            Ok(Outcome::Upgrade(program))
        }
        ended => {
            group.end_all();
            // The monitor ends last, when every counter has its final value.
            let report = monitor.finish();
            ended.map(|_| Outcome::Ended(Box::new(report)))
        }
    }
}

fn stop_signals() -> Result<UnixStream, SupervisorError> {
    let system = |source| SupervisorError::System { action: "handle signals".into(), source };
    let (stop, sender) = UnixStream::pair().map_err(system)?;
    for signal in
        [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM, signal_hook::consts::SIGHUP]
    {
        let sender = sender.try_clone().map_err(system)?;
        signal_hook::low_level::pipe::register(signal, sender).map_err(system)?;
    }
    Ok(stop)
}
