//! A synthetic match through the cores of all stages, without processes: frame by frame, as fast as
//! possible and reproducible.

// Every test file uses its own part of this.
#![allow(dead_code)]

use bytemuck::Zeroable;
use config::Config;
use grabber::synthetic::SyntheticMatch;
use messages::{Commands, DetectionFrame, FrameHeader, WorldFrame};
use offline::chain::Chain;

/// Capture time of the first frame.
pub const START_NS: u64 = 5_000_000_000;

/// A match, and the stages that watch it.
pub struct Offline {
    pub game: SyntheticMatch,
    /// Commands to the robots in the current frame.
    pub commands: Commands,
    /// Header of the current frame.
    pub header: FrameHeader,
    pub period_ns: u64,
    /// Whether the filter receives the robots' commands.
    pub hears_commands: bool,
    chain: Chain,
    pixels: Vec<u8>,
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
            commands: Commands::zeroed(),
            header: FrameHeader { t_capture_ns: START_NS, ..camera.frame_header() },
            period_ns: (1e9 / camera.fps).round() as u64,
            hears_commands: true,
            chain: Chain::new(config).unwrap(),
            pixels: vec![0; camera.frame_bytes()],
        }
    }

    /// Detections of the current frame.
    pub fn seen(&self) -> &DetectionFrame {
        self.chain.detections()
    }

    /// The resulting `world`.
    pub fn world(&self) -> &WorldFrame {
        self.chain.world()
    }

    /// Renders a picture, lets `spoil` change it, and processes it up to `seen`.
    pub fn look(&mut self, spoil: impl FnOnce(&mut [u8])) {
        let Self { game, header, pixels, chain, .. } = self;
        game.render(pixels, header.stride as usize);
        spoil(pixels);
        chain.classify(header, pixels).unwrap();
        chain.track(pixels);
    }

    /// Filters the detections up to `world`, and passes the resulting commands to the filter, unless
    /// these are withheld.
    pub fn think(&mut self) {
        // Predictions are for a command that leaves at once.
        self.chain.filter(self.header.t_capture_ns);
        self.commands = *self.game.commands();
        (self.commands.seq, self.commands.t_sent_ns) = (self.header.seq, self.header.t_capture_ns);
        if self.hears_commands {
            self.chain.command(&self.commands);
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
