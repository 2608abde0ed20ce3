//! `touchline recover`.

use super::{size_text, tell_parts};
use crate::cli::RecoverArgs;
use crate::commands::CommandError;
use recording::recover::{Recovery, recover as recover_in_place, recover_to};
use runtime::output::Rule;
use std::io::{IsTerminal, Write};
use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Time between two updates of the progress on a terminal.
const TELL_PERIOD: Duration = Duration::from_millis(250);

/// Completes unfinished recordings and repairs damaged ones.
pub fn recover(args: RecoverArgs) -> Result<ExitCode, CommandError> {
    if args.output.is_some() && args.files.len() > 1 {
        return Err("--output takes one recording at a time".into());
    }
    let mut code = ExitCode::SUCCESS;
    for path in &args.files {
        let shown = path.display();
        let outcome: Result<_, CommandError> = with_progress(path, |tell| match &args.output {
            Some(output) => {
                let rule = Rule { inputs: &[path], force: args.force };
                let output = rule.create(output)?;
                let outcome = recover_to(path, output.file(), tell)?;
                if matches!(outcome, Recovery::Recovered { .. }) {
                    output.finish()?;
                }
                Ok(outcome)
            }
            None => Ok(recover_in_place(path, tell)?),
        });
        match outcome {
            Ok(Recovery::NotNeeded) => _ = runtime::say_line!("{shown} is complete")?,
            Ok(Recovery::Recovered { messages, damages }) => {
                tell_parts(path, &damages);
                let written = args.output.as_deref().unwrap_or(path).display();
                runtime::say_line!("{written}: recovered {messages} messages")?;
            }
            Ok(Recovery::BeingWritten) => {
                runtime::tell!("touchline: {shown} is being written by a recorder");
                code = ExitCode::FAILURE;
            }
            // A recording that cannot be recovered does not stop the others.
            Err(error) => {
                runtime::tell!("touchline: {error}");
                code = ExitCode::FAILURE;
            }
        }
    }
    Ok(code)
}

/// Shows progress if the work takes long and the output is a terminal.
fn with_progress<T>(path: &Path, work: impl FnOnce(&mut dyn FnMut(u64, u64)) -> T) -> T {
    let is_terminal = std::io::stderr().is_terminal();
    let (mut told, mut is_shown) = (Instant::now(), false);
    let outcome = work(&mut |done, total| {
        if is_terminal && told.elapsed() > TELL_PERIOD {
            (told, is_shown) = (Instant::now(), true);
            let (done, total) = (size_text(done), size_text(total));
            runtime::tell_part!("\r\x1b[K{}: {done} of {total} looked at", path.display());
            let _ = std::io::stderr().flush();
        }
    });
    if is_shown {
        runtime::tell_part!("\r\x1b[K");
    }
    outcome
}
