//! `touchline restart` and `touchline upgrade`: planned changes in the middle of a match.

use super::group::{STATUS_PATIENCE, running};
use super::{CommandError, ask_program};
use crate::cli::{RestartArgs, UpgradeArgs};
use client::instance::Instance;
use control::report::Stage;
use control::{Done, Report, Request, read_status};
use messages::interface::Interface;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant};
use touchline::supervisor::{is_same_program, program_of};

/// A supervisor answers in its next round, within a few milliseconds.
const ANSWER_PATIENCE: Duration = Duration::from_secs(3);
/// A spare may first have to be started, and the machine may be busy.
const RESTART_PATIENCE: Duration = Duration::from_secs(30);
/// Seven processes are replaced one after the other.
const UPGRADE_PATIENCE: Duration = Duration::from_secs(120);
/// Time between two checks of a change under way.
const LOOK: Duration = Duration::from_millis(20);

/// Replaces the active processes of stages and attendants.
pub fn restart(args: RestartArgs) -> Result<ExitCode, CommandError> {
    let instance = running(&args.instance)?;
    let before = active(&status(&instance)?);
    ask(&instance, &Request::Restart(args.processes.clone()))?;

    let deadline = Instant::now() + RESTART_PATIENCE;
    let mut waiting = args.processes;
    waiting.sort();
    waiting.dedup();
    while !waiting.is_empty() {
        // On a busy machine the report may be missing for a moment; the wait continues.
        let now = status(&instance).map(|report| active(&report)).unwrap_or_default();
        let is_done = |name: &String| {
            let (old, new) = (before.get(name), now.get(name));
            new.is_some() && new != old
        };
        for name in waiting.extract_if(.., |name| is_done(name)) {
            let [old, new] = [&before, &now].map(|pids| pids.get(&name));
            let [old, new] = [old, new].map(|pid| pid.map_or("none".into(), u32::to_string));
            runtime::say_line!("{name}: {old} → {new}")?;
        }
        if Instant::now() > deadline {
            return Err(format!(
                "{} not replaced yet; `touchline status --instance {}` tells why",
                waiting.join(", "),
                instance.name()
            )
            .into());
        }
        std::thread::sleep(LOOK);
    }
    Ok(ExitCode::SUCCESS)
}

/// Replaces the group's program by another.
pub fn upgrade(args: UpgradeArgs) -> Result<ExitCode, CommandError> {
    let instance = running(&args.instance)?;
    let program = match args.program {
        Some(program) => program,
        None => std::env::current_exe()?,
    };
    let program =
        program.canonicalize().map_err(|error| format!("{}: {error}", program.display()))?;
    let Some(supervisor) = instance.supervisor_pid() else {
        return Err("the group is just starting or ending".into());
    };
    let runs_it = |pid: u32| is_same_program(&program_of(pid), &program);
    if processes(&status(&instance)?).into_iter().all(|(pid, _)| runs_it(pid)) {
        runtime::say_line!("the group {:?} runs {} already", instance.name(), program.display())?;
        return Ok(ExitCode::SUCCESS);
    }
    check(&program, &instance, supervisor)?;
    ask(&instance, &Request::Upgrade(program.clone()))?;

    let deadline = Instant::now() + UPGRADE_PATIENCE;
    let mut told: Vec<u32> = Vec::new();
    loop {
        // There is no supervisor for a moment, and so no status.
        if let Ok(report) = status(&instance) {
            let processes = processes(&report);
            for (pid, what) in processes.iter().filter(|(pid, _)| runs_it(*pid)) {
                if !told.contains(pid) {
                    runtime::say_line!("{what}: {pid}")?;
                    told.push(*pid);
                }
            }
            if report.complete && processes.iter().all(|&(pid, _)| runs_it(pid)) {
                runtime::say_line!(
                    "the group {:?} runs {} now",
                    instance.name(),
                    program.display()
                )?;
                return Ok(ExitCode::SUCCESS);
            }
        }
        if Instant::now() > deadline {
            return Err(format!(
                "the group has not gone over to the new program yet; \
                 `touchline status --instance {}` tells why",
                instance.name()
            )
            .into());
        }
        std::thread::sleep(LOOK);
    }
}

/// Prints the interface that another program asks for before an upgrade.
pub fn interface() -> Result<ExitCode, CommandError> {
    runtime::say_line!("{}", serde_json::to_string_pretty(&Interface::own())?)?;
    Ok(ExitCode::SUCCESS)
}

/// Refuses a program that cannot take over.
fn check(program: &Path, instance: &Instance, supervisor: u32) -> Result<(), CommandError> {
    // The running supervisor's own program may have another version than this one.
    let (old, new) = (interface_of(&program_of(supervisor))?, interface_of(program)?);
    let conflicts = old.conflicts_with(&new);
    if !conflicts.is_empty() {
        return Err(format!(
            "{} does not understand the running group's messages, so nothing was changed:\n  {}\n\
             stop the group and start it with the new program",
            program.display(),
            conflicts.join("\n  ")
        )
        .into());
    }
    let snapshot = instance.config_path();
    let output =
        ask_program::ask(program, &["config".as_ref(), "check".as_ref(), snapshot.as_os_str()])?;
    if !output.status.success() {
        return Err(format!(
            "{} does not accept the running group's configuration, so nothing was changed:\n{}",
            program.display(),
            String::from_utf8_lossy(&output.stderr).trim()
        )
        .into());
    }
    Ok(())
}

fn interface_of(program: &Path) -> Result<Interface, CommandError> {
    let output = ask_program::ask(program, &["interface".as_ref()])?;
    serde_json::from_slice(&output.stdout).map_err(|_| {
        format!(
            "{} does not say which messages it understands, so nothing was changed: {}",
            program.display(),
            String::from_utf8_lossy(&output.stderr).trim()
        )
        .into()
    })
}

/// Sends the supervisor a request.
pub fn ask(instance: &Instance, request: &Request) -> Result<Done, CommandError> {
    match control::ask(instance, request, ANSWER_PATIENCE) {
        Ok(answer) => Ok(answer?),
        Err(error) => Err(format!(
            "the supervisor of the group {:?} does not answer ({error}); it may be stopped or of an \
             older version",
            instance.name()
        )
        .into()),
    }
}

/// The group's report.
pub fn status(instance: &Instance) -> Result<Report, CommandError> {
    read_status(instance, STATUS_PATIENCE)?.ok_or_else(|| {
        format!("the supervisor of the group {:?} says nothing", instance.name()).into()
    })
}

/// The active process of each stage and attendant that has one.
fn active(report: &Report) -> BTreeMap<String, u32> {
    let active = |(name, stage): (&String, &Stage)| {
        let active = stage.processes.iter().find(|process| process.state != "spare")?;
        Some((name.clone(), active.pid))
    };
    let stages = report.stages.iter().filter_map(active);
    let attendants = report.attendants.iter();
    stages.chain(attendants.filter_map(|(name, it)| Some((name.clone(), it.pid?)))).collect()
}

/// All processes of a group, with their roles.
fn processes(report: &Report) -> Vec<(u32, String)> {
    let stages = report.stages.iter().flat_map(|(name, stage)| {
        let describe = move |state: &str| match state {
            "spare" => format!("{name} (spare)"),
            _ => name.to_string(),
        };
        stage.processes.iter().map(move |process| (process.pid, describe(&process.state)))
    });
    std::iter::once((report.supervisor_pid, "supervisor".to_string())).chain(stages).collect()
}
