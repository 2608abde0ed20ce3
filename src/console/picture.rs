//! Pictures for browsers: smaller ones as JPEG for the live view, exact ones as PNG, and single pixels.

use classifier::{Picture, to_rgb};
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageError};
use messages::{BayerOrder, FrameHeader, PixelFormat, PixelLayout};

/// Quality of the live view: patches keep their edges, and a half-resolution picture of 640 × 480 takes about
/// 10 kB.
const QUALITY: u8 = 82;

/// A frame, copied out of shared memory.
pub struct Frame {
    /// Its header, checked against the bytes.
    pub header: FrameHeader,
    /// Its pixels, with the header's stride.
    pub bytes: Vec<u8>,
}

/// A picture with three bytes a pixel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rgb {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green, blue.
    pub bytes: Vec<u8>,
}

impl Frame {
    /// The frame in these bytes if its header agrees with them and with the configured size.
    pub fn copy(header: &FrameHeader, bytes: &[u8], size_px: [u32; 2]) -> Option<Self> {
        let layout = header.check(size_px[0], size_px[1], bytes.len()).ok()?;
        let length = layout.format.frame_bytes(header.width, header.height, header.stride);
        Some(Self { header: *header, bytes: bytes.get(..length as usize)?.to_vec() })
    }

    /// Its pixel format.
    pub fn layout(&self) -> PixelLayout {
        // Both were checked when it was copied; a Bayer order is meaningless in other formats.
        PixelLayout {
            format: PixelFormat::from_number(self.header.pixel_format)
                .unwrap_or(PixelFormat::Bayer8),
            order: BayerOrder::from_number(self.header.bayer_order).unwrap_or(BayerOrder::Rggb),
        }
    }

    /// All pixels in colour, as the classifier sees them.
    pub fn rgb(&self) -> Option<Rgb> {
        let &FrameHeader { width, height, stride, .. } = &self.header;
        let picture = Picture::new(&self.bytes, width, height, stride, self.layout())?;
        let mut bytes = Vec::new();
        to_rgb(&picture, &mut bytes);
        Some(Rgb { width: width as usize, height: height as usize, bytes })
    }

    /// The picture at a half or a quarter of its resolution (`scale` 2 or 4), or in full (1).
    pub fn reduced(&self, scale: u32) -> Option<Rgb> {
        if scale <= 1 {
            return self.rgb();
        }
        let half = self.tiles().or_else(|| Some(halved(&self.rgb()?)))?;
        Some(if scale >= 4 { halved(&half) } else { half })
    }

    /// A Bayer picture with one pixel for each 2 × 2 tile: its red, its blue and the mean of its greens. No
    /// neighbour is looked at, so this takes a fraction of the time of demosaicing.
    fn tiles(&self) -> Option<Rgb> {
        let PixelLayout { format, order } = self.layout();
        let shift = match format {
            PixelFormat::Bayer8 => None,
            PixelFormat::Bayer10 => Some(2),
            PixelFormat::Bayer12 => Some(4),
            PixelFormat::Bayer16 => Some(8),
            _ => return None,
        };
        let step = if shift.is_some() { 2 } else { 1 };
        let (width, height) = (self.header.width as usize / 2, self.header.height as usize / 2);
        let value = |row: &[u8], x: usize| match shift {
            None => row.get(x).copied().unwrap_or(0),
            Some(bits) => {
                let low = row.get(x * step).copied().unwrap_or(0);
                let high = row.get(x * step + 1).copied().unwrap_or(0);
                (u16::from_le_bytes([low, high]) >> bits).min(255) as u8
            }
        };
        let (red_column, red_row) = order.red_site();
        let mut bytes = Vec::with_capacity(3 * width * height);
        for y in 0..height {
            let row = |y: usize| self.bytes.get(y * self.header.stride as usize..).unwrap_or(&[]);
            let (of_red, of_blue) = (row(2 * y + red_row), row(2 * y + 1 - red_row));
            for x in 0..width {
                let (at_red, at_blue) = (2 * x + red_column, 2 * x + 1 - red_column);
                let greens = u16::from(value(of_red, at_blue)) + u16::from(value(of_blue, at_red));
                bytes.extend([
                    value(of_red, at_red),
                    greens.div_ceil(2) as u8,
                    value(of_blue, at_blue),
                ]);
            }
        }
        Some(Rgb { width, height, bytes })
    }

    /// The rows without padding, for a browser that shows raw pixels. Planar formats come as they are.
    pub fn rows(&self) -> Vec<u8> {
        let format = self.layout().format;
        let row_bytes = format.row_bytes(self.header.width) as usize;
        let stride = self.header.stride as usize;
        if matches!(format, PixelFormat::Nv12 | PixelFormat::I420) || row_bytes == stride {
            return self.bytes.clone();
        }
        let rows = (0..self.header.height as usize).filter_map(|row| {
            let begin = row * stride;
            self.bytes.get(begin..begin + row_bytes)
        });
        rows.flatten().copied().collect()
    }

    /// The sample of the sensor at a pixel; for formats with all channels, its red or its brightness.
    pub fn raw_at(&self, x: usize, y: usize) -> Option<u32> {
        let format = self.layout().format;
        let step = match format {
            PixelFormat::Bayer8 | PixelFormat::Nv12 | PixelFormat::I420 => 1,
            PixelFormat::Rgb24 => 3,
            _ => 2,
        };
        let first = usize::from(format == PixelFormat::Uyvy);
        let at = y * self.header.stride as usize + x * step + first;
        let low = u32::from(*self.bytes.get(at)?);
        let is_deep = format.is_bayer() && format != PixelFormat::Bayer8;
        Some(if is_deep { low | u32::from(*self.bytes.get(at + 1)?) << 8 } else { low })
    }
}

impl Rgb {
    /// As JPEG.
    pub fn jpeg(&self) -> Result<Vec<u8>, ImageError> {
        let mut out = Vec::with_capacity(self.bytes.len() / 8);
        let (width, height) = (self.width as u32, self.height as u32);
        JpegEncoder::new_with_quality(&mut out, QUALITY).write_image(
            &self.bytes,
            width,
            height,
            ExtendedColorType::Rgb8,
        )?;
        Ok(out)
    }

    /// As PNG: exact.
    pub fn png(&self) -> Result<Vec<u8>, ImageError> {
        use image::codecs::png::{CompressionType, FilterType, PngEncoder};
        let mut out = Vec::with_capacity(self.bytes.len() / 2);
        let (width, height) = (self.width as u32, self.height as u32);
        PngEncoder::new_with_quality(&mut out, CompressionType::Fast, FilterType::Adaptive)
            .write_image(&self.bytes, width, height, ExtendedColorType::Rgb8)?;
        Ok(out)
    }

    /// A pixel.
    pub fn at(&self, x: usize, y: usize) -> Option<[u8; 3]> {
        if x >= self.width {
            return None;
        }
        let begin = 3 * (y * self.width + x);
        self.bytes.get(begin..begin + 3)?.try_into().ok()
    }
}

/// Means of 2 × 2 pixels.
fn halved(picture: &Rgb) -> Rgb {
    let (width, height) = (picture.width / 2, picture.height / 2);
    let mut bytes = Vec::with_capacity(3 * width * height);
    for y in 0..height {
        let rows = [0, 1].map(|below| {
            let begin = 3 * (2 * y + below) * picture.width;
            picture.bytes.get(begin..).unwrap_or(&[])
        });
        for x in 0..width {
            for channel in 0..3 {
                let sum: u16 = rows
                    .iter()
                    .flat_map(|row| [row.get(6 * x + channel), row.get(6 * x + 3 + channel)])
                    .map(|value| u16::from(value.copied().unwrap_or(0)))
                    .sum();
                bytes.push(((sum + 2) / 4) as u8);
            }
        }
    }
    Rgb { width, height, bytes }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bayer(order: BayerOrder, format: PixelFormat, shift: u32) -> Frame {
        // Every tile has red 200, greens 100 and 101, blue 50.
        let (width, height, padding) = (6u32, 4u32, 3);
        let stride = format.row_bytes(width) as u32 + padding;
        let mut bytes = vec![7; (stride * height) as usize];
        let (red_column, red_row) = order.red_site();
        for y in 0..height as usize {
            for x in 0..width as usize {
                let value = match (x % 2 == red_column, y % 2 == red_row) {
                    (true, true) => 200u16,
                    (false, false) => 50,
                    (true, false) => 100,
                    (false, true) => 101,
                };
                match shift {
                    0 => bytes[y * stride as usize + x] = value as u8,
                    _ => {
                        let at = y * stride as usize + 2 * x;
                        bytes[at..at + 2].copy_from_slice(&(value << shift).to_le_bytes());
                    }
                }
            }
        }
        let header = FrameHeader {
            width,
            height,
            stride,
            pixel_format: format as u32,
            bayer_order: order as u32,
            ..Default::default()
        };
        Frame::copy(&header, &bytes, [width, height]).unwrap()
    }

    #[test]
    fn tiles_become_pixels_in_every_order_and_depth() {
        for order in BayerOrder::ALL {
            for (format, shift) in [
                (PixelFormat::Bayer8, 0),
                (PixelFormat::Bayer10, 2),
                (PixelFormat::Bayer12, 4),
                (PixelFormat::Bayer16, 8),
            ] {
                let frame = bayer(order, format, shift);
                let half = frame.reduced(2).unwrap();
                assert_eq!((half.width, half.height), (3, 2));
                assert_eq!(half.bytes, [200, 101, 50].repeat(6), "{order:?} {format}");
                assert_eq!(frame.reduced(4).unwrap().bytes, [200, 101, 50]);
                let full = frame.reduced(1).unwrap();
                assert_eq!((full.width, full.height), (6, 4));
                assert_eq!(frame.rows().len(), (format.row_bytes(6) * 4) as usize);
                let (column, row) = order.red_site();
                assert_eq!(frame.raw_at(column, row), Some(200 << shift));
            }
        }
    }

    #[test]
    fn other_formats_are_reduced_too() {
        for format in [PixelFormat::Rgb24, PixelFormat::Yuyv, PixelFormat::Nv12, PixelFormat::I420]
        {
            let stride = format.row_bytes(5) as u32;
            let header = FrameHeader {
                width: 5,
                height: 5,
                stride,
                pixel_format: format as u32,
                ..Default::default()
            };
            let bytes = vec![128; format.frame_bytes(5, 5, stride) as usize];
            let frame = Frame::copy(&header, &bytes, [5, 5]).unwrap();
            let half = frame.reduced(2).unwrap();
            assert_eq!((half.width, half.height, half.bytes.len()), (2, 2, 12), "{format}");
            assert_eq!(frame.reduced(4).unwrap().bytes.len(), 3);
            assert!(frame.raw_at(4, 4).is_some());
        }
    }

    #[test]
    fn a_frame_that_contradicts_its_header_is_not_copied() {
        let header = FrameHeader { width: 4, height: 4, stride: 4, ..Default::default() };
        assert!(Frame::copy(&header, &[0; 16], [4, 4]).is_none(), "no format");
        let header = FrameHeader { pixel_format: PixelFormat::Bayer8 as u32, ..header };
        assert!(Frame::copy(&header, &[0; 15], [4, 4]).is_none());
        assert!(Frame::copy(&header, &[0; 16], [8, 4]).is_none());
        assert!(Frame::copy(&header, &[0; 16], [4, 4]).is_some());
    }

    #[test]
    fn pictures_are_encoded() {
        let rgb = Rgb { width: 3, height: 2, bytes: [200, 101, 50].repeat(6) };
        let png = image::load_from_memory(&rgb.png().unwrap()).unwrap().into_rgb8();
        assert_eq!(png.into_raw(), rgb.bytes);
        let jpeg = image::load_from_memory(&rgb.jpeg().unwrap()).unwrap();
        assert_eq!((jpeg.width(), jpeg.height()), (3, 2));
        assert_eq!(rgb.at(2, 1), Some([200, 101, 50]));
        assert_eq!((rgb.at(3, 0), rgb.at(0, 2)), (None, None));
    }
}
