//! Pixel formats of raw frames.

use std::fmt;

/// Meaning of a raw frame's bytes. Names and memory layouts are those of V4L2 and GenICam, so that a
/// camera driver passes its pictures on unchanged.
///
/// Rows are [`FrameHeader::stride`](super::FrameHeader::stride) bytes apart; bytes after a row's pixels
/// are padding. Chroma shared by two or four pixels counts for each of them; with an odd width or
/// height the last column or row has chroma of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum PixelFormat {
    /// One byte a pixel behind a Bayer colour filter array (V4L2 `RGGB` …, GenICam `BayerRG8` …).
    Bayer8 = 1,
    /// Bayer, two bytes a pixel, little endian, the value in the lower 10 bits (V4L2 `RG10` …, GenICam
    /// `BayerRG10` …). Only the upper 8 bits are used, as with the other deep formats.
    Bayer10 = 2,
    /// Bayer, two bytes a pixel, little endian, the value in the lower 12 bits (V4L2 `RG12` …,
    /// GenICam `BayerRG12` …).
    Bayer12 = 3,
    /// Bayer, two bytes a pixel, little endian, all 16 bits in use (V4L2 `RG16` …, GenICam
    /// `BayerRG16` …).
    Bayer16 = 4,
    /// Three bytes a pixel: red, green, blue (V4L2 `RGB3`, GenICam `RGB8`).
    Rgb24 = 5,
    /// Two pixels in four bytes: Y, U, Y, V (V4L2 `YUYV`, GenICam `YUV422_8`).
    Yuyv = 6,
    /// Two pixels in four bytes: U, Y, V, Y (V4L2 `UYVY`, GenICam `YUV422_8_UYVY`).
    Uyvy = 7,
    /// A plane of Y, then one of U and V in turns for each 2×2 pixels, its rows as far apart as
    /// those of Y (V4L2 `NV12`).
    Nv12 = 8,
    /// A plane of Y, then one of U and one of V for each 2×2 pixels, their rows half as far apart
    /// as those of Y, rounded up (V4L2 `YU12`, "I420").
    I420 = 9,
}

impl PixelFormat {
    /// All formats, in the order of their numbers in messages.
    pub const ALL: [PixelFormat; 9] = [
        Self::Bayer8,
        Self::Bayer10,
        Self::Bayer12,
        Self::Bayer16,
        Self::Rgb24,
        Self::Yuyv,
        Self::Uyvy,
        Self::Nv12,
        Self::I420,
    ];

    /// The format with this number in a message, if there is one.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|&format| format as u32 == number)
    }

    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bayer8 => "bayer8",
            Self::Bayer10 => "bayer10",
            Self::Bayer12 => "bayer12",
            Self::Bayer16 => "bayer16",
            Self::Rgb24 => "rgb24",
            Self::Yuyv => "yuyv",
            Self::Uyvy => "uyvy",
            Self::Nv12 => "nv12",
            Self::I420 => "i420",
        }
    }

    /// Whether [`FrameHeader::bayer_order`](super::FrameHeader::bayer_order) has a meaning.
    pub fn is_bayer(self) -> bool {
        matches!(self, Self::Bayer8 | Self::Bayer10 | Self::Bayer12 | Self::Bayer16)
    }

    /// Whether its pixels are luma and chroma.
    pub fn is_yuv(self) -> bool {
        matches!(self, Self::Yuyv | Self::Uyvy | Self::Nv12 | Self::I420)
    }

    /// Bytes that a row of `width` pixels takes without padding: the smallest possible stride.
    pub fn row_bytes(self, width: u32) -> u64 {
        let width = u64::from(width);
        match self {
            Self::Bayer8 => width,
            Self::Bayer10 | Self::Bayer12 | Self::Bayer16 => 2 * width,
            Self::Rgb24 => 3 * width,
            Self::Yuyv | Self::Uyvy => 4 * width.div_ceil(2),
            // The chroma of an odd last column needs room for U and V.
            Self::Nv12 => 2 * width.div_ceil(2),
            Self::I420 => width,
        }
    }

    /// Bytes of a whole frame whose rows are `stride` bytes apart; saturates at `u64::MAX`. The last
    /// row need not be padded to its stride.
    pub fn frame_bytes(self, width: u32, height: u32, stride: u32) -> u64 {
        let [width, height, stride] = [width, height, stride].map(u128::from);
        let rows = |count: u128, stride: u128, last: u128| count.saturating_sub(1) * stride + last;
        let row_bytes = u128::from(self.row_bytes(width as u32));
        let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
        let bytes = match self {
            Self::Nv12 => height * stride + rows(half_height, stride, row_bytes),
            Self::I420 => {
                let half_stride = stride.div_ceil(2);
                let u_plane = half_height * half_stride;
                height * stride + u_plane + rows(half_height, half_stride, half_width)
            }
            _ => rows(height, stride, row_bytes),
        };
        u64::try_from(bytes).unwrap_or(u64::MAX)
    }
}

impl fmt::Display for PixelFormat {
    fn fmt(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_lead_back_to_formats() {
        for format in PixelFormat::ALL {
            assert_eq!(PixelFormat::from_number(format as u32), Some(format));
        }
        assert_eq!(PixelFormat::from_number(0), None);
        assert_eq!(PixelFormat::from_number(PixelFormat::ALL.len() as u32 + 1), None);
    }

    #[test]
    fn frames_have_the_sizes_of_their_planes() {
        for (format, bytes) in [
            (PixelFormat::Bayer8, 640 * 480),
            (PixelFormat::Bayer12, 640 * 480 * 2),
            (PixelFormat::Rgb24, 640 * 480 * 3),
            (PixelFormat::Uyvy, 640 * 480 * 2),
            (PixelFormat::Nv12, 640 * 480 * 3 / 2),
            (PixelFormat::I420, 640 * 480 * 3 / 2),
        ] {
            let stride = format.row_bytes(640) as u32;
            assert_eq!(format.frame_bytes(640, 480, stride), bytes, "{format}");
        }
        // Padded rows except the last: 3 rows of 5 pixels.
        assert_eq!(PixelFormat::Bayer8.frame_bytes(5, 3, 8), 8 + 8 + 5);
        assert_eq!(PixelFormat::Yuyv.frame_bytes(5, 3, 16), 16 + 16 + 12);
        assert_eq!(PixelFormat::Nv12.frame_bytes(5, 3, 8), 3 * 8 + 8 + 6);
        assert_eq!(PixelFormat::I420.frame_bytes(5, 3, 7), 3 * 7 + 2 * 4 + 4 + 3);
        assert_eq!(PixelFormat::Nv12.frame_bytes(u32::MAX, u32::MAX, u32::MAX), u64::MAX);
    }
}
