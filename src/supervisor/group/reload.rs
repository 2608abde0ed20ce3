//! Changes of the configuration in the middle of a match. A change is an upgrade: spares start with the new
//! configuration and take over stage by stage, so no frame is lost.

use super::{Group, settings, tick};
use crate::supervisor::policy::MemberId;
use client::clock::monotonic_ns;
use config::Config;
use config::change::changes;
use control::Event as LogEvent;
use control::{Answer, Done};
use messages::{Attendant, EventKind, ProcessKind};
use std::path::Path;

/// Longest mark, characters.
const MARK_LENGTH: usize = 100;

impl Group<'_> {
    /// Goes over to the configuration in a file, a change that was made from revision `base`.
    pub(super) fn reload(&mut self, file: &Path, base: Option<u32>) -> Answer {
        let before = self.configuration.snapshot().config.clone();
        match self.configuration.accept(file, base, monotonic_ns())? {
            None => Ok(Done::default()),
            Some(kinds) => Ok(self.go_over(&before, &kinds)),
        }
    }

    /// Goes back to the configuration before the present one.
    pub(super) fn roll_back(&mut self, reason: &str) -> Answer {
        let before = self.configuration.snapshot().config.clone();
        let kinds = self.configuration.roll_back(reason)?;
        Ok(self.go_over(&before, &kinds))
    }

    /// Writes a user's words among the events.
    pub(super) fn mark(&mut self, words: &str) -> Answer {
        // They appear on terminals.
        let words: String = words.chars().filter(|c| !c.is_control()).take(MARK_LENGTH).collect();
        if words.trim().is_empty() {
            return Err("a mark needs a word".into());
        }
        let supervisor = Attendant::Supervisor.name();
        self.view.log(LogEvent::new(EventKind::Marked, supervisor, 0, &words, ""));
        Ok(Done::default())
    }

    /// Rolls back a configuration with which processes fail.
    pub(super) fn judge_configuration(&mut self) {
        let now_ns = monotonic_ns();
        if !self.configuration.has_failed(now_ns) {
            return;
        }
        if let Err(error) = self.roll_back("processes fail with it") {
            self.configuration.retry_later(now_ns);
            self.say(&format!(
                "the configuration cannot be rolled back: {error}; it is tried again"
            ));
        }
    }

    /// Counts a failure against a configuration on trial; true if it counts.
    pub(super) fn blame(&mut self, kind: ProcessKind, revision: Option<u32>) -> bool {
        revision.is_some_and(|revision| self.configuration.blame(kind, revision, monotonic_ns()))
    }

    /// Has the processes replaced that do not do as the newest configuration says, which the one before
    /// differs from.
    fn go_over(&mut self, before: &Config, kinds: &[ProcessKind]) -> Done {
        let snapshot = self.configuration.snapshot();
        let number = snapshot.revision.number;
        let is_outdated = |revision: Option<u32>, kind| {
            revision.is_some_and(|revision| revision < snapshot.needed(kind))
        };
        let outdated: Vec<MemberId> = self
            .processes
            .iter()
            .filter(|(_, process)| is_outdated(process.revision, process.stage.kind()))
            .map(|(&id, _)| id)
            .collect();
        self.settings = settings(&snapshot.config, self.settings.graph);
        self.tick = tick(&self.settings);
        self.policy.set_settings(self.settings.clone());
        self.premises.configuration_has_changed();
        for id in outdated {
            self.policy.outdate(id, monotonic_ns());
        }
        let config = &self.configuration.snapshot().config;
        self.progress.use_fps(config.camera.fps);
        self.attendants.go_over(config, &changes(before, config), monotonic_ns());
        self.view.update_config(number, config);
        let change = self.configuration.history().last().map_or("", |change| &change.what);
        let names: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
        let replaced = match &names[..] {
            [] => String::new(),
            names => format!("; replaced: {}", names.join(", ")),
        };
        let what = format!("configuration {number}: {change}{replaced}");
        let supervisor = Attendant::Supervisor.name();
        let pid = std::process::id();
        self.record_is_due.set(true);
        self.view.log(LogEvent::new(EventKind::Reconfigured, supervisor, pid, &what, ""));
        Done { revision: Some(number) }
    }
}
