//! The group under test: the real program as a child process, in its own runtime directory.

use super::leaks::{self, Leftovers};
use super::population;
use crate::TrialError;
use client::instance::{Instance, RUNTIME_DIR_VARIABLE};
use config::commented_toml;
use config::snapshot::Snapshot;
use control::{Report, Request, read_status};
use grabber::source::Source;
use messages::ProcessKind;
use runtime::descriptors;
use rustix::process::{Pid, Signal, kill_process};
use std::fs::{self, DirBuilder, File};
use std::os::unix::fs::DirBuilderExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Longest time for starting, ending and other events, on a slow and busy machine.
pub const PATIENCE: Duration = Duration::from_secs(30);
/// If this program is killed, the match ends by itself this long after its planned end.
const SPARE_TIME_S: f64 = 300.0;
/// Bytes of the log that an error message repeats.
pub const LAST_WORDS: usize = 4000;
/// Time between two checks of a condition.
const LOOK: Duration = Duration::from_millis(10);

/// A running group. Dropping it ends it, whatever its state.
pub struct Group {
    /// Its name and directories.
    pub instance: Instance,
    place: PathBuf,
    args: Vec<String>,
    supervisor: Child,
}

impl Group {
    /// Starts a match.
    pub fn start(
        config: Option<&Path>,
        source: &Source,
        fps: f64,
        seconds: f64,
    ) -> Result<Self, TrialError> {
        let name = format!("chaos-{}", std::process::id());
        let place = std::env::temp_dir().join(format!("tl-{name}"));
        DirBuilder::new()
            .mode(0o700)
            .create(&place)
            .map_err(|error| format!("{}: {error}", place.display()))?;
        let place = place.canonicalize()?;
        let instance = Instance::below(&place.join("run"), &name)?;
        let mut args: Vec<String> =
            ["run", "--quiet", "--no-console", "--instance"].map(Into::into).into();
        args.extend([name, "--fps".into(), fps.to_string()]);
        args.extend(["--source".into(), source.to_string()]);
        args.extend(["--seconds".into(), (seconds + SPARE_TIME_S).to_string()]);
        if let Some(config) = config {
            let config =
                config.canonicalize().map_err(|error| format!("{}: {error}", config.display()))?;
            args.extend(["--config".into(), config.to_string_lossy().into_owned()]);
        }
        let supervisor = spawn(&place, &args)?;
        let mut group = Self { instance, place, args, supervisor };
        // The configuration is written once the shared memory is cleared and ready for attaching.
        group.wait_for("the group to start", |group| group.instance.config_path().exists())?;
        Ok(group)
    }

    /// Process id of the supervisor.
    pub fn supervisor_pid(&self) -> u32 {
        self.supervisor.id()
    }

    /// Kills the supervisor, starts a new one and returns at once.
    pub fn replace_supervisor(&mut self) -> Result<(), TrialError> {
        self.supervisor.kill()?;
        self.supervisor.wait()?;
        self.supervisor = spawn(&self.place, &self.args)?;
        Ok(())
    }

    /// Asks the supervisor to replace a stage's active process; `false` if there is no supervisor.
    pub fn restart(&self, stage: ProcessKind) -> Result<bool, TrialError> {
        let request = Request::Restart(vec![stage.name().into()]);
        match control::ask(&self.instance, &request, PATIENCE) {
            Ok(answer) => Ok(answer.map(|_| true)?),
            Err(_) => Ok(false),
        }
    }

    /// Asks the supervisor to go over to another configuration, in which two colours have changed their
    /// class numbers and commands act at another time; `false` if there is no supervisor.
    pub fn reload(&self) -> Result<bool, TrialError> {
        let Ok(mut snapshot) = Snapshot::load(&self.instance.config_path()) else {
            return Ok(false);
        };
        let config = &mut snapshot.config;
        config.colors.swap(0, 1);
        config.filter.actuation_delay_ms = 100.0 - config.filter.actuation_delay_ms + 1.0;
        let candidate = self.place.join("candidate.toml");
        std::fs::write(&candidate, commented_toml(config))?;
        let request = Request::Reload { file: candidate, base: None };
        match control::ask(&self.instance, &request, PATIENCE) {
            Ok(answer) => Ok(answer.map(|_| true)?),
            Err(_) => Ok(false),
        }
    }

    /// Whether the group replaces processes of this kind with this revision of the configuration: after a
    /// reload, or when a configuration is taken back because disturbed processes count against it.
    pub fn is_outdated(&self, kind: ProcessKind, revision: u32) -> bool {
        let snapshot = Snapshot::load(&self.instance.config_path());
        snapshot.is_ok_and(|snapshot| revision < snapshot.needed(kind))
    }

    /// An error with the end of its log, if the supervisor has ended by itself.
    pub fn check(&mut self) -> Result<(), TrialError> {
        match self.supervisor.try_wait()? {
            None => Ok(()),
            Some(status) => {
                Err(format!("the supervisor ended by itself ({status}):\n{}", self.log(LAST_WORDS))
                    .into())
            }
        }
    }

    /// Waits for a condition; an error if it takes too long.
    pub fn wait_for(
        &mut self,
        what: &str,
        mut is_so: impl FnMut(&Self) -> bool,
    ) -> Result<(), TrialError> {
        let deadline = Instant::now() + PATIENCE;
        while !is_so(self) {
            self.check()?;
            if Instant::now() > deadline {
                return Err(format!("waited in vain for {what}:\n{}", self.log(LAST_WORDS)).into());
            }
            std::thread::sleep(LOOK);
        }
        Ok(())
    }

    /// The status that the group reports.
    pub fn status(&self) -> Option<Report> {
        read_status(&self.instance, Duration::from_secs(3)).ok().flatten()
    }

    /// Ends the group and collects what it leaves behind.
    pub fn end(mut self) -> Leftovers {
        let namespace = self.instance.namespace().ok().flatten();
        self.signal_supervisor(Signal::TERM);
        let deadline = Instant::now() + PATIENCE;
        let mut status = None;
        while status.is_none() && Instant::now() < deadline {
            std::thread::sleep(LOOK);
            status = self.supervisor.try_wait().ok().flatten();
        }
        Leftovers {
            ended_in_order: status.is_some_and(|status| status.success()),
            ..leaks::leftovers(&self.instance, namespace.as_ref())
        }
    }

    /// The end of the supervisors' log, which has one line for every event.
    pub fn log(&self, bytes: usize) -> String {
        let text = fs::read(self.place.join("log")).unwrap_or_default();
        let tail = &text[text.len().saturating_sub(bytes)..];
        String::from_utf8_lossy(tail).trim().into()
    }

    /// Sends the supervisor a signal.
    pub fn signal_supervisor(&self, signal: Signal) {
        // The supervisor is not reaped before it is waited for, so its process id is not reused.
        if let Some(pid) = Pid::from_raw(self.supervisor.id() as i32) {
            let _ = kill_process(pid, signal);
        }
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        let running = |child: &mut Child| matches!(child.try_wait(), Ok(None));
        if running(&mut self.supervisor) {
            self.signal_supervisor(Signal::TERM);
            let deadline = Instant::now() + PATIENCE;
            while running(&mut self.supervisor) && Instant::now() < deadline {
                std::thread::sleep(LOOK);
            }
        }
        let _ = self.supervisor.kill();
        let _ = self.supervisor.wait();
        for pid in leaks::processes(self.instance.name()) {
            if let Some(pidfd) = population::hold(pid, self.instance.name()) {
                let _ = rustix::process::pidfd_send_signal(&pidfd, Signal::KILL);
            }
        }
        let deadline = Instant::now() + PATIENCE;
        while !leaks::processes(self.instance.name()).is_empty() && Instant::now() < deadline {
            std::thread::sleep(LOOK);
        }
        let _ = self.instance.remove_namespace();
        let _ = fs::remove_dir_all(&self.place);
    }
}

/// Starts the very image that this program runs, even if its file has been replaced. Ctrl-C in the
/// terminal goes to this program alone, which ends the group in order.
fn spawn(place: &Path, args: &[String]) -> Result<Child, TrialError> {
    let log = File::options().create(true).append(true).open(place.join("log"))?;
    descriptors::keep_from_programs_run_now();
    Ok(Command::new("/proc/self/exe")
        .arg0("touchline")
        .args(args)
        .env(RUNTIME_DIR_VARIABLE, place.join("run"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(log)
        .process_group(0)
        .spawn()?)
}
