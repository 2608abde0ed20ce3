//! The tracker's process: receives runs, publishes detections.

use crate::Tracker;
use crate::revisions::Revisions;
use client::bus::Received;
use client::clock::monotonic_ns;
use config::Config;
use messages::topics;
use messages::{DetectionFrame, DropReason, FrameHeader, ProcessKind};
use runtime::process::{MAX_WAIT, Process, ProcessError, ProcessOptions};

/// Runs until asked to end.
pub fn run(options: &ProcessOptions, config: &Config) -> Result<(), ProcessError> {
    let mut process = Process::start(ProcessKind::Tracker, options, config)?;
    let input = topics::RUNS.in_lane(options.lane);
    let output = topics::DETECTIONS.in_lane(options.lane);
    // Subscribes to the output before the input, so the output of every input that may be missed is seen.
    let previous = process.bus.newest_only(&output)?;
    let runs = process.bus.subscriber_with_history(&input)?;
    let frames = process.bus.subscriber_with_history(&topics::FRAMES.in_lane(options.lane))?;
    let world = process.bus.newest_only(&topics::WORLD)?;
    let mut detections = process.bus.publisher(&output, 1)?;
    let tracker = Tracker::new(config).map_err(|error| ProcessError::Stage(error.to_string()))?;
    let mut revisions = Revisions::new(tracker, options.revision, &options.instance);
    let mut wake_up = process.wake_up(&input)?;
    if !process.activate()? {
        return Ok(());
    }
    let seq_of = |detections: &DetectionFrame| detections.frame.seq;
    let now_ns = monotonic_ns();
    let last = previous.newest_that(|seen| {
        seen.message().is_some_and(|detections| detections.frame.is_present(now_ns))
    })?;
    process.resume_after_seen(last.as_ref().and_then(Received::message).map(seq_of));
    // The message too: it would keep the connections, and with them the predecessor's memory.
    drop((last, previous));

    let mut prior = None;
    let mut frame: Option<Received<u8, FrameHeader>> = None;
    while process.keep_running()? {
        let Some(input) = runs.receive()? else {
            wake_up.wait(MAX_WAIT);
            continue;
        };
        let taken_ns = monotonic_ns();
        let header = input.header();
        let seq = header.frame.seq;
        if process.is_done_by_predecessor(seq) || !process.accept(&header.frame) {
            continue;
        }
        let Some((tracker, revision)) = revisions.for_runs(header) else {
            process.drop_input(DropReason::WrongFormat);
            continue;
        };
        prior = world.newest()?.or(prior);
        // Finds the frame that the runs were made from, if it has not been overwritten. A number far ahead is
        // invalid, and must not be waited for.
        let newest = seq.saturating_add(topics::FRAMES.buffer as u64);
        let is_due =
            |frame: &Received<u8, FrameHeader>| (seq..=newest).contains(&frame.header().seq);
        while !frame.as_ref().is_some_and(is_due) {
            let Some(next) = frames.receive()? else { break };
            frame = Some(next);
        }
        let pixels = frame.as_ref().filter(|frame| frame.header().seq == seq);
        let pixels = pixels.map(Received::elements);
        let mut output = detections.loan(1)?;
        let detection = &mut output.elements()[0];
        let prior = prior.as_ref().and_then(Received::message);
        tracker.step(header, header.valid(input.elements()), pixels, prior, detection);
        detection.t_runs_taken_ns = taken_ns;
        detection.revision = revision;
        detection.t_sent_ns = monotonic_ns();
        output.send()?;
        process.sent(seq);
    }
    Ok(())
}
