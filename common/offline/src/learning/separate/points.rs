//! Points that bounds are scored by: samples, samples in other light, rims and background.

use super::Objective;
use crate::learning::samples::{Rim, Sample, Samples};

/// Samples used per patch: pixels of one patch are much alike, so this many, spread over it, represent all.
const MAX_PER_PATCH: usize = 48;
/// Rim pixels used: they are many and weigh little.
const MAX_RIMS: usize = 12_000;
/// A full turn of hue.
pub(super) const TURN: f64 = 65536.0;

/// A colour, and the value of admitting it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    pub rgb: [u8; 3],
    /// In 256ths.
    pub saturation: u8,
    /// In 65536ths of a turn; `None` for grey, which no hue bound admits.
    pub hue: Option<u16>,
    /// `None` for background and rims.
    pub class: Option<u8>,
    /// Bit set of the classes that the point may have at no cost.
    indifferent: u32,
    pub patch: u32,
    /// Number of pixels of this colour; for a rim or a sample in other light, its weight.
    pub pixels: f32,
    /// A sample in other light, or a rim: does not count in the recall of a patch.
    pub is_derived: bool,
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
            is_derived: false,
            weight: 0.0,
        }
    }

    /// Whether it is a background pixel, not a rim.
    pub fn is_background(&self) -> bool {
        self.class.is_none() && !self.is_derived
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

/// The points made from samples. For each light, a third of the samples is used.
pub(super) fn points(samples: &Samples, objective: &Objective) -> Vec<Point> {
    let seen = thinned(samples);
    let mut points: Vec<Point> = seen
        .iter()
        .map(|sample| Point::new(sample.rgb, Some(sample.class), sample.patch, 1.0))
        .collect();
    let lights = objective.other_lights.len();
    for (number, (light, counts)) in objective.other_lights.into_iter().enumerate() {
        let derived = seen.iter().skip(number).step_by(lights).map(|sample| {
            let rgb = sample.rgb.map(|value| (f64::from(value) * light).min(255.0) as u8);
            let counts = (counts * lights as f64) as f32;
            let point = Point::new(rgb, Some(sample.class), sample.patch, counts);
            Point { is_derived: true, ..point }
        });
        points.extend(derived);
    }
    let rims: Vec<&Rim> =
        samples.rims.iter().step_by(samples.rims.len().div_ceil(MAX_RIMS).max(1)).collect();
    let rim_pixels = (objective.rim_weight / rims.len().max(1) as f64) as f32;
    points.extend(rims.iter().map(|rim| Point {
        indifferent: rim.beside,
        is_derived: true,
        ..Point::new(rim.rgb, None, 0, rim_pixels)
    }));
    let background = samples.background.iter();
    points.extend(background.map(|&(rgb, pixels)| Point::new(rgb, None, 0, pixels as f32)));
    points
}

/// At most [`MAX_PER_PATCH`] samples of each patch.
fn thinned(samples: &Samples) -> Vec<Sample> {
    let mut counts = vec![0usize; samples.patches as usize];
    samples.pixels.iter().for_each(|sample| counts[sample.patch as usize] += 1);
    let mut numbers = vec![0usize; counts.len()];
    let is_kept = |sample: &&Sample| {
        let patch = sample.patch as usize;
        numbers[patch] += 1;
        (numbers[patch] - 1).is_multiple_of(counts[patch].div_ceil(MAX_PER_PATCH))
    };
    samples.pixels.iter().filter(is_kept).copied().collect()
}
