//! `touchline run`.

use super::CommandError;
use super::watch;
use crate::cli::RunArgs;
use client::clock::monotonic_ns;
use client::instance::Instance;
use config::{Config, ConsoleConfig};
use grabber::playback::Playlist;
use grabber::source::Source;
use runtime::descriptors;
use runtime::output::Rule;
use runtime::user_config::load_config;
use std::fs::File;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, ExitCode};
use std::time::Duration;
use touchline::monitor::{Monitor, Output, summary};
use touchline::supervisor::{self, Launch, Outcome, Overrides, Record, Until, as_run};

/// Longest wait for the reader of the last texts.
const LAST_TEXTS: Duration = Duration::from_secs(1);

/// Set, it has the effect of `--no-console`: for scripts and tests that start groups in many places.
const NO_CONSOLE_VARIABLE: &str = "TOUCHLINE_NO_CONSOLE";

/// Runs a group until it is done or stopped.
pub fn run(args: RunArgs) -> Result<ExitCode, CommandError> {
    start(args, false)
}

/// Runs a group for its console: to look at a camera, pictures or a recording. A recording is played again and
/// again, as the page would end with it.
pub fn for_console(mut args: RunArgs) -> Result<ExitCode, CommandError> {
    if let Source::Recording(playlist) = &mut args.source {
        playlist.is_loop = true;
    }
    start(args, true)
}

fn start(args: RunArgs, for_console: bool) -> Result<ExitCode, CommandError> {
    let instance = Instance::new(&args.instance)?;
    let (launch, config) = if args.adopt {
        left_behind(&instance)?
    } else {
        asked_for(&args, &instance, for_console)?
    };
    // Problems of the source are reported now, not by a grabber that dies in the background.
    grabber::source::check(&launch.source, &config)?;
    for complaint in runtime::scheduling::unavailable(&config.scheduling) {
        runtime::tell!("touchline: {complaint}");
    }
    // A report that cannot be written is an error now, not at the end of the match.
    let report_file = args.report.as_deref().map(|path| report(path, &args)).transpose()?;

    // The reader of the output may stop reading; the match continues.
    if let Err(error) = runtime::tell::never_block() {
        runtime::tell!("touchline: no thread for what is said: {error}");
    }
    let output = if args.quiet { Output::Quiet } else { Output::for_stdout() };
    let is_bounded = launch.frames.is_some() || launch.source.is_bounded();
    let until = if is_bounded { Until::Finished } else { Until::Stopped };
    if args.watch {
        let Some(file) = launch.config_file.clone() else {
            return Err("--watch needs a file to watch: name one with --config".into());
        };
        watch::start(file, &launch)?;
    }
    let source = launch.source.to_string();
    let outcome = supervisor::run(launch, &config, until, |view, config| {
        Monitor::start(&instance, source.clone(), config, view, output)
    })?;
    let report = match outcome {
        Outcome::Ended(report) => report,
        Outcome::Upgrade(program) => {
            runtime::tell::finish(LAST_TEXTS);
            return Err(go_on_as(&program, &args));
        }
    };

    if !args.quiet {
        runtime::tell::show(summary(&report));
    }
    runtime::tell::finish(LAST_TEXTS);
    if let Some(file) = report_file {
        serde_json::to_writer_pretty(&file, &report)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The group that the command line describes.
fn asked_for(
    args: &RunArgs,
    instance: &Instance,
    for_console: bool,
) -> Result<(Launch, Config), CommandError> {
    let config = match (&args.config, &args.source) {
        // A recording is normally played with the configuration it was made with.
        (None, Source::Recording(playlist)) => {
            let mut config = grabber::playback::recorded_config(&playlist.path, playlist.from_s)?;
            // Receivers must not take a recording for the match.
            config.publish.disable_all();
            // Nor does a recording of somebody else's open addresses of this computer.
            config.console = ConsoleConfig::default();
            config
        }
        _ => load_config(args.config.as_deref())?,
    };
    let source = absolute(args.source.clone())?;
    let no_console = args.no_console || std::env::var_os(NO_CONSOLE_VARIABLE).is_some();
    let overrides =
        Overrides { fps: args.fps, publish: args.publish.clone(), no_console, for_console };
    let config = as_run(config, &overrides, &source);
    let ends_at_ns = args.seconds.map(|seconds| monotonic_ns() + (seconds * 1e9) as u64);
    let config_file = args.config.as_deref().map(std::path::absolute).transpose()?;
    let launch = Launch {
        instance: instance.clone(),
        source,
        frames: args.frames,
        ends_at_ns,
        config_file,
        overrides,
    };
    Ok((launch, config))
}

/// The group left behind by an earlier supervisor, with that supervisor's configuration and source.
fn left_behind(instance: &Instance) -> Result<(Launch, Config), CommandError> {
    let Some(record) = Record::read(instance) else {
        return Err(format!(
            "there is nothing to take over: no group {:?} has been left behind",
            instance.name()
        )
        .into());
    };
    let config = load_config(Some(&instance.config_path()))?;
    let source = record.source.parse()?;
    let Record { frames, ends_at_ns, config_file, overrides, .. } = record;
    let launch =
        Launch { instance: instance.clone(), source, frames, ends_at_ns, config_file, overrides };
    Ok((launch, config))
}

/// Executes another program, which takes over the group: the same process with the same terminal, parent
/// and children. Returns only if neither that program nor, as a fallback, this one can be executed.
fn go_on_as(program: &Path, args: &RunArgs) -> CommandError {
    let this = Path::new("/proc/self/exe");
    let run = |program: &Path| {
        let mut command = Command::new(program);
        command.arg0("touchline").args(["run", "--adopt", "--instance", &args.instance]);
        command.args(args.quiet.then_some("--quiet"));
        command.args(args.watch.then_some("--watch"));
        if let Some(report) = &args.report {
            command.arg("--report").arg(report);
        }
        descriptors::keep_from_programs_run_now();
        command.exec()
    };
    let error = run(program);
    runtime::tell!("touchline: {}: {error}; the old program goes on", program.display());
    format!("the supervisor cannot go on: {}", run(this)).into()
}

/// Paths become absolute, because a supervisor may be restarted from another directory.
fn absolute(source: Source) -> Result<Source, CommandError> {
    Ok(match source {
        Source::Pictures(path) => Source::Pictures(
            path.canonicalize().map_err(|error| format!("{}: {error}", path.display()))?,
        ),
        Source::Recording(playlist) => {
            let path = &playlist.path;
            let path =
                path.canonicalize().map_err(|error| format!("{}: {error}", path.display()))?;
            Source::Recording(Playlist { path, ..playlist })
        }
        // A device may appear later.
        Source::V4l2(path) => Source::V4l2(std::path::absolute(path)?),
        Source::Synthetic | Source::Loop(_) | Source::Genicam(_) | Source::External => source,
    })
}

/// Creates the report, which must not be a file that the group reads.
fn report(path: &Path, args: &RunArgs) -> Result<File, CommandError> {
    let mut inputs: Vec<&Path> = args.config.iter().map(|path| &**path).collect();
    match &args.source {
        Source::Pictures(path) | Source::Recording(Playlist { path, .. }) => inputs.push(path),
        _ => {}
    }
    Ok(Rule { inputs: &inputs, force: false }.create_report(path)?)
}
