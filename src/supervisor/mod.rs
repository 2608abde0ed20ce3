//! The supervisor: starts the group, watches it, replaces what fails, and cleans up at the end.
//!
//! * [`policy`] decides, and [`group`] carries the decisions out while the group runs.
//! * [`children`] starts, signals and reaps processes, with a [`log`] for each.
//! * [`configuration`] accepts changes of the configuration, and takes them back; [`history`] remembers them.
//! * [`progress`] observes the stages' outputs, also through their [`pages`].
//! * [`starvation`] measures which process gets no processor.
//! * [`control`] receives requests, and [`signals`] signals.
//! * [`takeover`] adopts or ends what an earlier supervisor left, according to its [`record`].
//! * [`evidence`] saves frames for bug reports; [`drops`] reports dropped inputs.
//! * [`janitor`] removes the garbage of dead processes; [`premises`] restores removed files.
//! * [`attendants`] keeps the processes running that serve people.
//!
//! This file starts and ends the group.
//!
//! No refusal by the system ends a match. Every fallible call goes through [`sys`], is retried, and is
//! reported by [`troubles`]; [`reserve`] keeps descriptors for when they run out. Steps before the
//! takeover of a running match are retried by [`persistence`].

mod attendants;
mod candidate;
mod children;
mod configuration;
mod drops;
mod evidence;
mod group;
mod history;
mod janitor;
mod log;
mod notify;
mod overrides;
mod pages;
mod persistence;
mod policy;
mod premises;
mod progress;
mod record;
mod requests;
mod reserve;
mod signals;
mod starvation;
mod sys;
mod takeover;
mod troubles;

pub use candidate::Candidate;
pub use children::{Launch, is_same_program, process_name, program_of};
pub use evidence::directory as evidence_directory;
pub use overrides::{Overrides, as_run};
pub use record::Record;

use crate::attendants::{AttendantError, TABLE};
use crate::monitor::{GroupView, Monitor};
use attendants::Attendants;
use client::bus::BusError;
use client::instance::InstanceError;
use config::Config;
use configuration::Configuration;
use control::Report;
use group::{Ending, Group};
use messages::stages::StageId;
use persistence::insist;
use premises::Premises;
use signals::Signals;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};
use sys::Call;
use takeover::Inheritance;

/// Reason for which a group could not be run.
#[derive(Debug, thiserror::Error)]
pub enum SupervisorError {
    /// Shared memory failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The runtime directory is unusable.
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// An attendant cannot do its work.
    #[error("{0}")]
    Attendant(AttendantError),
    /// Another supervisor runs the group.
    #[error(
        "the group {0:?} is running already; look at it with `touchline status --instance {0}`, end \
         it with `touchline stop --instance {0}`, or give this one another name with --instance"
    )]
    AlreadyRunning(String),
    /// Stage processes of a dead supervisor do not end.
    #[error("processes {0:?} of an earlier group {1:?} do not end; end them by hand")]
    Undead(Vec<u32>, String),
    /// The operating system refused something.
    #[error("{action}: {source}")]
    System {
        /// The attempted action.
        action: String,
        /// The system's answer.
        source: std::io::Error,
    },
    /// There is not enough shared memory for a match.
    #[error(
        "a match with these pictures takes about {} MB of shared memory, but {} MB are free; {}",
        needed >> 20,
        (free + (1 << 19)) >> 20,
        client::memory::advice(*ample)
    )]
    NoMemory {
        /// Least bytes to start with.
        needed: u64,
        /// Bytes that are always enough.
        ample: u64,
        /// Bytes that are free.
        free: u64,
    },
    /// A stage keeps failing at the start of the run.
    #[error("the {stage} does not start: {reason}")]
    NoStart {
        /// The stage.
        stage: StageId,
        /// Its last words.
        reason: String,
    },
}

/// Time processes have to end in order before they are killed.
const GRACE: Duration = Duration::from_secs(2);

/// How long a group runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Until {
    /// Until it is stopped.
    Stopped,
    /// Until the grabber has captured its frames and their results are out.
    Finished,
}

/// How supervising a group ended.
pub enum Outcome {
    /// The group ended too, with this report.
    Ended(Box<Report>),
    /// The group goes on, and this program takes it over.
    Upgrade(PathBuf),
}

/// Pause before a monitor that did not start, or has panicked, is started again.
const MONITOR_PAUSE: Duration = Duration::from_secs(2);
/// Most monitors started: one that has panicked never frees what it held.
const MOST_MONITORS: u32 = 3;

/// Runs the group. Afterwards neither a process nor shared memory of it is left.
pub fn run(
    launch: Launch,
    config: &Config,
    until: Until,
    start_monitor: impl Fn(Arc<GroupView>, &Config) -> Result<Monitor, BusError>,
) -> Result<Outcome, SupervisorError> {
    let instance = launch.instance.clone();
    if instance.record_path().exists() {
        sys::arm();
    }
    // First: before this a closed terminal ends the supervisor.
    let signals = insist(|| {
        sys::check(Call::HandleSignals)?;
        Signals::listen()
    })?;
    // Before creating anything that would be left behind.
    client::memory::check_place().map_err(InstanceError::from)?;
    insist(|| Ok(instance.create_directory()?))?;
    let lock = insist(|| {
        sys::check(Call::TakeLock)?;
        Ok(instance.lock()?)
    });
    let Some(lock) = lock? else {
        return Err(SupervisorError::AlreadyRunning(instance.name().into()));
    };
    let mut premises = Premises::new(&instance, lock);
    let outcome = insist(|| takeover::prepare(&launch, config)).and_then(|inheritance| {
        supervise(launch, until, signals, &mut premises, inheritance, start_monitor)
    });
    if matches!(outcome, Ok(Outcome::Upgrade(_))) {
        return outcome;
    }
    // After an error too; that error is reported rather than a failed clean-up.
    let tidied = insist(|| takeover::tidy_up(&instance));
    drop(premises);
    outcome.and_then(|outcome| tidied.map(|()| outcome))
}

fn supervise(
    launch: Launch,
    until: Until,
    signals: Signals,
    premises: &mut Premises,
    inheritance: Inheritance,
    start_monitor: impl Fn(Arc<GroupView>, &Config) -> Result<Monitor, BusError>,
) -> Result<Outcome, SupervisorError> {
    let view = Arc::new(GroupView::new(std::process::id()));
    let lives = inheritance.lives();
    let config = &inheritance.snapshot.config;
    let attendants =
        Attendants::prepare(&launch.instance, config, lives).map_err(SupervisorError::Attendant)?;
    let configuration = Configuration::new(&launch.instance, inheritance.snapshot.clone(), lives);
    let mut group = Group::new(
        launch,
        configuration,
        Arc::clone(&view),
        signals,
        premises,
        &inheritance,
        attendants,
    )?;
    let mut monitor = match start_monitor(Arc::clone(&view), config) {
        // The monitor only counts, so the match goes on without it.
        Err(error) if lives => {
            runtime::tell!("touchline: {error}; the match goes on, but is not counted for now");
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
            runtime::tell!("touchline: the monitor has met a fault; the match goes on");
        }
        if monitor.is_none() && fallen < MOST_MONITORS && Instant::now() >= try_again {
            try_again = Instant::now() + MONITOR_PAUSE;
            monitor = start_monitor(Arc::clone(&view), config).ok();
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
