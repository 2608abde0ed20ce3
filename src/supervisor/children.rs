//! Starting, signalling and reaping the group's processes.

use super::log::Log;
use super::notify;
use super::overrides::Overrides;
use super::starvation::{ProcessorWait, SchedulerTimes};
use super::sys::{self, Call};
use client::instance::Instance;
use grabber::camera::LastFrame;
use grabber::source::Source;
use messages::stages::StageId;
use runtime::descriptors;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::{AsFd, OwnedFd};
use rustix::io::Errno;
use rustix::process::{
    Pid, PidfdFlags, Signal, WaitId, WaitIdOptions, pidfd_open, pidfd_send_signal, waitid,
};
use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Start options shared by all processes of the group.
#[derive(Debug, Clone)]
pub struct Launch {
    /// The group.
    pub instance: Instance,
    /// Source of the grabber's frames.
    pub source: Source,
    /// Number of frames to capture.
    pub frames: Option<u64>,
    /// Time at which the group is to end, on the monotonic clock.
    pub ends_at_ns: Option<u64>,
    /// The configuration file, for `touchline reload`; an absolute path.
    pub config_file: Option<PathBuf>,
    /// What the command line changes in it.
    pub overrides: Overrides,
}

/// One process of the group.
pub struct Process {
    /// Its stage.
    pub stage: StageId,
    /// Its process id.
    pub pid: u32,
    /// Revision of the configuration that it was started with, or that its last heartbeat names; `None` when
    /// an adopted process has sent none yet.
    pub revision: Option<u32>,
    /// Becomes readable when the process ends.
    pub pidfd: OwnedFd,
    /// `None` for a process that another supervisor has started.
    child: Option<Child>,
    log: Log,
    wait: ProcessorWait,
}

/// How a process ended.
#[derive(Debug, Clone)]
pub struct End {
    /// Exit status or signal, in words.
    pub how: String,
    /// It failed by itself: it was neither killed from outside nor ended in order.
    pub crashed: bool,
    /// It ended with an error, or crashed.
    pub failed: bool,
    /// The last lines it wrote.
    pub last_words: String,
}

impl Process {
    /// Starts a process from the same executable image as this one: even if the file is replaced
    /// meanwhile, a restart never changes the version.
    pub fn start(
        launch: &Launch,
        stage: StageId,
        spare: bool,
        last_frame: Option<LastFrame>,
    ) -> io::Result<Self> {
        let log = Log::new(&stage.to_string());
        let mut command = command(&launch.instance, stage.kind().name(), &log);
        if stage.lane() != 0 {
            command.args(["--lane", &stage.lane().to_string()]);
        }
        if spare {
            command.arg("--spare");
        }
        if stage.is_grabber() {
            command.args(["--source", &launch.source.to_string()]);
            if let Some(frames) = launch.frames {
                command.args(["--frames", &frames.to_string()]);
            }
            if let Some(last) = last_frame {
                command.args(["--resume-after", &format!("{}@{}", last.seq, last.t_capture_ns)]);
            }
        }
        descriptors::keep_from_programs_run_now();
        let mut child = sys::ask(Call::StartProcess, || command.spawn())?;
        let pid = child.id();
        match sys::ask(Call::HoldProcess, || hold(Pid::from_child(&child))) {
            Ok(pidfd) => Ok(Self {
                stage,
                pid,
                revision: None,
                pidfd,
                child: Some(child),
                log,
                wait: Default::default(),
            }),
            Err(error) => {
                // Without a pidfd its end would not be noticed.
                let _ = child.kill().and_then(|()| child.wait());
                Err(error)
            }
        }
    }

    /// Adopts a process that another supervisor started.
    pub fn adopt(stage: StageId, pid: u32) -> io::Result<Self> {
        let id = Pid::from_raw(pid as i32).ok_or(io::ErrorKind::InvalidInput)?;
        let pidfd = sys::ask(Call::HoldProcess, || hold(id))?;
        let log = Log::of_process(pid);
        Ok(Self { stage, pid, revision: None, pidfd, child: None, log, wait: Default::default() })
    }

    /// Sends a signal. If the process has already ended, that is not an error: its end is noticed
    /// separately.
    pub fn signal(&self, signal: Signal) -> io::Result<()> {
        let send = || match pidfd_send_signal(&self.pidfd, signal) {
            Err(Errno::SRCH) => Ok(()),
            sent => Ok(sent?),
        };
        sys::ask(Call::SignalProcess, send)
    }

    /// Scheduling times that the system reports for it.
    pub fn processor_times(&self) -> io::Result<SchedulerTimes> {
        SchedulerTimes::of(self.pid)
    }

    /// Time without a processor while ready to run, since the last call, according to the latest
    /// times.
    pub fn newly_waited_ns(&mut self, times: SchedulerTimes, now_ns: u64) -> u64 {
        self.wait.newly_waited_ns(times, now_ns)
    }

    /// Reaps it: returns how it ended, or `None` while it runs.
    pub fn reap(&mut self) -> Option<End> {
        let Some(child) = &mut self.child else {
            let (how, crashed, failed) = end_of_adopted(&self.pidfd)?;
            return Some(End { how, crashed, failed, last_words: self.log.last_words() });
        };
        end_of(child, &self.log)
    }
}

/// Command that starts a process of the group from the same executable image as this one.
pub fn command(instance: &Instance, name: &str, log: &Log) -> Command {
    let mut command = Command::new("/proc/self/exe");
    command
        .arg0("touchline")
        .arg(name)
        .arg("--supervised")
        .args(["--instance", instance.name()])
        .arg("--config")
        .arg(instance.config_path())
        // Resolving names for a back trace takes longer than a stall; message and place are kept.
        .env("RUST_BACKTRACE", "0")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(log.for_writing())
        // Ctrl-C in the terminal is for the supervisor alone, which ends the group in order.
        .process_group(0);
    for variable in notify::VARIABLES {
        command.env_remove(variable);
    }
    command
}

/// Process name that `ps` and `top` show, as far as the system keeps it: all processes have the
/// same executable file.
pub fn process_name(name: &str) -> String {
    let mut shown = format!("tl-{name}");
    shown.truncate(15);
    shown
}

/// Reaps a child: returns how it ended, or `None` while it runs.
pub fn end_of(child: &mut Child, log: &Log) -> Option<End> {
    let status = sys::ask(Call::ReapProcess, || child.try_wait()).ok().flatten()?;
    let (how, crashed, failed) = describe(status.code(), status.signal());
    Some(End { how, crashed, failed, last_words: log.last_words() })
}

fn hold(pid: Pid) -> io::Result<OwnedFd> {
    Ok(pidfd_open(pid, PidfdFlags::empty())?)
}

/// Executable file of a process, even if it has been replaced or removed since.
pub fn program_of(pid: u32) -> PathBuf {
    format!("/proc/{pid}/exe").into()
}

/// Whether two paths name the same file.
pub fn is_same_program(one: &Path, other: &Path) -> bool {
    let identity = |path: &Path| fs::metadata(path).map(|data| (data.dev(), data.ino()));
    matches!((identity(one), identity(other)), (Ok(one), Ok(other)) if one == other)
}

fn has_ended(pidfd: &OwnedFd) -> bool {
    let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
    poll(&mut [PollFd::new(pidfd, PollFlags::IN)], Some(&at_once)).is_ok_and(|ready| ready > 0)
}

/// How an adopted process ended. After an upgrade this process may still be its parent; otherwise
/// the exit status went to another parent.
fn end_of_adopted(pidfd: &OwnedFd) -> Option<(String, bool, bool)> {
    let at_once = WaitIdOptions::EXITED | WaitIdOptions::NOHANG;
    let ask = || Ok(waitid(WaitId::PidFd(pidfd.as_fd()), at_once)?);
    match sys::ask(Call::ReapProcess, ask) {
        Ok(Some(status)) => Some(describe(status.exit_status(), status.terminating_signal())),
        Ok(None) => None,
        Err(_) => has_ended(pidfd).then(|| ("ended".into(), false, false)),
    }
}

/// Describes an exit, and says whether the process crashed, and whether it crashed or ended with an
/// error.
fn describe(code: Option<i32>, signal: Option<i32>) -> (String, bool, bool) {
    use signal_hook::consts::{SIGKILL, SIGTERM};
    match (code, signal) {
        // Exit status 1 is an orderly end with an error: the stage lacked something such as memory,
        // and no frame caused it.
        (Some(code), _) => (format!("exit status {code}"), code > 1, code != 0),
        (None, Some(signal)) => {
            let name = signal_hook::low_level::signal_name(signal);
            let name = name.map_or_else(|| format!("signal {signal}"), str::to_string);
            {
                let crashed = signal != SIGKILL && signal != SIGTERM;
                (format!("killed by {name}"), crashed, crashed)
            }
        }
        (None, None) => ("ended".into(), false, false),
    }
}
