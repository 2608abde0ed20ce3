//! `touchline status` and `touchline stop`: inspect and end a running group from outside.

use super::CommandError;
use crate::cli::{InstanceArgs, StatusArgs};
use client::instance::Instance;
use control::read_status;
use rustix::process::{Pid, Signal, kill_process};
use std::process::ExitCode;
use std::time::{Duration, Instant};
use touchline::monitor::summary;
use touchline::supervisor::Record;

/// A living group publishes its status several times a second.
pub const STATUS_PATIENCE: Duration = Duration::from_secs(3);
/// An orderly end takes a moment; processes that ignore the request are killed two seconds later.
const STOP_PATIENCE: Duration = Duration::from_secs(10);

/// Prints the state of a running group.
pub fn status(args: StatusArgs) -> Result<ExitCode, CommandError> {
    let instance = running(&args.instance)?;
    if let Some(pid) = instance.supervisor_pid().filter(|&pid| is_stopped(pid)) {
        return Err(format!(
            "the supervisor of the group {:?} (pid {pid}) is stopped; its stages play on, but nobody replaces \
             one that fails; `kill -CONT {pid}` has it go on",
            instance.name()
        )
        .into());
    }
    let Some(report) = read_status(&instance, STATUS_PATIENCE)? else {
        return Err(format!(
            "the group {:?} has a supervisor, but it says nothing; it may be stopped or starting",
            instance.name()
        )
        .into());
    };
    if args.json {
        runtime::say_line!("{}", serde_json::to_string_pretty(&report)?)?;
        return Ok(ExitCode::SUCCESS);
    }
    runtime::say!("{}", summary(&report))?;
    runtime::say_line!("  processes    supervisor {}", report.supervisor_pid)?;
    for (stage, processes) in report.stages.iter().map(|(name, stage)| (name, &stage.processes)) {
        for process in processes {
            runtime::say_line!("               {stage} {} ({})", process.pid, process.state)?;
        }
    }
    for version in strange_versions(&instance) {
        runtime::say_line!("  warning      {version}")?;
    }
    for event in &report.events {
        runtime::say_line!("  event        {} (pid {}): {}", event.stage, event.pid, event.what)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Description of what programs with other versions of iceoryx2 have created in the group.
pub fn strange_versions(instance: &Instance) -> Vec<String> {
    let namespace = instance.namespace().ok().flatten();
    namespace.and_then(|namespace| namespace.strange_versions().ok()).unwrap_or_default()
}

/// Ends a running group and waits until it is gone.
pub fn stop(args: InstanceArgs) -> Result<ExitCode, CommandError> {
    let instance = running(&args)?;
    let pid = instance.supervisor_pid().and_then(|pid| Pid::from_raw(pid as i32));
    let Some(pid) = pid else {
        return Err(format!("the group {:?} is just starting or ending", instance.name()).into());
    };
    kill_process(pid, Signal::TERM)?;
    let deadline = Instant::now() + STOP_PATIENCE;
    while instance.is_supervised() {
        if Instant::now() > deadline {
            return Err(format!(
                "the supervisor (pid {}) does not end; it may be stopped",
                pid.as_raw_nonzero()
            )
            .into());
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    runtime::say_line!("the group {:?} has ended", instance.name())?;
    Ok(ExitCode::SUCCESS)
}

/// Whether a process is stopped, by SIGSTOP or from its terminal.
fn is_stopped(pid: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    // The state follows the name, which may contain anything.
    stat.rsplit_once(") ").is_some_and(|(_, state)| state.starts_with(['T', 't']))
}

/// The group, if it has a living supervisor.
pub fn running(args: &InstanceArgs) -> Result<Instance, CommandError> {
    let instance = Instance::new(&args.instance)?;
    let name = instance.name();
    if instance.is_supervised() {
        return Ok(instance);
    }
    Err(match Record::read(&instance) {
        Some(_) => format!(
            "the supervisor of the group {name:?} is gone; take over what it has left with `touchline \
             run --adopt --instance {name}`"
        ),
        None => format!("no group {name:?} is running; start one with `touchline run`"),
    }
    .into())
}
