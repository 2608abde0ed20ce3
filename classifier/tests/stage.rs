//! The whole classifier against an independent reference, and with invalid input.

mod reference;

use config::{ColorConfig, Config, LightConfig};
use messages::{BayerOrder, FrameFault, FrameHeader, Run, RunsHeader};
use proptest::prelude::*;
use reference::{Frame, Noise, any_color, color};
use touchline_classifier::{
    BACKGROUND, BayerImage, Classifier, ClassifierError, SimdLevel, demosaic,
};

const STALE: Run = Run { row: 9, begin: 9, end: 9, class: 99, reserved: 99 };

fn stale_header() -> RunsHeader {
    RunsHeader { flags: u32::MAX, run_count: u32::MAX, ..bytemuck::Zeroable::zeroed() }
}

fn config(width: u32, height: u32, colors: &[ColorConfig]) -> Config {
    let mut config = Config::default();
    config.camera.width = width;
    config.camera.height = height;
    config.colors = colors.to_vec();
    config.light = LightConfig::default();
    // The default geometry does not fit these picture sizes.
    config.field.mask = false;
    config
}

/// The runs of a frame with room for `capacity`, and whether they were cut off. Asserts that every
/// instruction set of this machine gives the same, and everything else that a step guarantees.
fn step(frame: &Frame, colors: &[ColorConfig], capacity: usize) -> (Vec<Run>, bool) {
    let FrameHeader { width, height, .. } = frame.header;
    let config = config(width, height, colors);
    let levels = SimdLevel::available().into_iter();
    let results = levels.map(|level| {
        let mut classifier = Classifier::with_level(&config, level).unwrap();
        let mut out_header = stale_header();
        let mut out = vec![STALE; capacity];
        classifier.step(&frame.header, &frame.pixels, &mut out_header, &mut out).unwrap();
        assert_eq!(out_header.frame, frame.header);
        assert_eq!(out_header.t_sent_ns, 0);
        assert_eq!(out_header.class_table_version, classifier.tables().version());
        assert_eq!(out_header.flags & !RunsHeader::OVERFLOW, 0);
        let runs = out_header.valid(&out).to_vec();
        assert_eq!(runs.len(), out_header.run_count as usize);
        assert!(out[runs.len()..].iter().all(|&run| run == STALE), "wrote behind the last run");
        (level, (runs, out_header.flags == RunsHeader::OVERFLOW))
    });
    let results: Vec<_> = results.collect();
    let (_, specified) = results.last().expect("there is always the scalar code");
    for (level, result) in &results {
        assert_eq!(result, specified, "{level}");
    }
    specified.clone()
}

/// Any small size, order and padding. Pixels are noise, or patches of a few values, which make runs longer
/// than a pixel; padding is noise.
fn any_frame() -> impl Strategy<Value = Frame> {
    // Around one, two and three blocks of every instruction set.
    let width = prop_oneof![2u32..40, 40u32..230];
    let size = (width, 2u32..20, 0u32..9, any::<bool>());
    (size, 0u32..4, 1u64.., prop_oneof![Just(1u32), 1u32..12]).prop_map(
        |((width, height, padding, ends_early), order, seed, patch)| {
            let stride = width + padding;
            let mut noise = Noise(seed);
            let len = stride * height - if ends_early { padding } else { 0 };
            let mut pixels: Vec<u8> = (0..len).map(|_| noise.next_u32() as u8).collect();
            if patch > 1 {
                let level: [u8; 64] = std::array::from_fn(|_| noise.next_u32() as u8);
                for index in 0..len {
                    let (x, y) = (index % stride, index / stride);
                    if x < width {
                        // Same parity, same patch, same value: areas of one colour.
                        let site = (x & 1) + 2 * (y & 1);
                        let hash = (x / patch) * 7 + (y / patch) * 13 + site * 17;
                        pixels[index as usize] = level[hash as usize % 64];
                    }
                }
            }
            let order = BayerOrder::from_number(order).unwrap();
            Frame::new(width, height, stride, order, pixels)
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn demosaicing_equals_the_reference(frame in any_frame()) {
        let FrameHeader { width, height, stride, bayer_order, .. } = frame.header;
        let order = BayerOrder::from_number(bayer_order).unwrap();
        let image = BayerImage::new(&frame.pixels, width, height, stride, order).unwrap();
        let mut rgb = vec![1, 2, 3];
        demosaic(&image, &mut rgb);
        prop_assert_eq!(rgb, frame.rgb());
    }

    /// Only the second look decides, for every pixel.
    #[test]
    fn runs_of_second_looks_equal_the_reference(
        frame in any_frame(),
        colors in proptest::collection::vec(any_color(), 0..=32),
        dark in 0u8..5,
    ) {
        let open = |color| ColorConfig {
            red: [0, 255],
            green: [0, 255],
            blue: [0, 255],
            ..color
        };
        let colors: Vec<_> = colors
            .into_iter()
            .filter(|color| color.hue_deg.is_some() || color.saturation.is_some())
            .map(open)
            .collect();
        let mut frame = frame;
        frame.pixels.iter_mut().for_each(|value| *value >>= dark);
        let (runs, _) = step(&frame, &colors, 230 * 20);
        prop_assert_eq!(&runs, &frame.runs(&colors));
    }

    #[test]
    fn runs_equal_the_reference(
        frame in any_frame(),
        colors in proptest::collection::vec(any_color(), 0..=32),
    ) {
        let (runs, is_cut_off) = step(&frame, &colors, 230 * 20);
        prop_assert_eq!(&runs, &frame.runs(&colors));
        prop_assert!(!is_cut_off);

        let width = frame.header.width as usize;
        let mut labels = vec![None; width * frame.header.height as usize];
        for run in &runs {
            prop_assert!(run.begin < run.end && usize::from(run.end) <= width);
            prop_assert!(usize::from(run.class) < colors.len() && run.class != BACKGROUND);
            prop_assert_eq!(run.reserved, 0);
            let start = usize::from(run.row) * width;
            labels[start + usize::from(run.begin)..start + usize::from(run.end)]
                .fill(Some(run.class));
        }
        prop_assert_eq!(labels, frame.labels(&colors));
        for pair in runs.windows(2) {
            let in_order = (pair[0].row, pair[0].end) <= (pair[1].row, pair[1].begin)
                || pair[0].row < pair[1].row;
            prop_assert!(in_order, "{:?}", pair);
            let touch = pair[0].row == pair[1].row && pair[0].end == pair[1].begin;
            prop_assert!(!touch || pair[0].class != pair[1].class, "{:?}", pair);
        }
    }

    #[test]
    fn runs_beyond_capacity_are_cut_off_and_flagged(
        frame in any_frame(),
        colors in proptest::collection::vec(any_color(), 1..5),
        room in 0.0..1.0f64,
    ) {
        let all = frame.runs(&colors);
        let room = (all.len() as f64 * room) as usize;
        for capacity in [0, room, all.len().saturating_sub(1), all.len(), all.len() + 1] {
            let (runs, is_cut_off) = step(&frame, &colors, capacity);
            prop_assert_eq!(&runs[..], &all[..capacity.min(all.len())]);
            prop_assert_eq!(is_cut_off, capacity < all.len());
        }
    }

    #[test]
    fn invalid_frames_are_refused_without_a_trace(
        bytes: [u8; 64],
        damage in proptest::collection::vec((0usize..16, prop_oneof![
            Just(0u32), Just(1), Just(2), Just(u32::MAX), Just(1 << 31), any::<u32>(), 0u32..20,
        ]), 0..4),
        start_valid in prop::bool::weighted(0.8),
        pixels in proptest::collection::vec(any::<u8>(), 0..90),
    ) {
        let (width, height) = (7, 5);
        let mut header: FrameHeader = bytemuck::pod_read_unaligned(&bytes);
        if start_valid {
            header = Frame::new(width, height, 9, BayerOrder::Gbrg, vec![]).header;
        }
        for (word, value) in damage {
            bytemuck::cast_slice_mut::<_, u32>(std::slice::from_mut(&mut header))[word] = value;
        }
        let everything = [color([0, 255], [0, 255], [0, 255])];
        let mut classifier = Classifier::new(&config(width, height, &everything)).unwrap();
        let mut out_header = stale_header();
        let mut out = [STALE; 8];
        let result = classifier.step(&header, &pixels, &mut out_header, &mut out);
        prop_assert_eq!(result.err(), header.check(width, height, pixels.len()).err());
        if result.is_err() {
            prop_assert_eq!(out_header, stale_header());
            prop_assert!(out.iter().all(|&run| run == STALE));
        } else {
            prop_assert_eq!(out_header.run_count, height);
            prop_assert_eq!(bytemuck::bytes_of(&out_header.frame), bytemuck::bytes_of(&header));
        }
    }
}

#[test]
fn a_known_picture_is_interpolated_by_hand() {
    // R G R      10 20 30
    // G B G      40 50 60
    // R G R      70 80 91
    let pixels = [10, 20, 30, 40, 50, 60, 70, 80, 91];
    let image = BayerImage::new(&pixels, 3, 3, 3, BayerOrder::Rggb).unwrap();
    let mut rgb = Vec::new();
    demosaic(&image, &mut rgb);
    let at = |x: usize, y: usize| [0, 1, 2].map(|channel| rgb[3 * (3 * y + x) + channel]);
    assert_eq!(at(1, 1), [50, 50, 50]); // (10+30+70+91+2)/4, (20+40+60+80+2)/4
    assert_eq!(at(0, 0), [10, 30, 50]); // mirrored: greens 20 20 40 40, blue 50 four times
    assert_eq!(at(1, 0), [20, 20, 50]); // reds 10 30, blues 50 50
    assert_eq!(at(2, 1), [61, 60, 50]); // reds 30 91 → 60.5, blues 50 50
    assert_eq!(at(2, 2), [91, 70, 50]); // greens 60 60 80 80
}

#[test]
fn all_32_classes_come_out() {
    let colors: Vec<ColorConfig> =
        (0..32u8).map(|class| [8 * class, 8 * class + 7]).map(|r| color(r, r, r)).collect();
    // One grey level per pair of rows, 64 rows: away from the seams every pixel has its level.
    let pixels = (0..64u8).flat_map(|row| [row / 2 * 8 + 4; 6]).collect();
    let frame = Frame::new(6, 64, 6, BayerOrder::Bggr, pixels);
    let (runs, _) = step(&frame, &colors, 1000);
    assert_eq!(runs, frame.runs(&colors));
    let mut classes: Vec<u8> = runs.iter().map(|run| run.class).collect();
    classes.sort_unstable();
    classes.dedup();
    assert_eq!(classes, (0..32).collect::<Vec<u8>>());
}

#[test]
fn a_frame_of_one_color_is_one_run_a_row() {
    for order in BayerOrder::ALL {
        // Orange: every site has its channel's level, so interpolation changes nothing.
        let orange = [230, 110, 20];
        let pixels = (0..35).map(|i| orange[order.channel_at(i % 7, i / 7)]).collect();
        let exact = color([230, 230], [110, 110], [20, 20]);
        let colors = [ColorConfig { hue_deg: Some([20.0, 30.0]), ..exact }];
        let (runs, _) = step(&Frame::new(7, 5, 7, order, pixels), &colors, 100);
        let expected: Vec<Run> =
            (0..5).map(|row| Run { row, begin: 0, end: 7, class: 0, reserved: 0 }).collect();
        assert_eq!(runs, expected);
    }
}

#[test]
fn impossible_sizes_are_refused() {
    for (width, height) in [(0, 0), (0, 480), (640, 1), (1, 2), (640, 0)] {
        let result = Classifier::new(&config(width, height, &[]));
        assert_eq!(result.unwrap_err(), ClassifierError::ImageTooSmall { width, height });
    }
    for (width, height) in [(65_536, 2), (2, u32::MAX)] {
        let result = Classifier::new(&config(width, height, &[]));
        assert_eq!(result.unwrap_err(), ClassifierError::ImageTooLarge { width, height });
    }
    assert!(Classifier::new(&config(65_535, 65_535, &[])).is_ok());
    let colors = vec![color([0, 0], [0, 0], [0, 0]); 33];
    let result = Classifier::new(&config(640, 480, &colors));
    assert_eq!(result.unwrap_err(), ClassifierError::TooManyColors(33));
}

#[test]
fn widest_and_highest_frames_fit_their_runs() {
    let everything = [color([0, 255], [0, 255], [0, 255])];
    for (width, height) in [(65_535, 2), (2, 65_535)] {
        let pixels = vec![0; (width * height) as usize];
        let frame = Frame::new(width, height, width, BayerOrder::Grbg, pixels);
        let (runs, _) = step(&frame, &everything, 65_535);
        assert_eq!(runs.len(), height as usize);
        let last = runs[runs.len() - 1];
        assert_eq!((u32::from(last.row), u32::from(last.end)), (height - 1, width));
    }
}

#[test]
fn images_larger_than_their_pixels_are_refused() {
    let pixels = [0; 20];
    let exists = |width, height, stride| {
        BayerImage::new(&pixels, width, height, stride, BayerOrder::Rggb).is_some()
    };
    assert!(exists(4, 5, 4) && exists(2, 4, 6) && exists(2, 2, 18));
    assert!(!exists(4, 5, 3) && !exists(1, 5, 4) && !exists(4, 1, 4) && !exists(0, 0, 0));
    assert!(!exists(4, 6, 4) && !exists(3, 4, 6) && !exists(2, 2, 19));
    assert!(!exists(2, u32::MAX, u32::MAX) && !exists(u32::MAX, 2, u32::MAX));
}

#[test]
fn a_bad_frame_has_no_effect_on_the_next() {
    let frame = Frame::new(6, 4, 6, BayerOrder::Rggb, vec![200; 24]);
    let colors = [color([0, 255], [0, 255], [0, 255])];
    let mut classifier = Classifier::new(&config(6, 4, &colors)).unwrap();
    let (mut out_header, mut out) = (stale_header(), [STALE; 8]);
    let short = classifier.step(&frame.header, &frame.pixels[..23], &mut out_header, &mut out);
    assert_eq!(short, Err(FrameFault::Truncated { got: 23, needed: 24 }));
    classifier.step(&frame.header, &frame.pixels, &mut out_header, &mut out).unwrap();
    assert_eq!(out_header.run_count, 4);
}

#[test]
fn every_level_follows_the_light_from_frame_to_frame() {
    let mut config = Config::default();
    config.light.pitch_rgb = Some([40.0, 50.0, 45.0]);
    config.light.brightness = 1.0;
    let mut noise = Noise(3);
    // Each time a pitch in another light, with a column of every colour.
    let frames: Vec<Frame> = [[1.0, 1.0, 1.0], [0.7, 1.0, 1.3], [1.2, 0.8, 0.9], [1.0, 1.0, 1.0]]
        .into_iter()
        .map(|gains: [f64; 3]| {
            let pixels = (0..640 * 480).map(|index| {
                let (x, y) = (index % 640, index / 640);
                let channel = BayerOrder::Rggb.channel_at(x, y);
                let level = match x % 80 < 16 {
                    true => config.colors[x / 80].looks[channel],
                    false => [40, 50, 45][channel],
                };
                (f64::from(level) * gains[channel]) as u8 / 8 * 8 + (noise.next_u32() % 5) as u8
            });
            Frame::new(640, 480, 640, BayerOrder::Rggb, pixels.collect())
        })
        .collect();
    let mut counts = Vec::new();
    for level in SimdLevel::available() {
        let mut classifier = Classifier::with_level(&config, level).unwrap();
        for frame in &frames {
            let mut fresh = Classifier::with_level(&config, SimdLevel::Scalar).unwrap();
            let mut results = [&mut classifier, &mut fresh].map(|classifier| {
                let (mut header, mut out) = (stale_header(), vec![STALE; 100_000]);
                classifier.step(&frame.header, &frame.pixels, &mut header, &mut out).unwrap();
                (header.class_table_version, header.valid(&out).to_vec())
            });
            assert_eq!(results[0], results[1], "{level}");
            counts.push((std::mem::take(&mut results[0].1).len(), results[0].0));
        }
    }
    assert!(counts.iter().all(|&(runs, _)| runs > 3000), "{counts:?}");
    assert!(counts[0].1 != counts[1].1 && counts[0].1 == counts[3].1, "{counts:?}");
}
