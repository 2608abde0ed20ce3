//! Rendered objects lie where truth and camera model say.

use super::super::render::BODY_COLOR;
use super::*;
use config::{PatchRole, Preset};
use geometry::layout::Layout;
use geometry::{CameraModel, FieldPoint, ImagePoint, Pose};
use messages::{Team, TruthRobot};

/// All colours except the named ones are those of a robot's body.
fn only(config: &Config, names: &[&str]) -> Config {
    let mut config = config.clone();
    for color in &mut config.colors {
        if !names.contains(&color.name.as_str()) {
            color.looks = BODY_COLOR;
        }
    }
    config.synthetic.noise = 0.0;
    config.synthetic.vignette = 0.0;
    config
}

/// Centroid of the difference between two pictures around a place, and its weight.
fn centroid(a: &Picture, b: &Picture, around: ImagePoint, radius: f64) -> (ImagePoint, f64) {
    let (mut sum, mut x_sum, mut y_sum) = (0.0, 0.0, 0.0);
    let span = |center: f64, limit: usize| {
        (center - radius).max(0.0) as usize..((center + radius) as usize + 1).min(limit)
    };
    for row in span(around.y_px, a.height) {
        for column in span(around.x_px, a.width) {
            let (a, b) = (a.at(column, row), b.at(column, row));
            let weight: f64 = (0..3).map(|channel| a[channel] - b[channel]).sum();
            sum += weight;
            x_sum += weight * column as f64;
            y_sum += weight * row as f64;
        }
    }
    (ImagePoint::new(x_sum / sum, y_sum / sum), sum)
}

fn pose_of(robot: &TruthRobot) -> Pose {
    Pose { position: FieldPoint::new(robot.x_mm, robot.y_mm), orientation: robot.orientation }
}

fn off(a: ImagePoint, b: ImagePoint) -> f64 {
    (a.x_px - b.x_px).hypot(a.y_px - b.y_px)
}

/// Largest distance, in pixels, between the teams' rendered patches and their true positions: for standing
/// and for moving robots.
fn worst_patch_error(config: &Config, frames: &[u64]) -> [f64; 2] {
    let model =
        CameraModel::new(&config.geometry, config.camera.width, config.camera.height).unwrap();
    let layout = Layout::new(&config.robots);
    let team = layout.patches.iter().find(|patch| patch.role == PatchRole::Team).unwrap();
    let (with, without) = (only(config, &["yellow", "blue"]), only(config, &[]));
    let (mut worst, mut checked) = ([0.0f64; 2], [0; 2]);
    for &frame in frames {
        let (with, without) = (full_color(&with, frame), full_color(&without, frame));
        let scene = scene_at(config, frame);
        let robots = scene.truth().robots();
        for robot in robots {
            let pose = pose_of(robot);
            let alone = robots.iter().all(|other| {
                let distance = pose_of(other).position.distance(pose.position);
                distance == 0.0 || distance > 160.0
            });
            if !alone {
                continue;
            }
            let place = pose.field_from_robot(team.centroid_mm);
            let expected = model.image_from_field(place, config.robots.height_mm);
            let reach = 70.0 / model.pixel_area_mm2(expected, 0.0).sqrt();
            let (seen, _) = centroid(&with, &without, expected, reach);
            let moves = usize::from(robot.v_mm_s != 0.0 || robot.omega != 0.0);
            worst[moves] = worst[moves].max(off(seen, expected));
            checked[moves] += 1;
        }
    }
    assert!(checked.iter().all(|&count| count > 3), "too few robots stand free: {checked:?}");
    worst
}

#[test]
fn patches_are_painted_where_the_truth_says() {
    for preset in [Preset::Mirosot5v5, Preset::Vsss3v3] {
        let worst = worst_patch_error(&preset.config(), &[40, 90, 300, 500]);
        assert!(worst.iter().all(|&worst| worst < 0.02), "{}: {worst:?} px", preset.name());
    }
}

#[test]
fn long_exposures_blur_evenly_around_the_truth() {
    let mut config = Config::default();
    // Up to five pixels of blur.
    config.camera.exposure_us = 12_000;
    let [standing, moving] = worst_patch_error(&config, &[40, 90, 300, 500]);
    // A patch on a turning robot is blurred along an arc, whose centroid is not on the arc.
    assert!(standing < 0.02 && moving < 0.08, "{standing} {moving} px");
}

/// Middle of a ball's outline in the picture. Rays that touch the sphere form a cone around the ray through
/// its centre: its nearest and farthest rays from the point below the lens have the same angle to that ray,
/// but not the same distance on the plane.
fn middle_of_outline(config: &Config, model: &CameraModel, ball: FieldPoint) -> ImagePoint {
    let radius = config.ball.diameter_mm / 2.0;
    let [lens_x, lens_y, lens_z] = config.geometry.camera_mm;
    let (dx, dy) = (ball.x_mm - lens_x, ball.y_mm - lens_y);
    let (across, up) = (dx.hypot(dy), lens_z - radius);
    let (angle, half) = (across.atan2(up), (radius / across.hypot(up)).asin());
    let middle = up * ((angle + half).tan() + (angle - half).tan()) / 2.0;
    let place = FieldPoint::new(lens_x + dx * middle / across, lens_y + dy * middle / across);
    model.image_from_field(place, radius)
}

#[test]
fn the_ball_is_painted_where_the_truth_says() {
    let config = Config::default();
    let model =
        CameraModel::new(&config.geometry, config.camera.width, config.camera.height).unwrap();
    let (with, without) = (only(&config, &["orange"]), only(&config, &[]));
    let mut checked = 0;
    for frame in [0, 30, 100, 400] {
        let scene = scene_at(&config, frame);
        let truth = scene.truth();
        if truth.ball_visible == 0 {
            continue;
        }
        let ball = FieldPoint::new(truth.ball_x_mm, truth.ball_y_mm);
        let expected = middle_of_outline(&config, &model, ball);
        let (with, without) = (full_color(&with, frame), full_color(&without, frame));
        let (seen, _) = centroid(&with, &without, expected, 12.0);
        assert!(off(seen, expected) < 0.02, "frame {frame}: {seen:?} for {expected:?}");
        checked += 1;
    }
    assert!(checked >= 3, "the ball was hidden too often");
}

#[test]
fn a_patch_is_rendered_with_its_whole_area() {
    let config = Config::default();
    let model =
        CameraModel::new(&config.geometry, config.camera.width, config.camera.height).unwrap();
    let (with, without) = (only(&config, &["yellow"]), only(&config, &[]));
    let scene = scene_at(&config, 40);
    let (with, without) = (full_color(&with, 40), full_color(&without, 40));
    let yellow = config.colors.iter().find(|color| color.name == "yellow").unwrap();
    let contrast: f64 = (0..3)
        .map(|channel| f64::from(yellow.looks[channel]) - f64::from(BODY_COLOR[channel]))
        .sum();
    let robots = scene.truth().robots();
    let mut checked = 0;
    for robot in robots.iter().filter(|robot| robot.team == Team::Yellow as u32) {
        let place = pose_of(robot).field_from_robot([18.0, 18.0]);
        let alone = robots.iter().all(|other| {
            let distance = pose_of(other).position.distance(pose_of(robot).position);
            distance == 0.0 || distance > 160.0
        });
        if !alone {
            continue;
        }
        let expected = model.image_from_field(place, config.robots.height_mm);
        let (_, weight) = centroid(&with, &without, expected, 16.0);
        let area_mm2 = weight / contrast * model.pixel_area_mm2(expected, config.robots.height_mm);
        assert!((area_mm2 / (34.0 * 34.0) - 1.0).abs() < 0.02, "{area_mm2} mm²");
        checked += 1;
    }
    assert!(checked > 1);
}
