//! A small ray tracer that renders a pitch as a raw Bayer camera would see it.
//!
//! It shares no code and no assumption with the synthetic match: another lens (Brown–Conrady, with its
//! centre off the middle of the picture), another camera pose, lamps to one side whose light falls off
//! with the square of the distance, shadows, paints of another palette, a sensor that mixes its
//! channels, shot noise. So results on these pictures hold for independent pictures.
//!
//! Field coordinates are millimetres, x to the right, y up in the picture, z above the floor. Colours
//! are linear reflectances in red, green and blue, 0 to 1.

// Every test file uses its own part of this.
#![allow(dead_code)]

mod lens;
pub mod random;
mod scene;

pub use lens::Lens;
pub use scene::{Ball, Floor, Lamp, Marking, Robot, Scene, Shape};

use random::Random;

pub type Rgb = [f64; 3];
pub type Vector = [f64; 3];

/// Samples along each side of a pixel that shows more than one object.
const SAMPLES: u32 = 5;

/// The sensor behind the lens.
#[derive(Debug, Clone)]
pub struct Sensor {
    /// Response of each channel (row) to the light's red, green and blue (columns).
    pub mixing: [Rgb; 3],
    /// Digital number of a white surface in full light.
    pub white: f64,
    /// Electrons per digital number: shot noise is the root of their count.
    pub electrons_per_unit: f64,
    /// Standard deviation of the read noise, in electrons.
    pub read_noise: f64,
}

impl Default for Sensor {
    fn default() -> Self {
        Self {
            mixing: [[0.86, 0.12, 0.02], [0.09, 0.83, 0.08], [0.02, 0.15, 0.83]],
            white: 225.0,
            electrons_per_unit: 60.0,
            read_noise: 8.0,
        }
    }
}

/// The light that reaches each pixel, row by row.
pub fn paint(scene: &Scene, lens: &Lens) -> Vec<Rgb> {
    let (width, height) = (lens.width, lens.height);
    let at = |x: f64, y: f64| scene.look(lens.position, lens.ray(x, y));
    let mut light = Vec::with_capacity((width * height) as usize);
    let mut things = Vec::with_capacity((width * height) as usize);
    for y in 0..height {
        for x in 0..width {
            let (thing, color) = at(f64::from(x), f64::from(y));
            things.push(thing);
            light.push(color);
        }
    }
    let (width_i, height_i) = (i64::from(width), i64::from(height));
    for y in 0..height_i {
        for x in 0..width_i {
            let middle = (y * width_i + x) as usize;
            let uniform = (y - 1..=y + 1).all(|row| {
                (x - 1..=x + 1).all(|column| {
                    let inside = (0..height_i).contains(&row) && (0..width_i).contains(&column);
                    !inside || things[(row * width_i + column) as usize] == things[middle]
                })
            });
            if uniform {
                continue;
            }
            let mut sum = [0.0; 3];
            for sample in 0..SAMPLES * SAMPLES {
                let offset = |index: u32| (f64::from(index) + 0.5) / f64::from(SAMPLES) - 0.5;
                let (dx, dy) = (offset(sample % SAMPLES), offset(sample / SAMPLES));
                let (_, color) = at(x as f64 + dx, y as f64 + dy);
                sum = [0, 1, 2].map(|channel| sum[channel] + color[channel]);
            }
            light[middle] = sum.map(|value| value / f64::from(SAMPLES * SAMPLES));
        }
    }
    light
}

/// The sensor's output for this light: one byte a pixel, in the order RGGB.
pub fn expose(light: &[Rgb], width: u32, sensor: &Sensor, random: &mut Random) -> Vec<u8> {
    let width = width as usize;
    let channel = |index: usize| match (index / width % 2, index % width % 2) {
        (0, 0) => 0,
        (1, 1) => 2,
        _ => 1,
    };
    let mut byte = |index: usize, light: &Rgb| {
        let mixing = sensor.mixing[channel(index)];
        let value: f64 = mixing.iter().zip(light).map(|(part, light)| part * light).sum();
        let electrons = (value * sensor.white * sensor.electrons_per_unit).max(0.0);
        let deviation = (electrons + sensor.read_noise * sensor.read_noise).sqrt();
        let noisy = (electrons + deviation * random.normal()) / sensor.electrons_per_unit;
        noisy.round().clamp(0.0, 255.0) as u8
    };
    light.iter().enumerate().map(|(index, light)| byte(index, light)).collect()
}
