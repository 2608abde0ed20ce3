//! Copies of frames of a running group, for programs that look at pictures: `learn`, `calibrate`, the set-up
//! of the console.
//!
//! A normal consumer reads `frames`, which the group does not feel, and copies what it takes. Pictures come as
//! the camera gave them; [`LiveFrame::bayer`] and [`LiveFrame::rgb`] are those that the commands for picture files
//! work on, whatever the camera's pixel format is.

use classifier::{Picture, to_rgb};
use client::bus::BusError;
use client::consumer::{Consumer, Event, is_there};
use client::instance::Instance;
use config::{CameraConfig, Config};
use grabber::mosaic::mosaic;
use image::RgbImage;
use messages::topics;
use messages::{BayerOrder, FrameFault, FrameHeader, PixelLayout};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Longest time between two looks at the time limit.
const LOOK: Duration = Duration::from_millis(50);

/// Which frames to take.
#[derive(Debug, Clone, Copy)]
pub struct Request {
    /// Number of frames.
    pub frames: usize,
    /// Least time between the captures of two of them.
    pub apart: Duration,
    /// Time until the last of them, after which it is an error.
    pub time_limit: Duration,
}

/// A copy of a frame whose header fits its bytes.
#[derive(Debug, Clone, PartialEq)]
pub struct LiveFrame {
    header: FrameHeader,
    layout: PixelLayout,
    pixels: Vec<u8>,
}

/// Reason for which there are no frames.
#[derive(Debug, thiserror::Error)]
pub enum LiveFramesError {
    /// The group does not run.
    #[error("no group {0:?} is running; start one with `touchline run`")]
    NoGroup(String),
    /// The group has ended before the last frame.
    #[error("the group {instance:?} has ended after {got} of {wanted} frames")]
    Ended {
        /// Its name.
        instance: String,
        /// Frames taken until then.
        got: usize,
        /// Frames requested.
        wanted: usize,
    },
    /// Too few frames within the time limit.
    #[error(
        "the group {instance:?} has captured {got} of {wanted} frames in {seconds:.1} s; \
         `touchline status --instance {instance}` tells what its camera does"
    )]
    TooFew {
        /// Its name.
        instance: String,
        /// Frames taken.
        got: usize,
        /// Frames requested.
        wanted: usize,
        /// The time limit in seconds.
        seconds: f64,
    },
    /// The frames do not fit the group's configuration.
    #[error("the frames of the group {instance:?} cannot be used: {fault}")]
    Unusable {
        /// Its name.
        instance: String,
        /// Fault of the newest one.
        fault: FrameFault,
    },
    /// The group's memory cannot be read.
    #[error(transparent)]
    Bus(#[from] BusError),
}

/// Takes frames of a running group. `camera` is that of its configuration; frames of another size are left out.
pub fn take(
    instance: &Instance,
    camera: &CameraConfig,
    request: &Request,
) -> Result<Vec<LiveFrame>, LiveFramesError> {
    if !is_there(instance) {
        return Err(LiveFramesError::NoGroup(instance.name().into()));
    }
    let Request { frames: wanted, apart, time_limit } = *request;
    let deadline = Instant::now() + time_limit;
    let mut consumer = Consumer::new(instance.clone(), "live-frames", &topics::FRAMES);
    let mut frames: Vec<LiveFrame> = Vec::with_capacity(wanted.min(1000));
    let mut fault = None;
    while frames.len() < wanted {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            let (instance, got) = (instance.name().into(), frames.len());
            return Err(match fault {
                Some(fault) if got == 0 => LiveFramesError::Unusable { instance, fault },
                _ => {
                    let seconds = time_limit.as_secs_f64();
                    LiveFramesError::TooFew { instance, got, wanted, seconds }
                }
            });
        }
        let received = match consumer.next(left.min(LOOK))? {
            Some(Event::Message(received)) => received,
            Some(Event::Left) => {
                let (instance, got) = (instance.name().into(), frames.len());
                return Err(LiveFramesError::Ended { instance, got, wanted });
            }
            Some(Event::Joined | Event::Missed(_) | Event::Restarted) | None => continue,
        };
        let header = received.header();
        let is_due = frames.last().is_none_or(|last| {
            let passed_ns = header.t_capture_ns.saturating_sub(last.header.t_capture_ns);
            Duration::from_nanos(passed_ns) >= apart
        });
        if !is_due {
            continue;
        }
        match LiveFrame::copy(header, received.elements(), camera) {
            Ok(frame) => frames.push(frame),
            Err(why) => fault = Some(why),
        }
    }
    Ok(frames)
}

/// Frames as [`Lessons`](offline::learning::lessons::Lessons) take them: with a name each, mosaicked in the order of
/// the configured camera.
pub fn named_bayer(
    frames: &[LiveFrame],
    config: &Config,
) -> impl Iterator<Item = (PathBuf, Vec<u8>)> {
    frames.iter().map(|frame| {
        let name = format!("frame {}", frame.header().seq);
        (name.into(), frame.bayer(config.camera.bayer_order))
    })
}

impl LiveFrame {
    /// Copies a frame, if its header fits the camera and the bytes.
    pub fn copy(
        header: &FrameHeader,
        pixels: &[u8],
        camera: &CameraConfig,
    ) -> Result<Self, FrameFault> {
        let layout = header.check(camera.width, camera.height, pixels.len())?;
        Ok(Self { header: *header, layout, pixels: pixels.to_vec() })
    }

    /// The header as published.
    pub fn header(&self) -> &FrameHeader {
        &self.header
    }

    /// The bytes as published; [`layout`](Self::layout) and the header's stride say what they mean.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// Meaning of the bytes.
    pub fn layout(&self) -> PixelLayout {
        self.layout
    }

    /// The frame as the classifier's kernels see it; `None` for sides of less than two pixels.
    pub fn picture(&self) -> Option<Picture<'_>> {
        let FrameHeader { width, height, stride, .. } = self.header;
        Picture::new(&self.pixels, width, height, stride, self.layout)
    }

    /// The frame as Bayer data of one byte a pixel, rows without padding: exact for Bayer frames of this
    /// order, reduced to the mosaic for others. It is empty if [`picture`](Self::picture) is `None`.
    pub fn bayer(&self, order: BayerOrder) -> Vec<u8> {
        let mut bayer = Vec::new();
        match self.picture() {
            Some(Picture::Bayer(image)) if image.order() == order => image.copy_mosaic(&mut bayer),
            Some(_) => {
                bayer.resize(self.header.width as usize * self.header.height as usize, 0);
                mosaic(&self.rgb(), self.header.width as usize, order, &mut bayer);
            }
            None => {}
        }
        bayer
    }

    /// The demosaiced frame, three bytes a pixel, rows without padding: the colours that the classifier sees.
    pub fn rgb(&self) -> Vec<u8> {
        let mut rgb = Vec::new();
        if let Some(picture) = self.picture() {
            to_rgb(&picture, &mut rgb);
        }
        rgb
    }
}

/// The median of the frames in red, green and blue, pixel by pixel and channel by channel: what moves vanishes
/// from it, and noise is smaller. `None` without frames, or if their sizes differ.
pub fn median(frames: &[LiveFrame]) -> Option<RgbImage> {
    let (width, height) = frames.first().map(|frame| (frame.header.width, frame.header.height))?;
    let colors: Vec<Vec<u8>> = frames.iter().map(LiveFrame::rgb).collect();
    let bytes = 3 * width as usize * height as usize;
    if colors.iter().any(|rgb| rgb.len() != bytes) {
        return None;
    }
    let mut values = vec![0; colors.len()];
    let middle = colors.len() / 2;
    let median = |index: usize| {
        values.iter_mut().zip(&colors).for_each(|(value, rgb)| *value = rgb[index]);
        *values.select_nth_unstable(middle).1
    };
    RgbImage::from_raw(width, height, (0..bytes).map(median).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::PixelFormat;

    fn camera() -> CameraConfig {
        CameraConfig { width: 4, height: 2, ..config::Config::default().camera }
    }

    fn header(format: PixelFormat, order: BayerOrder, stride: u32) -> FrameHeader {
        FrameHeader {
            width: 4,
            height: 2,
            stride,
            pixel_format: format as u32,
            bayer_order: order as u32,
            ..FrameHeader::default()
        }
    }

    #[test]
    fn bayer_frames_lose_their_padding_and_surplus_bits_only() {
        let rows = [1, 2, 3, 4, 99, 5, 6, 7, 8, 99];
        let frame =
            LiveFrame::copy(&header(PixelFormat::Bayer8, BayerOrder::Grbg, 5), &rows, &camera());
        assert_eq!(frame.unwrap().bayer(BayerOrder::Grbg), [1, 2, 3, 4, 5, 6, 7, 8]);
        let deep: Vec<u8> = (1u16..=8).flat_map(|value| (value << 4 | 5).to_le_bytes()).collect();
        let frame =
            LiveFrame::copy(&header(PixelFormat::Bayer12, BayerOrder::Rggb, 8), &deep, &camera());
        assert_eq!(frame.unwrap().bayer(BayerOrder::Rggb), [1, 2, 3, 4, 5, 6, 7, 8]);
    }

    #[test]
    fn other_formats_are_reduced_to_the_mosaic() {
        let pixels = [10, 20, 30].repeat(8);
        let header = header(PixelFormat::Rgb24, BayerOrder::Rggb, 12);
        let frame = LiveFrame::copy(&header, &pixels, &camera()).unwrap();
        assert_eq!(frame.rgb(), pixels);
        assert_eq!(frame.bayer(BayerOrder::Bggr), [30, 20, 30, 20, 20, 10, 20, 10]);
    }

    #[test]
    fn a_header_that_does_not_fit_is_refused() {
        let header = header(PixelFormat::Bayer8, BayerOrder::Rggb, 4);
        assert!(matches!(
            LiveFrame::copy(&header, &[0; 7], &camera()),
            Err(FrameFault::Truncated { got: 7, needed: 8 })
        ));
        let larger = CameraConfig { width: 8, ..camera() };
        assert!(matches!(LiveFrame::copy(&header, &[0; 8], &larger), Err(FrameFault::Size { .. })));
    }

    #[test]
    fn what_moves_vanishes_from_the_median() {
        let frame = |value: u8| {
            let mut pixels = [10, 20, 30].repeat(8);
            pixels[usize::from(value) % 24] = 255;
            let header = header(PixelFormat::Rgb24, BayerOrder::Rggb, 12);
            LiveFrame::copy(&header, &pixels, &camera()).unwrap()
        };
        let median = median(&[frame(0), frame(7), frame(14)]).unwrap();
        assert_eq!(median.into_raw(), [10, 20, 30].repeat(8));
        assert!(super::median(&[]).is_none());
    }
}
