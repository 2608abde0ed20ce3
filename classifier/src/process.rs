//! The classifier's process: frames in, runs out.

use crate::Classifier;
use common::clock::monotonic_ns;
use common::config::Config;
use common::messages::{DropReason, MAX_RUNS, ProcessKind};
use common::process::{LOOK_AROUND, Process, ProcessError, ProcessOptions};
use common::topics;

/// Runs until asked to end.
pub fn run(options: &ProcessOptions, config: &Config) -> Result<(), ProcessError> {
    let mut process = Process::start(ProcessKind::Classifier, options, config)?;
    let frames = process.bus.subscriber(&topics::FRAMES)?;
    let previous = process.bus.subscriber_with_buffer(&topics::RUNS, 1)?;
    let mut runs = process.bus.publisher(&topics::RUNS, MAX_RUNS)?;
    let mut classifier =
        Classifier::new(config).map_err(|error| ProcessError::Stage(error.to_string()))?;
    if !process.activate()? {
        return Ok(());
    }
    if let Some(last) = previous.newest()? {
        process.resume_after(last.header().frame.seq);
    }
    drop(previous);

    let wake_up = process.bus.wake_up(&topics::FRAMES)?;
    while process.keep_running()? {
        let Some(frame) = frames.receive()? else {
            wake_up.wait(LOOK_AROUND)?;
            continue;
        };
        if process.is_done_by_predecessor(frame.header().seq) {
            continue;
        }
        let mut output = runs.loan(MAX_RUNS)?;
        let (elements, header) = output.parts();
        if let Err(fault) = classifier.step(frame.header(), frame.elements(), header, elements) {
            process.drop_input(DropReason::from(&fault));
            continue;
        }
        // Only now is the header known to be sound.
        if !process.accept(frame.header().seq) {
            continue;
        }
        header.t_sent_ns = monotonic_ns();
        output.send()?;
        process.sent(frame.header().seq);
    }
    Ok(())
}
