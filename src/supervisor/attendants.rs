//! Keeps the attendants running. They never affect the stages, so they have rules of their own: an attendant
//! is started when the group is complete, and restarted, with growing pauses, when it has ended or sends no
//! heartbeats.

use super::children::{self, End};
use super::log::Log;
use super::policy::Settings;
use super::sys::{self, Call};
use super::{GRACE, SupervisorError};
use crate::attendants::{AttendantError, Row, TABLE};
use crate::monitor::AttendantView;
use client::bus::participants;
use client::instance::Instance;
use config::Config;
use config::change::Change;
use messages::EventKind;
use std::fs;
use std::process::Child;
use std::time::{Duration, Instant};

/// Silence after which an attendant is killed. It sends ten heartbeats a second, and no busy
/// machine delays them this long.
const SILENCE_NS: u64 = 5_000_000_000;
/// Time to end before it is killed; it holds no data that could be lost.
const LAST_MOMENTS: Duration = Duration::from_millis(300);
const LAST_MOMENTS_NS: u64 = LAST_MOMENTS.as_nanos() as u64;
/// Uptime that resets the back-off.
const GOOD_START_NS: u64 = 10_000_000_000;

/// Pause before an attendant that could not be prepared is prepared again.
const PREPARE_PAUSE_NS: u64 = 1_000_000_000;

/// The attendants of a group.
pub struct Attendants {
    supervised: Vec<Supervised>,
    /// Those that the system has refused something at a takeover; tried again.
    unprepared: Vec<&'static Row>,
    prepare_after_ns: u64,
    instance: Instance,
    config: Config,
}

/// An attendant and its process.
struct Supervised {
    row: &'static Row,
    instance: Instance,
    running: Option<Running>,
    rules: Rules,
    starts: u64,
    /// Time at which a user asked for a restart: the end of this process is then no failure.
    restart_ns: Option<u64>,
}

struct Running {
    child: Child,
    log: Log,
}

/// An event of an attendant.
pub struct Happened {
    /// Its name.
    pub name: &'static str,
    /// Kind of the event.
    pub kind: EventKind,
    /// Its process; 0 for none.
    pub pid: u32,
    /// Description.
    pub what: String,
    /// The last lines it wrote.
    pub evidence: String,
}

impl Attendants {
    /// Prepares the attendants that the configuration asks for. An error ends the start, unless the
    /// group `lives` already: then the match goes on without that attendant, which is tried again.
    pub fn prepare(
        instance: &Instance,
        config: &Config,
        lives: bool,
    ) -> Result<Self, AttendantError> {
        let mut attendants = Self {
            supervised: vec![],
            unprepared: vec![],
            prepare_after_ns: 0,
            instance: instance.clone(),
            config: config.clone(),
        };
        for row in &TABLE {
            match attendants.prepare_one(row) {
                Ok(()) => {}
                Err(error) if lives => {
                    runtime::tell!(
                        "touchline: {error}; the match goes on without the {}, which is tried again",
                        row.name()
                    );
                    attendants.unprepared.push(row);
                }
                Err(error) => return Err(error),
            }
        }
        Ok(attendants)
    }

    fn prepare_one(&mut self, row: &'static Row) -> Result<(), AttendantError> {
        sys::check(Call::PrepareAttendant)?;
        if (row.prepare)(&self.instance, &self.config)? {
            self.supervised.push(Supervised::new(row, &self.instance));
        }
        Ok(())
    }

    fn prepare_again(&mut self, now_ns: u64) {
        if self.unprepared.is_empty() || now_ns < self.prepare_after_ns {
            return;
        }
        self.prepare_after_ns = now_ns + PREPARE_PAUSE_NS;
        for row in std::mem::take(&mut self.unprepared) {
            if self.prepare_one(row).is_err() {
                self.unprepared.push(row);
            }
        }
    }

    /// Records a heartbeat of an attendant.
    pub fn heard(&mut self, pid: u32, now_ns: u64) {
        for attendant in self.supervised.iter_mut().filter(|attendant| attendant.pid() == Some(pid))
        {
            attendant.rules.heard_ns = now_ns;
        }
    }

    /// Starts, reaps and kills attendants as due; returns the events.
    pub fn tend(&mut self, settings: &Settings, now_ns: u64) -> Vec<Happened> {
        self.prepare_again(now_ns);
        self.supervised
            .iter_mut()
            .filter_map(|attendant| attendant.tend(settings, now_ns))
            .collect()
    }

    /// Whether the group has the attendant of this name.
    pub fn has(&self, name: &str) -> bool {
        self.supervised.iter().any(|attendant| attendant.row.name() == name)
    }

    /// Replaces the process of the attendant of this name; one that waits for its next start is
    /// started at once.
    pub fn restart(&mut self, name: &str, now_ns: u64) {
        for attendant in self.supervised.iter_mut().filter(|attendant| attendant.row.name() == name)
        {
            match attendant.pid() {
                Some(pid) => {
                    attendant.restart_ns = Some(now_ns);
                    super::takeover::terminate(pid);
                }
                None => attendant.rules = Rules { start_after_ns: now_ns, ..Rules::default() },
            }
        }
    }

    /// Replaces the processes of those that a change of the configuration concerns.
    pub fn go_over(&mut self, config: &Config, changes: &[Change], now_ns: u64) {
        self.config = config.clone();
        let is_concerned = |row: &&Row| changes.iter().any(|change| row.is_concerned(change));
        for row in TABLE.iter().filter(is_concerned) {
            self.restart(row.name(), now_ns);
        }
    }

    /// The attendants for the report.
    pub fn view(&self) -> Vec<AttendantView> {
        let view = |attendant: &Supervised| AttendantView {
            name: attendant.row.name(),
            pid: attendant.pid(),
            restarts: attendant.starts.saturating_sub(1),
        };
        self.supervised.iter().map(view).collect()
    }

    /// Ends them, in order if they listen.
    pub fn end(&mut self) {
        for running in self.supervised.iter().filter_map(|attendant| attendant.running.as_ref()) {
            super::takeover::terminate(running.child.id());
        }
        let deadline = Instant::now() + LAST_MOMENTS;
        for running in self.supervised.iter_mut().filter_map(|attendant| attendant.running.as_mut())
        {
            while Instant::now() < deadline && matches!(running.child.try_wait(), Ok(None)) {
                std::thread::sleep(Duration::from_millis(5));
            }
            let _ = running.child.kill();
            let _ = running.child.wait();
        }
        self.supervised.clear();
    }
}

impl Supervised {
    fn new(row: &'static Row, instance: &Instance) -> Self {
        let rules = Rules::default();
        Self { row, instance: instance.clone(), running: None, rules, starts: 0, restart_ns: None }
    }

    fn pid(&self) -> Option<u32> {
        self.running.as_ref().map(|running| running.child.id())
    }

    fn tend(&mut self, settings: &Settings, now_ns: u64) -> Option<Happened> {
        let happened = self.reap(settings, now_ns);
        if happened.is_some() {
            return happened;
        }
        match &mut self.running {
            Some(running) if self.rules.is_silent(now_ns) => {
                self.rules.heard_ns = now_ns;
                let pid = running.child.id();
                // It is our child and was not reaped yet, so the pid is still its own.
                let _ = running.child.kill();
                Some(self.happened(EventKind::Killed, pid, "killed: it gave no sign of life", ""))
            }
            Some(running) if self.restart_ns.is_some_and(|at| now_ns > at + LAST_MOMENTS_NS) => {
                let _ = running.child.kill();
                None
            }
            None if self.rules.may_start(now_ns) => self.start(settings, now_ns),
            _ => None,
        }
    }

    fn start(&mut self, settings: &Settings, now_ns: u64) -> Option<Happened> {
        self.starts += 1;
        self.rules.started(now_ns);
        let log = Log::new(self.row.name());
        let mut command = children::command(&self.instance, self.row.name(), &log);
        runtime::descriptors::keep_from_programs_run_now();
        match sys::ask(Call::StartProcess, || command.spawn()) {
            Ok(child) => {
                self.running = Some(Running { child, log });
                None
            }
            Err(error) => {
                self.rules.ended(settings, now_ns);
                let what = format!("cannot be started: {error}");
                Some(self.happened(EventKind::Other, 0, &what, ""))
            }
        }
    }

    fn reap(&mut self, settings: &Settings, now_ns: u64) -> Option<Happened> {
        let running = self.running.as_mut()?;
        let End { how, last_words, .. } = children::end_of(&mut running.child, &running.log)?;
        let pid = running.child.id();
        self.running = None;
        if self.restart_ns.take().is_some() {
            self.rules = Rules { start_after_ns: now_ns, ..Rules::default() };
            return Some(self.happened(EventKind::Retired, pid, "ended: asked to restart", ""));
        }
        self.rules.ended(settings, now_ns);
        Some(self.happened(EventKind::Ended, pid, &how, &last_words))
    }

    fn happened(&self, kind: EventKind, pid: u32, what: &str, evidence: &str) -> Happened {
        Happened { name: self.row.name(), kind, pid, what: what.into(), evidence: evidence.into() }
    }
}

/// Rules for starting and killing an attendant; use neither a clock nor a process.
#[derive(Debug, Default)]
struct Rules {
    failures: u32,
    started_ns: u64,
    start_after_ns: u64,
    heard_ns: u64,
}

impl Rules {
    fn started(&mut self, now_ns: u64) {
        (self.started_ns, self.heard_ns) = (now_ns, now_ns);
    }

    fn ended(&mut self, settings: &Settings, now_ns: u64) {
        let good_start = now_ns.saturating_sub(self.started_ns) >= GOOD_START_NS;
        self.failures = if good_start { 1 } else { self.failures + 1 };
        self.start_after_ns = now_ns + settings.backoff(self.failures);
    }

    fn may_start(&self, now_ns: u64) -> bool {
        now_ns >= self.start_after_ns
    }

    fn is_silent(&self, now_ns: u64) -> bool {
        now_ns.saturating_sub(self.heard_ns) > SILENCE_NS
    }
}

/// Ends the attendants of an earlier supervisor; their clients reconnect. No living process of the
/// group depends on them.
pub fn end_earlier(instance: &Instance) -> Result<(), SupervisorError> {
    let deadline = Instant::now() + GRACE;
    loop {
        sys::check(Call::ListProcesses)?;
        let living = participants::living(instance)?;
        // Other programs may use any name.
        let is_ours = |pid: u32, name: &str| {
            let comm = fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
            comm.trim_end() == children::process_name(name)
        };
        let is_attendant = |name: &str| TABLE.iter().any(|row| row.name() == name);
        let mut is_over = true;
        for process in
            living.iter().filter(|it| is_attendant(&it.name) && is_ours(it.pid, &it.name))
        {
            is_over = false;
            super::takeover::kill(process.pid);
        }
        if is_over || Instant::now() > deadline {
            return Ok(());
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    fn settings() -> Settings {
        Settings {
            stall_ns: S,
            grabber_stall_ns: S,
            grabber_stuck_ns: S,
            ready_timeout_ns: S,
            backoff_ns: S / 10,
            backoff_max_ns: 5 * S,
            graph: messages::stages::StageGraph::SINGLE,
            spares: vec![],
        }
    }

    #[test]
    fn the_first_restart_comes_at_once_and_repeated_failures_delay_it() {
        let (mut rules, settings) = (Rules::default(), settings());
        let mut now_ns = 100 * S;
        assert!(rules.may_start(now_ns));
        let mut pauses = Vec::new();
        for _ in 0..10 {
            rules.started(now_ns);
            now_ns += S / 100;
            rules.ended(&settings, now_ns);
            let failed_ns = now_ns;
            while !rules.may_start(now_ns) {
                now_ns += S / 100;
            }
            pauses.push((now_ns - failed_ns) * 10 / S);
        }
        assert_eq!(pauses, [0, 1, 2, 4, 8, 16, 32, 50, 50, 50]);
        rules.started(now_ns);
        now_ns += GOOD_START_NS;
        rules.ended(&settings, now_ns);
        assert!(rules.may_start(now_ns), "it had worked well");
    }

    #[test]
    fn long_silence_is_detected() {
        let mut rules = Rules::default();
        rules.started(S);
        assert!(!rules.is_silent(S + SILENCE_NS));
        assert!(rules.is_silent(S + SILENCE_NS + 1));
        rules.heard_ns = S + SILENCE_NS;
        assert!(!rules.is_silent(S + SILENCE_NS + 1));
    }
}
