//! Pictures to measure with: dark background, squares of the classes' colours, or noise.

use super::COLD_BYTES;
use crate::TrialError;
use config::{ColorConfig, Config, GeometryConfig, LightConfig};
use grabber::synthetic::SyntheticMatch;
use messages::{BayerOrder, FrameHeader, PixelFormat, Run};
use std::fmt;

/// Content of a picture.
#[derive(Debug, Clone, Copy)]
pub enum Content {
    /// Squares that cover this share of the picture.
    Foreground(f64),
    /// Random bytes.
    Noise,
}

impl fmt::Display for Content {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Foreground(part) => write!(f, "{} % foreground", part * 100.0),
            Self::Noise => write!(f, "noise"),
        }
    }
}

/// Frames of a match, enough that none is still in a cache when its turn comes again.
pub fn match_frames(config: &Config) -> Result<Vec<Vec<u8>>, TrialError> {
    let mut scene = SyntheticMatch::new(config)?;
    let bytes = config.camera.frame_bytes();
    let frames = (0..(COLD_BYTES / bytes).clamp(3, 128)).map(|_| {
        let mut pixels = vec![0; bytes];
        scene.render(&mut pixels, config.camera.width as usize);
        scene.advance();
        pixels
    });
    Ok(frames.collect())
}

/// A Bayer frame and the configuration that goes with it.
pub struct Picture {
    pub width: u32,
    pub height: u32,
    pub classes: usize,
    pub content: Content,
    pub config: Config,
    pub header: FrameHeader,
    pub pixels: Vec<u8>,
}

/// Side of a square in pixels, about that of a patch.
const SQUARE: u32 = 9;
/// Colour of the background, and amplitude of its noise.
const GROUND: [u8; 3] = [30, 38, 34];
const STRAY: u64 = 9;

impl Picture {
    /// Paints the picture.
    pub fn new(width: u32, height: u32, classes: usize, content: Content) -> Self {
        let mut config = Config::default();
        (config.camera.width, config.camera.height) = (width, height);
        // The whole picture is processed, without corrections.
        config.field.mask = false;
        config.light = LightConfig::default();
        config.geometry = GeometryConfig::above(&config.field, config.camera.picture_px(), 2200.0);
        config.colors = (0..classes).map(color).collect();
        let order = BayerOrder::Rggb;
        let header = FrameHeader {
            width,
            height,
            stride: width,
            pixel_format: PixelFormat::Bayer8 as u32,
            bayer_order: order as u32,
            ..FrameHeader::default()
        };
        let mut state = 1u64;
        let mut draw = || {
            // The high bits of a linear congruential generator (Knuth's MMIX) are random enough.
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            state >> 33
        };
        let mut pixels = Vec::with_capacity((width * height) as usize);
        for y in 0..height {
            for x in 0..width {
                pixels.push(match content {
                    Content::Noise => draw() as u8,
                    Content::Foreground(part) => {
                        let channel = order.channel_at(x as usize, y as usize);
                        let level = match square_at(x, y, part) {
                            Some(number) => config.colors[number % classes].looks[channel],
                            None => GROUND[channel],
                        };
                        level.saturating_add((draw() % STRAY) as u8).saturating_sub(STRAY as u8 / 2)
                    }
                });
            }
        }
        Self { width, height, classes, content, config, header, pixels }
    }

    /// Regions that runs form, by flood fill over pixels.
    pub fn count_regions(&self, runs: &[Run]) -> usize {
        let width = self.width as usize;
        let mut labels = vec![None; width * self.height as usize];
        for run in runs {
            let row = usize::from(run.row) * width;
            labels[row + usize::from(run.begin)..row + usize::from(run.end)].fill(Some(run.class));
        }
        let mut count = 0;
        let mut pending = Vec::new();
        for start in 0..labels.len() {
            let Some(class) = labels[start] else { continue };
            count += 1;
            pending.push(start);
            while let Some(pixel) = pending.pop() {
                if labels[pixel] != Some(class) {
                    continue;
                }
                labels[pixel] = None;
                pending.extend((pixel % width > 0).then(|| pixel - 1));
                pending.extend((pixel % width + 1 < width).then(|| pixel + 1));
                pending.extend(pixel.checked_sub(width));
                pending.extend((pixel + width < labels.len()).then(|| pixel + width));
            }
        }
        count
    }
}

/// Index of the square that contains a pixel, if evenly spread squares cover `part` of the picture.
fn square_at(x: u32, y: u32, part: f64) -> Option<usize> {
    let pitch = (f64::from(SQUARE) / part.sqrt()).round() as u32;
    let number = (x / pitch) as usize + 7 * (y / pitch) as usize;
    (x % pitch < SQUARE && y % pitch < SQUARE).then_some(number)
}

/// Up to 32 colours whose boxes overlap neither each other nor the background.
fn color(class: usize) -> ColorConfig {
    let around = |level: u8, reach: u8| [level - reach, level.saturating_add(reach)];
    let levels = [80, 135, 190, 240];
    let (red, green) = (levels[class % 4], levels[class / 4 % 4]);
    let blue = [90, 200][class / 16 % 2];
    ColorConfig {
        name: format!("class {class}"),
        red: around(red, 22),
        green: around(green, 22),
        blue: around(blue, 40),
        hue_deg: None,
        saturation: None,
        y: None,
        u: None,
        v: None,
        looks: [red, green, blue],
    }
}
