//! Zones: every pixel is classified by the tables of its zone, with every instruction set and in every
//! format.

mod reference;

use config::{Config, LightConfig};
use messages::{BayerOrder, PixelFormat, Run, RunsHeader};
use proptest::prelude::*;
use reference::{Frame, Noise, any_color, label, runs_of_labels};
use touchline_classifier::kernels::{Kernel, scalar};
use touchline_classifier::zones::{ZonedTables, Zones};
use touchline_classifier::{ClassTables, Classifier, Correction, FieldMask, Picture, SimdLevel};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn each_zone_has_its_own_tables(
        (width, height, order) in (2u32..260, 2u32..40, 0u32..4),
        half_tile in 1usize..40,
        colors in proptest::collection::vec(any_color(), 5..6),
        lights in proptest::collection::vec((prop::array::uniform3(-41i32..42), 0u8..3), 3..4),
        tile_zones in proptest::collection::vec(0u8..3, 1..400),
        format in proptest::sample::select(vec![
            PixelFormat::Bayer8, PixelFormat::Bayer12, PixelFormat::Rgb24,
        ]),
        seed in 1u64..,
    ) {
        let mut noise = Noise(seed);
        let bytes: Vec<u8> = (0..width * height).map(|_| noise.next_u32() as u8).collect();
        let order = BayerOrder::from_number(order).unwrap();
        let mut frame = Frame::new(width, height, width, order, bytes);
        let mut zones = Zones::tiled(width as usize, height as usize, 2 * half_tile);
        let tiles = zones.by_tile_mut().iter_mut();
        tiles.zip(tile_zones.iter().cycle()).for_each(|(tile, &zone)| *tile = zone);
        let corrections: Vec<_> =
            lights.iter().map(|&(gains, haze)| Correction::new(gains, 40 * haze).tables()).collect();
        let pixels = frame.rgb();
        let expected: Vec<Option<u8>> = (0..)
            .zip(pixels.as_chunks::<3>().0)
            .map(|(index, rgb)| {
                let (column, row) = (index % width as usize, index / width as usize);
                let values = corrections[zones.at(column, row)];
                let rgb = [0, 1, 2].map(|channel| values[channel][usize::from(rgb[channel])]);
                label(rgb, &colors)
            })
            .collect();
        let expected = runs_of_labels(&expected, width);
        let colors = ClassTables::new(&colors).unwrap();
        let tables: Vec<_> =
            lights.iter().map(|&(gains, haze)| colors.corrected_with_haze(gains, 40 * haze)).collect();
        let zoned = ZonedTables { colors: &colors, tables: &tables, zones: &zones };
        let mask = FieldMask::everything(width, height);

        let rgb = frame.rgb();
        frame.header.pixel_format = format as u32;
        frame.pixels = match format {
            PixelFormat::Bayer12 => {
                frame.pixels.iter().flat_map(|&v| (u16::from(v) << 4).to_le_bytes()).collect()
            }
            PixelFormat::Rgb24 => rgb,
            _ => frame.pixels,
        };
        let stride = format.row_bytes(width) as u32;
        frame.header.stride = stride;
        let layout = frame.header.check(width, height, frame.pixels.len()).unwrap();
        let picture = Picture::new(&frame.pixels, width, height, stride, layout).unwrap();
        let mut runs = vec![Run::default(); (width * height) as usize];
        let written = scalar::classify(&picture, zoned, &mask, &mut runs);
        prop_assert_eq!(&runs[..written.count as usize], &expected);
        for level in SimdLevel::available() {
            let mut kernel = Kernel::new(level, &colors);
            let written = kernel.classify(&picture, zoned, &mask, &mut runs);
            prop_assert_eq!(&runs[..written.count as usize], &expected, "{}", level);
        }
    }
}

const FLOOR: [f64; 3] = [60.0, 64.0, 58.0];
const PATCHES: [[f64; 3]; 3] = [[180.0, 164.0, 32.0], [36.0, 152.0, 168.0], [28.0, 56.0, 172.0]];

/// Squares in the palette's colours all over a floor, under light that falls off to `corner` from the middle
/// to the corners; with a little noise.
fn frame(config: &Config, corner: f64, seed: u64) -> Frame {
    let camera = &config.camera;
    let (width, height) = (camera.width as usize, camera.height as usize);
    let mut noise = Noise(seed);
    let pixels = (0..width * height).map(|index| {
        let (x, y) = (index % width, index / width);
        let color = match x % 60 < 10 && y % 60 < 10 {
            true => PATCHES[(x / 60 + y / 60) % PATCHES.len()],
            false => FLOOR,
        };
        let half = [width as f64 / 2.0, height as f64 / 2.0];
        let apart = (x as f64 - half[0]).hypot(y as f64 - half[1]) / half[0].hypot(half[1]);
        let light = 1.0 - (1.0 - corner) * apart * apart;
        let dither = f64::from(noise.next_u32() % 3);
        (color[camera.bayer_order.channel_at(x, y)] * light + dither) as u8
    });
    Frame::new(camera.width, camera.height, camera.width, camera.bayer_order, pixels.collect())
}

fn config(unevenness: f64) -> Config {
    let mut config = Config::default();
    let pitch_rgb = Some(FLOOR.map(|value| value * 0.85));
    config.light = LightConfig { pitch_rgb, brightness: 1.0, unevenness, ..LightConfig::default() };
    // Up to a fifth less or more bright than in 0.85 of full light.
    let around = |value: f64| [value * 0.8 * 0.85 - 4.0, value * 1.2 * 0.85 + 2.0].map(|v| v as u8);
    config.colors = PATCHES
        .map(|rgb| {
            let [red, green, blue] = rgb.map(around);
            reference::color(red, green, blue)
        })
        .to_vec();
    config
}

/// Number of pixels with a class.
fn classified(classifier: &mut Classifier, frame: &Frame) -> u32 {
    let (mut header, mut runs) = (RunsHeader::default(), vec![Run::default(); 50_000]);
    classifier.step(&frame.header, &frame.pixels, &mut header, &mut runs).unwrap();
    header.valid(&runs).iter().map(|run| u32::from(run.end - run.begin)).sum()
}

#[test]
fn patches_in_dark_corners_are_seen_as_well_as_those_in_the_middle() {
    let seen = |unevenness: f64, corner: f64| {
        let config = config(unevenness);
        let level = SimdLevel::Scalar;
        let mut classifier = Classifier::with_level(&config, level).unwrap();
        classified(&mut classifier, &frame(&config, corner, 5))
    };
    let even = seen(1.0, 1.0);
    let (corrected, as_it_is) = (seen(1.0, 0.35), seen(0.0, 0.35));

    assert!(even > 5000, "{even}");
    assert!(100 * corrected > 97 * even, "{corrected} of {even}");
    assert!(10 * as_it_is < 9 * even, "{as_it_is} of {even}");
}

#[test]
fn every_level_follows_the_light_from_frame_to_frame() {
    // Brightness of the corners, and of the lamps as a whole.
    let lights =
        [(1.0, 1.0), (0.3, 1.0), (0.6, 0.8), (0.6, 1.3), (0.6, 0.8), (1.5, 1.0), (1.0, 1.0)];
    let config = config(0.6);
    let glaring =
        Config { light: LightConfig { glare: true, ..config.light.clone() }, ..config.clone() };
    let mut frames: Vec<Frame> = lights
        .iter()
        .zip(1..)
        .map(|(&(corner, lamps), seed)| {
            let mut frame = frame(&config, corner, seed);
            frame.pixels.iter_mut().for_each(|pixel| *pixel = (f64::from(*pixel) * lamps) as u8);
            frame
        })
        .collect();
    for frame in &mut frames[3..5] {
        for row in frame.pixels.chunks_exact_mut(640).skip(150).take(180) {
            row[120..280].iter_mut().for_each(|pixel| *pixel = pixel.saturating_add(90));
        }
    }
    let cases = [&config, &glaring]
        .map(|config| SimdLevel::available().into_iter().map(move |level| (config, level)));
    for (config, level) in cases.into_iter().flatten() {
        let mut classifier = Classifier::with_level(config, level).unwrap();
        let mut versions = Vec::new();
        for frame in &frames {
            let mut fresh = Classifier::with_level(config, SimdLevel::Scalar).unwrap();
            let [used, fresh] = [&mut classifier, &mut fresh].map(|classifier| {
                let (mut header, mut runs) = (RunsHeader::default(), vec![Run::default(); 50_000]);
                classifier.step(&frame.header, &frame.pixels, &mut header, &mut runs).unwrap();
                (header.class_table_version, header.valid(&runs).to_vec())
            });
            assert!(used.1.len() > 500);
            assert!(used == fresh, "{level}");
            versions.push(used.0);
        }
        assert!(versions.windows(2).all(|pair| pair[0] != pair[1]), "{versions:?}");
    }
}

/// Version of the tables of a frame.
fn version(config: &Config, frame: &Frame) -> u64 {
    let mut classifier = Classifier::new(config).unwrap();
    let (mut header, mut runs) = (RunsHeader::default(), vec![Run::default(); 50_000]);
    classifier.step(&frame.header, &frame.pixels, &mut header, &mut runs).unwrap();
    header.class_table_version
}

#[test]
fn different_zones_have_different_versions() {
    let uneven = config(1.0);
    let even =
        Config { light: LightConfig { unevenness: 0.0, ..uneven.light.clone() }, ..uneven.clone() };
    let [dark, darker] = [0.6, 0.3].map(|corner| frame(&uneven, corner, 5));
    assert_ne!(version(&uneven, &dark), version(&even, &dark));
    assert_ne!(version(&uneven, &dark), version(&uneven, &darker));
    assert_eq!(version(&uneven, &dark), version(&uneven, &dark));
    // Even light needs no correction.
    let flat = frame(&uneven, 1.0, 5);
    assert_eq!(version(&uneven, &flat), version(&even, &flat));

    // Likewise if glare is corrected.
    let glaring = LightConfig { glare: true, ..even.light.clone() };
    let glaring = Config { light: glaring, ..even.clone() };
    assert_eq!(version(&glaring, &flat), version(&even, &flat));
    let under_glare = |from: usize| {
        let mut frame = flat.clone();
        for row in frame.pixels.chunks_exact_mut(640).skip(150).take(180) {
            row[from..from + 160].iter_mut().for_each(|pixel| *pixel = pixel.saturating_add(90));
        }
        version(&glaring, &frame)
    };
    let [left, right] = [120, 360].map(under_glare);
    assert!(left != right && left != version(&glaring, &flat), "{left} {right}");
    assert_eq!(left, under_glare(120));
}

#[test]
fn pictures_without_a_pitch_are_survived() {
    let config = config(1.0);
    for level in SimdLevel::available() {
        let mut classifier = Classifier::with_level(&config, level).unwrap();
        let mut noise = Noise(9);
        for value in [0, 1, 128, 255] {
            let mut frame = frame(&config, 1.0, 1);
            frame.pixels.fill(value);
            classified(&mut classifier, &frame);
            frame.pixels.iter_mut().for_each(|pixel| *pixel = noise.next_u32() as u8);
            classified(&mut classifier, &frame);
            // Black on one side, white on the other.
            for (index, pixel) in frame.pixels.iter_mut().enumerate() {
                *pixel = if index % 640 < 320 { 0 } else { 255 };
            }
            classified(&mut classifier, &frame);
        }
    }
}
