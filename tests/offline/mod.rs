//! A synthetic match through the cores of all stages, without processes: frame by frame, as fast as
//! possible and reproducible.

// Every test file uses its own part of this.
#![allow(dead_code)]

use bytemuck::Zeroable;
use classifier::Classifier;
use common::config::Config;
use common::messages::{
    Commands, DetectionFrame, FrameHeader, MAX_RUNS, Run, RunsHeader, WorldFrame,
};
use filter::Filter;
use grabber::synthetic::SyntheticMatch;
use tracker::Tracker;

/// Capture time of the first frame.
pub const START_NS: u64 = 5_000_000_000;

/// A match and its observers.
pub struct Offline {
    pub game: SyntheticMatch,
    /// Detections in the current frame.
    pub seen: Box<DetectionFrame>,
    /// The resulting `world`.
    pub world: Box<WorldFrame>,
    /// Commands to the robots in the current frame.
    pub commands: Commands,
    /// Header of the current frame.
    pub header: FrameHeader,
    pub period_ns: u64,
    /// Whether the filter receives the robots' commands.
    pub hears_commands: bool,
    classifier: Classifier,
    tracker: Tracker,
    filter: Filter,
    pixels: Vec<u8>,
    runs: Vec<Run>,
}

impl Offline {
    /// The state before the first frame.
    pub fn new(config: &Config) -> Self {
        Self::watched_with(config, config)
    }

    /// A match rendered with one configuration and observed with another, less complete one.
    pub fn watched_with(painted: &Config, config: &Config) -> Self {
        let camera = &config.camera;
        Self {
            game: SyntheticMatch::new(painted).unwrap(),
            seen: Box::new(DetectionFrame::zeroed()),
            world: Box::new(WorldFrame::zeroed()),
            commands: Commands::zeroed(),
            header: FrameHeader { t_capture_ns: START_NS, ..camera.frame_header() },
            period_ns: (1e9 / camera.fps).round() as u64,
            hears_commands: true,
            classifier: Classifier::new(config).unwrap(),
            tracker: Tracker::new(config).unwrap(),
            filter: Filter::new(config).unwrap(),
            pixels: vec![0; camera.frame_bytes()],
            runs: vec![Run::zeroed(); MAX_RUNS],
        }
    }

    /// Renders a picture, lets `spoil` change it, and processes it up to `seen`.
    pub fn look(&mut self, spoil: impl FnOnce(&mut [u8])) {
        let Self { game, header, pixels, runs, seen, .. } = self;
        game.render(pixels, header.stride as usize);
        spoil(pixels);
        let mut runs_header = RunsHeader::default();
        self.classifier.step(header, pixels, &mut runs_header, runs).unwrap();
        let prior = (header.seq > 0).then_some(&*self.world);
        self.tracker.step(&runs_header, runs_header.valid(runs), Some(pixels), prior, seen);
        // Predictions are for a command that is sent at once.
        seen.t_sent_ns = header.t_capture_ns;
    }

    /// Filters the detections up to `world`, and passes the resulting commands to the filter, unless
    /// these are withheld.
    pub fn think(&mut self) {
        self.filter.step(&self.seen, &mut self.world);
        self.commands = *self.game.commands();
        (self.commands.seq, self.commands.t_sent_ns) = (self.header.seq, self.header.t_capture_ns);
        if self.hears_commands {
            self.filter.command(&self.commands);
        }
    }

    /// Continues with the next frame.
    pub fn advance(&mut self) {
        self.game.advance();
        self.header.seq += 1;
        self.header.t_capture_ns += self.period_ns;
    }

    /// Plays this many frames, and shows each after filtering.
    pub fn play(&mut self, frames: u64, mut note: impl FnMut(&Self)) {
        for _ in 0..frames {
            self.look(|_| ());
            self.think();
            note(self);
            self.advance();
        }
    }
}
