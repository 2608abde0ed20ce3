//! Learning from pictures painted by the tests: nothing here comes from the synthetic match, for whose
//! colours and light the presets are made.

use super::lessons::{Lesson, Lessons};
use super::*;
use crate::chain::Chain;
use crate::learning::labels::{BallLabel, Quality, RobotLabel};
use crate::learning::scene::Scene;
use config::{PatchRole, Preset};
use geometry::layout::Outlines;
use geometry::{CameraModel, FieldPoint, ImagePoint, Pose};
use messages::Team;
use std::path::PathBuf;

type Rgb = [f64; 3];

/// A pitch and the light on it.
#[derive(Clone)]
struct Painter {
    config: Config,
    /// Paint of each colour that is used.
    paints: Vec<(&'static str, Rgb)>,
    floor: Rgb,
    body: Rgb,
    /// Brightness of each channel.
    lamp: Rgb,
    /// Share by which the right side is darker than the left.
    gradient: f64,
    /// Grey levels of white light added to a part of the pitch.
    glare: f64,
    noise: f64,
}

const PAINTS: [(&str, Rgb); 10] = [
    ("orange", [235.0, 90.0, 20.0]),
    ("yellow", [225.0, 200.0, 30.0]),
    ("blue", [25.0, 70.0, 205.0]),
    ("red", [200.0, 25.0, 35.0]),
    ("green", [30.0, 165.0, 60.0]),
    ("violet", [120.0, 40.0, 190.0]),
    ("pink", [235.0, 110.0, 180.0]),
    ("white", [235.0, 235.0, 235.0]),
    ("grey", [120.0, 120.0, 120.0]),
    ("cyan", [40.0, 190.0, 215.0]),
];

/// A configuration with only the approximate appearance of each colour. Both teams have the same colours
/// for the same numbers.
fn config(preset: Preset, identities: &[&[&str]], more: &str) -> Config {
    let mut names = vec!["orange", "yellow", "blue"];
    let mut robots = String::new();
    for team in ["yellow", "blue"] {
        for (id, colors) in identities.iter().enumerate() {
            robots += &format!("{{ team = {team:?}, id = {id}, colors = {colors:?} }},\n");
            names.extend(colors.iter().filter(|name| !names.contains(name)).collect::<Vec<_>>());
        }
    }
    names.sort();
    names.dedup();
    let mut text = format!(
        "preset = {:?}\n[camera]\nwidth = 480\nheight = 400\n[robots]\nidentities = [\n{robots}]\n{more}\n",
        preset.name()
    );
    for name in names {
        let (_, paint) = PAINTS.iter().find(|(known, _)| *known == name).unwrap();
        let looks = paint.map(|value| ((value / 25.0).round() * 25.0).min(255.0) as u8);
        text += &format!("[[colors]]\nname = {name:?}\nlooks = {looks:?}\n");
    }
    Config::parse(&text, "match.toml").unwrap_or_else(|error| panic!("{error}"))
}

impl Painter {
    fn new(config: &Config) -> Self {
        Self {
            config: config.clone(),
            paints: PAINTS.to_vec(),
            floor: [45.0, 47.0, 42.0],
            body: [28.0; 3],
            lamp: [1.0; 3],
            gradient: 0.0,
            glare: 0.0,
            noise: 2.0,
        }
    }

    fn paint_of(&self, name: &str) -> Rgb {
        self.paints.iter().find(|(known, _)| *known == name).unwrap().1
    }

    /// A picture of all robots and a ball, with its labels.
    fn picture(&self, seed: u32) -> (Lesson, ImageLabels) {
        let camera = &self.config.camera;
        let (width, height) = (camera.width as usize, camera.height as usize);
        let model = CameraModel::new(&self.config.geometry, camera.width, camera.height).unwrap();
        let mut random = Random(seed.wrapping_mul(2_654_435_761).wrapping_add(12345));
        let mut rgb = vec![self.floor; width * height];
        // Robots and ball each have their own cell of the pitch.
        let robots = &self.config.robots;
        let (columns, rows) = (5, 3);
        let mut cells: Vec<usize> = (0..columns * rows).collect();
        for last in (1..cells.len()).rev() {
            cells.swap(last, random.below(last as u32 + 1) as usize);
        }
        let field = &self.config.field;
        let mut place = || {
            let cell = cells.pop().expect("there are more cells than robots");
            let at = |index: usize, count: usize, size: f64, shift: f64| {
                ((index as f64 + 0.5) / count as f64 - 0.5) * 0.86 * size + shift
            };
            let mut shift = || (f64::from(random.below(1000)) / 1000.0 - 0.5) * 150.0;
            let (dx, dy) = (shift(), shift());
            let turn = f64::from(random.below(6283)) / 1000.0;
            let place = FieldPoint::new(
                at(cell % columns, columns, field.length_mm, dx),
                at(cell / columns, rows, field.width_mm, dy),
            );
            (place, turn)
        };
        let outlines = Outlines::new(&robots.patches);
        let body = robots.body(&robots.patches);
        let mut labels = Vec::new();
        for identity in &robots.identities {
            let (position, orientation) = place();
            let pose = Pose { position, orientation };
            let mut names = identity.colors.iter();
            let paints: Vec<Rgb> = robots
                .patches
                .iter()
                .map(|patch| match patch.role {
                    PatchRole::Team => self.config.teams.color(identity.team),
                    PatchRole::Identification => names.next().unwrap(),
                })
                .map(|name| self.paint_of(name))
                .collect();
            let top = |point: ImagePoint| {
                let place = model.field_from_image(point, robots.height_mm);
                let (dx, dy) = (place.x_mm - position.x_mm, place.y_mm - position.y_mm);
                let turned = |angle: f64| {
                    let (sin, cos) = angle.sin_cos();
                    [cos * dx + sin * dy, cos * dy - sin * dx]
                };
                let is_body = body.depth_mm(turned(orientation)) >= 0.0;
                let patch = outlines.topmost(turned(orientation));
                patch.map(|patch| paints[patch]).or(is_body.then_some(self.body))
            };
            let center = model.image_from_field(position, robots.height_mm);
            draw(&mut rgb, width, center, 24, top);
            let ahead = pose.field_from_robot([30.0, 0.0]);
            let ahead = model.image_from_field(ahead, robots.height_mm);
            let (dx, dy) = (ahead.x_px - center.x_px, center.y_px - ahead.y_px);
            labels.push(RobotLabel {
                team: identity.team,
                id: identity.id,
                x_px: center.x_px,
                y_px: center.y_px,
                heading_deg: dy.atan2(dx).to_degrees(),
                quality: Quality::Clear,
            });
        }
        let (position, _) = place();
        let radius_mm = self.config.ball.diameter_mm / 2.0;
        let center = model.image_from_field(position, radius_mm);
        let orange = self.paint_of("orange");
        draw(&mut rgb, width, center, 12, |point| {
            let distance = model.field_from_image(point, radius_mm).distance(position);
            (distance <= radius_mm).then_some(orange)
        });
        let bayer = rgb.iter().enumerate().map(|(index, rgb)| {
            let (x, y) = (index % width, index / width);
            let channel = camera.bayer_order.channel_at(x, y);
            let across = x as f64 / width as f64;
            let (dx, dy) = (across - 0.65, y as f64 / height as f64 - 0.4);
            let glare = self.glare * (-(dx * dx + dy * dy) / 0.04).exp();
            let light = self.lamp[channel] * (1.0 - self.gradient * across);
            let noise = self.noise * random.bell();
            (rgb[channel] * light + glare + noise).round().clamp(0.0, 255.0) as u8
        });
        let file = PathBuf::from(format!("{seed}.png"));
        let lesson = Lesson::new(&self.config, file.clone(), bayer.collect()).unwrap();
        let ball = BallLabel { x_px: center.x_px, y_px: center.y_px, quality: Quality::Clear };
        let labels =
            ImageLabels { file, robots: Some(labels), ball: Some(Some(ball)), samples: Vec::new() };
        (lesson, labels)
    }
}

/// Paints the pixels around a point by `color`, each as the mean of nine points.
fn draw(
    rgb: &mut [Rgb],
    width: usize,
    center: ImagePoint,
    reach: i64,
    color: impl Fn(ImagePoint) -> Option<Rgb>,
) {
    let around = |middle: f64, size: usize| {
        let middle = middle.round() as i64;
        (middle - reach).max(0)..(middle + reach + 1).min(size as i64)
    };
    for row in around(center.y_px, rgb.len() / width) {
        for column in around(center.x_px, width) {
            let pixel = &mut rgb[row as usize * width + column as usize];
            let mut sum = [0.0; 3];
            for index in 0..9 {
                let [dx, dy] = [index % 3, index / 3].map(|third| f64::from(third - 1) / 3.0);
                let point = ImagePoint::new(column as f64 + dx, row as f64 + dy);
                let color = color(point).unwrap_or(*pixel);
                sum.iter_mut().zip(color).for_each(|(sum, value)| *sum += value / 9.0);
            }
            *pixel = sum;
        }
    }
}

struct Random(u32);

impl Random {
    fn below(&mut self, count: u32) -> u32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((u64::from(self.0) * u64::from(count)) >> 32) as u32
    }

    /// Approximately a normal distribution of standard deviation 1.
    fn bell(&mut self) -> f64 {
        (0..12).map(|_| f64::from(self.below(65536)) / 65536.0).sum::<f64>() - 6.0
    }
}

fn painted(painters: &[Painter]) -> (Lessons, Vec<ImageLabels>) {
    let scene = Scene::new(&painters[0].config).unwrap();
    let pictures = painters.iter().zip(1..).map(|(painter, seed)| painter.picture(seed));
    let (list, labels) = pictures.unzip();
    (Lessons { scene, list }, labels)
}

/// Number of robots found with the right identity within 3 px and 6°, and number of all robots.
fn right(config: &Config, lessons: &Lessons, labels: &[ImageLabels]) -> [usize; 2] {
    let mut chain = Chain::new(config).unwrap();
    let (mut right, mut all) = (0, 0);
    for (lesson, labels) in lessons.list.iter().zip(labels) {
        let seen = chain.look_at(&lesson.bayer).unwrap();
        for label in labels.robots.iter().flatten() {
            all += 1;
            right += usize::from(seen.robots().iter().any(|robot| {
                let degrees = f64::from(robot.orientation_image).to_degrees() - label.heading_deg;
                let (dx, dy) =
                    (f64::from(robot.x_px) - label.x_px, f64::from(robot.y_px) - label.y_px);
                Team::from_number(robot.team) == Some(label.team)
                    && robot.robot_id.number() == Some(label.id)
                    && dx.hypot(dy) < 3.0
                    && ((degrees + 180.0).rem_euclid(360.0) - 180.0).abs() < 6.0
            }));
        }
    }
    [right, all]
}

/// Learns both ways; all robots must be right, and `--auto` no worse than its start.
fn assert_learned(painters: &[Painter]) -> Config {
    let configured = &painters[0].config;
    let (lessons, labels) = painted(painters);
    let taught = from_labels(configured, &lessons, &labels, false).unwrap();
    let [found, all] = right(&taught, &lessons, &labels);
    assert_eq!(found, all, "with labels");
    let (taught, found) = without_labels(configured, &lessons, false).unwrap();
    assert_eq!(found.len(), lessons.list.len());
    let [found, all] = right(&taught, &lessons, &labels);
    assert_eq!(found, all, "without labels: {:?}", taught.colors);
    taught
}

const FIVE: [&[&str]; 5] = [&["green"], &["cyan"], &["pink"], &["violet"], &["red"]];
const THREE: [&[&str]; 3] = [&["red", "green"], &["green", "violet"], &["violet", "red"]];

#[test]
fn vivid_paint_with_a_channel_at_zero_is_learned() {
    let config = config(Preset::Mirosot5v5, &[&["red"], &["green"], &["violet"]], "");
    let mut painter = Painter::new(&config);
    painter.paints = vec![
        ("orange", [255.0, 100.0, 0.0]),
        ("yellow", [255.0, 220.0, 0.0]),
        ("blue", [0.0, 0.0, 220.0]),
        ("red", [220.0, 0.0, 0.0]),
        ("green", [0.0, 190.0, 0.0]),
        ("violet", [210.0, 0.0, 200.0]),
    ];
    assert_learned(&[painter.clone(), painter]);
}

#[test]
fn a_floor_of_the_colour_of_a_patch_is_left_out_and_costs_little() {
    for floor in [[30.0, 75.0, 35.0], [35.0, 110.0, 55.0], [35.0, 60.0, 115.0]] {
        let config = config(Preset::Mirosot5v5, &FIVE, "");
        let painter = Painter { floor, ..Painter::new(&config) };
        let painters = [painter.clone(), painter.clone(), painter];
        let taught = assert_learned(&painters);
        let mut passing = passing::Passing::none(&taught).unwrap();
        let (lessons, _) = painted(&painters);
        for picture in &lessons.under_light(&taught).unwrap() {
            passing.add(picture, &lessons.scene.is_on_pitch);
        }
        assert!(passing.share() < 0.08, "{floor:?}: {}", passing.text("the pitch"));
    }
}

#[test]
fn white_and_grey_are_distinguished_by_brightness_under_changing_light() {
    let identities: [&[&str]; 4] = [&["white"], &["grey"], &["green"], &["pink"]];
    let config = config(Preset::Mirosot5v5, &identities, "");
    let painter = Painter { floor: [45.0, 58.0, 46.0], ..Painter::new(&config) };
    let under = |lamp: Rgb, gradient: f64| Painter { lamp, gradient, ..painter.clone() };
    assert_learned(&[
        under([1.0; 3], 0.0),
        under([0.75, 0.72, 0.6], 0.2),
        under([1.05, 1.0, 0.8], 0.3),
    ]);
}

#[test]
fn three_robots_a_team_under_glare_are_learned() {
    let config = config(Preset::MirosotTriangles, &THREE, "");
    let painter = Painter { glare: 80.0, gradient: 0.2, ..Painter::new(&config) };
    assert_learned(&[painter.clone(), painter.clone(), painter.clone(), painter]);
}

#[test]
fn robots_without_a_number_are_no_labels() {
    let config = config(Preset::Mirosot5v5, &FIVE, "");
    let painter = Painter::new(&config);
    let (lessons, labels) = painted(&[painter.clone(), painter]);
    let mut configured = config.clone();
    configured.robots.report_unknown = true;
    configured.robots.identities.retain(|identity| identity.team == Team::Yellow);
    let (taught, _) = without_labels(&configured, &lessons, false).unwrap();
    let mut own = labels.clone();
    for labels in &mut own {
        labels.robots.as_mut().unwrap().retain(|robot| robot.team == Team::Yellow);
    }
    let [found, all] = right(&taught, &lessons, &own);
    assert_eq!((found, all), (10, 10));
}

#[test]
fn colours_without_labels_stay_as_configured() {
    let config = config(Preset::Mirosot5v5, &FIVE, "");
    let painter = Painter::new(&config);
    let (lessons, mut labels) = painted(&[painter.clone(), painter]);
    for labels in &mut labels {
        labels.ball = None;
        labels.robots.as_mut().unwrap().retain(|robot| robot.team == Team::Yellow);
    }
    let taught = from_labels(&config, &lessons, &labels, false).unwrap();
    let color = |config: &Config, name: &str| {
        config.colors.iter().find(|color| color.name == name).cloned().unwrap()
    };
    for name in ["blue", "orange"] {
        assert_eq!(color(&taught, name), color(&config, name));
    }
    assert_ne!(color(&taught, "green"), color(&config, "green"));
    let nothing: Vec<ImageLabels> =
        labels.into_iter().map(|labels| ImageLabels { robots: None, ..labels }).collect();
    let error = from_labels(&config, &lessons, &nothing, false).unwrap_err().to_string();
    assert!(error.contains("nothing that is labelled"), "{error}");
}

#[test]
fn a_colour_that_takes_the_floor_is_warned_of() {
    let config = config(Preset::Mirosot5v5, &FIVE, "");
    let painter = Painter { floor: [30.0, 75.0, 35.0], ..Painter::new(&config) };
    let (lessons, labels) = painted(&[painter]);
    let mut open = config.clone();
    open.light.follow = false;
    let green = open.colors.iter_mut().find(|color| color.name == "green").unwrap();
    (green.red, green.green, green.blue) = ([0, 60], [50, 255], [0, 90]);
    let text = summary::text(&open, &lessons, &labels).unwrap();
    let warning = text.lines().find(|line| line.starts_with("warning: green takes"));
    let warning = warning.unwrap_or_else(|| panic!("{text}"));
    assert!(warning.contains("of the floor in 1.png") && warning.contains("% of the pitch"));
    let taught = from_labels(&config, &lessons, &labels, false).unwrap();
    let text = summary::text(&taught, &lessons, &labels).unwrap();
    assert!(!text.contains("takes"), "{text}");
}
