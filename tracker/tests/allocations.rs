//! A step allocates nothing, once pictures like it have been seen.

#[path = "../../tests/counting/mod.rs"]
mod counting;
mod support;

use bytemuck::Zeroable;
use config::Config;
use counting::allocations_in;
use messages::{DetectionFrame, PixelFormat, Run, RunsHeader, Team};
use support::*;
use touchline_tracker::Tracker;

/// Robots that stand alone, robots that touch, and squares by the hundred.
fn pictures(config: &Config) -> Vec<Vec<Run>> {
    let alone =
        [robot(Team::Yellow, 0, -500.0, 0.0, 10.0), robot(Team::Blue, 1, 300.0, 200.0, 80.0)];
    let touching = [
        robot(Team::Yellow, 1, 0.0, 0.0, 0.0),
        robot(Team::Yellow, 2, 75.0, 0.0, 180.0),
        robot(Team::Blue, 3, 0.0, 76.0, 90.0),
    ];
    let mut full = Picture::new(config);
    for (index, label) in full.labels.iter_mut().enumerate() {
        let (x, y) = (index % 640, index / 640);
        if x % 8 < 7 && y % 8 < 7 {
            *label = Some(((y / 8 * 3 + x / 8 * 5) % 8) as u8);
        }
    }
    vec![
        Picture::of_robots(config, &alone).runs(),
        Picture::of_robots(config, &touching).runs(),
        full.runs(),
    ]
}

#[test]
fn a_step_allocates_nothing_once_warm() {
    let config = Config::default();
    let pictures = pictures(&config);
    let mut tracker = Tracker::new(&config).unwrap();
    let mut out = Box::new(DetectionFrame::zeroed());
    let mut header = RunsHeader::zeroed();
    // Edges are looked for in the frame too; what they are does not matter here.
    let pixels: Vec<u8> = (0..640 * 480).map(|index| (index * 7 % 251) as u8).collect();
    let (width, height) = (config.camera.width, config.camera.height);
    (header.frame.width, header.frame.height, header.frame.stride) = (width, height, width);
    header.frame.pixel_format = PixelFormat::Bayer8 as u32;
    let mut step = |seq: u64, runs: &[Run]| {
        (header.frame.seq, header.frame.t_capture_ns) = (seq, seq * 12_500_000);
        allocations_in(|| tracker.step(&header, runs, Some(&pixels), None, &mut out))
    };
    for seq in 0..12 {
        step(seq, &pictures[seq as usize % 3]);
    }
    for seq in 12..24 {
        let picture = seq as usize % 3;
        assert_eq!(step(seq, &pictures[picture]), 0, "picture {picture}");
    }
    assert!(!out.regions().is_empty());
}
