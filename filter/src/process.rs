//! The filter's process: detections and commands in, world out.

use crate::Filter;
use crate::intake::Intake;
use client::bus::Received;
use client::clock::monotonic_ns;
use config::Config;
use messages::topics;
use messages::{DropReason, ProcessKind};
use runtime::process::{MAX_WAIT, Process, ProcessError, ProcessOptions};

/// Runs until asked to end.
pub fn run(options: &ProcessOptions, config: &Config) -> Result<(), ProcessError> {
    let mut process = Process::start(ProcessKind::Filter, options, config)?;
    // Before its input, so that it sees the output of every input that it sees.
    let previous = process.bus.newest_only(&topics::WORLD)?;
    let detections = process.bus.subscriber_with_history(&topics::DETECTIONS)?;
    let commands = process.bus.subscriber(&topics::COMMANDS)?;
    let mut world = process.bus.publisher(&topics::WORLD, 1)?;
    let mut filter = Filter::new(config).map_err(|error| ProcessError::Stage(error.to_string()))?;
    let mut intake = Intake::default();
    let mut wake_up = process.wake_up(&topics::DETECTIONS)?;
    if !process.activate()? {
        return Ok(());
    }
    // The complete state is in the predecessor's last output, which a spare has seen. A filter started from
    // scratch has not; it finds all robots anew within a frame.
    let now_ns = monotonic_ns();
    let last = previous
        .newest_that(|seen| seen.message().is_some_and(|world| world.frame.is_present(now_ns)))?;
    if let Some(last) = last.as_ref().and_then(Received::message) {
        process.resume_after_seen(Some(last.frame.seq));
        if process.resumes_after() == Some(last.frame.seq) {
            filter.resume(last);
        }
    }
    // The message too: it would keep the connections, and with them the predecessor's memory.
    drop((last, previous));

    while process.keep_running()? {
        intake.collect(&commands)?;
        let Some(input) = detections.receive()? else {
            wake_up.wait(MAX_WAIT);
            continue;
        };
        let taken_ns = monotonic_ns();
        let Some(detection) = input.message() else {
            process.drop_input(DropReason::WrongSize);
            continue;
        };
        let seq = detection.frame.seq;
        if process.is_done_by_predecessor(seq) || !process.accept(&detection.frame) {
            continue;
        }
        intake.deliver(&mut filter);
        let mut output = world.loan(1)?;
        let state = &mut output.elements()[0];
        filter.step(detection, state);
        state.t_detections_taken_ns = taken_ns;
        state.revision = process.revision().number;
        state.t_sent_ns = monotonic_ns();
        output.send()?;
        process.sent(seq);
    }
    Ok(())
}
