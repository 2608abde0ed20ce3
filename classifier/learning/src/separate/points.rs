//! What bounds are judged by: samples, the same samples in other light, rims and background.

use super::Wishes;
use crate::samples::{Rim, Sample, Samples};

/// Pixels of one patch are much alike: this many, spread over the patch, say what all of it says.
const MOST_PER_PATCH: usize = 48;
/// Rims are many and count little; this many are enough.
const MOST_RIMS: usize = 12_000;
/// A turn of hue.
pub(super) const TURN: f64 = 65536.0;

/// A colour that bounds admit or not, and what that is worth.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    pub rgb: [u8; 3],
    /// In 256ths.
    pub saturation: u8,
    /// In 65536ths of a turn; `None` for grey, which no bound in hue admits.
    pub hue: Option<u16>,
    /// `None` for background and rims.
    pub class: Option<u8>,
    /// Bit i: taking it for class i costs nothing.
    indifferent: u32,
    pub patch: u32,
    /// How many pixels look like this; how much it counts, for a rim and for a sample in other light.
    pub pixels: f32,
    /// A sample in other light, or a rim: its being recognised or not is no measure of a patch.
    pub is_imagined: bool,
    pub weight: f32,
}

impl Point {
    pub fn new(rgb: [u8; 3], class: Option<u8>, patch: u32, pixels: f32) -> Self {
        let [red, green, blue] = rgb.map(f64::from);
        let hue = || {
            let radians = (3f64.sqrt() * (green - blue)).atan2(2.0 * red - green - blue);
            (radians / std::f64::consts::TAU * TURN).round() as i64 as u16
        };
        let is_grey = rgb[0] == rgb[1] && rgb[1] == rgb[2];
        Self {
            rgb,
            saturation: (saturation(rgb) * 256.0).min(255.0) as u8,
            hue: (!is_grey).then(hue),
            class,
            indifferent: 0,
            patch,
            pixels,
            is_imagined: false,
            weight: 0.0,
        }
    }

    /// Whether it is a pixel of the background, and no rim.
    pub fn is_background(&self) -> bool {
        self.class.is_none() && !self.is_imagined
    }

    /// Gain of classifying the point as this class.
    pub fn value(&self, class: Option<u8>) -> f32 {
        match (self.class, class) {
            (_, None) => 0.0,
            (Some(own), Some(class)) if own == class => self.weight,
            (None, Some(class)) if self.indifferent >> class & 1 == 1 => 0.0,
            _ => -self.weight,
        }
    }
}

fn saturation(rgb: [u8; 3]) -> f64 {
    let [red, green, blue] = rgb.map(u32::from);
    let sum = red + green + blue;
    let colored = sum - 3 * red.min(green).min(blue);
    f64::from(colored) / f64::from(sum.max(1))
}

/// The points that samples make. Samples in other light are a third of the samples for each light.
pub(super) fn points(samples: &Samples, wishes: &Wishes) -> Vec<Point> {
    let seen = thinned(samples);
    let mut points: Vec<Point> = seen
        .iter()
        .map(|sample| Point::new(sample.rgb, Some(sample.class), sample.patch, 1.0))
        .collect();
    let lights = wishes.other_lights.len();
    for (number, (light, counts)) in wishes.other_lights.into_iter().enumerate() {
        let imagined = seen.iter().skip(number).step_by(lights).map(|sample| {
            let rgb = sample.rgb.map(|value| (f64::from(value) * light).min(255.0) as u8);
            let counts = (counts * lights as f64) as f32;
            let point = Point::new(rgb, Some(sample.class), sample.patch, counts);
            Point { is_imagined: true, ..point }
        });
        points.extend(imagined);
    }
    let rims: Vec<&Rim> =
        samples.rims.iter().step_by(samples.rims.len().div_ceil(MOST_RIMS).max(1)).collect();
    let rim_pixels = (wishes.rim_weight / rims.len().max(1) as f64) as f32;
    points.extend(rims.iter().map(|rim| Point {
        indifferent: rim.beside,
        is_imagined: true,
        ..Point::new(rim.rgb, None, 0, rim_pixels)
    }));
    let background = samples.background.iter();
    points.extend(background.map(|&(rgb, pixels)| Point::new(rgb, None, 0, pixels as f32)));
    points
}

/// At most [`MOST_PER_PATCH`] samples of each patch.
fn thinned(samples: &Samples) -> Vec<Sample> {
    let mut counts = vec![0usize; samples.patches as usize];
    samples.pixels.iter().for_each(|sample| counts[sample.patch as usize] += 1);
    let mut numbers = vec![0usize; counts.len()];
    let is_kept = |sample: &&Sample| {
        let patch = sample.patch as usize;
        numbers[patch] += 1;
        (numbers[patch] - 1).is_multiple_of(counts[patch].div_ceil(MOST_PER_PATCH))
    };
    samples.pixels.iter().filter(is_kept).copied().collect()
}
