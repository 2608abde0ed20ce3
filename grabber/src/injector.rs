//! A source that costs next to nothing: frames of the synthetic match, painted in advance, shown to
//! and fro. For finding out what the rest of the group is capable of.

use crate::camera::{CameraError, Exposure, Painter, Timeline};
use crate::synthetic::{SyntheticError, SyntheticMatch};
use common::clock::monotonic_ns;
use common::config::Config;

/// Frames painted in advance.
pub struct Injector {
    frames: Vec<Vec<u8>>,
}

/// An injector at work.
pub struct InjectorCamera {
    frames: Vec<Vec<u8>>,
    /// How long the last frame took.
    copying_ns: u64,
    timeline: Timeline,
}

impl Injector {
    /// Paints `count` frames, at least one, one after the other.
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

    /// Starts to show them.
    pub fn start(self, timeline: Timeline) -> InjectorCamera {
        InjectorCamera { frames: self.frames, copying_ns: 0, timeline }
    }
}

impl Painter for InjectorCamera {
    fn expose(&mut self, pixels: &mut [u8]) -> Result<Exposure, CameraError> {
        let skipped = self.timeline.skip_late();
        self.timeline.rest(self.copying_ns);
        let begun_ns = monotonic_ns();
        pixels.copy_from_slice(&self.frames[place(self.timeline.next_seq(), self.frames.len())]);
        self.copying_ns = monotonic_ns() - begun_ns;
        Ok(self.timeline.wait(skipped))
    }
}

/// Which of `count` frames is shown as number `seq`: forwards, then backwards, so that nothing jumps.
fn place(seq: u64, count: usize) -> usize {
    let period = (2 * (count as u64 - 1)).max(1);
    let step = seq % period;
    step.min(period - step) as usize % count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_shown_to_and_fro() {
        let shown: Vec<usize> = (0..8).map(|seq| place(seq, 4)).collect();
        assert_eq!(shown, [0, 1, 2, 3, 2, 1, 0, 1]);
        assert_eq!((place(0, 1), place(5, 1), place(0, 2), place(1, 2)), (0, 0, 0, 1));
    }

    #[test]
    fn they_are_those_of_the_match() {
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
