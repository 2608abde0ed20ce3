//! Carries out the actions that the rules decide.

use super::Group;
use crate::supervisor::SupervisorError;
use crate::supervisor::children::{Launch, Process};
use crate::supervisor::evidence;
use crate::supervisor::policy::{Action, Cause, Event, MemberId};
use client::clock::monotonic_ns;
use client::memory::{self, GroupMemory};
use config::Config;
use messages::stages::{FrameId, StageId};
use messages::topics;
use messages::{EventKind, ProcessKind, ProcessState};
use runtime::handover::Handover;
use rustix::process::Signal;
use std::io;

/// Failed starts after which a group that was never complete gives up.
const HOPELESS_STARTS: u32 = 3;
/// Name of an operation that can fail for a while, as reported.
const SIGNALS: &str = "signal a process";

impl Group<'_> {
    pub(super) fn act(&mut self, action: Action) -> Result<(), SupervisorError> {
        match action {
            Action::Start { id, stage, spare } => self.start(id, stage, spare)?,
            Action::Promote { id, stage } => {
                self.hand_over(stage);
                if let Some(process) = self.processes.get(&id) {
                    let pid = process.pid;
                    self.signal(id, Signal::USR1);
                    self.log(EventKind::Promoted, stage, pid, "promoted from spare", "");
                }
            }
            Action::Kill { id, stage, cause } => {
                if let Some(process) = self.processes.get(&id) {
                    let (event, what) = match cause {
                        Cause::Stalled if stage.is_grabber() => {
                            (EventKind::Stalled, "killed: it gives no frames")
                        }
                        Cause::Stalled => {
                            (EventKind::Stalled, "killed: it has input but gives no output")
                        }
                        Cause::OnlyDrops => (EventKind::Stalled, "killed: it drops all its input"),
                        Cause::NotReady => {
                            (EventKind::Killed, "killed: it did not get ready in time")
                        }
                        Cause::DoesNotEnd => {
                            (EventKind::Killed, "killed: it did not end when asked to")
                        }
                    };
                    let (pid, revision) = (process.pid, process.revision);
                    self.log(event, stage, pid, what, "");
                    // A stage that was slow before stalls under any configuration.
                    let is_slow = cause == Cause::Stalled && self.policy.is_slow(stage);
                    if cause != Cause::DoesNotEnd && !is_slow {
                        self.blame(stage.kind(), revision);
                    }
                    self.signal(id, Signal::KILL);
                }
            }
            Action::Retire { id, stage } => {
                if let Some(process) = self.processes.get(&id) {
                    let what = match self.states.get(&process.pid) {
                        Some(ProcessState::Spare) | None => {
                            "asked to end: a newer spare is to stand by"
                        }
                        _ => "asked to end: its successor is ready",
                    };
                    self.log(EventKind::Retired, stage, process.pid, what, "");
                    self.signal(id, Signal::TERM);
                }
            }
            Action::Skip { stage, after } => self.skip(stage, after),
            Action::CleanUp => self.janitor.call(),
        }
        Ok(())
    }

    /// Starts a process. If the system refuses, that counts as a failed start, and the rules decide
    /// when to retry.
    pub(super) fn start(
        &mut self,
        id: MemberId,
        stage: StageId,
        spare: bool,
    ) -> Result<(), SupervisorError> {
        if !spare {
            self.hand_over(stage);
        }
        let Self { launch, configuration, progress, reserve, .. } = self;
        let config = &configuration.snapshot().config;
        let revision = configuration.snapshot().revision.number;
        let last_frame = progress.last_frame(stage.lane());
        let started = room_for(launch, config, stage)
            .and_then(|()| reserve.lend(|| Process::start(launch, stage, spare, last_frame)));
        let failure = started.as_ref().err().map(ToString::to_string);
        let outcome = started.map(|mut process| {
            process.revision = Some(revision);
            self.processes.insert(id, process);
        });
        self.attempted(&format!("start the {stage}"), outcome);
        match failure {
            Some(reason) => {
                self.policy.note(Event::NotStarted(id), monotonic_ns());
                self.failed_to_start(stage, reason)
            }
            None => Ok(()),
        }
    }

    /// Counts a failed start. Before the group was ever complete, a user is waiting at the
    /// terminal, so the group gives up after a few.
    pub(super) fn failed_to_start(
        &mut self,
        stage: StageId,
        reason: String,
    ) -> Result<(), SupervisorError> {
        self.start_failures += u32::from(!self.ever_complete);
        match self.ever_complete || self.start_failures < HOPELESS_STARTS {
            true => Ok(()),
            false => Err(SupervisorError::NoStart { stage, reason }),
        }
    }

    /// Sends a signal; retried if it cannot be sent.
    pub(super) fn signal(&mut self, id: MemberId, signal: Signal) {
        let Some(process) = self.processes.get(&id) else { return };
        let sent = process.signal(signal);
        if sent.is_err() {
            self.unsent.push((id, signal));
        }
        self.attempted(SIGNALS, sent);
    }

    pub(super) fn send_again(&mut self) {
        for (id, signal) in std::mem::take(&mut self.unsent) {
            self.signal(id, signal);
        }
    }

    /// Leaves a note for the next active process of a stage: the last output of its predecessor,
    /// which is confirmed dead and whose outputs have all been read.
    pub(super) fn hand_over(&mut self, stage: StageId) {
        let lane = stage.lane();
        let Some(resume_after) = self.outputs[stage].of(lane) else { return };
        // The note stays until there is a later output: this process may die too, or fail to start.
        let last = FrameId { lane, seq: resume_after };
        let skip_next = self.skip_after.get(&stage) == Some(&last);
        self.progress.pages().leave_note(stage, Handover { resume_after, skip_next });
    }

    /// Makes the next process of a stage skip the input that has killed two, and saves the frame.
    pub(super) fn skip(&mut self, stage: StageId, after: FrameId) {
        self.skip_after.insert(stage, after);
        let what = match self.progress.first_frame_after(after) {
            Some(frame) => {
                let kept = match evidence::save_frame(&self.launch.instance, frame) {
                    Ok(path) => format!("kept in {}", path.display()),
                    Err(error) => format!("it cannot be kept: {error}"),
                };
                let seq = frame.header().seq;
                format!("frame {seq} has killed two processes and is skipped; {kept}")
            }
            None => {
                format!("the frame after {} has killed two processes and is skipped", after.seq)
            }
        };
        self.log(EventKind::Poisonous, stage, 0, &what, "");
    }
}

/// Checks that there is enough shared memory for a new process and for its readers.
fn room_for(launch: &Launch, config: &Config, stage: StageId) -> io::Result<()> {
    let topic = match stage.kind() {
        ProcessKind::Grabber => topics::FRAMES.name,
        ProcessKind::Classifier => topics::RUNS.name,
        ProcessKind::Tracker => topics::DETECTIONS.name,
        ProcessKind::Filter => topics::WORLD.name,
    };
    let frame_bytes = launch.source.frame_capacity(&config.camera);
    let needed = GroupMemory::with_larger_frames(config.camera.frame_bytes(), frame_bytes)
        .start_bytes(topic);
    match memory::free_bytes() {
        Ok(free) if free < needed => Err(io::Error::other(format!(
            "not enough shared memory: it takes about {} kB, {} kB are free in {}, see `touchline doctor`",
            needed >> 10,
            free >> 10,
            memory::SHARED_MEMORY
        ))),
        _ => Ok(()),
    }
}
