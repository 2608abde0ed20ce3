//! `touchline score --synthetic`: scores the stages on pictures of the synthetic match, scene by scene.
//!
//! Every scene is a match under some difficulty. Frames are sampled at intervals, each stands alone, and
//! the detections are compared with the truth.

use super::moments::{MOMENTS, Moment, PATIENCE};
use crate::commands::CommandError;
use config::painted_light::follow_painted_light;
use config::{Config, DistortionConfig, DistortionModel, GeometryConfig, PointPair, Preset};
use grabber::synthetic::SyntheticMatch;
use offline::chain::Chain;
use runtime::output::Reader;
use serde::Serialize;
use touchline::monitor::accuracy::{ReportedRobot, Scorer};

/// Changes the configuration to that of a scene.
type Change = fn(&mut Config);

/// The scenes, by name.
const SCENES: &[(&str, Change)] = &[
    ("standard", |_| {}),
    ("light-0.5", |config| config.synthetic.brightness = 0.5),
    ("light-0.75", |config| config.synthetic.brightness = 0.75),
    ("light-1.25", |config| config.synthetic.brightness = 1.25),
    ("light-1.5", |config| config.synthetic.brightness = 1.5),
    ("lamp-3500K", |config| config.synthetic.color_temperature_k = 3500.0),
    ("lamp-5000K", |config| config.synthetic.color_temperature_k = 5000.0),
    ("lamp-9000K", |config| config.synthetic.color_temperature_k = 9000.0),
    ("gradient", |config| config.synthetic.gradient = 0.4),
    ("vignette", |config| config.synthetic.vignette = 0.5),
    ("glare", |config| config.synthetic.glare = 0.25),
    ("noise", |config| config.synthetic.noise = 6.0),
    ("blur", |config| config.camera.exposure_us = 10_000),
    ("blur-11px", |config| {
        // A robot at full speed covers 11 pixels while the shutter is open.
        config.camera.fps = 30.0;
        config.camera.exposure_us = 31_000;
    }),
    ("defocus", |config| config.synthetic.defocus_px = 2.5),
    ("dim", |config| {
        // Half as bright as "light-0.5", with a read noise of nine electrons; 255 grey levels are a
        // thousand electrons.
        config.synthetic.brightness = 0.25;
        config.synthetic.noise = 2.3;
    }),
    ("green-floor", |config| lie_on_floor(config, [22, 58, 27])),
    ("blue-floor", |config| lie_on_floor(config, [22, 38, 75])),
    ("white-and-grey", wear_white_and_grey),
    ("3v3", |config| config.robots.identities.retain(|identity| identity.id < 3)),
    ("vsss", |config| *config = Preset::Vsss3v3.config()),
    ("tall-opponents", |config| config.teams.blue.height_mm = Some(150.0)),
    ("11v11", |config| *config = Preset::MirosotLarge.config()),
    ("fisheye", look_through_fisheye),
    ("crowd", |config| {
        // Twenty-two robots on a pitch for ten, so that they hide each other everywhere.
        let large = Preset::MirosotLarge.config();
        config.robots = large.robots;
        config.camera = large.camera;
        config.geometry = GeometryConfig::above(&config.field, config.camera.picture_px(), 2200.0);
    }),
];

/// A floor of another colour, learned with its light.
fn lie_on_floor(config: &mut Config, rgb: [u8; 3]) {
    let black = config.synthetic.floor_rgb;
    config.synthetic.floor_rgb = rgb;
    if let Some(pitch) = &mut config.light.pitch_rgb {
        for (channel, value) in pitch.iter_mut().enumerate() {
            *value *= f64::from(rgb[channel]) / f64::from(black[channel]);
        }
    }
}

/// Two of the identification colours become achromatic: paper as bright as lines, and as bright as
/// walls.
fn wear_white_and_grey(config: &mut Config) {
    let papers = [("green", [200; 3], [112, 255]), ("pink", [100; 3], [54, 108])];
    for (name, looks, values) in papers {
        for color in config.colors.iter_mut().filter(|color| color.name == name) {
            (color.red, color.green, color.blue) = (values, values, values);
            color.saturation = Some([0.0, 0.12]);
            color.looks = looks;
        }
    }
}

/// An equidistant fisheye 1500 mm above the middle; it sees the pitch's corners at 43° from its axis.
fn look_through_fisheye(config: &mut Config) {
    const HEIGHT_MM: f64 = 1500.0;
    let (field, camera) = (&config.field, &config.camera);
    let center_px = [camera.width, camera.height].map(|size| (f64::from(size) - 1.0) / 2.0);
    let (x, y) = (field.length_mm / 2.0 + field.goal_depth_mm, field.width_mm / 2.0 + 20.0);
    let fitting = |size_px: f64, size_mm: f64| size_px / (size_mm / HEIGHT_MM).atan();
    let focal_px = fitting(center_px[0], x).min(fitting(center_px[1], y));
    let seen = |field_mm: [f64; 2]| {
        let away = field_mm[0].hypot(field_mm[1]);
        let px_per_mm = focal_px * (away / HEIGHT_MM).atan() / away;
        let [x, y] = field_mm.map(|value| value * px_per_mm);
        PointPair { field_mm, image_px: [center_px[0] + x, center_px[1] - y] }
    };
    let (x, y) = (field.length_mm / 2.0, field.width_mm / 2.0);
    config.geometry = GeometryConfig {
        camera_mm: [0.0, 0.0, HEIGHT_MM],
        points: [[-x, y], [x, y], [x, -y], [-x, -y]].map(seen).to_vec(),
        distortion: DistortionConfig {
            model: DistortionModel::Fisheye,
            focal_px,
            k1: 0.0,
            center_px,
            ..DistortionConfig::default()
        },
    };
}

/// Interval between scored frames: a quarter of a second at 80 frames a second.
const STRIDE: usize = 20;

/// The score of a scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SceneScore {
    pub scene: &'static str,
    pub frames: usize,
    /// Share of the visible robots that were found under their right identity.
    pub found_ratio: f64,
    pub wrong_identity: u64,
    pub position_rms_mm: f64,
    pub heading_rms_deg: f64,
    pub ball_found_ratio: f64,
    pub ball_rms_mm: f64,
}

/// All scenes: the change of the configuration, and the moment to wait for, if any.
fn scenes() -> impl Iterator<Item = (&'static str, Change, Option<Moment>)> {
    let unchanged: Change = |_| {};
    let scenes = SCENES.iter().map(|&(name, change)| (name, change, None));
    scenes.chain(MOMENTS.iter().map(move |&(name, moment)| (name, unchanged, Some(moment))))
}

/// The names of the scenes.
pub fn names() -> Vec<&'static str> {
    scenes().map(|(name, ..)| name).collect()
}

/// Plays the scenes whose names contain one of `filters`, or all. Each score is passed on when it is
/// complete, as long as there is a reader.
pub fn play(
    config: &Config,
    filters: &[String],
    frames: usize,
    mut done: impl FnMut(SceneScore) -> Result<Reader, CommandError>,
) -> Result<(), CommandError> {
    let is_wanted = |name: &str| {
        filters.is_empty() || filters.iter().any(|filter| name.contains(filter.as_str()))
    };
    let mut scenes = scenes().filter(|(name, ..)| is_wanted(name)).peekable();
    if scenes.peek().is_none() {
        return Err(format!("no such scene; there are {}", names().join(", ")).into());
    }
    for (scene, change, moment) in scenes {
        if done(play_scene(config, scene, change, moment, frames)?)? == Reader::Gone {
            break;
        }
    }
    Ok(())
}

fn play_scene(
    config: &Config,
    scene: &'static str,
    change: Change,
    moment: Option<Moment>,
    frames: usize,
) -> Result<SceneScore, CommandError> {
    let mut config = config.clone();
    change(&mut config);
    let width = config.camera.width as usize;
    let mut pixels = vec![0; width * config.camera.height as usize];
    follow_painted_light(&mut config);
    let mut game = SyntheticMatch::new(&config)?;
    let mut chain = Chain::new(&taught(&config))?;
    let mut scorer = Scorer::default();
    for _ in 0..frames {
        for _ in 0..STRIDE {
            game.advance();
        }
        if let Some(is_it) = moment {
            let mut patience = PATIENCE;
            while !is_it(&config, game.truth()) {
                game.advance();
                patience -= 1;
                if patience == 0 {
                    return Err(format!("the match of scene {scene} has no such moment").into());
                }
            }
        }
        game.render(&mut pixels, width);
        let seen = chain.look_at(&pixels)?;
        let robots: Vec<ReportedRobot> = seen
            .robots()
            .iter()
            .filter_map(|robot| {
                Some(ReportedRobot {
                    team: robot.team,
                    robot_id: robot.robot_id.number()?,
                    x_mm: robot.x_mm.into(),
                    y_mm: robot.y_mm.into(),
                    orientation: robot.orientation.into(),
                })
            })
            .collect();
        let ball = seen.balls().first().map(|ball| [ball.x_mm.into(), ball.y_mm.into()]);
        let mut truth = *game.truth();
        // A moment decides itself how much of the ball must be visible.
        truth.ball_visible |= u32::from(moment.is_some());
        scorer.score(&truth, &robots, ball);
    }
    let errors = scorer.errors().ok_or("there is no robot in the synthetic match")?;
    Ok(SceneScore {
        scene,
        frames,
        found_ratio: errors.found_ratio,
        wrong_identity: errors.wrong_identity,
        position_rms_mm: errors.position_rms_mm,
        heading_rms_deg: errors.heading_rms_deg,
        ball_found_ratio: errors.ball_found_ratio,
        ball_rms_mm: errors.ball_rms_mm,
    })
}

/// Lowest brightness, relative to that for which the colours were made, down to which changes of the
/// light are followed.
const DIMMEST: f64 = 0.4;

/// The configuration, with colours learned in the match's light if that light is too dim to be followed
/// from the preset's.
fn taught(config: &Config) -> Config {
    let mut config = config.clone();
    let brightness = config.synthetic.brightness;
    if brightness >= DIMMEST {
        return config;
    }
    for color in &mut config.colors {
        for [low, high] in [&mut color.red, &mut color.green, &mut color.blue] {
            *low = (f64::from(*low) * brightness).floor() as u8;
            *high = (f64::from(*high) * brightness).ceil() as u8;
        }
        color.looks = color.looks.map(|value| (f64::from(value) * brightness).round() as u8);
    }
    let pitch = &mut config.light.pitch_rgb;
    *pitch = pitch.map(|rgb| rgb.map(|value| value * brightness));
    config
}

impl SceneScore {
    /// The score as a line of text; [`HEADING`] is printed above.
    pub fn text(&self) -> String {
        format!(
            "{:<14} {:>6.2} % {:>6} {:>9.2} mm {:>7.2}° {:>8.1} % {:>8.2} mm\n",
            self.scene,
            100.0 * self.found_ratio,
            self.wrong_identity,
            self.position_rms_mm,
            self.heading_rms_deg,
            100.0 * self.ball_found_ratio,
            self.ball_rms_mm
        )
    }
}

/// Headings of the columns of [`SceneScore::text`].
pub const HEADING: &str =
    "scene             found  wrong     error (rms)        ball found  error (rms)\n";
