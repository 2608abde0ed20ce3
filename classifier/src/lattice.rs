//! A lattice of places all over a picture. Their colours are sampled once per frame, and shared by all
//! estimates of the light.

use crate::picture::{BayerImage, Picture, narrowed};
use crate::yuv::rgb_from_yuv;
use config::CameraConfig;
use runtime::prefetch::prefetch;

/// Number of places, about.
const SITES: f64 = 3000.0;
/// Prefetch distance, rows of the lattice.
const ROWS_AHEAD: usize = 3;

/// The places, and their colours in the latest picture.
#[derive(Debug, Clone)]
pub struct Lattice {
    grid: Grid,
    /// Red, green and blue of the places, row by row.
    channels: [Vec<u8>; 3],
}

/// Positions of the places.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Grid {
    /// Distance between places, pixels; even, so that all places have the same position in the Bayer pattern.
    pub step: usize,
    pub columns: usize,
    pub rows: usize,
}

impl Grid {
    /// For pictures of a camera's size.
    pub fn new(camera: &CameraConfig) -> Self {
        let step = (f64::from(camera.width) * f64::from(camera.height) / SITES).sqrt() / 2.0;
        let step = (step.round() as usize).max(1) * 2;
        let count = |size: u32| (size.saturating_sub(1) as usize).div_ceil(step);
        Self { step, columns: count(camera.width), rows: count(camera.height) }
    }

    /// Column and row of each place's top-left pixel, row by row.
    pub fn places(self) -> impl Iterator<Item = [usize; 2]> {
        let Self { step, columns, rows } = self;
        (0..rows).flat_map(move |row| (0..columns).map(move |column| [column * step, row * step]))
    }
}

impl Lattice {
    /// For pictures of a camera's size.
    pub fn new(camera: &CameraConfig) -> Self {
        let grid = Grid::new(camera);
        Self { grid, channels: std::array::from_fn(|_| vec![0; grid.columns * grid.rows]) }
    }

    /// Red, green and blue of the places, each row by row.
    pub(crate) fn channels(&self) -> [&[u8]; 3] {
        self.channels.each_ref().map(Vec::as_slice)
    }

    /// Red, green and blue of the places, mutable.
    pub(crate) fn channels_mut(&mut self) -> &mut [Vec<u8>; 3] {
        &mut self.channels
    }

    /// Samples a picture.
    ///
    /// # Panics
    /// If the picture is smaller than the camera's.
    pub fn sample(&mut self, picture: &Picture) {
        match picture {
            Picture::Bayer(image) if image.shift().is_none() => self.sample_bytes(image),
            _ => {
                let [reds, greens, blues] = &mut self.channels;
                let channels = reds.iter_mut().zip(greens).zip(blues);
                for ([x, y], ((red, green), blue)) in self.grid.places().zip(channels) {
                    [*red, *green, *blue] = rgb_at(picture, x, y);
                }
            }
        }
    }

    /// Samples a Bayer picture of one byte per pixel: faster than [`rgb_at`], with the same result.
    fn sample_bytes(&mut self, image: &BayerImage) {
        let Grid { step, columns, rows } = self.grid;
        let (red_x, red_y) = image.order().red_site();
        let [reds, greens, blues] = &mut self.channels;
        let channels = reds
            .chunks_exact_mut(columns)
            .zip(greens.chunks_exact_mut(columns))
            .zip(blues.chunks_exact_mut(columns));
        for (row, ((reds, greens), blues)) in channels.enumerate() {
            let y = row * step;
            if row + ROWS_AHEAD < rows {
                prefetch(image.row(y + ROWS_AHEAD * step));
                prefetch(image.row(y + ROWS_AHEAD * step + 1));
            }
            let (with_red, with_blue) = (image.row(y + red_y), image.row(y + 1 - red_y));
            let places = reds.iter_mut().zip(greens).zip(blues);
            for (column, ((red, green), blue)) in places.enumerate() {
                let (red_x, blue_x) = (column * step + red_x, column * step + 1 - red_x);
                *red = with_red[red_x];
                *green = mean(with_red[blue_x], with_blue[red_x]);
                *blue = with_blue[blue_x];
            }
        }
    }
}

/// Rounded down.
fn mean(a: u8, b: u8) -> u8 {
    ((u16::from(a) + u16::from(b)) / 2) as u8
}

/// The colour of a place; in a Bayer picture, from the 2 × 2 pixels that begin there.
fn rgb_at(picture: &Picture, x: usize, y: usize) -> [u8; 3] {
    match picture {
        Picture::Bayer(image) => {
            let mut sums = [0u16; 3];
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let value = bayer_byte(image, x + dx, y + dy);
                sums[image.order().channel_at(x + dx, y + dy)] += u16::from(value);
            }
            [sums[0] as u8, (sums[1] / 2) as u8, sums[2] as u8]
        }
        Picture::Color(image) => {
            let color = image.row(y).pixel(x);
            if image.is_yuv() { rgb_from_yuv(color) } else { color }
        }
    }
}

fn bayer_byte(image: &BayerImage, x: usize, y: usize) -> u8 {
    let row = image.row(y);
    match image.shift() {
        None => row[x],
        Some(shift) => narrowed(row[2 * x], row[2 * x + 1], shift),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{BayerOrder, PixelFormat, PixelLayout};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn fast_sampling_equals_the_general_one(
            (width, height, padding) in (2u32..400, 2u32..60, 0u32..3),
            seed: u32,
            order in proptest::sample::select(BayerOrder::ALL.to_vec()),
        ) {
            let camera = CameraConfig { width, height, ..CameraConfig::default() };
            let stride = width + padding;
            let noise = |i: u32| ((i ^ seed).wrapping_mul(2_654_435_761) >> 24) as u8;
            let bytes: Vec<u8> = (0..stride * height).map(noise).collect();
            let layout = PixelLayout { format: PixelFormat::Bayer8, order };
            let picture = Picture::new(&bytes, width, height, stride, layout).unwrap();
            let mut lattice = Lattice::new(&camera);
            lattice.sample(&picture);
            let [reds, greens, blues] = lattice.channels();
            let places: Vec<[usize; 2]> = lattice.grid.places().collect();
            prop_assert_eq!(places.len(), reds.len());
            for (index, &[x, y]) in places.iter().enumerate() {
                let color = [reds[index], greens[index], blues[index]];
                prop_assert_eq!(color, rgb_at(&picture, x, y), "{} {}", x, y);
            }
        }
    }
}
