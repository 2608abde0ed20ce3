//! The field mask in the kernels: pixels outside are background, pixels inside are classified as without a
//! mask, with every instruction set and in every format.

mod reference;

use config::{Config, LightConfig, Pair};
use messages::{BayerOrder, PixelFormat, Run, RunsHeader};
use proptest::prelude::*;
use reference::{Frame, Noise, any_color, runs_of_labels};
use touchline_classifier::{Classifier, FieldMask, SimdLevel};

/// A small picture that partly shows the field, and some further areas.
fn config(width: u32, height: u32, size: f64, offset: Pair, areas: Vec<Vec<Pair>>) -> Config {
    let mut config = Config::default();
    (config.camera.width, config.camera.height) = (width, height);
    config.geometry.distortion.k1 = 0.0;
    for pair in &mut config.geometry.points {
        let [x, y] = pair.field_mm;
        pair.image_px = [
            (offset[0] + size * x / 2200.0 + 0.5) * f64::from(width),
            (offset[1] - size * y / 1800.0 + 0.5) * f64::from(height),
        ];
    }
    config.field.also_look_at_mm = areas;
    config.light = LightConfig::default();
    config
}

fn is_in(mask: &FieldMask, column: usize, row: usize) -> bool {
    mask.spans(row).iter().any(|span| span.begin <= column && column < span.end)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn only_masked_pixels_become_background(
        (width, height, order) in (2u32..260, 2u32..40, 0u32..4),
        size in 0.1..1.2f64,
        offset in [-0.5..0.5f64, -0.5..0.5f64],
        areas in proptest::collection::vec(
            proptest::collection::vec([-6000.0..6000.0f64, -6000.0..6000.0f64], 3..5), 0..3),
        colors in proptest::collection::vec(any_color(), 1..9),
        format in proptest::sample::select(vec![
            PixelFormat::Bayer8, PixelFormat::Bayer12, PixelFormat::Rgb24,
        ]),
        seed in 1u64..,
    ) {
        let mut config = config(width, height, size, offset, areas);
        config.colors = colors;
        let mut noise = Noise(seed);
        let bytes: Vec<u8> = (0..width * height).map(|_| noise.next_u32() as u8).collect();
        let order = BayerOrder::from_number(order).unwrap();
        let mut frame = Frame::new(width, height, width, order, bytes);
        let labels = frame.labels(&config.colors);
        let rgb = frame.rgb();
        frame.header.pixel_format = format as u32;
        frame.header.stride = format.row_bytes(width) as u32;
        frame.pixels = match format {
            PixelFormat::Bayer12 => {
                frame.pixels.iter().flat_map(|&v| (u16::from(v) << 4).to_le_bytes()).collect()
            }
            PixelFormat::Rgb24 => rgb,
            _ => frame.pixels,
        };
        for level in SimdLevel::available() {
            let mut classifier = Classifier::with_level(&config, level).unwrap();
            let mask = classifier.mask().clone();
            let expected: Vec<Option<u8>> = labels
                .iter()
                .enumerate()
                .map(|(index, &label)| {
                    let (column, row) = (index % width as usize, index / width as usize);
                    label.filter(|_| is_in(&mask, column, row))
                })
                .collect();
            let mut header = RunsHeader::default();
            let mut runs = vec![Run::default(); labels.len()];
            classifier.step(&frame.header, &frame.pixels, &mut header, &mut runs).unwrap();
            prop_assert_eq!(header.valid(&runs), runs_of_labels(&expected, width), "{}", level);
        }
    }
}
