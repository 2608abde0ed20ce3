//! Programs that attach to the match and behave badly: the sleeper is frozen for ten seconds again and
//! again; the flapper is killed a tenth of a second after it has attached, and comes back.

use super::population::has_ended;
use super::vandal::publish_garbage;
use crate::TrialError;
use crate::args::BystanderArgs;
use client::bus::Bus;
use client::instance::{Instance, RUNTIME_DIR_VARIABLE};
use messages::topics;
use runtime::descriptors;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::OwnedFd;
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};
use serde::Serialize;
use std::io::Write as _;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::{Duration, Instant};

/// Time between two attachments of the flapper.
const FLAP: Duration = Duration::from_millis(100);
/// Time for which the sleeper is frozen …
const FROZEN: Duration = Duration::from_secs(10);
/// … and time for which it then keeps up.
const AWAKE: Duration = Duration::from_secs(1);
/// Time between two reads of a bystander from its topics.
const LOOK: Duration = Duration::from_millis(5);

/// Counts of what happened to the bystanders.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Fate {
    /// Bystanders that attached and were killed.
    pub killed: u64,
    /// Freezes of the sleeper.
    pub frozen: u64,
    /// Bystanders that could not attach, or ended by themselves.
    pub failed: u64,
}

/// The bystanders of a match. Dropping them ends them.
#[derive(Debug)]
pub struct Bystanders {
    instance: Instance,
    sleeper: Bystander,
    sleeps: bool,
    sleeper_turns_at: Instant,
    flapper: Option<Bystander>,
    flaps_at: Instant,
    /// Counts so far.
    pub fate: Fate,
}

impl Bystanders {
    /// Lets them attach to a match.
    pub fn start(instance: &Instance) -> Result<Self, TrialError> {
        let now = Instant::now();
        Ok(Self {
            instance: instance.clone(),
            sleeper: Bystander::start(instance)?,
            sleeps: false,
            sleeper_turns_at: now + AWAKE,
            flapper: None,
            flaps_at: now,
            fate: Fate::default(),
        })
    }

    /// Freezes, wakes, kills and starts bystanders when it is time.
    pub fn look(&mut self) -> Result<(), TrialError> {
        let now = Instant::now();
        if now >= self.sleeper_turns_at {
            if has_ended(&self.sleeper.pidfd) {
                self.fate.failed += 1;
                self.sleeper = Bystander::start(&self.instance)?;
                self.sleeps = true; // to be woken in a moment: it is awake
            }
            self.sleeps = !self.sleeps;
            self.sleeper.signal(if self.sleeps { Signal::STOP } else { Signal::CONT });
            self.fate.frozen += u64::from(self.sleeps);
            self.sleeper_turns_at = now + if self.sleeps { FROZEN } else { AWAKE };
        }
        match &self.flapper {
            None if now >= self.flaps_at => {
                self.flapper = Some(Bystander::start(&self.instance)?);
                self.flaps_at = now + FLAP;
            }
            // Attaching takes longer on a busy machine; the flapper is killed only once it has attached.
            Some(flapper) if now >= self.flaps_at && flapper.has_attached() => {
                self.fate.killed += 1;
                self.flapper = None;
            }
            Some(flapper) if has_ended(&flapper.pidfd) => {
                self.fate.failed += 1;
                self.flapper = None;
            }
            _ => {}
        }
        Ok(())
    }
}

/// A process that attaches, reads, and is killed when it is dropped.
#[derive(Debug)]
struct Bystander {
    child: Child,
    pidfd: OwnedFd,
}

impl Bystander {
    fn start(instance: &Instance) -> Result<Self, TrialError> {
        let places = instance.directory().parent().unwrap_or(instance.directory());
        descriptors::keep_from_programs_run_now();
        let child = Command::new("/proc/self/exe")
            .arg0("touchline")
            .args(["bystander", "--instance", instance.name()])
            .env(RUNTIME_DIR_VARIABLE, places)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .process_group(0)
            .spawn()?;
        let pidfd = pidfd_open(Pid::from_child(&child), PidfdFlags::empty())?;
        Ok(Self { child, pidfd })
    }

    /// Whether it has reported that it is attached.
    fn has_attached(&self) -> bool {
        let Some(said) = &self.child.stdout else { return false };
        let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
        let mut fds = [PollFd::new(said, PollFlags::IN)];
        poll(&mut fds, Some(&at_once)).is_ok() && fds[0].revents().contains(PollFlags::IN)
    }

    fn signal(&self, signal: Signal) {
        // Its end is noticed elsewhere.
        let _ = pidfd_send_signal(&self.pidfd, signal);
    }
}

impl Drop for Bystander {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// `touchline bystander`: attaches to a group as a user's program would, reports it, and reads until it
/// is killed or its parent is gone.
pub fn attach(args: &BystanderArgs) -> Result<ExitCode, TrialError> {
    if let Some(ms) = args.rubbish {
        return publish_garbage(args, Duration::from_millis(ms));
    }
    let parent = rustix::process::getppid();
    let instance = Instance::new(&args.instance)?;
    let bus = Bus::join(&instance, "bystander")?;
    let world = bus.subscriber(&topics::WORLD)?;
    let mut out = std::io::stdout();
    writeln!(out, "attached")?;
    out.flush()?;
    while rustix::process::getppid() == parent {
        while world.receive()?.is_some() {}
        std::thread::sleep(LOOK);
    }
    Ok(ExitCode::SUCCESS)
}
