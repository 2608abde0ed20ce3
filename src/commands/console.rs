//! `touchline console`: where a group's page for browsers is.

use super::{CommandError, run};
use crate::cli::ConsoleArgs;
use client::instance::Instance;
use messages::Attendant;
use std::io::IsTerminal;
use std::process::ExitCode;
use touchline::attendants;
use touchline::console::Place;

/// Says where the page is, and starts the group first if it is not running.
pub fn console(args: ConsoleArgs) -> Result<ExitCode, CommandError> {
    if args.supervised
        && let Some(row) = attendants::named(Attendant::Console.name())
    {
        return super::attend(row, args.process());
    }
    let instance = Instance::new(&args.run.instance)?;
    if !instance.is_supervised() {
        // It says where the page is when it starts.
        return run::for_console(args.run);
    }
    let Some(place) = Place::read(&instance) else {
        return Err(format!(
            "the group {:?} has no console: its configuration says [console] enabled = false, or it was started \
             with --no-console",
            instance.name()
        )
        .into());
    };
    runtime::say!("{}", place.words(std::io::stdout().is_terminal()))?;
    Ok(ExitCode::SUCCESS)
}
