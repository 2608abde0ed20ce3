//! Sources that paint their frames themselves.

use super::{Camera, CameraError, Captured, Exposure, FramePool, Picture};
use common::config::CameraConfig;
use common::messages::{Commands, PixelFormat, TruthFrame};

/// A source of raw Bayer frames in the configured size and order, rows without padding.
///
/// It writes into the memory it is given, which is shared memory and holds an old frame.
pub trait Painter {
    /// Waits for the next frame, writes it to `pixels` and says when it was taken.
    fn expose(&mut self, pixels: &mut [u8]) -> Result<Exposure, CameraError>;

    /// See [`Camera::truth`].
    fn truth(&self) -> Option<(&TruthFrame, &Commands)> {
        None
    }
}

/// A painter as a camera.
pub struct Painted<P> {
    painter: P,
    picture: Picture,
}

impl<P: Painter> Painted<P> {
    /// Frames as configured.
    pub fn new(painter: P, config: &CameraConfig) -> Self {
        let picture = Picture {
            width: config.width,
            height: config.height,
            stride: config.width,
            pixel_format: PixelFormat::Bayer8,
            bayer_order: config.bayer_order,
            exposure_us: config.exposure_us,
        };
        Self { painter, picture }
    }
}

impl<P: Painter> Camera for Painted<P> {
    fn capture(&mut self, pool: &mut FramePool) -> Result<Option<Captured>, CameraError> {
        let picture = self.picture;
        let mut frame = pool.loan(picture.stride as usize * picture.height as usize)?;
        let exposure = self.painter.expose(frame.elements())?;
        Ok(Some(Captured { frame, exposure, picture }))
    }

    fn truth(&self) -> Option<(&TruthFrame, &Commands)> {
        self.painter.truth()
    }
}
