//! What an earlier supervisor has left behind: a group to take over, processes to end, or rubbish.

use super::{GRACE, Launch, SupervisorError};
use common::bus::{Bus, BusError};
use common::config::{Config, commented_toml};
use common::instance::{Instance, create_private};
use common::messages::ProcessKind;
use rustix::process::{Pid, Signal, kill_process};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A living stage process that another supervisor has started.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Inherited {
    /// Its stage.
    pub kind: ProcessKind,
    /// The system's number for it.
    pub pid: u32,
}

/// Makes the instance ready for a supervisor that holds its lock. Living stages that were started
/// for the same run are returned, to be taken over; others are ended, and it is said why. Programs of
/// others that have attached to the group are left alone.
pub fn prepare(launch: &Launch, config: &Config) -> Result<Vec<Inherited>, SupervisorError> {
    let instance = &launch.instance;
    let text = [
        (instance.config_path(), "its configuration differs", commented_toml(config)),
        (launch_path(instance), "its source differs", launch_text(launch)),
    ];
    let inherited = living_stages(instance)?;
    if !inherited.is_empty() {
        let differs = |(path, _, text): &&(PathBuf, _, String)| {
            fs::read_to_string(path).ok().as_ref() != Some(text)
        };
        match text.iter().find(differs) {
            None => {
                // The dead supervisor's places on the topics are needed.
                Bus::clean_up_dead(instance)?;
                remove_logs_of_others(instance, &inherited);
                return Ok(inherited);
            }
            Some((_, why, _)) => {
                eprintln!(
                    "touchline: a group without supervisor is running, but {why}: it is ended and \
                     started afresh"
                );
                end(instance)?;
            }
        }
    }
    clean_slate(instance)?;
    for (path, _, text) in &text {
        write(path, text)?;
    }
    Ok(Vec::new())
}

/// Removes everything dead processes have left; if none is alive, without asking what it was.
fn clean_slate(instance: &Instance) -> Result<(), SupervisorError> {
    if Bus::living_processes(instance)?.is_empty() {
        instance.wipe()?;
    } else {
        Bus::clean_up_dead(instance)?;
    }
    Ok(())
}

/// Leaves nothing of a group that has ended. What programs of others that are still attached need
/// stays; the next start, or the end of the next group, removes it.
pub fn tidy_up(instance: &Instance) -> Result<(), SupervisorError> {
    clean_slate(instance)?;
    if Bus::living_processes(instance)?.is_empty() {
        instance.remove_directory()?;
    }
    Ok(())
}

/// Logs of stages that died while there was no supervisor. That one cannot be removed is no reason
/// not to take over.
fn remove_logs_of_others(instance: &Instance, living: &[Inherited]) {
    let in_use: Vec<PathBuf> = living
        .iter()
        .filter_map(|stage| fs::read_link(format!("/proc/{}/fd/2", stage.pid)).ok())
        .collect();
    for entry in fs::read_dir(instance.directory()).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.extension().is_some_and(|extension| extension == "log") && !in_use.contains(&path) {
            let _ = fs::remove_file(path);
        }
    }
}

/// Kills a process that is not our child. That it has ended in the meantime is no error.
pub fn kill(pid: u32) {
    send(pid, Signal::KILL);
}

fn living_stages(instance: &Instance) -> Result<Vec<Inherited>, BusError> {
    let kind_of = |name: &str| ProcessKind::ALL.into_iter().find(|kind| kind.name() == name);
    let mut stages: Vec<Inherited> = Bus::living_processes(instance)?
        .into_iter()
        .filter_map(|process| Some(Inherited { kind: kind_of(&process.name)?, pid: process.pid }))
        .collect();
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

fn launch_path(instance: &Instance) -> PathBuf {
    instance.directory().join("launch")
}

fn launch_text(launch: &Launch) -> String {
    format!("source {}\nframes {:?}\n", launch.source, launch.frames)
}

fn write(path: &Path, text: &str) -> Result<(), SupervisorError> {
    let written = create_private(path).and_then(|mut file| file.write_all(text.as_bytes()));
    written.map_err(|source| SupervisorError::System {
        action: format!("write {}", path.display()),
        source,
    })
}
