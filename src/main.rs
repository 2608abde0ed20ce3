//! Touchline: global vision for robot soccer.
//!
//! One program. `touchline run` (also without arguments) starts a group of processes, each of
//! which is this program again with a stage's name as subcommand; see ARCHITECTURE.md.

mod cli;
mod commands;
mod monitor;
mod supervisor;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    match commands::execute(cli::Cli::parse()) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("touchline: {error}");
            ExitCode::FAILURE
        }
    }
}
