//! Remains of an earlier supervisor: a group to take over, processes to end, or garbage to remove.

use super::sys::{self, Call};
use super::{GRACE, Launch, Record, SupervisorError, TABLE, attendants, configuration};
use client::bus::BusError;
use client::bus::participants::{self, LivingProcess};
use client::instance::Instance;
use client::memory::{self, GroupMemory};
use config::Config;
use config::snapshot::Snapshot;
use messages::stages::StageId;
use rustix::process::{Pid, Signal, kill_process};
use std::time::{Duration, Instant};

/// A living stage process that an earlier supervisor started.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Inherited {
    /// Its stage.
    pub stage: StageId,
    /// Its process id.
    pub pid: u32,
    /// Whether it is a spare, according to the record; `None` when that does not say.
    pub spare: Option<bool>,
}

/// State that a new supervisor starts from.
#[derive(Debug)]
pub struct Inheritance {
    /// Processes to take over.
    pub stages: Vec<Inherited>,
    /// Record of their group; empty for a new group.
    pub record: Record,
    /// The configuration to go on with.
    pub snapshot: Snapshot,
}

impl Inheritance {
    /// Whether there is a living group to take over.
    pub fn lives(&self) -> bool {
        !self.stages.is_empty()
    }
}

/// Prepares the instance for a supervisor that holds its lock. Returns the living stage processes
/// of the same run, to be taken over. Those of another run are ended, and the reason is reported.
/// Foreign programs attached to the group are left alone.
pub fn prepare(launch: &Launch, config: &Config) -> Result<Inheritance, SupervisorError> {
    let instance = &launch.instance;
    attendants::end_earlier(instance)?;
    let stages = living_stages(instance)?;
    if !stages.is_empty() {
        let record = Record::read(instance).unwrap_or_default();
        let snapshot = configuration::left_behind(instance, config);
        let differs = if !record.serves(launch) {
            "its source differs"
        } else if let Some(snapshot) = snapshot {
            // The dead supervisor's slots on the topics are needed. Clearing the garbage of foreign
            // programs too could take longer than a stage can do without a supervisor.
            let is_ours =
                |name: &str| OWN_NAMES.contains(&name) || StageId::from_name(name).is_some();
            match sys::check(Call::ListProcesses) {
                Err(error) => warn(&error),
                Ok(()) => warn_of(participants::remove_dead_named(instance, is_ours)),
            }
            let recorded = |stage: Inherited| Inherited {
                spare: record.is_spare(stage.stage, stage.pid),
                ..stage
            };
            let stages = stages.into_iter().map(recorded).collect();
            if snapshot.config != *config {
                runtime::tell!(
                    "touchline: the group goes on with revision {} of its configuration, which was changed while it \
                     ran; `touchline reload` uses the file",
                    snapshot.revision.number
                );
            }
            if let Err(error) = configuration::keep_origin(instance, config) {
                warn(&error);
            }
            return Ok(Inheritance { stages, record, snapshot });
        } else {
            "its configuration differs"
        };
        runtime::tell!(
            "touchline: a group without supervisor is running, but {differs}: it is ended and \
             started afresh"
        );
        end(instance)?;
    }
    clean_slate(instance)?;
    instance.forget_progress()?;
    check_memory(launch, config)?;
    let snapshot = Snapshot::first(config.clone());
    let failed = |source| SupervisorError::System {
        action: format!("write {}", instance.config_path().display()),
        source,
    };
    configuration::write(instance, &snapshot).map_err(failed)?;
    configuration::keep_origin(instance, config).map_err(failed)?;
    Ok(Inheritance { stages: Vec::new(), record: Record::default(), snapshot })
}

/// Checks that there is enough shared memory for a new group. If it runs out, processes die of
/// touching it.
fn check_memory(launch: &Launch, config: &Config) -> Result<(), SupervisorError> {
    let frame_bytes = launch.source.frame_capacity(&config.camera);
    let group = GroupMemory::with_larger_frames(config.camera.frame_bytes(), frame_bytes);
    let (needed, ample) = (group.least_bytes(), group.ample_bytes());
    let free = memory::free_bytes().map_err(|source| SupervisorError::System {
        action: format!("look at {}", memory::SHARED_MEMORY),
        source,
    })?;
    if free < needed {
        return Err(SupervisorError::NoMemory { needed, ample, free });
    }
    if free < ample {
        runtime::tell!(
            "touchline: {} MB of shared memory are free; noisy pictures and hand-overs may need up to \
             {} MB: {}",
            free >> 20,
            ample >> 20,
            memory::advice(ample)
        );
    }
    Ok(())
}

/// Removes the garbage of dead processes; if no process is alive, removes everything.
fn clean_slate(instance: &Instance) -> Result<(), SupervisorError> {
    // Listed first: a program that joins from now on, such as `touchline status`, keeps its files. Without them it would
    // remove those of the new group, which have the same names, when it leaves.
    let leftovers = instance.leftovers()?;
    if others(instance)?.is_empty() {
        let foreign = leftovers.remove()?;
        if let Some(first) = foreign.first() {
            let others = match foreign.len() - 1 {
                0 => String::new(),
                others => format!(", as were {others} others"),
            };
            runtime::tell!(
                "touchline: {first}{others}; nothing uses them, and they are left alone"
            );
        }
    } else {
        warn_of(participants::remove_dead(instance));
    }
    Ok(())
}

/// Living processes of the instance except this one, which has left the group in order or, if its
/// monitor has panicked, never will.
fn others(instance: &Instance) -> Result<Vec<LivingProcess>, BusError> {
    let mut others = participants::living(instance)?;
    others.retain(|process| process.pid != std::process::id());
    Ok(others)
}

/// Reports a failed removal. The janitor retries it; it is no reason to give up a match.
fn warn(error: &dyn std::error::Error) {
    runtime::tell!("touchline: {error}; it is tried again");
}

fn warn_of(cleaned: Result<usize, BusError>) {
    if let Err(error) = cleaned {
        warn(&error);
    }
}

/// Removes everything that a group which has ended leaves behind. Files that attached foreign
/// programs need stay until the next start, or the end of the next group.
pub fn tidy_up(instance: &Instance) -> Result<(), SupervisorError> {
    // A group that could not be taken over is alive, and stays for the next supervisor.
    if !living_stages(instance)?.is_empty() {
        return Ok(());
    }
    clean_slate(instance)?;
    for row in &TABLE {
        (row.remove)(instance)?;
    }
    if others(instance)?.is_empty() {
        instance.remove_directory()?;
    } else {
        // These files serve a takeover, and this group has ended.
        let _ = std::fs::remove_file(instance.record_path());
        instance.forget_progress()?;
    }
    Ok(())
}

/// Kills a process that is not our child. If it has already ended, that is no error.
pub fn kill(pid: u32) {
    send(pid, Signal::KILL);
}

/// Asks a process to end.
pub fn terminate(pid: u32) {
    send(pid, Signal::TERM);
    // A stopped process handles SIGTERM only after SIGCONT.
    send(pid, Signal::CONT);
}

/// Names under which a supervisor's own process joins the group.
const OWN_NAMES: [&str; 2] = ["supervisor", "monitor"];

fn living_stages(instance: &Instance) -> Result<Vec<Inherited>, SupervisorError> {
    sys::check(Call::ListProcesses)?;
    let stage = |process: LivingProcess| {
        let stage = StageId::from_name(&process.name)?;
        Some(Inherited { stage, pid: process.pid, spare: None })
    };
    let mut stages: Vec<Inherited> =
        participants::living(instance)?.into_iter().filter_map(stage).collect();
    stages.sort_by_key(|stage| stage.pid);
    stages.dedup();
    Ok(stages)
}

fn end(instance: &Instance) -> Result<(), SupervisorError> {
    for signal in [Signal::TERM, Signal::KILL] {
        for stage in living_stages(instance)? {
            send(stage.pid, signal);
            send(stage.pid, Signal::CONT);
        }
        let deadline = Instant::now() + GRACE;
        while Instant::now() < deadline && !living_stages(instance)?.is_empty() {
            std::thread::sleep(Duration::from_millis(20));
        }
    }
    match living_stages(instance)? {
        stages if stages.is_empty() => Ok(()),
        stages => {
            let pids = stages.iter().map(|stage| stage.pid).collect();
            Err(SupervisorError::Undead(pids, instance.name().into()))
        }
    }
}

fn send(pid: u32, signal: Signal) {
    if let Some(pid) = Pid::from_raw(pid as i32) {
        let _ = kill_process(pid, signal);
    }
}
