//! `touchline recover`.

use crate::cli::RecoverArgs;
use crate::commands::CommandError;
use recording::recover::{Recovery, recover as recover_file};
use std::process::ExitCode;

/// Completes recordings that were never finished.
pub fn recover(args: RecoverArgs) -> Result<ExitCode, CommandError> {
    if args.output.is_some() && args.files.len() > 1 {
        return Err("--output takes one recording at a time".into());
    }
    let mut code = ExitCode::SUCCESS;
    for path in &args.files {
        let shown = path.display();
        match recover_file(path, args.output.as_deref()) {
            Ok(Recovery::NotNeeded) => _ = say_line!("{shown} is complete")?,
            Ok(Recovery::Recovered(messages)) => {
                say_line!("{shown}: recovered {messages} messages")?;
            }
            Ok(Recovery::BeingWritten) => {
                common::tell!("touchline: {shown} is being written by a recorder");
                code = ExitCode::FAILURE;
            }
            // One that cannot be recovered is no reason to leave out the others.
            Err(error) => {
                common::tell!("touchline: {error}");
                code = ExitCode::FAILURE;
            }
        }
    }
    Ok(code)
}
