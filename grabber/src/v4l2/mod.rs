//! Cameras of Video for Linux: webcams, capture cards, on-board cameras.
//!
//! `ioctl` has the kernel's requests, `device` negotiates the format, `controls` sets exposure and the like,
//! `stream` receives pictures.

pub mod controls;
mod device;
mod formats;
// Its fields are the kernel's, and documented there.
#[allow(missing_docs)]
mod ioctl;
mod listing;
mod mapping;
mod stream;

pub use listing::list;

use crate::camera::{Device, Fault, FramePool, Session, Stream};
use config::CameraConfig;
use device::Negotiated;
use rustix::fd::OwnedFd;
use std::path::{Path, PathBuf};
use stream::V4l2Stream;

/// A camera of Video for Linux, by the path of its device.
pub struct V4l2Device {
    path: PathBuf,
    config: CameraConfig,
}

impl V4l2Device {
    /// The camera of this device, and its configuration.
    pub fn new(path: &Path, config: &CameraConfig) -> Self {
        Self { path: path.to_path_buf(), config: config.clone() }
    }
}

impl Device for V4l2Device {
    fn name(&self) -> String {
        format!("v4l2:{}", self.path.display())
    }

    fn open(&self) -> Result<Box<dyn Session>, Fault> {
        let (device, capability) = device::open(&self.path)?;
        let negotiated = device::negotiate(&device, &self.path, &self.config)?;
        controls::apply(&device, &self.config.v4l2.controls)?;
        let exposure_us = controls::exposure_us(&device).unwrap_or(self.config.exposure_us);
        Ok(Box::new(Opened {
            device,
            path: self.path.clone(),
            model: ioctl::text(&capability.card),
            config: self.config.clone(),
            negotiated,
            exposure_us,
        }))
    }
}

struct Opened {
    device: OwnedFd,
    path: PathBuf,
    model: String,
    config: CameraConfig,
    negotiated: Negotiated,
    exposure_us: u32,
}

impl Session for Opened {
    fn promised_fps(&self) -> Option<f64> {
        self.negotiated.fps
    }

    fn start(self: Box<Self>, pool: &mut FramePool) -> Result<(Box<dyn Stream>, String), Fault> {
        let CameraConfig { width, height, .. } = self.config;
        let picture = stream::picture_of(&self.negotiated, width, height, self.exposure_us);
        let stream = V4l2Stream::start(
            self.device,
            self.path,
            self.negotiated,
            picture,
            self.config.v4l2.buffers,
            self.config.v4l2.direct,
            pool,
        )?;
        let way = if stream.is_direct() { "straight into shared memory" } else { "copied" };
        let format = formats::name(self.negotiated.fourcc);
        Ok((Box::new(stream), format!("{}, {format} {width}×{height}, {way}", self.model)))
    }
}
