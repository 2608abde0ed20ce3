//! `touchline reload` and `touchline rollback`: another configuration in the middle of a match.

use super::CommandError;
use super::group::running;
use super::operate::{ask, status};
use crate::cli::{ReloadArgs, RollbackArgs};
use client::instance::Instance;
use config::Config;
use config::change::{Change, Effect, changes, only_for};
use config::edit::with_values;
use config::snapshot::{Snapshot, concerned};
use control::{Configured, Request};
use std::process::ExitCode;
use std::time::{Duration, Instant};
use touchline::supervisor::{Candidate, Record, as_run};

/// Each concerned stage has to start a process, on a machine that may be busy.
const PATIENCE: Duration = Duration::from_secs(60);
/// Time between two looks at the status.
const LOOK: Duration = Duration::from_millis(20);

/// Goes over to another configuration.
pub fn reload(args: ReloadArgs) -> Result<ExitCode, CommandError> {
    let instance = running(&args.instance)?;
    let now = Snapshot::load(&instance.config_path())?;
    let wanted = wanted(&args, &instance, &now.config)?;
    if args.stages.is_empty() {
        return go_over(&instance, &now, &wanted, args.dry_run);
    }
    let (wanted, left) = only_for(&now.config, &wanted, &args.stages)?;
    for change in left {
        runtime::say_line!(
            "stays as it runs: {} (the file has {})",
            change.key,
            change.new_text()
        )?;
    }
    go_over(&instance, &now, &wanted, args.dry_run)
}

/// Has a running group go over from the configuration that it runs with `now` to another: says what differs and
/// what is replaced, and waits until it is in use. A dry run only says it. Refused if somebody else has changed
/// the configuration meanwhile.
pub fn go_over(
    instance: &Instance,
    now: &Snapshot,
    wanted: &Config,
    is_dry_run: bool,
) -> Result<ExitCode, CommandError> {
    let changes = changes(&now.config, wanted);
    if changes.is_empty() {
        runtime::say_line!(
            "nothing differs from what the group runs with (revision {})",
            now.revision.number
        )?;
        return Ok(ExitCode::SUCCESS);
    }
    for change in &changes {
        runtime::say_line!("{change}{}", note(change))?;
    }
    let names: Vec<&str> = concerned(&changes).iter().map(|kind| kind.name()).collect();
    let replaced = if names.is_empty() { "no stage".into() } else { names.join(", ") };
    runtime::say_line!("to be replaced: {replaced}")?;
    if names.contains(&"grabber") {
        runtime::say_line!(
            "the grabber opens its camera again: frames until then are not captured"
        )?;
    }
    if is_dry_run {
        return Ok(ExitCode::SUCCESS);
    }
    let candidate = Candidate::write(instance, wanted)?;
    let base = Some(now.revision.number);
    let done = ask(instance, &Request::Reload { file: candidate.path.clone(), base })?;
    drop(candidate);
    match done.revision {
        Some(revision) => wait_for(instance, revision),
        // Somebody else was faster.
        None => Ok(ExitCode::SUCCESS),
    }
}

/// Goes back to the configuration before.
pub fn rollback(args: RollbackArgs) -> Result<ExitCode, CommandError> {
    let instance = running(&args.instance)?;
    let done = ask(&instance, &Request::Rollback)?;
    wait_for(&instance, done.revision.unwrap_or_default())
}

/// The configuration asked for, with what the group's command line changes in it.
fn wanted(args: &ReloadArgs, instance: &Instance, now: &Config) -> Result<Config, CommandError> {
    let record = Record::read(instance).unwrap_or_default();
    let file = match (&args.config, &record.config_file) {
        (Some(file), _) => Some(file),
        // Keys of the command line alone change what runs, not what the file says by now.
        (None, _) if !args.set.is_empty() => None,
        (None, Some(file)) => Some(file),
        (None, None) => {
            return Err(
                "the group was started without a configuration file: name one with --config, or \
                        keys with --set"
                    .into(),
            );
        }
    };
    let config = match file {
        Some(file) => {
            let (config, warnings) = config::check_file(file)?;
            if !warnings.list.is_empty() {
                runtime::tell!("{warnings}\n");
            }
            as_run(config, &record.overrides, &record.source.parse()?)
        }
        None => now.clone(),
    };
    Ok(with_values(&config, &args.set)?)
}

fn note(change: &Change) -> String {
    match change.effect() {
        Effect::NewGroup(reason) => format!("   needs a new group: {reason}"),
        Effect::Stages(_) | Effect::Supervisor => String::new(),
    }
}

/// Waits until all stages run with this revision or a later one. A later one can be this one taken back.
fn wait_for(instance: &Instance, revision: u32) -> Result<ExitCode, CommandError> {
    let deadline = Instant::now() + PATIENCE;
    loop {
        // A supervisor may be replaced meanwhile.
        let configured = status(instance).map(|report| report.configuration).unwrap_or_default();
        if configured.revision >= revision && configured.pending.is_empty() {
            return finish(&configured, revision);
        }
        if Instant::now() > deadline {
            return Err(format!(
                "accepted as revision {revision}, but not all stages run with it yet ({}); `touchline status \
                 --instance {}` tells why",
                configured.pending.join(", "),
                instance.name()
            )
            .into());
        }
        std::thread::sleep(LOOK);
    }
}

fn finish(configured: &Configured, revision: u32) -> Result<ExitCode, CommandError> {
    let later = configured.history.iter().find(|it| it.revision > revision);
    match later {
        Some(it) if it.what.starts_with("back to") => {
            Err(format!("revision {revision} was taken back: {}", it.what).into())
        }
        _ => {
            runtime::say_line!("the group runs with revision {}", configured.revision)?;
            Ok(ExitCode::SUCCESS)
        }
    }
}
