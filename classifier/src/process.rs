//! The classifier's process: frames in, runs out.

use crate::{Classifier, SimdChoice};
use client::bus::Publisher;
use client::clock::monotonic_ns;
use config::Config;
use messages::topics;
use messages::{DropReason, FrameHeader, LightReport, MAX_RUNS, ProcessKind};
use runtime::process::{HEARTBEAT, MAX_WAIT, Process, ProcessError, ProcessOptions};

/// Runs until asked to end.
pub fn run(options: &ProcessOptions, config: &Config) -> Result<(), ProcessError> {
    let mut process = Process::start(ProcessKind::Classifier, options, config)?;
    let input = topics::frames(config.camera.frame_bytes()).in_lane(options.lane);
    let output = topics::RUNS.in_lane(options.lane);
    // Before its input, so that it sees the output of every input that it sees.
    let previous = process.bus.newest_only(&output)?;
    let frames = process.bus.subscriber_with_history(&input)?;
    let mut runs = process.bus.publisher(&output, MAX_RUNS)?;
    let mut classifier =
        Classifier::new(config).map_err(|error| ProcessError::Stage(error.to_string()))?;
    let mut wake_up = process.wake_up(&input)?;
    let mut light_reports = LightReports::new(&process)?;
    let revision = process.revision();
    runtime::tell!("{}: {}", ProcessKind::Classifier.name(), SimdChoice::of_process());
    if !process.activate()? {
        return Ok(());
    }
    let of_present = |frame: &FrameHeader| frame.is_present(monotonic_ns());
    let seen = previous.newest_that(|runs| of_present(&runs.header().frame))?;
    process.resume_after_seen(seen.map(|runs| runs.header().frame.seq));
    drop(previous);

    while process.keep_running()? {
        let Some(frame) = frames.receive()? else {
            wake_up.wait(MAX_WAIT);
            continue;
        };
        let taken_ns = monotonic_ns();
        let seq = frame.header().seq;
        if process.is_done_by_predecessor(seq) {
            continue;
        }
        // Nothing in an unsound header means anything, not even the frame number.
        if let Err(fault) = classifier.check(frame.header(), frame.elements().len()) {
            process.drop_input(DropReason::from(&fault));
            continue;
        }
        if !process.accept(frame.header()) {
            continue;
        }
        let mut output = runs.loan(MAX_RUNS)?;
        let (elements, header) = output.parts();
        if let Err(fault) = classifier.step(frame.header(), frame.elements(), header, elements) {
            process.drop_input(DropReason::from(&fault));
            continue;
        }
        header.t_frame_taken_ns = taken_ns;
        header.revision = revision.number;
        header.classes_since = revision.classes_since;
        header.t_sent_ns = monotonic_ns();
        output.send()?;
        process.sent(seq);
        light_reports.publish_when_due(seq, &classifier)?;
    }
    Ok(())
}

/// Reports the light at the pace of heartbeats.
struct LightReports {
    publisher: Publisher<LightReport, ()>,
    t_sent_ns: u64,
}

impl LightReports {
    fn new(process: &Process) -> Result<Self, ProcessError> {
        Ok(Self { publisher: process.bus.publisher(&topics::LIGHT, 1)?, t_sent_ns: 0 })
    }

    fn publish_when_due(&mut self, seq: u64, classifier: &Classifier) -> Result<(), ProcessError> {
        let now_ns = monotonic_ns();
        if now_ns.saturating_sub(self.t_sent_ns) < HEARTBEAT.as_nanos() as u64 {
            return Ok(());
        }
        self.t_sent_ns = now_ns;
        let report = LightReport { t_sent_ns: now_ns, seq, correction: classifier.light() };
        Ok(self.publisher.publish(&report)?)
    }
}
