//! Raw frame: the samples of the sensor at their places, without interpolation.
//!
//! A Bayer pixel gives one sample of its colour, an RGB pixel three. YUV pictures give Y only, because
//! several pixels share U and V.

use messages::{FrameHeader, PixelFormat};

/// Colour channels of samples.
pub(crate) const CHANNELS: usize = 3;

/// A frame whose header agrees with its bytes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RawFrame<'a> {
    bytes: &'a [u8],
    stride: usize,
    pub width: usize,
    pub height: usize,
    /// Channel of a pixel's first sample, by parity of the row and of the column.
    channels: [[usize; 2]; 2],
    pub samples_per_pixel: usize,
    /// Bytes from a pixel to the next one in its row.
    step: usize,
    /// Bytes from a pixel's begin to its first sample.
    first: usize,
    /// For samples of two bytes, their bits beyond eight.
    deep: Option<u32>,
}

impl<'a> RawFrame<'a> {
    /// `None` if the header does not describe a picture of this size in these bytes.
    pub fn new(header: &FrameHeader, bytes: &'a [u8], width: u32, height: u32) -> Option<Self> {
        let layout = header.check(width, height, bytes.len()).ok()?;
        let [stride, width, height] = [header.stride, width, height].map(|value| value as usize);
        let (step, first, samples_per_pixel) = match layout.format {
            PixelFormat::Bayer8 => (1, 0, 1),
            PixelFormat::Bayer10 | PixelFormat::Bayer12 | PixelFormat::Bayer16 => (2, 0, 1),
            PixelFormat::Rgb24 => (3, 0, CHANNELS),
            PixelFormat::Yuyv => (2, 0, 1),
            PixelFormat::Uyvy => (2, 1, 1),
            PixelFormat::Nv12 | PixelFormat::I420 => (1, 0, 1),
        };
        let deep = match layout.format {
            PixelFormat::Bayer10 => Some(2),
            PixelFormat::Bayer12 => Some(4),
            PixelFormat::Bayer16 => Some(8),
            _ => None,
        };
        let channels = [0, 1].map(|row| {
            [0, 1].map(|column| match layout.format.is_bayer() {
                true => layout.order.channel_at(column, row),
                false => 0,
            })
        });
        Some(Self { bytes, stride, width, height, channels, samples_per_pixel, step, first, deep })
    }

    /// Number of channels that have samples.
    pub fn channels(&self) -> usize {
        let is_bayer = self.channels != [[0; 2]; 2];
        if is_bayer { CHANNELS } else { self.samples_per_pixel }
    }

    /// Means of each channel over a square of `size` × `size` pixels (even) that begins at this row and
    /// column and lies in the picture; 0 for a channel without samples.
    pub fn mean(&self, row: usize, column: usize, size: usize) -> [f32; CHANNELS] {
        let (mut sums, mut counts) = ([0.0; CHANNELS], [0.0f32; CHANNELS]);
        let quarter = (size * size / 4) as f32;
        for (y, x) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            // Every second row and column: one channel of a mosaic.
            for index in 0..self.samples_per_pixel {
                let channel = self.channels[(row + y) & 1][(column + x) & 1] + index;
                for row in (row + y..row + size).step_by(2) {
                    for column in (column + x..column + size).step_by(2) {
                        sums[channel] += self.sample(row, column, index).1;
                    }
                }
                counts[channel] += quarter;
            }
        }
        std::array::from_fn(|channel| sums[channel] / counts[channel].max(1.0))
    }

    /// Channel and value (0 to 255) of a sample of a pixel within the picture.
    #[inline(always)]
    pub fn sample(&self, row: usize, column: usize, index: usize) -> (usize, f32) {
        let channel = self.channels[row & 1][column & 1] + index;
        let place = row * self.stride + column * self.step + self.first + index;
        let byte = self.bytes[place];
        let Some(shift) = self.deep else { return (channel, f32::from(byte)) };
        // Ignores bits above those of the format, as the classifier does.
        let value = u16::from_le_bytes([byte, self.bytes[place + 1]]) << (8 - shift);
        (channel, f32::from(value) / 256.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::BayerOrder;

    fn samples(format: PixelFormat, bytes: &[u8], column: usize, row: usize) -> Vec<(usize, f32)> {
        let header = FrameHeader {
            width: 2,
            height: 2,
            stride: format.row_bytes(2) as u32,
            pixel_format: format as u32,
            bayer_order: BayerOrder::Grbg as u32,
            ..FrameHeader::default()
        };
        let frame = RawFrame::new(&header, bytes, 2, 2).unwrap();
        (0..frame.samples_per_pixel).map(|index| frame.sample(row, column, index)).collect()
    }

    #[test]
    fn every_format_gives_its_samples() {
        assert_eq!(samples(PixelFormat::Bayer8, &[1, 2, 3, 4], 1, 0), [(0, 2.0)]);
        assert_eq!(samples(PixelFormat::Bayer8, &[1, 2, 3, 4], 0, 1), [(2, 3.0)]);
        // 0x3ff is the brightest; the six bits above it are of no account.
        let deep = [0, 0, 0, 0, 0, 0, 0xff, 0xff];
        assert_eq!(samples(PixelFormat::Bayer10, &deep, 1, 1), [(1, 255.75)]);
        let twelve = [0, 0, 0x80, 0x07, 0, 0, 0, 0];
        assert_eq!(samples(PixelFormat::Bayer12, &twelve, 1, 0), [(0, 120.0)]);
        let sixteen = [0, 0, 0, 0, 0x80, 0x10, 0, 0];
        assert_eq!(samples(PixelFormat::Bayer16, &sixteen, 0, 1), [(2, 16.5)]);
        let rgb: Vec<u8> = (0..12).collect();
        let expected = [(0, 9.0), (1, 10.0), (2, 11.0)];
        assert_eq!(samples(PixelFormat::Rgb24, &rgb, 1, 1), expected);
        assert_eq!(samples(PixelFormat::Yuyv, &[10, 1, 20, 2, 30, 3, 40, 4], 1, 1), [(0, 40.0)]);
        assert_eq!(samples(PixelFormat::Uyvy, &[1, 10, 2, 20, 3, 30, 4, 40], 0, 1), [(0, 30.0)]);
        assert_eq!(samples(PixelFormat::Nv12, &[1, 2, 3, 4, 5, 6], 1, 1), [(0, 4.0)]);
        assert_eq!(samples(PixelFormat::I420, &[1, 2, 3, 4, 5, 6], 0, 1), [(0, 3.0)]);
    }

    #[test]
    fn means_are_those_of_all_samples_of_a_channel() {
        for format in [PixelFormat::Bayer8, PixelFormat::Bayer12, PixelFormat::Rgb24] {
            let header = FrameHeader {
                width: 12,
                height: 10,
                stride: format.row_bytes(12) as u32,
                pixel_format: format as u32,
                bayer_order: BayerOrder::Gbrg as u32,
                ..FrameHeader::default()
            };
            let bytes: Vec<u8> =
                (0..header.stride * 10).map(|index| (index * 37 % 251) as u8).collect();
            let frame = RawFrame::new(&header, &bytes, 12, 10).unwrap();
            for (row, column, size) in [(0, 0, 2), (3, 5, 2), (2, 7, 4), (4, 1, 6)] {
                let (mut sums, mut counts) = ([0.0; CHANNELS], [0.0; CHANNELS]);
                for (y, x) in (0..size).flat_map(|y| (0..size).map(move |x| (y, x))) {
                    for index in 0..frame.samples_per_pixel {
                        let (channel, value) = frame.sample(row + y, column + x, index);
                        sums[channel] += value;
                        counts[channel] += 1.0;
                    }
                }
                let expected: [f32; CHANNELS] =
                    std::array::from_fn(|channel| sums[channel] / counts[channel]);
                assert_eq!(frame.mean(row, column, size), expected, "{format:?} {row} {column}");
            }
        }
    }

    #[test]
    fn bytes_that_do_not_fit_the_header_make_no_frame() {
        let header = FrameHeader {
            width: 4,
            height: 4,
            stride: 4,
            pixel_format: PixelFormat::Bayer8 as u32,
            ..FrameHeader::default()
        };
        assert!(RawFrame::new(&header, &[0; 16], 4, 4).is_some());
        assert!(RawFrame::new(&header, &[0; 15], 4, 4).is_none());
        assert!(RawFrame::new(&header, &[0; 64], 8, 4).is_none());
        assert!(RawFrame::new(&FrameHeader::default(), &[0; 64], 4, 4).is_none());
    }
}
