//! The table of frame sources.

use crate::camera::{
    Camera, CameraError, Exposure, FrameRenderer, LastFrame, Link, RenderedCamera, Timeline,
};
use crate::genicam::GenicamDevice;
use crate::injector::Injector;
use crate::picture_camera::Pictures;
use crate::playback::{Playback, Playlist, recorded_config};
use crate::synthetic::SyntheticMatch;
use crate::v4l2::V4l2Device;
use client::clock::monotonic_ns;
use config::{CameraConfig, Config};
use messages::{Commands, TruthFrame};
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;

/// A source of frames, as named on the command line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Source {
    /// The built-in match: `synthetic`.
    Synthetic,
    /// A number of frames of the match, rendered in advance and replayed forwards and backwards:
    /// `synthetic-loop:N`. Costs little, so that at any rate the rest of the group has the machine.
    Loop(u32),
    /// Picture files: `images:PATH`.
    Pictures(PathBuf),
    /// A recording: `recording:FILE[,fast|,step][,loop][,from=SECONDS]`.
    Recording(Playlist),
    /// A camera of Video for Linux: `v4l2:DEVICE`.
    V4l2(PathBuf),
    /// A GigE Vision or USB3 Vision camera: `genicam:ID`, or `genicam` for the first one.
    Genicam(Option<String>),
    /// Another program, which `access.publishers` names: `external`.
    External,
}

/// Default number of frames of a loop.
pub const LOOP_FRAMES: u32 = 32;
/// Maximum number of frames of a loop.
const MAX_LOOP_FRAMES: u32 = 4096;
const HELP: &str = "use synthetic, synthetic-loop:N, images:PATH with a picture or a folder of pictures, \
                    recording:FILE[,fast|,step][,loop][,from=SECONDS], v4l2:/dev/videoN, genicam or genicam:ID with a camera (`touchline cameras` \
                    lists them), or external for a program that access.publishers names";

impl FromStr for Source {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            None if text == "synthetic" => Ok(Self::Synthetic),
            None if text == "synthetic-loop" => Ok(Self::Loop(LOOP_FRAMES)),
            Some(("synthetic-loop", frames)) => match frames.parse() {
                Ok(frames) if (1..=MAX_LOOP_FRAMES).contains(&frames) => Ok(Self::Loop(frames)),
                _ => Err(format!("use synthetic-loop:N with N from 1 to {MAX_LOOP_FRAMES}")),
            },
            None if text == "external" => Ok(Self::External),
            None if text == "genicam" => Ok(Self::Genicam(None)),
            Some(("genicam", id)) if !id.is_empty() => Ok(Self::Genicam(Some(id.into()))),
            Some(("images", path)) if !path.is_empty() => Ok(Self::Pictures(path.into())),
            Some(("recording", playlist)) => Ok(Self::Recording(playlist.parse()?)),
            Some(("v4l2", path)) if !path.is_empty() => Ok(Self::V4l2(path.into())),
            _ => Err(HELP.into()),
        }
    }
}

impl std::fmt::Display for Source {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Synthetic => write!(f, "synthetic"),
            Self::Loop(frames) => write!(f, "synthetic-loop:{frames}"),
            Self::Pictures(path) => write!(f, "images:{}", path.display()),
            Self::Recording(playlist) => write!(f, "recording:{playlist}"),
            Self::V4l2(path) => write!(f, "v4l2:{}", path.display()),
            Self::External => write!(f, "external"),
            Self::Genicam(None) => write!(f, "genicam"),
            Self::Genicam(Some(id)) => write!(f, "genicam:{id}"),
        }
    }
}

impl Source {
    /// Maximum bytes per frame, for which memory is reserved. Real cameras choose their own format, and pad
    /// rows and pictures.
    pub fn frame_capacity(&self, camera: &CameraConfig) -> usize {
        let (width, height) = (camera.width as usize, camera.height as usize);
        match self {
            Self::Synthetic | Self::Loop(_) | Self::Pictures(_) | Self::External => {
                camera.frame_bytes()
            }
            Self::V4l2(_) | Self::Genicam(_) | Self::Recording(_) => {
                (3 * width).next_multiple_of(256) * (height + 16) + 4096
            }
        }
    }
}

impl Source {
    /// Whether it ends by itself.
    pub fn is_bounded(&self) -> bool {
        matches!(self, Self::Recording(playlist) if !playlist.is_loop)
    }
}

/// An opened source, ready to start.
type Opened = Box<dyn FnOnce(Option<LastFrame>) -> Result<Box<dyn Camera>, CameraError>>;

/// Checks whether a source can be opened.
pub fn check(source: &Source, config: &Config) -> Result<(), CameraError> {
    open(source, config).map(drop)
}

/// Opens a source. All slow and fallible work happens here; the timeline starts when the returned function is
/// called.
pub fn open(source: &Source, config: &Config) -> Result<Opened, CameraError> {
    let camera = config.camera.clone();
    match source {
        Source::External if config.access.publishers.is_empty() => Err(CameraError::External),
        Source::External => Ok(Box::new(|_| Err(CameraError::External))),
        Source::Synthetic => {
            let scene = SyntheticMatch::new(config)
                .map_err(|error| CameraError::Synthetic(error.to_string()))?;
            Ok(Box::new(move |last| {
                let timeline = Timeline::new(camera.fps, last);
                let width = camera.width as usize;
                let painter =
                    SyntheticCamera { scene, width, position: 0, painting_ns: 0, timeline };
                Ok(Box::new(RenderedCamera::new(painter, &camera)))
            }))
        }
        Source::Loop(frames) => {
            let injector = Injector::new(config, *frames)
                .map_err(|error| CameraError::Synthetic(error.to_string()))?;
            Ok(Box::new(move |last| {
                let injector = injector.start(Timeline::new(camera.fps, last));
                Ok(Box::new(RenderedCamera::new(injector, &camera)))
            }))
        }
        Source::V4l2(path) => {
            let device = Arc::new(V4l2Device::new(path, &camera));
            Ok(Box::new(move |last| Ok(Box::new(Link::new(device, camera.fps, last)))))
        }
        Source::Genicam(id) => {
            let device = Arc::new(GenicamDevice::new(id.clone(), &camera));
            Ok(Box::new(move |last| Ok(Box::new(Link::new(device, camera.fps, last)))))
        }
        Source::Pictures(path) => {
            let pictures = Pictures::open(path, &camera)?;
            Ok(Box::new(move |last| {
                let timeline = Timeline::new(camera.fps, last);
                Ok(Box::new(RenderedCamera::new(pictures.start(timeline), &camera)))
            }))
        }
        Source::Recording(playlist) => {
            let recorded = recorded_config(&playlist.path, 0.0)?.camera;
            let size = (camera.width, camera.height);
            if size != (recorded.width, recorded.height) {
                return Err(CameraError::Picture {
                    path: playlist.path.display().to_string(),
                    problem: format!(
                        "its frames are {}×{}, the configuration says {}×{}; without --config the \
                         recorded configuration is used",
                        recorded.width, recorded.height, camera.width, camera.height
                    ),
                });
            }
            let (playlist, config) = (playlist.clone(), config.clone());
            Ok(Box::new(move |last| Ok(Box::new(Playback::open(&playlist, &config, last)?))))
        }
    }
}

/// The synthetic match as a camera: each frame is rendered before it is due, and delivered when it is.
struct SyntheticCamera {
    scene: SyntheticMatch,
    width: usize,
    /// Frame number of the scene's present state.
    position: u64,
    /// Duration of rendering the last frame.
    painting_ns: u64,
    timeline: Timeline,
}

impl FrameRenderer for SyntheticCamera {
    fn expose(&mut self, pixels: &mut [u8]) -> Result<Exposure, CameraError> {
        let skipped = self.timeline.skip_late();
        self.timeline.rest(self.painting_ns);
        let begun_ns = monotonic_ns();
        // A successor reaches its predecessor's state in the same way, since the match is a function of seed
        // and frame number.
        while self.position < self.timeline.next_seq() {
            self.scene.advance();
            self.position += 1;
        }
        self.scene.render(pixels, self.width);
        self.painting_ns = monotonic_ns() - begun_ns;
        Ok(self.timeline.wait(skipped))
    }

    fn truth(&self) -> Option<(&TruthFrame, &Commands)> {
        Some((self.scene.truth(), self.scene.commands()))
    }

    fn obey(&mut self, commands: &Commands) {
        self.scene.obey(commands);
    }
}
