//! The stages' own cores, one after the other in one process: what is found here is found in a
//! match.

use super::CommandError;
use bytemuck::Zeroable;
use classifier::Classifier;
use common::config::{CameraConfig, Config};
use common::messages::{DetectionFrame, FrameFault, MAX_RUNS, Run, RunsHeader};
use tracker::Tracker;

/// The stages between a frame and what is seen in it, and the memory they work in.
pub struct Pipeline {
    camera: CameraConfig,
    classifier: Classifier,
    tracker: Tracker,
    runs_header: RunsHeader,
    runs: Vec<Run>,
    seen: Box<DetectionFrame>,
}

impl Pipeline {
    /// The stages as configured.
    pub fn new(config: &Config) -> Result<Self, CommandError> {
        Ok(Self {
            camera: config.camera.clone(),
            classifier: Classifier::new(config)?,
            tracker: Tracker::new(config)?,
            runs_header: RunsHeader::default(),
            runs: vec![Run::zeroed(); MAX_RUNS],
            seen: Box::new(DetectionFrame::zeroed()),
        })
    }

    /// Looks at a picture, which stands alone: nothing is known of what was before.
    pub fn step(&mut self, bayer: &[u8]) -> Result<&DetectionFrame, FrameFault> {
        let header = self.camera.frame_header();
        self.classifier.step(&header, bayer, &mut self.runs_header, &mut self.runs)?;
        let runs = self.runs_header.valid(&self.runs);
        self.tracker.step(&self.runs_header, runs, Some(bayer), None, &mut self.seen);
        Ok(&self.seen)
    }

    /// What the last picture was classified as.
    pub fn runs(&self) -> &[Run] {
        self.runs_header.valid(&self.runs)
    }

    /// What was seen in the last picture.
    pub fn seen(&self) -> &DetectionFrame {
        &self.seen
    }
}
