//! How long a 640×480 frame takes, beside a copy of the same frame: `cargo bench -p
//! touchline-classifier`. Answers are verified first; the candidates take turns so that a change
//! of the machine's mood meets all of them.

#[path = "../tests/reference/mod.rs"]
mod reference;

use common::config::Config;
use common::messages::{BayerOrder, RunsHeader};
use reference::{Frame, Noise};
use std::hint::black_box;
use std::time::Instant;
use touchline_classifier::{Classifier, ClassifierError};

const ROUNDS: usize = 300;

fn main() -> Result<(), ClassifierError> {
    let config = Config::default();
    let mut second_look = config.clone();
    for color in &mut second_look.colors {
        color.hue_deg = Some([350.0, 340.0]);
        color.saturation = Some([0.1, 1.0]);
    }
    if let Ok(info) = std::fs::read_to_string("/proc/cpuinfo") {
        println!("{}", info.lines().find(|line| line.starts_with("model name")).unwrap_or(""));
    }
    measure("match", &config, &pitch(&config))?;
    measure("match, second look", &second_look, &pitch(&config))?;
    measure("random bytes", &config, &random(&config))
}

/// A dark, noisy pitch with a square of 9×9 pixels for each of 13 patches and the ball.
fn pitch(config: &Config) -> Frame {
    let mut noise = Noise(1);
    frame(config, |x, y, channel| {
        let (patch, in_x, in_y) = (x / 90 + 7 * (y / 240), x % 90 < 9, y % 240 < 9);
        let looks = config.colors[patch % config.colors.len()].looks;
        let level = if in_x && in_y && patch < 14 { looks[channel] } else { [30, 38, 34][channel] };
        level.saturating_add((noise.next_u32() % 9) as u8).saturating_sub(4)
    })
}

fn random(config: &Config) -> Frame {
    let mut noise = Noise(1);
    frame(config, |_, _, _| noise.next_u32() as u8)
}

fn frame(config: &Config, mut level: impl FnMut(usize, usize, usize) -> u8) -> Frame {
    let (width, height) = (config.camera.width, config.camera.height);
    let order = BayerOrder::Rggb;
    let pixels = (0..(width * height) as usize)
        .map(|index| (index % width as usize, index / width as usize))
        .map(|(x, y)| level(x, y, order.channel_at(x, y)))
        .collect();
    Frame::new(width, height, width, order, pixels)
}

fn measure(name: &str, config: &Config, frame: &Frame) -> Result<(), ClassifierError> {
    let mut classifier = Classifier::new(config)?;
    let mut header: RunsHeader = bytemuck::Zeroable::zeroed();
    // Room for everything: noise has more runs than a message, and all of it shall be measured.
    let mut runs = vec![bytemuck::Zeroable::zeroed(); frame.pixels.len()];
    let mut copy = vec![0; frame.pixels.len()];
    let (mut copying, mut classifying) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        let start = Instant::now();
        black_box(&mut copy).copy_from_slice(black_box(&frame.pixels));
        copying.push(start.elapsed());
        let start = Instant::now();
        let result = classifier.step(&frame.header, &frame.pixels, &mut header, &mut runs);
        classifying.push(start.elapsed());
        assert_eq!(result, Ok(()));
    }
    assert!(header.valid(&runs) == frame.runs(&config.colors), "{name}: wrong answer");
    let percentile = |times: &mut Vec<std::time::Duration>, percent: usize| {
        times.sort_unstable();
        times[(times.len() - 1) * percent / 100].as_secs_f64() * 1e6
    };
    let copy_us = percentile(&mut copying, 50);
    let (p50_us, p99_us) = (percentile(&mut classifying, 50), percentile(&mut classifying, 99));
    let foreground: u32 = header.valid(&runs).iter().map(|run| run.pixels()).sum();
    println!(
        "{name:20} {p50_us:7.0} µs (p99 {p99_us:.0}), copy {copy_us:.1} µs: {:.0}×; {} runs, {:.1} % foreground",
        p50_us / copy_us,
        header.run_count,
        100.0 * f64::from(foreground) / frame.pixels.len() as f64,
    );
    Ok(())
}
