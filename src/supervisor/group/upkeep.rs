//! What a supervisor does besides looking after processes: it keeps what it needs itself, and says how
//! things are.

use super::{Group, SIGHT};
use crate::monitor::{Event as LogEvent, ProcessView};
use crate::supervisor::children::Process;
use crate::supervisor::policy::{Degraded, Lack};
use crate::supervisor::record::{Member, Record};
use crate::supervisor::reserve::raise_limit;
use common::clock::monotonic_ns;
use common::messages::{Attendant, EventKind, ProcessState};
use common::stages::StageId;
use std::time::{Duration, Instant};

/// A record that could not be written is tried again so much later.
const RECORD_PAUSE: Duration = Duration::from_secs(1);

// What cannot be done for a while, in the words in which it is told.
pub(super) const PREMISES: &str = "keep the runtime directory in order";
const PAGES: &str = "map the pages of the stages";
const JANITOR: &str = "clean up after dead processes";
const RECORD: &str = "write the group's record";

impl Group<'_> {
    /// The terminal is gone; what it showed can be had elsewhere.
    pub(super) fn leave_terminal(&self) {
        let name = self.launch.instance.name();
        self.say(&format!(
            "the terminal is gone (SIGHUP); the match goes on: look at it with `touchline status \
             --instance {name}`, end it with `touchline stop --instance {name}`"
        ));
    }

    /// Takes note of how an attempt went that is made again and again, and says what there is to say.
    pub(super) fn attempted(&mut self, what: &str, outcome: std::io::Result<()>) {
        let outcome = outcome.map_err(|error| error.to_string());
        if let Some(said) = self.troubles.note(what, outcome, monotonic_ns()) {
            self.say(&said);
        }
    }

    /// Notes an event that concerns the supervisor itself.
    pub(super) fn say(&self, what: &str) {
        let supervisor = Attendant::Supervisor.name();
        self.view.log(LogEvent::new(EventKind::Other, supervisor, std::process::id(), what, ""));
    }

    /// Looks after what the supervisor itself needs.
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
                // It may be gone, too.
                self.record_is_due.set(true);
            }
            self.attempted(PREMISES, restored.map(drop));
            let opened = self.progress.pages().open_all();
            self.attempted(PAGES, opened);
            let running = self.janitor.keep_running();
            self.attempted(JANITOR, running);
        }
        // A process that is just starting will have to be connected to.
        if !is_blind && self.states.len() == self.processes.len() {
            self.reserve.refill();
        }
    }

    /// Begins when the group is complete: whatever serves people comes after the match.
    pub(super) fn tend_attendants(&mut self) {
        if !self.ever_complete {
            return;
        }
        for it in self.attendants.tend(&self.settings, monotonic_ns()) {
            self.record_is_due.set(true);
            self.view.log(LogEvent::new(it.kind, it.name, it.pid, &it.what, &it.evidence));
        }
    }

    /// Writes down what a successor needs to know. Comes last in a round: whoever waits for a spare
    /// does not wait for the disk.
    pub(super) fn keep_record(&mut self) {
        if Instant::now() < self.record_after || !self.record_is_due.replace(false) {
            return;
        }
        let by_name = |(stage, &count): (&StageId, &u64)| (stage.to_string(), count);
        let member = |process: &Process| {
            // One that has not said its first word is still starting.
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
        // It is a help for a successor, who can do without.
        let written = record.write(&self.launch.instance);
        if written.is_err() {
            self.record_after = Instant::now() + RECORD_PAUSE;
        }
        let failed = written.is_err();
        self.attempted(RECORD, written);
        self.record_is_due.set(failed);
    }

    /// Everything that is missing at the moment, as text.
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
                Lack::Peace(deaths) => format!(
                    "the {stage} dies too often ({deaths} times in five seconds or more): it is started \
                     with pauses, {next}"
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
    }
}
