//! Sources that render their frames.

use super::{Camera, CameraError, Captured, Exposure, FramePool, Picture};
use config::CameraConfig;
use messages::{Commands, PixelFormat, TruthFrame};

/// A source of raw Bayer frames in the configured size and order, rows without padding.
///
/// It writes into shared memory that holds an old frame.
pub trait FrameRenderer {
    /// Waits until the next frame is due, and writes it to `pixels`.
    fn expose(&mut self, pixels: &mut [u8]) -> Result<Exposure, CameraError>;

    /// The truth of the frame just exposed, and the commands sent to the robots at that time; only for
    /// simulated sources.
    fn truth(&self) -> Option<(&TruthFrame, &Commands)> {
        None
    }

    /// Commands of another program; simulated robots obey them.
    fn obey(&mut self, _commands: &Commands) {}
}

/// A camera made of a renderer.
pub struct RenderedCamera<P> {
    painter: P,
    picture: Picture,
    truth: Option<TruthFrame>,
    commands: Vec<Commands>,
}

impl<P: FrameRenderer> RenderedCamera<P> {
    /// For frames as configured.
    pub fn new(painter: P, config: &CameraConfig) -> Self {
        let picture = Picture {
            width: config.width,
            height: config.height,
            stride: config.width,
            pixel_format: PixelFormat::Bayer8,
            bayer_order: config.bayer_order,
            exposure_us: config.exposure_us,
        };
        Self { painter, picture, truth: None, commands: Vec::with_capacity(1) }
    }
}

impl<P: FrameRenderer> Camera for RenderedCamera<P> {
    fn capture(&mut self, pool: &mut FramePool) -> Result<Option<Captured>, CameraError> {
        let picture = self.picture;
        let mut frame = pool.loan(picture.stride as usize * picture.height as usize)?;
        let exposure = self.painter.expose(frame.elements())?;
        let Exposure { seq, t_capture_ns, .. } = exposure;
        self.commands.clear();
        self.truth = self.painter.truth().map(|(truth, commands)| {
            self.commands.push(Commands { seq, t_sent_ns: t_capture_ns, ..*commands });
            TruthFrame { seq, t_capture_ns, ..*truth }
        });
        Ok(Some(Captured { frame, exposure, picture }))
    }

    fn truth(&self) -> Option<&TruthFrame> {
        self.truth.as_ref()
    }

    fn commands(&self) -> &[Commands] {
        &self.commands
    }

    fn obey(&mut self, commands: &Commands) {
        self.painter.obey(commands);
    }
}
