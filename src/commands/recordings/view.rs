//! `touchline recording-viewer`: a recording for the console.

use crate::cli::RecordingViewerArgs;
use crate::commands::CommandError;
use client::instance::Instance;
use std::io::{BufReader, stdin, stdout};
use std::process::ExitCode;
use touchline::viewing;

/// Answers until there are no more questions.
pub fn view(args: RecordingViewerArgs) -> Result<ExitCode, CommandError> {
    let instance = Instance::new(&args.instance.instance)?;
    viewing::serve(&args.file, &instance, BufReader::new(stdin()), stdout().lock())?;
    Ok(ExitCode::SUCCESS)
}
