//! Keeps the gateway running, in a group that other users may attach to. Nothing that happens to it
//! concerns the stages, so it has rules of its own: it is started when the group is complete, and
//! started again, with growing pauses, when it has ended or gives no sign of life.

use super::children::{self, End};
use super::log::Log;
use super::policy::Settings;
use super::sys::{self, Call};
use super::{GRACE, SupervisorError};
use crate::gateway::permissions::Permissions;
use crate::gateway::{NAME, place};
use crate::monitor::GatewayView;
use common::bus::participants;
use common::config::Config;
use common::instance::Instance;
use common::messages::EventKind;
use std::fs;
use std::process::Child;
use std::time::{Duration, Instant};

/// It gives a sign ten times a second; so long a silence is no busy machine any more.
const SILENCE_NS: u64 = 5_000_000_000;
/// It holds nothing that would be lost with it.
const LAST_MOMENTS: Duration = Duration::from_millis(300);
/// Who has lived so long has started well.
const GOOD_START_NS: u64 = 10_000_000_000;

/// Looks after the gateway.
pub struct Gateway {
    instance: Instance,
    group: String,
    running: Option<Running>,
    rules: Rules,
    view: GatewayView,
    starts: u64,
}

struct Running {
    child: Child,
    log: Log,
}

/// What has happened to it.
pub struct Happened {
    /// What kind of thing.
    pub kind: EventKind,
    /// Its process.
    pub pid: u32,
    /// In words.
    pub what: String,
    /// The last lines it wrote.
    pub evidence: String,
}

impl Gateway {
    /// Prepares the way for the configured group of users; `None` when there is none.
    pub fn prepare(instance: &Instance, config: &Config) -> Result<Option<Self>, SupervisorError> {
        let Some(group) = config.access.group() else {
            // What an earlier group has left, with another configuration.
            instance.remove_gateway_directory()?;
            return Ok(None);
        };
        // What the gateway would fail at is said before it is started.
        Permissions::of(&config.access)?;
        if let Some(closed) = place::prepare(instance, group)? {
            common::tell!("touchline: {}", place::advice(&closed, group));
        }
        let socket = instance.gateway_path().display().to_string();
        Ok(Some(Self {
            instance: instance.clone(),
            group: group.into(),
            running: None,
            rules: Rules::default(),
            view: GatewayView { group: group.into(), socket, ..GatewayView::default() },
            starts: 0,
        }))
    }

    /// It has given a sign of life.
    pub fn heard(&mut self, pid: u32, now_ns: u64) {
        if self.view.pid == Some(pid) {
            self.rules.heard_ns = now_ns;
        }
    }

    /// Does what there is to do; returns what has happened.
    pub fn tend(&mut self, settings: &Settings, now_ns: u64) -> Option<Happened> {
        let happened = self.reap(settings, now_ns);
        if happened.is_some() {
            return happened;
        }
        match &mut self.running {
            Some(running) if self.rules.is_silent(now_ns) => {
                self.rules.heard_ns = now_ns;
                let pid = running.child.id();
                // It is our child, and was not waited for: the number is still its own.
                let _ = running.child.kill();
                let what = "killed: it gave no sign of life".into();
                Some(Happened { kind: EventKind::Killed, pid, what, evidence: String::new() })
            }
            None if self.rules.may_start(now_ns) => self.start(settings, now_ns),
            _ => None,
        }
    }

    /// As the report shows it.
    pub fn view(&self) -> GatewayView {
        self.view.clone()
    }

    /// Ends it, in order if it listens.
    pub fn end(mut self) {
        let Some(mut running) = self.running.take() else { return };
        super::takeover::terminate(running.child.id());
        let deadline = Instant::now() + LAST_MOMENTS;
        while Instant::now() < deadline && matches!(running.child.try_wait(), Ok(None)) {
            std::thread::sleep(Duration::from_millis(5));
        }
        let _ = running.child.kill();
        let _ = running.child.wait();
    }

    fn start(&mut self, settings: &Settings, now_ns: u64) -> Option<Happened> {
        self.starts += 1;
        self.rules.started(now_ns);
        let log = Log::new(NAME);
        let mut command = children::command(&self.instance, NAME, &log);
        common::descriptors::keep_from_programs_run_now();
        let spawned = sys::ask(Call::StartProcess, || command.spawn());
        match spawned {
            Ok(child) => {
                self.view.pid = Some(child.id());
                self.view.restarts = self.starts - 1;
                self.running = Some(Running { child, log });
                None
            }
            Err(error) => {
                self.rules.ended(settings, now_ns);
                let what = format!("{} cannot be served: {error}", self.group);
                Some(Happened { kind: EventKind::Other, pid: 0, what, evidence: String::new() })
            }
        }
    }

    fn reap(&mut self, settings: &Settings, now_ns: u64) -> Option<Happened> {
        let running = self.running.as_mut()?;
        let End { how, last_words, .. } = children::end_of(&mut running.child, &running.log)?;
        let pid = running.child.id();
        self.running = None;
        self.view.pid = None;
        self.rules.ended(settings, now_ns);
        Some(Happened { kind: EventKind::Ended, pid, what: how, evidence: last_words })
    }
}

/// When to start it, and when to give it up. No clock, no process.
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

/// Ends a gateway that an earlier supervisor has started: its clients come again. Nothing that lives
/// on under a dead supervisor depends on it.
pub fn end_earlier(instance: &Instance) -> Result<(), SupervisorError> {
    let deadline = Instant::now() + GRACE;
    loop {
        let living = participants::living(instance)?;
        // Programs of others may call themselves what they like.
        let is_gateway = |pid: u32| {
            let name = fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
            name.trim_end() == "tl-gateway"
        };
        let gateways = living.iter().filter(|it| it.name == NAME && is_gateway(it.pid));
        let mut is_over = true;
        for gateway in gateways {
            is_over = false;
            super::takeover::kill(gateway.pid);
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
            graph: common::stages::StageGraph::SINGLE,
            spares: vec![],
        }
    }

    #[test]
    fn one_that_falls_is_started_at_once_and_one_that_keeps_falling_ever_later() {
        let (mut rules, settings) = (Rules::default(), settings());
        let mut now_ns = 100 * S;
        assert!(rules.may_start(now_ns));
        let mut pauses = Vec::new();
        for _ in 0..10 {
            rules.started(now_ns);
            now_ns += S / 100;
            rules.ended(&settings, now_ns);
            let fell_ns = now_ns;
            while !rules.may_start(now_ns) {
                now_ns += S / 100;
            }
            pauses.push((now_ns - fell_ns) * 10 / S);
        }
        assert_eq!(pauses, [0, 1, 2, 4, 8, 16, 32, 50, 50, 50]);
        rules.started(now_ns);
        now_ns += GOOD_START_NS;
        rules.ended(&settings, now_ns);
        assert!(rules.may_start(now_ns), "it had worked well");
    }

    #[test]
    fn silence_is_noticed() {
        let mut rules = Rules::default();
        rules.started(S);
        assert!(!rules.is_silent(S + SILENCE_NS));
        assert!(rules.is_silent(S + SILENCE_NS + 1));
        rules.heard_ns = S + SILENCE_NS;
        assert!(!rules.is_silent(S + SILENCE_NS + 1));
    }
}
