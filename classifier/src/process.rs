//! The classifier's process: frames in, runs out.

use crate::{Classifier, SimdChoice};
use client::clock::monotonic_ns;
use config::Config;
use messages::topics;
use messages::{DropReason, FrameHeader, MAX_RUNS, ProcessKind};
use runtime::process::{MAX_WAIT, Process, ProcessError, ProcessOptions};

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
    process.counters.light = classifier.light();
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
        header.t_sent_ns = monotonic_ns();
        output.send()?;
        process.sent(seq);
        process.counters.light = classifier.light();
    }
    Ok(())
}
