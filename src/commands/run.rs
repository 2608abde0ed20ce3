//! `touchline run`.

use super::{CommandError, load_config};
use crate::cli::RunArgs;
use crate::monitor::{Monitor, Output, summary};
use crate::supervisor::{self, Launch, Until};
use common::instance::Instance;
use grabber::source::Source;
use std::fs::File;
use std::path::Path;
use std::process::ExitCode;

/// Runs a group until it is done or stopped.
pub fn run(args: RunArgs) -> Result<ExitCode, CommandError> {
    let mut config = load_config(args.config.as_deref())?;
    if let Some(fps) = args.fps {
        config.camera.fps = fps;
    }
    let source = absolute(args.source)?;
    // Whatever is wrong with the source is said now, not by a grabber that dies in the background.
    grabber::source::check(&source, &config)?;
    let frames = args.frames.or(args.seconds.map(|seconds| frames_in(seconds, config.camera.fps)));
    // Nor does a match end with a report that cannot be written.
    let report_file = args.report.as_deref().map(create).transpose()?;

    let instance = Instance::new(&args.instance)?;
    let output = if args.quiet { Output::Quiet } else { Output::for_stdout() };
    let launch = Launch { instance: instance.clone(), source: source.clone(), frames };
    let until = if frames.is_some() { Until::Finished } else { Until::Stopped };
    let report = supervisor::run(launch, &config, until, |view| {
        Monitor::start(&instance, source.to_string(), &config, view, output)
    })?;

    if !args.quiet {
        print!("{}", summary(&report));
    }
    if let Some(file) = report_file {
        serde_json::to_writer_pretty(&file, &report)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn frames_in(seconds: f64, fps: f64) -> u64 {
    ((seconds * fps).round() as u64).max(1)
}

/// Stages do not share the caller's idea of relative paths for ever: a supervisor may be restarted
/// from elsewhere.
fn absolute(source: Source) -> Result<Source, CommandError> {
    Ok(match source {
        Source::Pictures(path) => Source::Pictures(
            path.canonicalize().map_err(|error| format!("{}: {error}", path.display()))?,
        ),
        Source::Synthetic => Source::Synthetic,
    })
}

fn create(path: &Path) -> Result<File, CommandError> {
    File::create(path).map_err(|error| format!("report {}: {error}", path.display()).into())
}
