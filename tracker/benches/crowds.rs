//! How long the tracker takes for many robots that wear few colours, alone and touching:
//! `cargo bench -p touchline-tracker --bench crowds`. Answers are verified first; the pictures take turns.

#[path = "../tests/support/mod.rs"]
mod support;

use config::{Config, GeometryConfig, Preset};
use messages::{Run, RunsHeader};
use std::hint::black_box;
use std::time::Instant;
use support::{Picture, robot};
use touchline_tracker::Tracker;

const ROUNDS: usize = 300;

/// A picture and the measurements.
struct Subject {
    name: &'static str,
    robots: usize,
    tracker: Tracker,
    runs: Vec<Run>,
    times_us: Vec<f64>,
}

fn main() {
    let mut ssl = Preset::SslDivisionB.config();
    (ssl.field.length_mm, ssl.field.width_mm) = (4500.0, 3000.0);
    (ssl.camera.width, ssl.camera.height) = (1224, 1024);
    ssl.geometry = GeometryConfig::above(&ssl.field, ssl.camera.picture_px(), 4200.0);
    let mut subjects = [
        subject("ssl, 32 robots apart", &ssl, [520.0, 600.0]),
        subject("ssl, 32 robots touching", &ssl, [184.0, 184.0]),
        subject("mirosot, 10 robots", &Config::default(), [200.0, 400.0]),
        subject("large league, 22 robots", &Preset::MirosotLarge.config(), [450.0, 600.0]),
    ];
    let mut seen = support::detections(&ssl, &[], None);
    for round in 0..ROUNDS {
        for subject in &mut subjects {
            let tracker = &mut subject.tracker;
            let header =
                RunsHeader { run_count: subject.runs.len() as u32, ..RunsHeader::default() };
            // Once without a clock, as the frame before would have been one like it.
            tracker.step(&header, &subject.runs, None, None, &mut seen);
            if round == 0 {
                assert_eq!(seen.robots().len(), subject.robots, "{}", subject.name);
            }
            let begin = Instant::now();
            tracker.step(&header, black_box(&subject.runs), None, None, &mut seen);
            subject.times_us.push(begin.elapsed().as_secs_f64() * 1e6);
        }
    }
    for Subject { name, times_us, .. } in &mut subjects {
        times_us.sort_by(f64::total_cmp);
        let (median, tail) = (times_us[ROUNDS / 2], times_us[ROUNDS * 99 / 100]);
        println!("{name:24} {median:7.1} µs (99 %: {tail:.1})");
    }
}

/// All robots of a configuration in rows of eight, so far apart.
fn subject(name: &'static str, config: &Config, [x_mm, y_mm]: [f64; 2]) -> Subject {
    let robots: Vec<_> = config
        .robots
        .identities
        .iter()
        .zip(0u32..)
        .map(|(identity, index)| {
            let (column, row) = (f64::from(index % 8) - 3.5, f64::from(index / 8) - 1.5);
            let heading = f64::from(index) * 137.0;
            robot(identity.team, identity.id, column * x_mm, row * y_mm, heading)
        })
        .collect();
    let runs = Picture::of_robots(config, &robots).runs();
    let tracker = Tracker::new(config).expect("presets are usable");
    Subject { name, robots: robots.len(), tracker, runs, times_us: Vec::new() }
}
