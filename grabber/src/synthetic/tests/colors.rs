//! The preset's colours on the synthetic pitch: each is found, with few false pixels.

use super::*;
use config::{ColorConfig, PatchRole, Preset};
use geometry::layout::topmost_patch;
use geometry::{CameraModel, FieldPoint, ImagePoint, Pose};

/// The first colour whose box contains a value.
fn class_of(colors: &[ColorConfig], rgb: [f64; 3]) -> Option<usize> {
    let within =
        |value: f64, [low, high]: [u8; 2]| f64::from(low) <= value && value <= f64::from(high);
    colors.iter().position(|color| {
        within(rgb[0], color.red) && within(rgb[1], color.green) && within(rgb[2], color.blue)
    })
}

/// True content of a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Content {
    /// No colour here or nearby.
    Nothing,
    /// Near a patch or the ball.
    Edge,
    /// Well inside a patch or the ball of this colour.
    Color(usize),
}

fn truth_map(config: &Config, scene: &SyntheticMatch) -> Vec<Content> {
    let camera = &config.camera;
    let model = CameraModel::new(&config.geometry, camera.width, camera.height).unwrap();
    let index_of = |name: &str| config.colors.iter().position(|color| color.name == name).unwrap();
    let (width, height) = (camera.width as usize, camera.height as usize);
    let mut map = vec![Content::Nothing; width * height];
    let mut mark = |center: ImagePoint, radius: i64, look: &dyn Fn(ImagePoint) -> Option<usize>| {
        let (cx, cy) = (center.x_px.round() as i64, center.y_px.round() as i64);
        for y in (cy - radius).max(0)..(cy + radius).min(height as i64) {
            for x in (cx - radius).max(0)..(cx + radius).min(width as i64) {
                // A pixel is inside if all points within 1.25 pixels are alike, and outside if there is no
                // colour within 2 pixels.
                let around = |reach: f64| {
                    (0..16).map(move |step| {
                        let angle = f64::from(step) * std::f64::consts::TAU / 16.0;
                        ImagePoint::new(
                            x as f64 + reach * angle.cos(),
                            y as f64 + reach * angle.sin(),
                        )
                    })
                };
                let here = look(ImagePoint::new(x as f64, y as f64));
                let cell = &mut map[y as usize * width + x as usize];
                match here {
                    Some(color) if around(1.25).all(|point| look(point) == here) => {
                        *cell = Content::Color(color);
                    }
                    Some(_) => *cell = Content::Edge,
                    None if around(2.0).any(|point| look(point).is_some()) => *cell = Content::Edge,
                    None => {}
                }
            }
        }
    };
    let truth = scene.truth();
    let ball = FieldPoint::new(truth.ball_x_mm, truth.ball_y_mm);
    let radius = config.ball.diameter_mm / 2.0;
    let ball_color = index_of(&config.ball.color);
    mark(model.image_from_field(ball, radius), 12, &|point| {
        (model.field_from_image(point, radius).distance(ball) < radius).then_some(ball_color)
    });
    for robot in truth.robots() {
        let identity = config
            .robots
            .identities
            .iter()
            .find(|identity| identity.team as u32 == robot.team && identity.id == robot.robot_id)
            .unwrap();
        let mut names = identity.colors.iter();
        let colors: Vec<usize> = config
            .robots
            .patches
            .iter()
            .map(|patch| match patch.role {
                PatchRole::Team => index_of(config.teams.color(identity.team)),
                PatchRole::Identification => index_of(names.next().unwrap()),
            })
            .collect();
        let pose = Pose {
            position: FieldPoint::new(robot.x_mm, robot.y_mm),
            orientation: robot.orientation,
        };
        let (sin, cos) = pose.orientation.sin_cos();
        mark(model.image_from_field(pose.position, config.robots.height_mm), 24, &|point| {
            let seen = model.field_from_image(point, config.robots.height_mm);
            let (dx, dy) = (seen.x_mm - robot.x_mm, seen.y_mm - robot.y_mm);
            topmost_patch(&config.robots, [dx * cos + dy * sin, dy * cos - dx * sin])
                .map(|patch| colors[patch])
        });
    }
    map
}

/// Size of the largest 4-connected set of pixels of the same class for which `wrong` holds.
fn largest_cluster(classes: &[Option<usize>], wrong: &[bool], width: usize) -> usize {
    let mut seen = vec![false; classes.len()];
    let mut largest = 0;
    for start in 0..classes.len() {
        if seen[start] || !wrong[start] {
            continue;
        }
        let (mut stack, mut size) = (vec![start], 0);
        seen[start] = true;
        while let Some(index) = stack.pop() {
            size += 1;
            let column = index % width;
            let neighbours = [
                (column > 0).then(|| index - 1),
                (column + 1 < width).then_some(index + 1),
                index.checked_sub(width),
                Some(index + width).filter(|&index| index < classes.len()),
            ];
            for next in neighbours.into_iter().flatten() {
                if !seen[next] && wrong[next] && classes[next] == classes[start] {
                    seen[next] = true;
                    stack.push(next);
                }
            }
        }
        largest = largest.max(size);
    }
    largest
}

/// Separation of the colours by their boxes in a match.
#[derive(Debug, Default)]
struct Tally {
    /// For each true colour: pixels well inside it, and those of them that were classified correctly.
    inside: Vec<[u32; 2]>,
    /// Pixels classified as a colour that is nowhere near.
    wrong: usize,
    /// Size of the largest connected set of these.
    largest: usize,
}

/// Simulates a match and compares every pixel's class with the truth.
fn tally(config: &Config, frames: u64) -> Tally {
    let (width, height) = (config.camera.width as usize, config.camera.height as usize);
    let mut tally = Tally { inside: vec![[0; 2]; config.colors.len()], ..Tally::default() };
    let mut scene = SyntheticMatch::new(config).unwrap();
    for _ in 0..frames {
        for _ in 0..50 {
            scene.advance();
        }
        let raw = render(&mut scene, config);
        let picture = demosaic(&raw, width, height, config.camera.bayer_order);
        let truth = truth_map(config, &scene);
        let classes: Vec<_> =
            picture.pixels.iter().map(|&rgb| class_of(&config.colors, rgb)).collect();
        let mut wrong = vec![false; classes.len()];
        for (index, (shows, &class)) in truth.iter().zip(&classes).enumerate() {
            if let Content::Color(color) = *shows {
                tally.inside[color][0] += 1;
                tally.inside[color][1] += u32::from(class == Some(color));
            }
            if let Some(class) = class {
                let (x, y) = (index % width, index / width);
                let near = (y.saturating_sub(4)..(y + 5).min(height)).any(|row| {
                    (x.saturating_sub(4)..(x + 5).min(width))
                        .any(|column| truth[row * width + column] == Content::Color(class))
                });
                wrong[index] = !near;
            }
        }
        tally.wrong += wrong.iter().filter(|&&wrong| wrong).count();
        tally.largest = tally.largest.max(largest_cluster(&classes, &wrong, width));
    }
    tally
}

#[test]
fn every_color_is_found_with_few_false_pixels() {
    let bright = |brightness| {
        let mut config = Config::default();
        config.synthetic.brightness = brightness;
        config
    };
    for (name, config, frames) in [
        ("standard", Config::default(), 12),
        ("dark", bright(0.85), 6),
        ("bright", bright(1.1), 6),
        ("large", Preset::MirosotLarge.config(), 3),
        ("small", Preset::Vsss3v3.config(), 6),
    ] {
        let tally = tally(&config, frames);
        for (color, &[inside, found]) in config.colors.iter().zip(&tally.inside) {
            // Some colours do not occur in every preset.
            let found_ratio = f64::from(found) / f64::from(inside.max(1));
            assert!(inside == 0 || found_ratio > 0.99, "{name}: {} {found_ratio}", color.name);
        }
        let seen: u32 = tally.inside.iter().map(|[inside, _]| inside).sum();
        assert!(seen > 500 * frames as u32, "{name}: only {seen} coloured pixels");
        // Blobs of up to seven pixels are noise to the tracker (`tracker.min_region_px`).
        assert!(tally.largest < 6, "{name}: {} pixels in a wrong place", tally.largest);
        let robots = config.robots.identities.len() * frames as usize;
        assert!(tally.wrong < 4 * robots, "{name}: {} pixels in wrong places", tally.wrong);
    }
}

#[test]
fn no_shade_of_a_color_falls_into_the_box_of_another() {
    let config = Config::default();
    for color in &config.colors {
        for percent in 0..=115 {
            let shade =
                color.looks.map(|value| (f64::from(value) * f64::from(percent) / 100.0).min(255.0));
            // Pure, and mixed with the robot's body colour.
            for black in [0.0, 26.0] {
                let rest = (1.0 - f64::from(percent) / 100.0).max(0.0) * black;
                let class = class_of(&config.colors, shade.map(|value| value + rest));
                let name = class.map(|class| config.colors[class].name.as_str());
                assert!(
                    name.is_none_or(|name| name == color.name),
                    "{percent} % of {} is {name:?}",
                    color.name
                );
                if percent >= 66 {
                    assert_eq!(name, Some(color.name.as_str()), "{percent} %");
                }
            }
        }
    }
    for grey in 0..=255 {
        assert_eq!(class_of(&config.colors, [f64::from(grey); 3]), None);
    }
}
