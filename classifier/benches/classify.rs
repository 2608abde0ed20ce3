//! Duration of classifying a frame, beside that of copying it: `cargo bench -p touchline-classifier`. With
//! `-- quick` only 640×480, with `-- hue` only colours bounded by hue and saturation. Takes half a gigabyte
//! of memory for frames, and the same for the copies.
//!
//! Results are verified first. The candidates take turns, so that a change in the machine's speed affects all
//! of them; medians are printed. "hot" is the same frame again and again. "cold" rotates through so many that
//! none is in a cache, like a frame that a camera has just written. Everything runs on one core.

#[path = "../tests/reference/mod.rs"]
mod reference;

use config::{ColorConfig, Config, LightConfig};
use messages::{BayerOrder, FrameHeader, PixelFormat, Run, RunsHeader};
use reference::{Frame, Noise, encode};
use std::hint::black_box;
use std::time::Instant;
use touchline_classifier::second_look::{hue_deg, saturation};
use touchline_classifier::{BayerImage, Classifier, ClassifierError, SimdLevel, demosaic};

/// Frames that a cold measurement rotates through, and the memory they may take.
const COLD_FRAMES: usize = 256;
const COLD_BYTES: usize = 512 << 20;

fn main() -> Result<(), ClassifierError> {
    if let Ok(info) = std::fs::read_to_string("/proc/cpuinfo") {
        println!("{}", info.lines().find(|line| line.starts_with("model name")).unwrap_or(""));
    }
    let is_quick = std::env::args().any(|argument| argument == "quick");
    let levels = SimdLevel::available();
    println!("levels: {}", levels.iter().map(|level| level.name()).collect::<Vec<_>>().join(", "));

    let sizes: &[(u32, u32)] = match is_quick {
        true => &[(640, 480)],
        false => &[(640, 480), (1280, 960), (1920, 1200), (2448, 2048)],
    };
    if std::env::args().any(|argument| argument == "hue") {
        return measure_looks(&levels);
    }
    println!("\nresolutions: 13 classes, 0.5 % foreground");
    heading(&levels);
    for &(width, height) in sizes {
        let name = format!("{width}×{height}");
        measure(&name, &config(width, height, 13), Picture::Pitch(0.005), &levels)?;
    }
    println!("\nclasses: 640×480, 0.5 % foreground");
    heading(&levels);
    for classes in [1, 8, 13, 32] {
        let name = format!("{classes} classes");
        measure(&name, &config(640, 480, classes), Picture::Pitch(0.005), &levels)?;
    }
    println!("\nforeground: 640×480, 13 classes");
    heading(&levels);
    let config = config(640, 480, 13);
    for (name, picture) in [
        ("0.5 %", Picture::Pitch(0.005)),
        ("12 %", Picture::Pitch(0.12)),
        ("noise", Picture::Noise),
        ("checkerboard", Picture::Checkerboard),
    ] {
        measure(name, &config, picture, &levels)?;
    }
    let mut second_look = config.clone();
    for color in &mut second_look.colors {
        color.hue_deg = Some([350.0, 340.0]);
        color.saturation = Some([0.1, 1.0]);
    }
    measure("12 %, HSI", &second_look, Picture::Pitch(0.12), &levels)?;
    measure_looks(&levels)?;
    println!("\nformats: 640×480, 13 classes, 0.5 % foreground");
    heading(&levels);
    for format in PixelFormat::ALL {
        let frame = in_format(Picture::Pitch(0.005).frame(&config, 1), format);
        measure_frame(format.name(), &config, std::slice::from_ref(&frame), &levels)?;
        if format.is_yuv() {
            let name = format!("{format}, boxes");
            measure_frame(&name, &with_yuv_boxes(&config), &[frame], &levels)?;
        }
    }
    Ok(())
}

/// Boxes, and bounds on hue and saturation instead of them.
fn measure_looks(levels: &[SimdLevel]) -> Result<(), ClassifierError> {
    println!(
        "\nhue and saturation instead of red, green and blue: 1224×1024, 8 classes, 0.5 % foreground"
    );
    heading(levels);
    let boxes = self::config(1224, 1024, 8);
    let looks = with_looks_only(&boxes);
    let mut lit = looks.clone();
    lit.light = Config::default().light;
    lit.light.pitch_rgb = Some([20.0, 30.0, 24.0]);
    for floor in [BLACK, GREEN] {
        let picture = Picture::Floor(floor);
        for (name, config) in [("boxes", &boxes), ("hue", &looks), ("hue, lamps", &lit)] {
            let name = format!("{name}, {}", if floor == BLACK { "black" } else { "green" });
            measure(&name, config, picture, levels)?;
        }
    }
    Ok(())
}

/// The preset's eight colours, and further ones with narrow boxes between them.
fn config(width: u32, height: u32, classes: usize) -> Config {
    let mut config = Config::default();
    (config.camera.width, config.camera.height) = (width, height);
    // The whole picture, without mask and without correction of the light.
    config.field.mask = false;
    config.light = LightConfig::default();
    let mut noise = Noise(99);
    for class in config.colors.len()..classes {
        let mut channel = || {
            let low = 70 + (noise.next_u32() % 150) as u8;
            [low, low + 30]
        };
        let [red, green, blue] = [channel(), channel(), channel()];
        let looks = [red, green, blue].map(|range| range[0] + 15);
        let name = format!("colour {class}");
        config.colors.push(ColorConfig { name, looks, ..reference::color(red, green, blue) });
    }
    config.colors.truncate(classes);
    config
}

/// Replaces each colour's box by bounds on hue and saturation around its display colour.
fn with_looks_only(config: &Config) -> Config {
    let mut config = config.clone();
    for color in &mut config.colors {
        (color.red, color.green, color.blue) = ([0, 255], [0, 255], [0, 255]);
        let hue = hue_deg(color.looks).unwrap_or(0.0);
        color.hue_deg = Some([hue - 12.0, hue + 12.0]);
        let saturation = saturation(color.looks);
        color.saturation = Some([(0.7 * saturation).max(0.4), 1.0]);
    }
    config
}

/// Floors.
const BLACK: [u8; 3] = [30, 38, 34];
const GREEN: [u8; 3] = [30, 75, 35];

#[derive(Clone, Copy)]
enum Picture {
    /// A [`Pitch`](Self::Pitch) with 0.5 % of patches on a floor of another colour.
    Floor([u8; 3]),
    /// A dark, noisy pitch, white lines, and colour patches that take this share of it.
    Pitch(f64),
    /// Random bytes.
    Noise,
    /// Single pixels of two classes in turns, all over.
    Checkerboard,
}

impl Picture {
    fn frame(self, config: &Config, seed: u64) -> Frame {
        let (width, height) = (config.camera.width as usize, config.camera.height as usize);
        let order = BayerOrder::Rggb;
        let mut noise = Noise(seed);
        let mut pixels = vec![0; width * height];
        // Patches of 9×9 pixels at 640×480, in a grid that has as many cells as patches.
        let side = 9 * height / 480;
        let (share, floor) = match self {
            Self::Pitch(share) => (share, BLACK),
            Self::Floor(floor) => (0.005, floor),
            Self::Noise | Self::Checkerboard => (0.0, BLACK),
        };
        let pitch = ((side * side) as f64 / share.max(1e-9)).sqrt() as usize;
        for (y, row) in pixels.chunks_exact_mut(width).enumerate() {
            for (x, pixel) in row.iter_mut().enumerate() {
                let channel = order.channel_at(x, y);
                let random = noise.next_u32();
                *pixel = match self {
                    Self::Noise => random as u8,
                    Self::Checkerboard => 255 * ((x / 2 + y / 2) % 2) as u8,
                    Self::Pitch(_) | Self::Floor(_) => {
                        let is_patch = x % pitch < side && y % pitch < side;
                        let is_line = x == width / 2 || y == height / 10;
                        let patch = x / pitch + 7 * (y / pitch);
                        let level = match (is_patch, is_line) {
                            (true, _) => config.colors[patch % config.colors.len()].looks[channel],
                            (_, true) => 200,
                            _ => floor[channel],
                        };
                        level.saturating_add((random % 9) as u8).saturating_sub(4)
                    }
                };
            }
        }
        Frame::new(width as u32, height as u32, width as u32, order, pixels)
    }
}

/// The same picture in another format.
fn in_format(frame: Frame, format: PixelFormat) -> Frame {
    let FrameHeader { width, height, stride, .. } = frame.header;
    let bayer = BayerImage::new(&frame.pixels, width, height, stride, BayerOrder::Rggb);
    let mut rgb = Vec::new();
    demosaic(&bayer.expect("a whole frame"), &mut rgb);
    let color = |x: usize, y: usize| {
        let first = 3 * (y * width as usize + x);
        let rgb = [rgb[first], rgb[first + 1], rgb[first + 2]];
        if format.is_yuv() { yuv_from_rgb(rgb) } else { rgb }
    };
    let stride = format.row_bytes(width) as u32;
    let header = FrameHeader { stride, pixel_format: format as u32, ..frame.header };
    let shift = match format {
        PixelFormat::Bayer10 => 2,
        PixelFormat::Bayer12 => 4,
        _ => 8,
    };
    let pixels = match format {
        PixelFormat::Bayer8 => frame.pixels,
        _ if format.is_bayer() => {
            frame.pixels.iter().flat_map(|&v| (u16::from(v) << shift).to_le_bytes()).collect()
        }
        _ => encode(&header, &mut Noise(1), color),
    };
    Frame { header, pixels }
}

/// BT.601, as cameras convert.
fn yuv_from_rgb(rgb: [u8; 3]) -> [u8; 3] {
    let [r, g, b] = rgb.map(i32::from);
    let y = (66 * r + 129 * g + 25 * b + 128) / 256 + 16;
    let u = (-38 * r - 74 * g + 112 * b + 128 + 128 * 256) / 256;
    let v = (112 * r - 94 * g - 18 * b + 128 + 128 * 256) / 256;
    [y, u, v].map(|value| value.clamp(0, 255) as u8)
}

/// With a box in YUV around each colour's display colour.
fn with_yuv_boxes(config: &Config) -> Config {
    let mut config = config.clone();
    for color in &mut config.colors {
        let around =
            |value: u8, extent: u8| [value.saturating_sub(extent), value.saturating_add(extent)];
        let [y, u, v] = yuv_from_rgb(color.looks);
        (color.y, color.u, color.v) =
            (Some(around(y, 60)), Some(around(u, 15)), Some(around(v, 15)));
    }
    config
}

fn heading(levels: &[SimdLevel]) {
    print!("{:14} {:>6} {:>6} {:>9} {:>9}", "", "runs", "fg %", "copy hot", "copy cold");
    for level in levels {
        print!(" {:>9} {:>5} {:>9} {:>5}", level.name(), "×hot", "cold", "×cold");
    }
    println!();
}

fn measure(
    name: &str,
    config: &Config,
    picture: Picture,
    levels: &[SimdLevel],
) -> Result<(), ClassifierError> {
    // A few different frames are enough: caches do not notice that frames are alike.
    let frames: Vec<Frame> = (1..=4).map(|seed| picture.frame(config, seed)).collect();
    measure_frame(name, config, &frames, levels)
}

fn measure_frame(
    name: &str,
    config: &Config,
    frames: &[Frame],
    levels: &[SimdLevel],
) -> Result<(), ClassifierError> {
    let bytes = frames[0].pixels.len();
    let count = COLD_FRAMES.min(COLD_BYTES / bytes);
    let cold: Vec<Frame> = (0..count).map(|index| frames[index % frames.len()].clone()).collect();
    let mut copies: Vec<Vec<u8>> = (0..count).map(|_| vec![1; bytes]).collect();
    // At another offset in its page than the source: copying between equal offsets takes many times as long.
    let mut copy = vec![0; bytes + 2048];
    let copy = &mut copy[2048..];
    let mut header = RunsHeader::default();
    // Room for all runs: noise has more than a message holds, and all of it is measured.
    let mut runs = vec![Run::default(); (config.camera.width * config.camera.height) as usize];

    let mut classifiers = Vec::new();
    for &level in levels {
        classifiers.push(Classifier::with_level(config, level)?);
    }
    let hot = &frames[0];
    let mut expected: Option<Vec<Run>> = None;
    for classifier in classifiers.iter_mut().rev() {
        let result = classifier.step(&hot.header, &hot.pixels, &mut header, &mut runs);
        assert_eq!(result, Ok(()), "{name}");
        let got = header.valid(&runs);
        let expected = expected.get_or_insert_with(|| match hot.header.pixel_format {
            1 if bytes < 1 << 20 => hot.runs(&config.colors),
            _ => got.to_vec(),
        });
        assert!(got == expected, "{name}: {} gives a wrong answer", classifier.level());
    }

    let rounds = (40_000_000 / bytes).clamp(15, 101);
    let mut times = vec![Vec::new(); 2 + 2 * levels.len()];
    let timed = |times: &mut Vec<f64>, work: &mut dyn FnMut()| {
        let start = Instant::now();
        work();
        times.push(start.elapsed().as_secs_f64() * 1e6);
    };
    let mut next = 0;
    for _ in 0..rounds {
        // Hot means just used: everything runs twice, and the second time counts.
        for _ in 0..2 {
            copy.copy_from_slice(black_box(&hot.pixels));
        }
        timed(&mut times[0], &mut || black_box(&mut *copy).copy_from_slice(black_box(&hot.pixels)));
        next = (next + 1) % count;
        timed(&mut times[1], &mut || {
            black_box(&mut copies[next]).copy_from_slice(black_box(&cold[next].pixels));
        });
        for (index, classifier) in classifiers.iter_mut().enumerate() {
            let mut step = |frame: &Frame| {
                let result = classifier.step(&frame.header, &frame.pixels, &mut header, &mut runs);
                assert_eq!(result, Ok(()));
            };
            step(hot);
            timed(&mut times[2 + 2 * index], &mut || step(black_box(hot)));
            next = (next + 1) % count;
            timed(&mut times[3 + 2 * index], &mut || step(black_box(&cold[next])));
        }
    }
    let medians: Vec<f64> = times
        .iter_mut()
        .map(|times| {
            times.sort_by(f64::total_cmp);
            times[times.len() / 2]
        })
        .collect();
    let [copy_hot, copy_cold] = [medians[0], medians[1]];
    let runs = expected.unwrap_or_default();
    let foreground: u32 = runs.iter().map(Run::pixels).sum();
    let pixels = config.camera.width * config.camera.height;
    let percent = 100.0 * f64::from(foreground) / f64::from(pixels);
    print!("{name:14} {:6} {percent:6.1} {copy_hot:9.1} {copy_cold:9.1}", runs.len());
    for pair in medians[2..].chunks_exact(2) {
        let (hot, cold) = (pair[0], pair[1]);
        print!(" {hot:9.1} {:5.1} {cold:9.1} {:5.1}", hot / copy_hot, cold / copy_cold);
    }
    println!();
    Ok(())
}
