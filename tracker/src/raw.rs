//! A frame's bytes as samples: what the sensor measured, where it measured it.
//!
//! Nothing is interpolated. A Bayer pixel gives one sample of the one colour it sees; an RGB pixel
//! gives three. Of YUV pictures only the Y is used, which each pixel has for itself.

use common::messages::{FrameHeader, PixelFormat, PixelLayout};

/// Colour channels a sample may belong to.
pub(crate) const CHANNELS: usize = 3;

/// A frame whose header agrees with its bytes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RawFrame<'a> {
    bytes: &'a [u8],
    stride: usize,
    pub width: usize,
    pub height: usize,
    layout: PixelLayout,
}

/// The samples of one row.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RawRow<'a> {
    bytes: &'a [u8],
    kind: Kind,
    /// By parity of the column: which channel a Bayer row sees.
    channels: [usize; 2],
}

#[derive(Debug, Clone, Copy)]
enum Kind {
    Bayer8,
    /// Two bytes, shifted down by so much to make a byte.
    BayerDeep(u32),
    Rgb24,
    /// One byte of Y every so many, from the given one on.
    Luma {
        step: usize,
        first: usize,
    },
}

impl<'a> RawFrame<'a> {
    /// `None` if the header is not that of a picture of the expected size in these bytes.
    pub fn new(header: &FrameHeader, bytes: &'a [u8], width: u32, height: u32) -> Option<Self> {
        let layout = header.check(width, height, bytes.len()).ok()?;
        let [stride, width, height] = [header.stride, width, height].map(|value| value as usize);
        Some(Self { bytes, stride, width, height, layout })
    }

    /// A row of the picture, which it must have.
    pub fn row(&self, row: usize) -> RawRow<'a> {
        let kind = match self.layout.format {
            PixelFormat::Bayer8 => Kind::Bayer8,
            PixelFormat::Bayer10 => Kind::BayerDeep(2),
            PixelFormat::Bayer12 => Kind::BayerDeep(4),
            PixelFormat::Bayer16 => Kind::BayerDeep(8),
            PixelFormat::Rgb24 => Kind::Rgb24,
            PixelFormat::Yuyv => Kind::Luma { step: 2, first: 0 },
            PixelFormat::Uyvy => Kind::Luma { step: 2, first: 1 },
            PixelFormat::Nv12 | PixelFormat::I420 => Kind::Luma { step: 1, first: 0 },
        };
        let channels = [0, 1].map(|column| match self.layout.format.is_bayer() {
            true => self.layout.order.channel_at(column, row),
            false => 0,
        });
        RawRow { bytes: &self.bytes[row * self.stride..], kind, channels }
    }
}

impl RawRow<'_> {
    /// Hands out channel and value (0–255) of each sample of a pixel.
    #[inline(always)]
    pub fn samples(&self, column: usize, mut sample: impl FnMut(usize, f32)) {
        match self.kind {
            Kind::Bayer8 => sample(self.channels[column & 1], f32::from(self.bytes[column])),
            Kind::BayerDeep(shift) => {
                let pair = [self.bytes[2 * column], self.bytes[2 * column + 1]];
                // Bits above those that the format has are ignored, as the classifier does.
                let value = u16::from_le_bytes(pair) << (8 - shift);
                sample(self.channels[column & 1], f32::from(value) / 256.0);
            }
            Kind::Rgb24 => {
                for channel in 0..CHANNELS {
                    sample(channel, f32::from(self.bytes[3 * column + channel]));
                }
            }
            Kind::Luma { step, first } => sample(0, f32::from(self.bytes[step * column + first])),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use common::messages::BayerOrder;

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
        let mut found = Vec::new();
        frame.row(row).samples(column, |channel, value| found.push((channel, value)));
        found
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
