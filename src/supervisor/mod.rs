//! The supervisor: starts the group, watches it, replaces what fails, and cleans up at the end.
//!
//! [`policy`] decides, [`children`] does, with a [`log`] for each, [`progress`] looks, also into the
//! [`pages`] of the stages, [`starvation`] sees who gets no
//! processor, [`control`] listens to requests and [`signals`] to signals, [`takeover`] deals with what an
//! earlier supervisor has left, of which [`record`] tells, [`evidence`] keeps what a bug report needs,
//! [`drops`] tells which input was dropped and why, [`janitor`] removes what the dead leave, [`premises`]
//! puts back what somebody removes, [`attendants`] keeps the processes running that serve people;
//! [`group`] ties them together while a group lives, and this file is its beginning and
//! its end.
//!
//! Nothing that the system refuses ends a match. All that can be refused is asked for through [`sys`],
//! tried again, and said by [`troubles`]; for want of descriptors there is a [`reserve`]. What is refused before a living
//! match is taken over is tried again by [`persistence`].

mod attendants;
mod children;
mod control;
mod drops;
mod evidence;
mod group;
mod janitor;
mod log;
mod notify;
mod pages;
mod persistence;
mod policy;
mod premises;
mod progress;
mod record;
mod reserve;
mod signals;
mod starvation;
mod sys;
mod takeover;
mod troubles;

pub use children::{Launch, is_same_program, process_name, program_of};
pub use control::{Request, ask};
pub use evidence::directory as evidence_directory;
pub use record::Record;

use crate::attendants::{AttendantError, TABLE};
use crate::monitor::{GroupView, Monitor, Report};
use attendants::Attendants;
use common::bus::BusError;
use common::config::Config;
use common::instance::InstanceError;
use common::stages::StageId;
use group::{Ending, Group};
use persistence::insist;
use premises::Premises;
use signals::Signals;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};
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
    /// An attendant cannot do its work.
    #[error("{0}")]
    Attendant(AttendantError),
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
        (free + (1 << 19)) >> 20,
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
        stage: StageId,
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

/// Before a monitor that could not be started, or has met a fault, is tried again.
const MONITOR_PAUSE: Duration = Duration::from_secs(2);
/// What one that has met a fault held is not given back, so there are not many of them.
const MOST_MONITORS: u32 = 3;

/// Runs the group. When it has ended nothing of it is left, neither a process nor shared memory.
pub fn run(
    launch: Launch,
    config: &Config,
    until: Until,
    start_monitor: impl Fn(Arc<GroupView>) -> Result<Monitor, BusError>,
) -> Result<Outcome, SupervisorError> {
    // First: until then a terminal that is closed ends it.
    let signals = Signals::listen()?;
    let instance = launch.instance.clone();
    // Before anything is made that would be left behind.
    common::memory::check_place().map_err(InstanceError::from)?;
    insist(|| Ok(instance.create_directory()?))?;
    let Some(lock) = insist(|| Ok(instance.lock()?))? else {
        return Err(SupervisorError::AlreadyRunning(instance.name().into()));
    };
    let mut premises = Premises::new(&instance, lock);
    let outcome = insist(|| takeover::prepare(&launch, config)).and_then(|inheritance| {
        supervise(launch, config, until, signals, &mut premises, inheritance, start_monitor)
    });
    if matches!(outcome, Ok(Outcome::Upgrade(_))) {
        return outcome;
    }
    // Also after an error, which is of more interest than that something was left behind.
    let tidied = takeover::tidy_up(&instance);
    drop(premises);
    outcome.and_then(|outcome| tidied.map(|()| outcome))
}

fn supervise(
    launch: Launch,
    config: &Config,
    until: Until,
    signals: Signals,
    premises: &mut Premises,
    inheritance: Inheritance,
    start_monitor: impl Fn(Arc<GroupView>) -> Result<Monitor, BusError>,
) -> Result<Outcome, SupervisorError> {
    let view = Arc::new(GroupView::new(std::process::id()));
    let lives = inheritance.lives();
    let attendants =
        Attendants::prepare(&launch.instance, config, lives).map_err(SupervisorError::Attendant)?;
    let mut group =
        Group::new(launch, config, Arc::clone(&view), signals, premises, &inheritance, attendants)?;
    let mut monitor = match start_monitor(Arc::clone(&view)) {
        // It only counts.
        Err(error) if lives => {
            common::tell!("touchline: {error}; the match goes on, but is not counted for now");
            None
        }
        started => Some(started?),
    };
    let (mut try_again, mut fallen) = (Instant::now() + MONITOR_PAUSE, 0);
    let mut keep_counting = || {
        if monitor.as_ref().is_some_and(Monitor::has_fallen) {
            monitor = None;
            fallen += 1;
            try_again = Instant::now() + MONITOR_PAUSE;
            common::tell!("touchline: the monitor has met a fault; the match goes on");
        }
        if monitor.is_none() && fallen < MOST_MONITORS && Instant::now() >= try_again {
            try_again = Instant::now() + MONITOR_PAUSE;
            monitor = start_monitor(Arc::clone(&view)).ok();
        }
    };
    let ending =
        group.adopt(&inheritance.stages).and_then(|()| group.watch(until, &mut keep_counting));
    let report = |monitor: Option<Monitor>| monitor.map(Monitor::finish).unwrap_or_default();
    match ending {
        Ok(Ending::Upgrade(program)) => {
            group.leave();
            report(monitor);
            Ok(Outcome::Upgrade(program))
        }
        ended => {
            group.end_all();
            // The monitor ends last, when every counter has its final value.
            let report = report(monitor);
            ended.map(|_| Outcome::Ended(Box::new(report)))
        }
    }
}
