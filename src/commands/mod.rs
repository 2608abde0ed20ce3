//! The subcommands.

mod ask_program;
mod calibrate;
mod cameras;
mod config;
mod console;
mod detect;
mod doctor;
mod from_group;
mod group;
mod learn;
mod operate;
mod picture_file;
mod recordings;
mod reload;
mod run;
mod score;
mod setup_worker;
mod step;
mod topics;
mod watch;

use crate::cli::{AttendantArgs, Cli, Command, GrabberArgs, StageArgs};
use ::config::Config;
use ::config::snapshot::Snapshot;
use client::instance::Instance;
use grabber::process::GrabberOptions;
use messages::ProcessKind;
use messages::stages::StageId;
use runtime::process::{ProcessError, ProcessOptions};
use std::error::Error;
use std::process::ExitCode;
use touchline::attendants::Row;
use touchline::supervisor::process_name;

/// Error of a command; its text is for the user.
pub type CommandError = Box<dyn Error>;

/// Carries out a command line.
pub fn execute(cli: Cli) -> Result<ExitCode, CommandError> {
    match cli.command {
        None => run::run(crate::cli::default_run()),
        Some(Command::Run(args)) => run::run(args),
        Some(Command::Console(args)) => console::console(args),
        Some(Command::Detect(args)) => detect::detect(args),
        Some(Command::Calibrate(args)) => calibrate::calibrate(args),
        Some(Command::Learn(args)) => learn::learn(args),
        Some(Command::Score(args)) => score::score(args),
        Some(Command::Cameras(args)) => cameras::cameras(args),
        Some(Command::Step(args)) => step::step(args),
        Some(Command::Status(args)) => group::status(args),
        Some(Command::Stop(args)) => group::stop(args),
        Some(Command::Restart(args)) => operate::restart(args),
        Some(Command::Upgrade(args)) => operate::upgrade(args),
        Some(Command::Reload(args)) => reload::reload(args),
        Some(Command::Rollback(args)) => reload::rollback(args),
        Some(Command::Interface) => operate::interface(),
        Some(Command::Doctor(args)) => doctor::doctor(args),
        Some(Command::Chaos(args)) => trials::chaos::chaos(args),
        Some(Command::Bench(args)) => trials::bench::bench(args),
        Some(Command::Stress(args)) => trials::stress::stress(args),
        Some(Command::Bystander(args)) => trials::chaos::attach(&args),
        Some(Command::Topics(args)) => topics::topics(args),
        Some(Command::Record(args)) => recordings::record(args),
        Some(Command::Info(args)) => recordings::info(args),
        Some(Command::Replay(args)) => recordings::replay(args),
        Some(Command::Export(args)) => recordings::export(args),
        Some(Command::Recover(args)) => recordings::recover(args),
        Some(Command::SetupWorker(args)) => setup_worker::work(args),
        Some(Command::RecordingViewer(args)) => recordings::view(args),
        Some(Command::Config(command)) => config::execute(command),
        Some(Command::Grabber(args)) => grabber_stage(args),
        Some(Command::Classifier(args)) => {
            stage(ProcessKind::Classifier, args, classifier::process::run)
        }
        Some(Command::Tracker(args)) => stage(ProcessKind::Tracker, args, tracker::process::run),
        Some(Command::Filter(args)) => stage(ProcessKind::Filter, args, filter::process::run),
    }
}

fn stage(
    kind: ProcessKind,
    args: StageArgs,
    run: impl FnOnce(&ProcessOptions, &Config) -> Result<(), ProcessError>,
) -> Result<ExitCode, CommandError> {
    let snapshot = match &args.config {
        // The supervisor has checked it.
        Some(path) if args.supervised => Snapshot::load_accepted(path)?,
        Some(path) => Snapshot::load(path)?,
        None => Snapshot::of_user(Config::default()),
    };
    let instance = Instance::new(&args.instance.instance)?;
    instance.create_directory()?;
    let stage = StageId::new(kind, args.lane);
    name_process(&stage.to_string());
    let StageArgs { lane, spare, supervised, .. } = args;
    let revision = snapshot.revision;
    run(&ProcessOptions { instance, lane, revision, spare, supervised }, &snapshot.config)
        .map_err(|error| format!("{stage}: {error}"))?;
    Ok(ExitCode::SUCCESS)
}

fn grabber_stage(args: GrabberArgs) -> Result<ExitCode, CommandError> {
    let options = GrabberOptions {
        source: args.source,
        frames: args.frames,
        resume_after: args.resume_after,
    };
    stage(ProcessKind::Grabber, args.stage, |process, config| {
        grabber::process::run(process, &options, config)
    })
}

/// Runs an attendant's process.
pub fn attend(row: &Row, args: AttendantArgs) -> Result<ExitCode, CommandError> {
    let instance = Instance::new(&args.instance.instance)?;
    instance.check_directory()?;
    let config = Config::load(&args.config.unwrap_or_else(|| instance.config_path()))?;
    name_process(row.name());
    (row.run)(&instance, &config, args.supervised)
        .map_err(|error| format!("{}: {error}", row.name()))?;
    Ok(ExitCode::SUCCESS)
}

fn name_process(name: &str) {
    if let Ok(name) = std::ffi::CString::new(process_name(name)) {
        // A failure is harmless: the name is only for display.
        let _ = rustix::thread::set_name(&name);
    }
}
