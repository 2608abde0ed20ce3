//! Effect of a change of the light during a match: synthetic matches through the cores of all stages,
//! offline, frame by frame, with lamps turned up and down; and the status of a group about it.

mod offline;
mod support;

use bytemuck::Zeroable;
use classifier::Classifier;
use config::{Config, Preset};
use grabber::synthetic::SyntheticMatch;
use messages::{DetectionFrame, MAX_RUNS, Run, RunsHeader, TrackStatus, WorldFrame};
use offline::Offline;
use serde_json::Value;
use std::collections::HashMap;
use support::{Group, Scratch};

/// No robot may be lost for more frames in a row.
const MOST_LOST: u32 = 5;

/// Consecutive frames in which robots were lost.
#[derive(Debug, Default)]
struct Lost {
    running: HashMap<(u32, u32), u32>,
    longest: u32,
    frames: u64,
}

impl Lost {
    fn note(&mut self, robot: (u32, u32), is_found: bool) {
        let running = self.running.entry(robot).or_default();
        *running = if is_found { 0 } else { *running + 1 };
        self.longest = self.longest.max(*running);
        self.frames += u64::from(!is_found);
    }
}

/// Losses of the tracker, and of the filter.
#[derive(Debug, Default)]
struct Outcome {
    seen: Lost,
    known: Lost,
    wrong: u64,
    robots: u64,
}

/// Plays a match in which a lamp gives `light(s)` times its light after s seconds.
fn play(config: &Config, seconds: f64, light: impl Fn(f64) -> f64) -> Outcome {
    let mut offline = Offline::new(config);
    let mut outcome = Outcome::default();
    for frame in 0..(seconds * config.camera.fps) as u64 {
        let light = light(frame as f64 / config.camera.fps);
        offline.look(|pixels| {
            for pixel in pixels {
                *pixel = (f64::from(*pixel) * light).round().min(255.0) as u8;
            }
        });
        offline.think();
        outcome.note(&offline.game, offline.seen(), offline.world());
        offline.advance();
    }
    outcome
}

impl Outcome {
    fn note(&mut self, game: &SyntheticMatch, seen: &DetectionFrame, world: &WorldFrame) {
        for truth in game.truth().robots().iter().filter(|truth| truth.visible != 0) {
            self.robots += 1;
            let name = (truth.team, truth.robot_id);
            let is_here =
                |x_mm: f64, y_mm: f64| (x_mm - truth.x_mm).hypot(y_mm - truth.y_mm) < 20.0;
            let robot = seen
                .robots()
                .iter()
                .find(|robot| (robot.team, robot.robot_id) == (name.0, name.1.into()));
            let is_found = robot.is_some_and(|robot| is_here(robot.x_mm.into(), robot.y_mm.into()));
            self.wrong += u64::from(robot.is_some() && !is_found);
            self.seen.note(name, is_found);
            let state = world.robots().iter().find(|state| (state.team, state.robot_id) == name);
            let is_known = state.is_some_and(|state| {
                state.status != TrackStatus::Absent as u32 && is_here(state.x_mm, state.y_mm)
            });
            self.known.note(name, is_known);
        }
    }

    fn check(&self, what: &str) {
        println!(
            "{what}: seen: lost in {} of {} places, {} frames in a row; known: {}, {} in a row; {} wrong",
            self.seen.frames,
            self.robots,
            self.seen.longest,
            self.known.frames,
            self.known.longest,
            self.wrong
        );
        assert!(self.robots > 1000, "{what}: {self:?}");
        assert!(self.seen.longest <= MOST_LOST && self.known.longest <= MOST_LOST, "{what}");
        assert_eq!(self.wrong, 0, "{what}");
    }
}

#[test]
fn presets_know_the_pitch_that_their_colors_are_made_for() {
    for preset in Preset::ALL {
        let config = preset.config();
        let camera = &config.camera;
        let mut pixels = vec![0; (camera.width * camera.height) as usize];
        SyntheticMatch::new(&config).unwrap().render(&mut pixels, camera.width as usize);
        let mut classifier = Classifier::new(&config).unwrap();
        let (mut header, mut runs) = (RunsHeader::default(), vec![Run::zeroed(); MAX_RUNS]);
        classifier.step(&camera.frame_header(), &pixels, &mut header, &mut runs).unwrap();
        assert_eq!(classifier.light().gains, [1.0; 3], "{preset:?}");
    }
}

#[test]
fn the_defaults_hold_under_brighter_and_darker_lamps() {
    for brightness in [0.7, 0.8, 1.2, 1.3] {
        let mut config = Config::default();
        config.synthetic.brightness = brightness;
        let outcome = play(&config, 2.0, |_| 1.0);
        assert_eq!(outcome.seen.frames, 0, "×{brightness}");
        outcome.check(&format!("×{brightness}"));
    }
    // The light is the only reason to lose them.
    let mut config = Config::default();
    config.synthetic.brightness = 2.0;
    config.light.follow = false;
    let outcome = play(&config, 1.0, |_| 1.0);
    assert!(outcome.seen.frames > 50, "{outcome:?}");
}

#[test]
fn a_step_of_the_light_loses_nobody() {
    let config = Config::default();
    for part in [0.7, 1.3] {
        let light = |s: f64| if (1.0..2.0).contains(&s) { part } else { 1.0 };
        play(&config, 3.0, light).check(&format!("a step to {part} and back"));
    }
}

#[test]
fn light_that_fades_to_half_loses_nobody() {
    let mut config = Config::default();
    config.camera.fps = 40.0;
    play(&config, 30.0, |s| 1.0 - 0.5 * s / 30.0).check("to half the light in 30 s");
}

/// Lamps on alternating current, in a camera that sees part of it: 20 % up and down.
#[test]
fn flicker_loses_nobody() {
    let flicker = |s: f64| 1.0 + 0.2 * (s * 100.0 * std::f64::consts::TAU).sin();
    play(&Config::default(), 3.0, flicker).check("flicker of 100 Hz");
}

/// A group in a match whose lamps fade and return.
#[test]
fn how_the_light_is_corrected_is_in_the_status() {
    let scratch = Scratch::new("fading");
    let config = Config::default();
    let (width, height) = (config.camera.width, config.camera.height);
    let mut pixels = vec![0; (width * height) as usize];
    SyntheticMatch::new(&config).unwrap().render(&mut pixels, width as usize);
    for number in 0..40 {
        let light = 1.0 - 0.4 * (f64::from(number) / 39.0);
        let faded = pixels.iter().map(|&pixel| (f64::from(pixel) * light).round() as u8);
        let picture = image::GrayImage::from_raw(width, height, faded.collect()).unwrap();
        picture.save(scratch.path.join(format!("{number:02}.png"))).unwrap();
    }
    let source = format!("images:{}", scratch.path.display());
    let green = |status: &Value| status["light"]["gains"][1].as_f64();

    let text = "[camera]\nfps = 20\n[light]\nbrightness = 1.0\n";
    let mut group = Group::start("fading-followed", text, &["--source", &source]);
    group.wait_until_working();
    let dark = group.wait_for("a gain in the dark", |status| green(status) > Some(1.5));
    assert_eq!(dark["light"]["followed"], true, "{dark:#}");
    assert_eq!(dark["light"]["at_bound"], false, "{dark:#}");
    assert!(dark["light"]["changes"].as_u64() > Some(5), "{dark:#}");
    let bright = group.wait_for("no gain in the light", |status| green(status) < Some(1.1));
    assert!(green(&bright) > Some(0.9), "{bright:#}");
    let table = String::from_utf8(group.touchline(&["status"]).stdout).unwrap();
    assert!(table.contains("  light        followed: red ×"), "{table}");
    drop(group);

    let text = "[camera]\nfps = 20\n[light]\nfollow = false\n";
    let mut group = Group::start("fading-alone", text, &["--source", &source]);
    let status = group.wait_for("a word on the light", |status| status["light"].is_object());
    assert_eq!(status["light"]["followed"], false, "{status:#}");
    assert_eq!(status["light"]["gains"], serde_json::json!([1.0, 1.0, 1.0]), "{status:#}");
    assert_eq!(status["light"]["changes"], 0, "{status:#}");
}

/// A group that is shown a grey photograph of a match, which passes for a raw frame.
#[test]
fn a_match_in_grey_pictures_is_told_in_the_status() {
    let scratch = Scratch::new("grey-pictures");
    let config = Config::default();
    let (width, height) = (config.camera.width, config.camera.height);
    let mut pixels = vec![0; (width * height) as usize];
    SyntheticMatch::new(&config).unwrap().render(&mut pixels, width as usize);
    // Every 2×2 sites get one grey: the colours of the filter are gone.
    let width_px = width as usize;
    let grey = (0..pixels.len()).map(|index| {
        let even = |place: usize| place - place % 2;
        let (row, column) = (even(index / width_px), even(index % width_px));
        let site =
            |down: usize, right: usize| u32::from(pixels[(row + down) * width_px + column + right]);
        ((site(0, 0) + site(0, 1) + site(1, 0) + site(1, 1)) / 4) as u8
    });
    let picture = image::GrayImage::from_raw(width, height, grey.collect()).unwrap();
    let path = scratch.path.join("grey.png");
    picture.save(&path).unwrap();
    let source = format!("images:{}", path.display());
    let mut group = Group::start("grey-match", "", &["--source", &source]);
    group.wait_until_working();
    let said = group.wait_for("a word on the pictures", |status| status["pictures"].is_string());
    assert!(said["pictures"].as_str().unwrap().contains("no pixel has a colour"), "{said:#}");
    let table = String::from_utf8(group.touchline(&["status"]).stdout).unwrap();
    assert!(table.contains("  pictures     no pixel has a colour"), "{table}");
    drop(group);

    let mut group = Group::start("coloured-match", "", &[]);
    let found = group.wait_for("robots", |status| status["found"]["robots"].as_u64() > Some(0));
    assert!(found["pictures"].is_null(), "{found:#}");
}
