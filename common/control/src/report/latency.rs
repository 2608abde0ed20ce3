//! Latencies.

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};

/// Latency from the middle of the exposure to a stage's output.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Latency {
    /// To the frame itself being published.
    pub capture_to_frame: Percentiles,
    /// To the runs.
    pub capture_to_runs: Percentiles,
    /// To the detections.
    pub capture_to_detections: Percentiles,
    /// To the world.
    pub capture_to_world: Percentiles,
    /// Time of each step, along the way of a frame.
    pub breakdown: Breakdown,
}

/// The way of a frame from capture to `world`, cut into pieces.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Breakdown {
    /// From the middle of the exposure until the grabber hands the frame on.
    pub grabber: Percentiles,
    /// Until the classifier has it: publishing, waking up, taking over.
    pub way_to_classifier: Percentiles,
    /// Until the classifier hands the runs on.
    pub classifier: Percentiles,
    /// Until the tracker has them.
    pub way_to_tracker: Percentiles,
    /// Until the tracker hands the detections on.
    pub tracker: Percentiles,
    /// Until the filter has them.
    pub way_to_filter: Percentiles,
    /// Until the filter hands the world on.
    pub filter: Percentiles,
}

/// A distribution.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Percentiles {
    /// Median.
    pub p50: f64,
    /// 90th percentile.
    pub p90: f64,
    /// 99th percentile.
    pub p99: f64,
    /// The largest.
    pub max: f64,
}

impl Percentiles {
    /// Percentiles in microseconds of a histogram in nanoseconds.
    pub fn of_ns(histogram: &Histogram<u64>) -> Self {
        let at = |quantile| histogram.value_at_quantile(quantile) as f64 / 1000.0;
        if histogram.is_empty() {
            return Self::default();
        }
        Self { p50: at(0.5), p90: at(0.9), p99: at(0.99), max: histogram.max() as f64 / 1000.0 }
    }
}
