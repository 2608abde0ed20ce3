//! Doing what the rules decide.

use super::Group;
use crate::supervisor::SupervisorError;
use crate::supervisor::children::{Launch, Process};
use crate::supervisor::evidence;
use crate::supervisor::policy::{Action, Cause, Event, MemberId};
use common::clock::monotonic_ns;
use common::config::Config;
use common::handover::Handover;
use common::memory::{self, GroupMemory};
use common::messages::{EventKind, ProcessKind};
use common::stages::{FrameId, StageId};
use common::topics;
use rustix::process::Signal;
use std::io;

/// Failed starts, before anything has worked, after which the group gives up.
const HOPELESS_STARTS: u32 = 3;
/// What cannot be done for a while, in the words in which it is told.
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
                    self.log(event, stage, process.pid, what, "");
                    self.signal(id, Signal::KILL);
                }
            }
            Action::Retire { id, stage } => {
                if let Some(process) = self.processes.get(&id) {
                    let what = "asked to end: its successor is ready";
                    self.log(EventKind::Retired, stage, process.pid, what, "");
                    self.signal(id, Signal::TERM);
                }
            }
            Action::Skip { stage, after } => self.skip(stage, after),
            Action::CleanUp => self.janitor.call(),
        }
        Ok(())
    }

    /// Starts a process. One that cannot be started is one that failed to start: the rules say when it
    /// is tried again.
    pub(super) fn start(
        &mut self,
        id: MemberId,
        stage: StageId,
        spare: bool,
    ) -> Result<(), SupervisorError> {
        if !spare {
            self.hand_over(stage);
        }
        let Self { launch, config, progress, reserve, .. } = self;
        let last_frame = progress.last_frame(stage.lane());
        let started = room_for(launch, config, stage)
            .and_then(|()| reserve.lend(|| Process::start(launch, stage, spare, last_frame)));
        let failure = started.as_ref().err().map(ToString::to_string);
        let outcome = started.map(|process| drop(self.processes.insert(id, process)));
        self.attempted(&format!("start the {stage}"), outcome);
        match failure {
            Some(reason) => {
                self.policy.note(Event::NotStarted(id), monotonic_ns());
                self.failed_to_start(stage, reason)
            }
            None => Ok(()),
        }
    }

    /// Before anything ever worked, somebody is waiting to be told what is wrong.
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

    /// Sends a signal, and if it cannot be sent, sends it again.
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

    /// Tells the process of a stage that is about to work how far the last one came. That one is
    /// confirmed dead, and all it has published was looked at since.
    pub(super) fn hand_over(&mut self, stage: StageId) {
        let lane = stage.lane();
        let Some(resume_after) = self.outputs[stage].of(lane) else { return };
        // Stays until there is a later output: this process may die, or not even start.
        let last = FrameId { lane, seq: resume_after };
        let skip_next = self.skip_after.get(&stage) == Some(&last);
        self.progress.pages().leave_note(stage, Handover { resume_after, skip_next });
    }

    /// Has the next process of a stage skip the input that has killed two, and keeps the frame.
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

/// Whether there is the shared memory that a new process takes, in itself and in all that connect to it.
fn room_for(launch: &Launch, config: &Config, stage: StageId) -> io::Result<()> {
    let topic = match stage.kind() {
        ProcessKind::Grabber => topics::FRAMES.name,
        ProcessKind::Classifier => topics::RUNS.name,
        ProcessKind::Tracker => topics::DETECTIONS.name,
        ProcessKind::Filter => topics::WORLD.name,
    };
    let frame_bytes = launch.source.frame_capacity(&config.camera);
    let needed = GroupMemory::with_frames_of(config, frame_bytes).start_bytes(topic);
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
