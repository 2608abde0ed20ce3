//! Pictures in every pixel format, as the kernels see them: dimensions checked against the bytes, and access
//! by row or pixel.

use messages::{BayerOrder, PixelFormat, PixelLayout};

/// A picture in any format.
#[derive(Debug, Clone, Copy)]
pub enum Picture<'a> {
    /// With a Bayer colour filter array.
    Bayer(BayerImage<'a>),
    /// With all three channels of every pixel.
    Color(ColorImage<'a>),
}

impl<'a> Picture<'a> {
    /// `stride` is the distance between the starts of two rows in bytes; see [`PixelFormat`] for the rest of
    /// the layout. `None` unless `width` and `height` are from 2 to 65,535, rows do not overlap, and `pixels`
    /// holds all of them.
    pub fn new(
        pixels: &'a [u8],
        width: u32,
        height: u32,
        stride: u32,
        layout: PixelLayout,
    ) -> Option<Self> {
        let PixelLayout { format, order } = layout;
        let possible = 2..=u32::from(u16::MAX);
        if !possible.contains(&width)
            || !possible.contains(&height)
            || u64::from(stride) < format.row_bytes(width)
            || (pixels.len() as u64) < format.frame_bytes(width, height, stride)
        {
            return None;
        }
        let [width, height, stride] = [width, height, stride].map(|value| value as usize);
        Some(if format.is_bayer() {
            let shift = match format {
                PixelFormat::Bayer10 => Some(2),
                PixelFormat::Bayer12 => Some(4),
                PixelFormat::Bayer16 => Some(8),
                _ => None,
            };
            Self::Bayer(BayerImage { pixels, width, height, stride, order, shift })
        } else {
            Self::Color(ColorImage { pixels, width, height, stride, format })
        })
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        match self {
            Self::Bayer(image) => image.width,
            Self::Color(image) => image.width,
        }
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        match self {
            Self::Bayer(image) => image.height,
            Self::Color(image) => image.height,
        }
    }
}

/// A Bayer picture.
#[derive(Debug, Clone, Copy)]
pub struct BayerImage<'a> {
    pixels: &'a [u8],
    width: usize,
    height: usize,
    stride: usize,
    order: BayerOrder,
    /// `None`: one byte per pixel. Otherwise two, whose value is shifted right by this to make a byte.
    shift: Option<u32>,
}

impl<'a> BayerImage<'a> {
    /// A picture of one byte per pixel; see [`Picture::new`].
    pub fn new(
        pixels: &'a [u8],
        width: u32,
        height: u32,
        stride: u32,
        order: BayerOrder,
    ) -> Option<Self> {
        let layout = PixelLayout { format: PixelFormat::Bayer8, order };
        match Picture::new(pixels, width, height, stride, layout) {
            Some(Picture::Bayer(image)) => Some(image),
            _ => None,
        }
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Colours of the top-left 2×2 pixels.
    pub fn order(&self) -> BayerOrder {
        self.order
    }

    /// `None`: one byte per pixel. Otherwise two, whose value is shifted right by this to make a byte.
    pub fn shift(&self) -> Option<u32> {
        self.shift
    }

    /// The bytes of a row, without padding: one or two per pixel.
    ///
    /// # Panics
    /// If there is no such row.
    pub fn row(&self, row: usize) -> &'a [u8] {
        assert!(row < self.height, "row {row} of {}", self.height);
        let bytes = if self.shift.is_some() { 2 * self.width } else { self.width };
        &self.pixels[row * self.stride..][..bytes]
    }

    /// Replaces `mosaic` by the samples as bytes, row by row without padding.
    pub fn copy_mosaic(&self, mosaic: &mut Vec<u8>) {
        mosaic.clear();
        for row in (0..self.height).map(|row| self.row(row)) {
            match self.shift {
                None => mosaic.extend_from_slice(row),
                Some(shift) => {
                    mosaic.extend(row.chunks_exact(2).map(|pair| narrowed(pair[0], pair[1], shift)))
                }
            }
        }
    }
}

/// A sample of a deep Bayer picture as a byte: little endian, shifted right; bits above those of the format
/// are ignored.
#[inline(always)]
pub fn narrowed(low: u8, high: u8, shift: u32) -> u8 {
    (u16::from_le_bytes([low, high]) >> shift) as u8
}

/// A picture whose pixels have colours: RGB or YUV.
#[derive(Debug, Clone, Copy)]
pub struct ColorImage<'a> {
    pixels: &'a [u8],
    width: usize,
    height: usize,
    stride: usize,
    format: PixelFormat,
}

/// The bytes of a row of colours, without padding.
#[derive(Debug, Clone, Copy)]
pub enum ColorRow<'a> {
    /// Red, green, blue.
    Rgb(&'a [u8]),
    /// Y, U, Y, V.
    Yuyv(&'a [u8]),
    /// U, Y, V, Y.
    Uyvy(&'a [u8]),
    /// Y for each pixel; U, V for each two.
    Nv12(&'a [u8], &'a [u8]),
    /// Y for each pixel; U and V for each two.
    I420(&'a [u8], &'a [u8], &'a [u8]),
}

impl<'a> ColorImage<'a> {
    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Whether its channels are Y, U, V; otherwise they are red, green, blue.
    pub fn is_yuv(&self) -> bool {
        self.format.is_yuv()
    }

    /// The bytes of a row.
    ///
    /// # Panics
    /// If there is no such row.
    pub fn row(&self, row: usize) -> ColorRow<'a> {
        assert!(row < self.height, "row {row} of {}", self.height);
        let bytes = |start: usize, count: usize| &self.pixels[start..][..count];
        let (width, half_width) = (self.width, self.width.div_ceil(2));
        let first = row * self.stride;
        let chroma = self.height * self.stride;
        match self.format {
            PixelFormat::Yuyv => ColorRow::Yuyv(bytes(first, 4 * half_width)),
            PixelFormat::Uyvy => ColorRow::Uyvy(bytes(first, 4 * half_width)),
            PixelFormat::Nv12 => {
                let uv = bytes(chroma + row / 2 * self.stride, 2 * half_width);
                ColorRow::Nv12(bytes(first, width), uv)
            }
            PixelFormat::I420 => {
                let half_stride = self.stride.div_ceil(2);
                let u = chroma + row / 2 * half_stride;
                let v = u + self.height.div_ceil(2) * half_stride;
                ColorRow::I420(bytes(first, width), bytes(u, half_width), bytes(v, half_width))
            }
            _ => ColorRow::Rgb(bytes(first, 3 * width)),
        }
    }
}

impl<'a> ColorRow<'a> {
    /// The memory ranges of the row; unused ones are empty.
    #[inline(always)]
    pub fn parts(self) -> [&'a [u8]; 3] {
        match self {
            Self::Rgb(row) | Self::Yuyv(row) | Self::Uyvy(row) => [row, &[], &[]],
            Self::Nv12(y, uv) => [y, uv, &[]],
            Self::I420(y, u, v) => [y, u, v],
        }
    }

    /// The three channels of a pixel, as stored in the picture.
    ///
    /// # Panics
    /// If there is no such pixel.
    #[inline(always)]
    pub fn pixel(&self, column: usize) -> [u8; 3] {
        let pair = column / 2;
        match self {
            Self::Rgb(row) => [0, 1, 2].map(|channel| row[3 * column + channel]),
            Self::Yuyv(row) => [row[2 * column], row[4 * pair + 1], row[4 * pair + 3]],
            Self::Uyvy(row) => [row[2 * column + 1], row[4 * pair], row[4 * pair + 2]],
            Self::Nv12(y, uv) => [y[column], uv[2 * pair], uv[2 * pair + 1]],
            Self::I420(y, u, v) => [y[column], u[pair], v[pair]],
        }
    }
}
