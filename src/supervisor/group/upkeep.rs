//! The supervisor's own upkeep: its files and connections, the record, the attendants and the report.

use super::{Group, SIGHT};
use crate::monitor::ProcessView;
use crate::supervisor::children::Process;
use crate::supervisor::policy::{Degraded, Lack};
use crate::supervisor::record::{Member, Record};
use crate::supervisor::reserve::raise_limit;
use client::clock::monotonic_ns;
use control::{Configured, Event as LogEvent};
use messages::stages::StageId;
use messages::{Attendant, EventKind, ProcessState};
use std::time::{Duration, Instant};

/// Pause before a failed write of the record is retried.
const RECORD_PAUSE: Duration = Duration::from_secs(1);

// Names of operations that can fail for a while, as reported.
pub(super) const PREMISES: &str = "keep the runtime directory in order";
const PAGES: &str = "map the pages of the stages";
const JANITOR: &str = "clean up after dead processes";
const RECORD: &str = "write the group's record";

impl Group<'_> {
    /// Reports that the terminal is gone, and which commands replace it.
    pub(super) fn leave_terminal(&self) {
        let name = self.launch.instance.name();
        self.say(&format!(
            "the terminal is gone (SIGHUP); the match goes on: look at it with `touchline status \
             --instance {name}`, end it with `touchline stop --instance {name}`"
        ));
    }

    /// Records the outcome of a repeated operation, and reports it where that is due.
    pub(super) fn attempted(&mut self, what: &str, outcome: std::io::Result<()>) {
        let outcome = outcome.map_err(|error| error.to_string());
        if let Some(said) = self.troubles.note(what, outcome, monotonic_ns()) {
            self.say(&said);
        }
    }

    /// Logs an event that concerns the supervisor itself.
    pub(super) fn say(&self, what: &str) {
        let supervisor = Attendant::Supervisor.name();
        self.view.log(LogEvent::new(EventKind::Other, supervisor, std::process::id(), what, ""));
    }

    /// Maintains the supervisor's own files, connections and threads.
    pub(super) fn tend_itself(&mut self) {
        let connected = self.reserve.lend(|| self.progress.connect().transpose());
        if let Err(error) = connected {
            self.attempted(SIGHT, Err(error));
        }
        let is_blind = !self.progress.is_connected();
        self.policy.set_blind(is_blind, monotonic_ns());
        if self.premises.is_due() {
            raise_limit();
            let restored = self.premises.restore();
            if let Ok(restored) = &restored
                && !restored.is_empty()
            {
                self.say(&format!("somebody has removed {}: put back", restored.join(", ")));
                // The record may have been removed too.
                self.record_is_due.set(true);
            }
            self.attempted(PREMISES, restored.map(drop));
            let opened = self.progress.pages().open_all();
            self.attempted(PAGES, opened);
            let running = self.janitor.keep_running();
            self.attempted(JANITOR, running);
        }
        // Not while a process is starting: connecting to it takes descriptors.
        if !is_blind && self.states.len() == self.processes.len() {
            self.reserve.refill();
        }
    }

    /// Starts and restarts attendants, only after the group is complete: the match comes first.
    pub(super) fn tend_attendants(&mut self) {
        if !self.ever_complete {
            return;
        }
        for it in self.attendants.tend(&self.settings, monotonic_ns()) {
            self.record_is_due.set(true);
            self.view.log(LogEvent::new(it.kind, it.name, it.pid, &it.what, &it.evidence));
        }
    }

    /// Writes the record for a later supervisor. Last in a round, so that a promotion does not wait
    /// for the disk.
    pub(super) fn keep_record(&mut self) {
        if Instant::now() < self.record_after || !self.record_is_due.replace(false) {
            return;
        }
        let by_name = |(stage, &count): (&StageId, &u64)| (stage.to_string(), count);
        let member = |process: &Process| {
            // A process without a heartbeat is still starting.
            let state = self.states.get(&process.pid)?;
            Some(Member {
                stage: process.stage.to_string(),
                pid: process.pid,
                spare: *state == ProcessState::Spare,
            })
        };
        let record = Record {
            members: self.processes.values().filter_map(member).collect(),
            restarts: self.restarts.iter().map(by_name).collect(),
            events: self.view.events(),
            ..Record::new(&self.launch)
        };
        // The record is optional for a later supervisor.
        let written = record.write(&self.launch.instance);
        if written.is_err() {
            self.record_after = Instant::now() + RECORD_PAUSE;
        }
        let failed = written.is_err();
        self.attempted(RECORD, written);
        self.record_is_due.set(failed);
    }

    /// Everything the group lacks at the moment, as text.
    pub(super) fn lacks(&self) -> Vec<String> {
        let in_s = |ns: u64| format!("next try in {:.1} s", ns as f64 / 1e9);
        let lack = |it: Degraded| {
            let next = in_s(it.next_start_in_ns);
            let stage = it.stage;
            match it.what {
                Lack::Process(failures) => {
                    format!(
                        "the {stage} does not work: it has failed {failures} times in a row, {next}"
                    )
                }
                Lack::Spare(failures) => {
                    format!(
                        "the {stage} has no spare: it has failed {failures} times in a row, {next}"
                    )
                }
                Lack::Output => format!(
                    "the {stage} drops all its input: `touchline status` counts the reasons; look at the stage \
                     before it, and at the camera's settings"
                ),
                Lack::Stability(deaths) => format!(
                    "the {stage} dies too often ({deaths} times in five seconds or more): it is started \
                     with pauses, {next}"
                ),
                Lack::Speed => format!(
                    "the {stage} takes longer for a frame than the stall deadline, and is given more time: frames \
                     are lost or late; `touchline bench` tells what it can do with this configuration"
                ),
            }
        };
        let lacks = self.policy.degraded(monotonic_ns()).into_iter().map(lack);
        lacks.chain(self.troubles.list()).collect()
    }

    pub(super) fn publish_view(&self) {
        let mut processes: Vec<ProcessView> = self
            .processes
            .values()
            .map(|process| ProcessView {
                stage: process.stage,
                pid: process.pid,
                state: self.states.get(&process.pid).copied(),
            })
            .collect();
        processes.sort_by_key(|process| (process.stage, process.pid));
        self.view.update(processes, self.restarts.clone());
        self.view.update_lacks(self.lacks());
        self.view.update_attendants(self.attendants.view());
        let pending =
            self.policy.pending_stages(monotonic_ns()).iter().map(StageId::to_string).collect();
        self.view.update_configured(Configured {
            revision: self.configuration.snapshot().revision.number,
            hash: self.configuration.hash().into(),
            pending,
            history: self.configuration.history().to_vec(),
        });
    }
}
