//! `touchline status` and `touchline stop`: a running group from outside.

use super::CommandError;
use crate::cli::{InstanceArgs, StatusArgs};
use crate::monitor::{read_status, summary};
use crate::supervisor::Record;
use common::instance::Instance;
use rustix::process::{Pid, Signal, kill_process};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// A living group publishes its status several times a second.
pub const STATUS_PATIENCE: Duration = Duration::from_secs(3);
/// Ending in order takes a moment, killing what does not listen two seconds more.
const STOP_PATIENCE: Duration = Duration::from_secs(10);

/// Prints the state of a running group.
pub fn status(args: StatusArgs) -> Result<ExitCode, CommandError> {
    let instance = running(&args.instance)?;
    let Some(report) = read_status(&instance, STATUS_PATIENCE)? else {
        return Err(format!(
            "the group {:?} has a supervisor, but it says nothing; it may be stopped or starting",
            instance.name()
        )
        .into());
    };
    if args.json {
        say_line!("{}", serde_json::to_string_pretty(&report)?)?;
        return Ok(ExitCode::SUCCESS);
    }
    say!("{}", summary(&report))?;
    say_line!("  processes    supervisor {}", report.supervisor_pid)?;
    for (stage, processes) in report.stages.iter().map(|(name, stage)| (name, &stage.processes)) {
        for process in processes {
            say_line!("               {stage} {} ({})", process.pid, process.state)?;
        }
    }
    for event in &report.events {
        say_line!("  event        {} (pid {}): {}", event.stage, event.pid, event.what)?;
    }
    Ok(ExitCode::SUCCESS)
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
    say_line!("the group {:?} has ended", instance.name())?;
    Ok(ExitCode::SUCCESS)
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
