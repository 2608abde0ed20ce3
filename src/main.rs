//! Touchline: global vision for robot soccer.
//!
//! One program. `touchline run` (also without arguments) starts a group of processes, each of
//! which is this program again with a stage's name as subcommand; see ARCHITECTURE.md.

// A process outlives the readers of its output: see `runtime::tell`.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

mod cli;
mod commands;

use std::process::ExitCode;

fn main() -> ExitCode {
    let outcome = match cli::parse() {
        cli::Invocation::Cli(cli) => commands::execute(cli),
        cli::Invocation::Attendant(row, args) => commands::attend(row, args),
    };
    match outcome {
        Ok(code) => code,
        Err(error) => {
            // A configuration error begins with file and line, as editors expect it.
            let prefix = if error.is::<config::ConfigError>() { "" } else { "touchline: " };
            runtime::tell!("{prefix}{error}");
            runtime::tell::finish(std::time::Duration::from_secs(1));
            ExitCode::FAILURE
        }
    }
}
