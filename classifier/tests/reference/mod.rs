//! A second classifier, written from the definitions without regard to speed, which shares no code with the
//! library: the reference of every kernel.
#![allow(dead_code)] // every test uses a part of it

use config::ColorConfig;
use messages::{BayerOrder, FrameHeader, PixelFormat, Run};
use proptest::prelude::*;

/// A frame as it is transmitted: header and padded pixels.
#[derive(Debug, Clone)]
pub struct Frame {
    pub header: FrameHeader,
    pub pixels: Vec<u8>,
}

impl Frame {
    pub fn new(width: u32, height: u32, stride: u32, order: BayerOrder, pixels: Vec<u8>) -> Self {
        let header = FrameHeader {
            seq: 7,
            t_capture_ns: 1_000,
            t_capture_wall_ns: 2_000,
            t_sent_ns: 3_000,
            camera_id: 1,
            width,
            height,
            stride,
            pixel_format: PixelFormat::Bayer8 as u32,
            bayer_order: order as u32,
            exposure_us: 2_000,
            revision: 0,
        };
        Self { header, pixels }
    }

    fn order(&self) -> BayerOrder {
        BayerOrder::from_number(self.header.bayer_order).expect("test frames have an order")
    }

    /// The mean, rounded half up, over the sites of a channel among the 3×3 pixels around a pixel; the pixel
    /// itself if it is one.
    fn channel(&self, x: i64, y: i64, channel: usize) -> u8 {
        let mirror = |i: i64, n: u32| {
            let last = i64::from(n) - 1;
            (last - (last - i.abs()).abs()) as usize
        };
        let at = |x: i64, y: i64| {
            let (x, y) = (mirror(x, self.header.width), mirror(y, self.header.height));
            let value = self.pixels[y * self.header.stride as usize + x];
            (self.order().channel_at(x, y) == channel).then_some(u32::from(value))
        };
        if let Some(known) = at(x, y) {
            return known as u8;
        }
        let around: Vec<u32> = (-1..=1)
            .flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)))
            .filter_map(|(dx, dy)| at(x + dx, y + dy))
            .collect();
        let count = around.len() as u32;
        ((around.iter().sum::<u32>() + count / 2) / count) as u8
    }

    /// Three bytes per pixel.
    pub fn rgb(&self) -> Vec<u8> {
        let mut rgb = Vec::new();
        for y in 0..i64::from(self.header.height) {
            for x in 0..i64::from(self.header.width) {
                rgb.extend((0..3).map(|channel| self.channel(x, y, channel)));
            }
        }
        rgb
    }

    /// The class of every pixel, row by row.
    pub fn labels(&self, colors: &[ColorConfig]) -> Vec<Option<u8>> {
        self.rgb().chunks_exact(3).map(|rgb| label([rgb[0], rgb[1], rgb[2]], colors)).collect()
    }

    /// The expected runs.
    pub fn runs(&self, colors: &[ColorConfig]) -> Vec<Run> {
        runs_of_labels(&self.labels(colors), self.header.width)
    }
}

/// The class of a pixel.
pub fn label(rgb: [u8; 3], colors: &[ColorConfig]) -> Option<u8> {
    colors.iter().position(|color| is_of_color(rgb, color)).map(|class| class as u8)
}

/// The runs of classified pixels in rows of `width`.
pub fn runs_of_labels(labels: &[Option<u8>], width: u32) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for (row, labels) in labels.chunks_exact(width as usize).enumerate() {
        let mut begin = 0;
        for stretch in labels.chunk_by(|a, b| a == b) {
            let end = begin + stretch.len();
            if let Some(class) = stretch[0] {
                let [row, begin, end] = [row, begin, end].map(|value| value as u16);
                runs.push(Run { row, begin, end, class, reserved: 0 });
            }
            begin = end;
        }
    }
    runs
}

/// The box of section 4.2, then the textbook formulas of HSI.
pub fn is_of_color(rgb: [u8; 3], color: &ColorConfig) -> bool {
    let in_box = [color.red, color.green, color.blue]
        .iter()
        .zip(rgb)
        .all(|(&[low, high], value)| low <= value && value <= high);
    let [r, g, b] = rgb.map(f64::from);
    let is_saturated = color.saturation.is_none_or(|[low, high]| {
        let sum = r + g + b;
        let saturation = if sum == 0.0 { 0.0 } else { 1.0 - 3.0 * r.min(g).min(b) / sum };
        low <= saturation && saturation <= high
    });
    let has_hue = color.hue_deg.is_none_or(|[from, to]| {
        if r == g && g == b {
            return false;
        }
        let root = ((r - g) * (r - g) + (r - b) * (g - b)).sqrt();
        let theta = (0.5 * ((r - g) + (r - b)) / root).clamp(-1.0, 1.0).acos().to_degrees();
        let hue = if b <= g { theta } else { 360.0 - theta };
        if from <= to { from <= hue && hue <= to } else { hue >= from || hue <= to }
    });
    in_box && is_saturated && has_hue
}

/// Repeatable noise for tests and benches.
pub struct Noise(pub u64);

impl Noise {
    /// 32 fresh bits (xorshift, upper half of a multiplication).
    pub fn next_u32(&mut self) -> u32 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 32) as u32
    }
}

/// A colour with a box in RGB and nothing else.
pub fn color(red: [u8; 2], green: [u8; 2], blue: [u8; 2]) -> ColorConfig {
    let name = "test".into();
    ColorConfig {
        name,
        red,
        green,
        blue,
        hue_deg: None,
        saturation: None,
        y: None,
        u: None,
        v: None,
        looks: [0; 3],
    }
}

fn range() -> impl Strategy<Value = [u8; 2]> {
    // Half of them one-sided, so that many boxes hold something.
    prop_oneof![
        any::<(u8, u8)>().prop_map(|(a, b)| [a.min(b), a.max(b)]),
        any::<u8>().prop_map(|low| [low, 255]),
        any::<u8>().prop_map(|high| [0, high]),
    ]
}

/// A colour of any kind except in YUV.
pub fn any_color() -> impl Strategy<Value = ColorConfig> {
    // Bounds off round values, which a colour may meet exactly: there the reference is inexact.
    let hue = (0u16..360, 0u16..360).prop_map(|(a, b)| [f64::from(a) + 0.37, f64::from(b) + 0.37]);
    let saturation = (0u16..50, 0u16..100)
        .prop_map(|(low, extent)| [low, low + extent].map(|v| f64::from(v) / 100.0 + 0.0037));
    (range(), range(), range(), proptest::option::of(hue), proptest::option::of(saturation))
        .prop_map(|(red, green, blue, hue_deg, saturation)| ColorConfig {
            hue_deg,
            saturation,
            ..color(red, green, blue)
        })
}

/// Writes a picture of colours in a format. Pixels that share chroma have that of the top-left one. Padding
/// is noise.
pub fn encode(
    header: &FrameHeader,
    noise: &mut Noise,
    color: impl Fn(usize, usize) -> [u8; 3],
) -> Vec<u8> {
    let format = PixelFormat::from_number(header.pixel_format).unwrap();
    let [width, height, stride] =
        [header.width, header.height, header.stride].map(|value| value as usize);
    let bytes = format.frame_bytes(header.width, header.height, header.stride) as usize;
    let mut pixels: Vec<u8> = (0..bytes).map(|_| noise.next_u32() as u8).collect();
    let half_stride = stride.div_ceil(2);
    for y in 0..height {
        for x in 0..width {
            let [a, b, c] = color(x, y);
            let (first, has_chroma) = (y * stride, x % 2 == 0 && y % 2 == 0);
            let places = match format {
                PixelFormat::Rgb24 => [first + 3 * x, first + 3 * x + 1, first + 3 * x + 2],
                PixelFormat::Yuyv => [first + 2 * x, first + x / 2 * 4 + 1, first + x / 2 * 4 + 3],
                PixelFormat::Uyvy => [first + 2 * x + 1, first + x / 2 * 4, first + x / 2 * 4 + 2],
                PixelFormat::Nv12 => {
                    let chroma = height * stride + y / 2 * stride + x / 2 * 2;
                    [first + x, chroma, chroma + 1]
                }
                PixelFormat::I420 => {
                    let chroma = height * stride + y / 2 * half_stride + x / 2;
                    [first + x, chroma, chroma + height.div_ceil(2) * half_stride]
                }
                _ => unreachable!("not a format of colours"),
            };
            pixels[places[0]] = a;
            let owns_chroma = match format {
                PixelFormat::Rgb24 => true,
                PixelFormat::Yuyv | PixelFormat::Uyvy => x % 2 == 0,
                _ => has_chroma,
            };
            if owns_chroma {
                (pixels[places[1]], pixels[places[2]]) = (b, c);
            }
        }
    }
    pixels
}
