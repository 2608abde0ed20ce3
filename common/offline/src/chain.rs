//! The stages' own code, chained in one process: results are the same as in a match.
//!
//! A frame goes through [`classify`](Chain::classify), [`track`](Chain::track) and [`filter`](Chain::filter), as it
//! goes through three processes in a match; [`step`](Chain::step) is all three. A single picture, without
//! predecessors, goes through [`look_at`](Chain::look_at), which takes the time to search all of it.

use bytemuck::Zeroable;
use classifier::{Classifier, ClassifierError};
use config::{CameraConfig, Config};
use filter::{Filter, FilterError};
use messages::{
    Commands, DetectionFrame, FrameFault, FrameHeader, MAX_RUNS, Run, RunsHeader, WorldFrame,
};
use tracker::{Tracker, TrackerError};

/// Reason for which a configuration cannot be used.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub enum ChainError {
    #[error(transparent)]
    Classifier(#[from] ClassifierError),
    #[error(transparent)]
    Tracker(#[from] TrackerError),
    #[error(transparent)]
    Filter(#[from] FilterError),
}

/// Classifier, tracker and filter, and the messages between them.
pub struct Chain {
    camera: CameraConfig,
    classifier: Classifier,
    tracker: Tracker,
    filter: Filter,
    runs_header: RunsHeader,
    runs: Vec<Run>,
    detections: Box<DetectionFrame>,
    world: Box<WorldFrame>,
    /// Whether `world` holds the result of an earlier frame.
    has_world: bool,
}

impl Chain {
    /// The stages as configured, before the first frame.
    pub fn new(config: &Config) -> Result<Self, ChainError> {
        Ok(Self {
            camera: config.camera.clone(),
            classifier: Classifier::new(config)?,
            tracker: Tracker::new(config)?,
            filter: Filter::new(config)?,
            runs_header: RunsHeader::default(),
            runs: vec![Run::zeroed(); MAX_RUNS],
            detections: Box::new(DetectionFrame::zeroed()),
            world: Box::new(WorldFrame::zeroed()),
            has_world: false,
        })
    }

    /// Turns a frame into runs.
    pub fn classify(&mut self, header: &FrameHeader, pixels: &[u8]) -> Result<(), FrameFault> {
        self.classifier.step(header, pixels, &mut self.runs_header, &mut self.runs)
    }

    /// Turns the runs into detections, with the last `world` as a prediction. `pixels` are those of
    /// the same frame.
    pub fn track(&mut self, pixels: &[u8]) {
        let prior = self.has_world.then_some(&*self.world);
        let runs = self.runs_header.valid(&self.runs);
        self.tracker.step(&self.runs_header, runs, Some(pixels), prior, &mut self.detections);
    }

    /// Turns the detections, sent at this time, into `world`. Its predictions are for a command
    /// that leaves then.
    pub fn filter(&mut self, t_sent_ns: u64) {
        self.detections.t_sent_ns = t_sent_ns;
        self.filter.step(&self.detections, &mut self.world);
        self.has_world = true;
    }

    /// Goes on from a `world` that another chain or a group has made, so that the next frame has a prediction.
    /// Tracks of robots that are not configured here are left out.
    pub fn resume(&mut self, last: &WorldFrame) {
        self.filter.resume(last);
        *self.world = *last;
        self.has_world = true;
    }

    /// Passes commands to the filter.
    pub fn command(&mut self, commands: &Commands) {
        self.filter.command(commands);
    }

    /// Turns a frame into `world`, as if no stage took any time.
    pub fn step(&mut self, header: &FrameHeader, pixels: &[u8]) -> Result<&WorldFrame, FrameFault> {
        self.classify(header, pixels)?;
        self.track(pixels);
        self.filter(header.t_capture_ns);
        Ok(&self.world)
    }

    /// Detects in a single picture of the configured camera.
    pub fn look_at(&mut self, pixels: &[u8]) -> Result<&DetectionFrame, FrameFault> {
        self.has_world = false;
        self.classify(&self.camera.frame_header(), pixels)?;
        let runs = self.runs_header.valid(&self.runs);
        self.tracker.look_at(&self.runs_header, runs, Some(pixels), &mut self.detections);
        Ok(&self.detections)
    }

    /// The classifier.
    pub fn classifier(&self) -> &Classifier {
        &self.classifier
    }

    /// Runs of the last frame.
    pub fn runs(&self) -> &[Run] {
        self.runs_header.valid(&self.runs)
    }

    /// Detections of the last frame.
    pub fn detections(&self) -> &DetectionFrame {
        &self.detections
    }

    /// The last `world`.
    pub fn world(&self) -> &WorldFrame {
        &self.world
    }
}
