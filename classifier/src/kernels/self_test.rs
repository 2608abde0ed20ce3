//! The test that a level must pass on every machine before it is used.

use super::{Kernel, SimdLevel, scalar};
use crate::mask::FieldMask;
use crate::picture::Picture;
use crate::zones::{ZonedTables, Zones};
use crate::{ClassTables, MAX_CLASSES};
use config::ColorConfig;
use messages::{BayerOrder, PixelFormat, PixelLayout, Run};

/// Two blocks of the widest registers, a partial block, and an odd number of columns.
const WIDTH: u32 = 151;
const HEIGHT: u32 = 5;

/// Whether the level gives the same runs as the scalar code, with different sets of colours: for all Bayer
/// orders, and for a format of each other kind.
pub fn passes(level: SimdLevel) -> bool {
    let mut random = Random(0x1234_5678_9abc_def1);
    let orders = BayerOrder::ALL.map(|order| PixelLayout { format: PixelFormat::Bayer8, order });
    let others = [PixelFormat::Bayer12, PixelFormat::Rgb24, PixelFormat::Yuyv, PixelFormat::Nv12]
        .map(|format| PixelLayout { format, order: BayerOrder::Grbg });
    let mask = FieldMask::everything(WIDTH, HEIGHT);
    let mut zones = Zones::tiled(WIDTH as usize, HEIGHT as usize, 18);
    zones.by_tile_mut().iter_mut().enumerate().for_each(|(tile, zone)| *zone = tile as u8 / 2 % 2);
    let mut expected = vec![Run::default(); (WIDTH * HEIGHT) as usize];
    let mut got = expected.clone();
    [5, MAX_CLASSES].into_iter().all(|count| {
        let mut some_tables = || {
            let colors: Vec<ColorConfig> = (0..count).map(|_| random.color(count)).collect();
            ClassTables::new(&colors).ok()
        };
        let Some(colors) = some_tables() else { return false };
        let tables = [colors.clone(), colors.corrected_with_haze([-9, 0, 21], 16)];
        let zoned = ZonedTables { colors: &colors, tables: &tables, zones: &zones };
        let mut kernel = Kernel::new(level, &colors);
        orders.into_iter().chain(others).all(|layout| {
            let stride = layout.format.row_bytes(WIDTH) as u32 + 3;
            let bytes = layout.format.frame_bytes(WIDTH, HEIGHT, stride);
            let pixels: Vec<u8> = (0..bytes).map(|_| random.byte()).collect();
            let Some(picture) = Picture::new(&pixels, WIDTH, HEIGHT, stride, layout) else {
                return false;
            };
            let specified = scalar::classify(&picture, zoned, &mask, &mut expected);
            let written = kernel.classify(&picture, zoned, &mask, &mut got);
            let count = specified.count as usize;
            written == specified && got[..count] == expected[..count]
        })
    })
}

struct Random(u64);

impl Random {
    /// The upper bits of a linear congruential generator.
    fn byte(&mut self) -> u8 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (self.0 >> 56) as u8
    }

    fn range(&mut self) -> [u8; 2] {
        let (a, b) = (self.byte(), self.byte());
        [a.min(b), a.max(b)]
    }

    /// Half of the colours have a box in YUV, every fourth a second look, and every eighth only a second
    /// look.
    fn color(&mut self, count: usize) -> ColorConfig {
        let has_yuv = count > 5 || self.byte() < 128;
        let has_look = self.byte() < 64;
        let is_open = has_look && self.byte() < 128;
        let mut range = || if is_open { [0, 255] } else { self.range() };
        let [red, green, blue] = [range(), range(), range()];
        ColorConfig {
            name: String::new(),
            red,
            green,
            blue,
            hue_deg: has_look.then_some([20.5, 200.5]),
            saturation: is_open.then_some([0.3, 0.805]),
            y: has_yuv.then(|| self.range()),
            u: None,
            v: None,
            looks: [0; 3],
        }
    }
}
