//! Cost of measuring by edges: frames of ten robots and a ball without the raw picture, with it, and
//! with it and a `world` that knows where the robots are, taking turns:
//! `cargo bench -p touchline-tracker --bench edges`.

#[path = "../tests/support/mod.rs"]
mod support;

use bytemuck::Zeroable;
use config::Config;
use geometry::FieldPoint;
use messages::{RobotState, RunsHeader, TrackStatus, WorldFrame};
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
        frame: camera.frame_header(),
        run_count: runs.len() as u32,
        ..RunsHeader::default()
    };
    let mut tracker = Tracker::new(&config).unwrap();
    let mut seen = picture.detections();
    tracker.step(&header, &runs, Some(&pixels), None, &mut seen);
    let measured = seen.robots().iter().filter(|robot| robot.edge_samples > 0).count();
    assert_eq!(seen.robots().len(), robots.len());
    // A picture without a lens hardly has edges; the most crooked one may lead nowhere.
    assert!(measured + 1 >= robots.len(), "{measured}");

    let mut world = Box::new(WorldFrame::zeroed());
    world.robot_count = seen.robots().len() as u32;
    for (state, robot) in world.robots.iter_mut().zip(seen.robots()) {
        *state = RobotState {
            team: robot.team,
            robot_id: robot.robot_id.number().expect("all robots are named"),
            status: TrackStatus::Measured as u32,
            x_mm: robot.x_mm.into(),
            y_mm: robot.y_mm.into(),
            orientation: robot.orientation.into(),
            ..RobotState::zeroed()
        };
    }
    let mut header = header;
    header.frame.seq = 1;
    let ways = [(None, None), (Some(&pixels[..]), None), (Some(&pixels[..]), Some(&*world))];
    let mut times_us: [Vec<f64>; 3] = Default::default();
    for _ in 0..ROUNDS {
        for (times, (pixels, prior)) in times_us.iter_mut().zip(ways) {
            let begin = Instant::now();
            tracker.step(&header, black_box(&runs), pixels, prior, &mut seen);
            times.push(begin.elapsed().as_secs_f64() * 1e6);
        }
    }
    let names = ["by centroids", "by edges", "by edges where expected"];
    for (name, times) in names.iter().zip(&mut times_us) {
        times.sort_by(f64::total_cmp);
        let (median, tail) = (times[ROUNDS / 2], times[ROUNDS * 99 / 100]);
        println!("{name:24} {median:6.1} µs (99 %: {tail:.1})");
    }
}
