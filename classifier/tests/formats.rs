//! Every pixel format gives the runs of a picture with the same colours.

mod reference;

use config::{ColorConfig, Config, LightConfig};
use messages::{BayerOrder, FrameHeader, PixelFormat, PixelLayout, Run, RunsHeader};
use proptest::prelude::*;
use reference::{Frame, Noise, any_color, encode, runs_of_labels};
use touchline_classifier::{Classifier, Picture, SimdLevel, rgb_from_yuv, to_rgb};

/// The runs of a frame; asserts that every instruction set of this machine gives the same.
fn classify(header: &FrameHeader, pixels: &[u8], colors: &[ColorConfig]) -> Vec<Run> {
    let mut config = Config::default();
    (config.camera.width, config.camera.height) = (header.width, header.height);
    config.colors = colors.to_vec();
    config.light = LightConfig::default();
    // The default geometry does not fit these picture sizes.
    config.field.mask = false;
    let mut specified = None;
    for level in SimdLevel::available().into_iter().rev() {
        let mut classifier = Classifier::with_level(&config, level).unwrap();
        let mut out_header = RunsHeader::default();
        let mut out = vec![Run::default(); (header.width * header.height) as usize];
        classifier.step(header, pixels, &mut out_header, &mut out).unwrap();
        let runs = out_header.valid(&out).to_vec();
        assert_eq!(&runs, specified.get_or_insert_with(|| runs.clone()), "{level}");
    }
    specified.unwrap()
}

fn header(format: PixelFormat, width: u32, height: u32, padding: u32) -> FrameHeader {
    let stride = format.row_bytes(width) as u32 + padding;
    let order = BayerOrder::Grbg;
    let mut header = Frame::new(width, height, stride, order, vec![]).header;
    header.pixel_format = format as u32;
    header
}

/// The colour that a pixel is decoded as: pixels that share chroma have that of one of them.
fn decoded(
    format: PixelFormat,
    color: &impl Fn(usize, usize) -> [u8; 3],
    x: usize,
    y: usize,
) -> [u8; 3] {
    let [first, ..] = color(x, y);
    let [_, second, third] = match format {
        PixelFormat::Rgb24 => color(x, y),
        PixelFormat::Yuyv | PixelFormat::Uyvy => color(x & !1, y),
        _ => color(x & !1, y & !1),
    };
    [first, second, third]
}

fn in_yuv(color: ColorConfig, ranges: Option<[[u8; 2]; 3]>) -> ColorConfig {
    let [y, u, v] = ranges.map_or([None; 3], |ranges| ranges.map(Some));
    ColorConfig { y, u, v, ..color }
}

fn any_yuv_color() -> impl Strategy<Value = ColorConfig> {
    let range = || any::<(u8, u8)>().prop_map(|(a, b)| [a.min(b), a.max(b)]);
    let ranges = proptest::option::of([range(), range(), range()]);
    (any_color(), ranges).prop_map(|(color, ranges)| in_yuv(color, ranges))
}

const COLOR_FORMATS: [PixelFormat; 5] = [
    PixelFormat::Rgb24,
    PixelFormat::Yuyv,
    PixelFormat::Uyvy,
    PixelFormat::Nv12,
    PixelFormat::I420,
];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn colors_are_classified_as_they_come(
        format in proptest::sample::select(&COLOR_FORMATS),
        (width, height, padding) in (2u32..150, 2u32..8, 0u32..9),
        seed in 1u64..,
        patch in 1usize..9,
        colors in proptest::collection::vec(any_yuv_color(), 0..=32),
    ) {
        let header = header(format, width, height, padding);
        let mut noise = Noise(seed);
        let levels: [[u8; 3]; 64] =
            std::array::from_fn(|_| [0; 3].map(|_: i32| noise.next_u32() as u8));
        let color = |x: usize, y: usize| levels[(x / patch * 7 + y / patch * 13) % 64];
        let pixels = encode(&header, &mut noise, color);

        let mut rgb = Vec::new();
        let layout = PixelLayout { format, order: BayerOrder::Rggb };
        let picture = Picture::new(&pixels, width, height, header.stride, layout).unwrap();
        to_rgb(&picture, &mut rgb);

        let mut labels = Vec::new();
        for y in 0..height as usize {
            for x in 0..width as usize {
                let color = decoded(format, &color, x, y);
                let as_rgb = if format.is_yuv() { rgb_from_yuv(color) } else { color };
                prop_assert_eq!(&rgb[3 * labels.len()..][..3], &as_rgb);
                labels.push(colors.iter().position(|wanted| match wanted.yuv_box() {
                    Some(ranges) if format.is_yuv() => {
                        let holds = |([low, high], value): ([u8; 2], u8)| low <= value && value <= high;
                        let any_rgb = ColorConfig { red: [0, 255], green: [0, 255], blue: [0, 255], ..wanted.clone() };
                        ranges.into_iter().zip(color).all(holds) && reference::is_of_color(as_rgb, &any_rgb)
                    }
                    _ => reference::is_of_color(as_rgb, wanted),
                }).map(|class| class as u8));
            }
        }
        prop_assert_eq!(classify(&header, &pixels, &colors), runs_of_labels(&labels, width));
    }

    #[test]
    fn deep_bayer_is_used_with_its_upper_bits(
        (format, bits) in proptest::sample::select(vec![
            (PixelFormat::Bayer10, 10), (PixelFormat::Bayer12, 12), (PixelFormat::Bayer16, 16),
        ]),
        (width, height, padding) in (2u32..150, 2u32..8, 0u32..9),
        seed in 1u64..,
        order in 0u32..4,
        colors in proptest::collection::vec(any_color(), 0..=8),
    ) {
        let mut noise = Noise(seed);
        let bytes: Vec<u8> = (0..width * height).map(|_| noise.next_u32() as u8).collect();
        let order = BayerOrder::from_number(order).unwrap();
        let shallow = Frame::new(width, height, width, order, bytes.clone());
        let mut header = header(format, width, height, padding);
        header.bayer_order = order as u32;
        let mut pixels = Vec::new();
        for row in bytes.chunks(width as usize) {
            for &byte in row {
                // Arbitrary lower bits.
                let low = noise.next_u32() as u16 & ((1 << (bits - 8)) - 1);
                pixels.extend((u16::from(byte) << (bits - 8) | low).to_le_bytes());
            }
            pixels.extend(vec![0x5A; padding as usize]);
        }
        let runs = classify(&header, &pixels, &colors);
        prop_assert_eq!(runs, shallow.runs(&colors));
    }
}

#[test]
fn a_frame_that_is_too_short_for_its_format_is_refused() {
    for format in PixelFormat::ALL {
        let header = header(format, 7, 5, 3);
        let needed = format.frame_bytes(7, 5, header.stride);
        let layout = header.check(7, 5, needed as usize).unwrap();
        assert_eq!(layout.format, format);
        assert!(header.check(7, 5, needed as usize - 1).is_err(), "{format}");
        let narrow = FrameHeader { stride: format.row_bytes(7) as u32 - 1, ..header };
        assert!(narrow.check(7, 5, 1000).is_err(), "{format}");
        let pixels = vec![0; needed as usize];
        assert!(Picture::new(&pixels, 7, 5, header.stride, layout).is_some());
        assert!(Picture::new(&pixels[1..], 7, 5, header.stride, layout).is_none());
        // Only Bayer formats have an order.
        let disordered = FrameHeader { bayer_order: 99, ..header };
        assert_eq!(disordered.check(7, 5, needed as usize).is_err(), format.is_bayer());
    }
}
