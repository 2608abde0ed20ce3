//! Arguments of the commands that change a running group: `restart`, `upgrade`, `reload`, `rollback`.

use super::InstanceArgs;
use clap::Args;
use messages::ProcessKind;
use messages::stages::StageId;
use std::path::PathBuf;
use touchline::attendants::{self, Row};

/// Arguments of `restart`.
#[derive(Debug, Args)]
pub struct RestartArgs {
    /// Any of grabber, classifier, tracker, filter and the group's attendants, such as the gateway
    #[arg(required = true, value_name = "PROCESS", value_parser = parse_process)]
    pub processes: Vec<String>,
    /// The group.
    #[command(flatten)]
    pub instance: InstanceArgs,
}

/// Arguments of `upgrade`.
#[derive(Debug, Args)]
pub struct UpgradeArgs {
    /// The new program [default: the one that is given this command]
    #[arg(value_name = "PROGRAM")]
    pub program: Option<PathBuf>,
    /// The group.
    #[command(flatten)]
    pub instance: InstanceArgs,
}

/// Shown by `touchline reload --help`.
pub const RELOAD_EXAMPLES: &str = "\
Examples:
  touchline reload                                    after editing the file of `touchline run --config`
  touchline reload --set filter.actuation_delay_ms=60
  touchline reload --set 'colors.orange.red=[190, 255]' --dry-run
  touchline rollback";

/// Arguments of `reload`.
#[derive(Debug, Args)]
pub struct ReloadArgs {
    /// Configuration file [default: the one of `touchline run --config`]
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Set a key, on top of the file, or without --config on top of what the group runs with; colours and
    /// robots by name: `colors.orange.red=[190,255]`, `robots.identities.yellow 1.height_mm=120`
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Take over only the sections of which every change concerns these stages alone, separated by commas:
    /// any of grabber, classifier, tracker, filter. What else differs is listed, and stays as it runs
    #[arg(long, value_name = "STAGES", value_delimiter = ',', value_parser = trials::args::parse_stage)]
    pub stages: Vec<ProcessKind>,
    /// Only tell what differs and which stages it concerns
    #[arg(long)]
    pub dry_run: bool,
    /// The group.
    #[command(flatten)]
    pub instance: InstanceArgs,
}

/// Arguments of `rollback`.
#[derive(Debug, Args)]
pub struct RollbackArgs {
    /// The group.
    #[command(flatten)]
    pub instance: InstanceArgs,
}

fn parse_process(name: &str) -> Result<String, String> {
    let is_attendant = attendants::named(name).is_some();
    match StageId::from_name(name) {
        None if !is_attendant => {
            let kinds = ProcessKind::ALL.map(ProcessKind::name);
            let names = kinds.into_iter().chain(attendants::TABLE.iter().map(Row::name));
            Err(format!("use {}", names.collect::<Vec<_>>().join(", ")))
        }
        _ => Ok(name.into()),
    }
}
