//! What measuring by edges costs: frames of ten robots and a ball with and without the raw picture,
//! taking turns: `cargo bench -p touchline-tracker --bench edges`.

#[path = "../tests/support/mod.rs"]
mod support;

use common::config::Config;
use common::geometry::FieldPoint;
use common::messages::{FrameHeader, PixelFormat, RunsHeader};
use std::hint::black_box;
use std::time::Instant;
use support::{Picture, robot};
use touchline_tracker::Tracker;

const ROUNDS: usize = 2000;

fn main() {
    let config = Config::default();
    let camera = &config.camera;
    let robots: Vec<_> = config
        .robots
        .identities
        .iter()
        .zip(0u32..)
        .map(|(identity, index)| {
            let (x, y) = (f64::from(index % 5) * 400.0 - 800.0, f64::from(index / 5) * 700.0);
            robot(identity.team, identity.id, x, y - 350.0, f64::from(index) * 37.0)
        })
        .collect();
    let mut picture = Picture::of_robots(&config, &robots);
    picture.ball(FieldPoint::new(100.0, 20.0));
    let pixels: Vec<u8> = (0..)
        .zip(&picture.labels)
        .map(|(index, class)| {
            let (column, row) = (index % camera.width as usize, index / camera.width as usize);
            let channel = camera.bayer_order.channel_at(column, row);
            class.map_or(30, |class| config.colors[usize::from(class)].looks[channel])
        })
        .collect();
    let runs = picture.runs();
    let header = RunsHeader {
        frame: FrameHeader {
            width: camera.width,
            height: camera.height,
            stride: camera.width,
            pixel_format: PixelFormat::Bayer8 as u32,
            bayer_order: camera.bayer_order as u32,
            ..FrameHeader::default()
        },
        run_count: runs.len() as u32,
        ..RunsHeader::default()
    };
    let mut tracker = Tracker::new(&config).unwrap();
    let mut seen = picture.detections();
    tracker.step(&header, &runs, Some(&pixels), None, &mut seen);
    let measured = seen.robots().iter().filter(|robot| robot.edge_samples > 0).count();
    assert_eq!((seen.robots().len(), measured), (robots.len(), robots.len()));

    let mut times_us = [Vec::new(), Vec::new()];
    for _ in 0..ROUNDS {
        for (times, pixels) in times_us.iter_mut().zip([None, Some(&pixels[..])]) {
            let begin = Instant::now();
            tracker.step(&header, black_box(&runs), pixels, None, &mut seen);
            times.push(begin.elapsed().as_secs_f64() * 1e6);
        }
    }
    let [without, with] = times_us.map(|mut times| {
        times.sort_by(f64::total_cmp);
        [times[ROUNDS / 2], times[ROUNDS * 99 / 100]]
    });
    println!(
        "by centroids {:.1} µs (99 %: {:.1}), by edges {:.1} µs (99 %: {:.1}): {:.1} µs more, {:.2} times",
        without[0],
        without[1],
        with[0],
        with[1],
        with[0] - without[0],
        with[0] / without[0]
    );
}
