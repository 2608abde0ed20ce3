//! A load generator: frames of the synthetic match, rendered in advance and replayed forwards and backwards.
//! It costs little more than a copy, so the capacity of the other stages can be measured.

use crate::camera::{CameraError, Exposure, FrameRenderer, Timeline};
use crate::synthetic::{SyntheticError, SyntheticMatch};
use client::clock::monotonic_ns;
use config::Config;

/// Frames rendered in advance.
pub struct Injector {
    frames: Vec<Vec<u8>>,
}

/// A running injector.
pub struct InjectorCamera {
    frames: Vec<Vec<u8>>,
    /// Duration of the last copy.
    copying_ns: u64,
    timeline: Timeline,
}

impl Injector {
    /// Renders `count` consecutive frames, at least one.
    pub fn new(config: &Config, count: u32) -> Result<Self, SyntheticError> {
        let mut scene = SyntheticMatch::new(config)?;
        let frames = (0..count.max(1))
            .map(|_| {
                let mut pixels = vec![0; config.camera.frame_bytes()];
                scene.render(&mut pixels, config.camera.width as usize);
                scene.advance();
                pixels
            })
            .collect();
        Ok(Self { frames })
    }

    /// Starts replaying them.
    pub fn start(self, timeline: Timeline) -> InjectorCamera {
        InjectorCamera { frames: self.frames, copying_ns: 0, timeline }
    }
}

impl FrameRenderer for InjectorCamera {
    fn expose(&mut self, pixels: &mut [u8]) -> Result<Exposure, CameraError> {
        let skipped = self.timeline.skip_late();
        self.timeline.rest(self.copying_ns);
        let begun_ns = monotonic_ns();
        pixels.copy_from_slice(&self.frames[place(self.timeline.next_seq(), self.frames.len())]);
        self.copying_ns = monotonic_ns() - begun_ns;
        Ok(self.timeline.wait(skipped))
    }
}

/// Index among `count` frames of the frame shown as number `seq`: forwards, then backwards, so that nothing
/// jumps.
fn place(seq: u64, count: usize) -> usize {
    let period = (2 * (count as u64 - 1)).max(1);
    let step = seq % period;
    step.min(period - step) as usize % count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_shown_forwards_and_backwards() {
        let shown: Vec<usize> = (0..8).map(|seq| place(seq, 4)).collect();
        assert_eq!(shown, [0, 1, 2, 3, 2, 1, 0, 1]);
        assert_eq!((place(0, 1), place(5, 1), place(0, 2), place(1, 2)), (0, 0, 0, 1));
    }

    #[test]
    fn frames_are_those_of_the_match() {
        let config = Config::default();
        let injector = Injector::new(&config, 3).unwrap();
        let mut scene = SyntheticMatch::new(&config).unwrap();
        let mut pixels = vec![0; config.camera.frame_bytes()];
        for frame in &injector.frames {
            scene.render(&mut pixels, config.camera.width as usize);
            assert!(*frame == pixels);
            scene.advance();
        }
    }
}
