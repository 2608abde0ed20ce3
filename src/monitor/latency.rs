//! Latency from capture to `world` and of each step, from the time stamps in every `world`.

use control::report::{Breakdown, Latency, Percentiles};
use hdrhistogram::Histogram;
use messages::{FrameHeader, WorldFrame};

/// Longest latency that is resolved.
const LONGEST_NS: u64 = 60_000_000_000;

/// Distributions of latencies, in nanoseconds.
pub struct LatencyMeter {
    /// Latency to the frame, the runs, the detections and the world.
    since_capture: [Histogram<u64>; 4],
    /// Time between consecutive stamps.
    pieces: [Histogram<u64>; 7],
}

impl Default for LatencyMeter {
    fn default() -> Self {
        let histogram =
            || Histogram::new_with_max(LONGEST_NS, 3).expect("these bounds are allowed");
        Self {
            since_capture: std::array::from_fn(|_| histogram()),
            pieces: std::array::from_fn(|_| histogram()),
        }
    }
}

impl LatencyMeter {
    /// Records a frame.
    pub fn frame(&mut self, frame: &FrameHeader) {
        if has_just_been_captured(frame) {
            let latency_ns = frame.t_sent_ns.saturating_sub(frame.t_capture_ns);
            self.since_capture[0].saturating_record(latency_ns);
        }
    }

    /// Records a world.
    pub fn world(&mut self, world: &WorldFrame) {
        let frame = &world.frame;
        let sent_ns = [world.t_runs_ns, world.t_detections_ns, world.t_sent_ns];
        if has_just_been_captured(frame) {
            for (histogram, t_ns) in self.since_capture[1..].iter_mut().zip(sent_ns) {
                histogram.saturating_record(t_ns.saturating_sub(frame.t_capture_ns));
            }
        }
        let stamps_ns = [
            frame.t_capture_ns,
            frame.t_sent_ns,
            world.t_frame_taken_ns,
            world.t_runs_ns,
            world.t_runs_taken_ns,
            world.t_detections_ns,
            world.t_detections_taken_ns,
            world.t_sent_ns,
        ];
        let first = usize::from(!has_just_been_captured(frame));
        let pieces = self.pieces.iter_mut().zip(stamps_ns.windows(2)).skip(first);
        for (histogram, stamps) in pieces {
            histogram.saturating_record(stamps[1].saturating_sub(stamps[0]));
        }
    }

    /// Report in microseconds.
    pub fn report(&self) -> Latency {
        let [to_frame, to_runs, to_detections, to_world] =
            self.since_capture.each_ref().map(Percentiles::of_ns);
        let [grabber, to_classifier, classifier, to_tracker, tracker, to_filter, filter] =
            self.pieces.each_ref().map(Percentiles::of_ns);
        Latency {
            capture_to_frame: to_frame,
            capture_to_runs: to_runs,
            capture_to_detections: to_detections,
            capture_to_world: to_world,
            breakdown: Breakdown {
                grabber,
                way_to_classifier: to_classifier,
                classifier,
                way_to_tracker: to_tracker,
                tracker,
                way_to_filter: to_filter,
                filter,
            },
        }
    }
}

/// Whether a frame is live. Frames of a recording played at another pace lie in the past, and their
/// latencies mean nothing.
fn has_just_been_captured(frame: &FrameHeader) -> bool {
    frame.t_sent_ns.saturating_sub(frame.t_capture_ns) < LONGEST_NS
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    #[test]
    fn the_pieces_add_up_to_the_whole() {
        let mut meter = LatencyMeter::default();
        let us = 1000;
        let mut world = WorldFrame::zeroed();
        world.frame.t_capture_ns = 5000 * us;
        world.frame.t_sent_ns = 5001 * us;
        world.t_frame_taken_ns = 5003 * us;
        world.t_runs_ns = 5007 * us;
        world.t_runs_taken_ns = 5015 * us;
        world.t_detections_ns = 5031 * us;
        world.t_detections_taken_ns = 5063 * us;
        world.t_sent_ns = 5127 * us;
        meter.frame(&world.frame);
        meter.world(&world);
        let latency = meter.report();
        let pieces = latency.breakdown;
        let p50 = [
            pieces.grabber,
            pieces.way_to_classifier,
            pieces.classifier,
            pieces.way_to_tracker,
            pieces.tracker,
            pieces.way_to_filter,
            pieces.filter,
        ]
        .map(|piece| piece.p50.round());
        assert_eq!(p50, [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0]);
        assert_eq!(latency.capture_to_frame.p50.round(), 1.0);
        assert_eq!(latency.capture_to_world.p50.round(), 127.0);

        // A frame of a recording.
        world.frame.t_capture_ns = 0;
        world.frame.t_sent_ns += LONGEST_NS;
        let mut meter = LatencyMeter::default();
        meter.frame(&world.frame);
        meter.world(&world);
        let latency = meter.report();
        assert_eq!(latency.capture_to_world.max, 0.0);
        assert_eq!(latency.breakdown.filter.p50.round(), 64.0);
    }
}
