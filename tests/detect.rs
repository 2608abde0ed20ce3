//! `touchline detect` on rendered pictures: its results, and its errors for other files.

mod support;

use config::{CameraConfig, Config, commented_toml};
use geometry::layout::topmost_patch;
use geometry::{CameraModel, FieldPoint, ImagePoint, Pose, wrap_angle};
use grabber::mosaic::mosaic;
use image::codecs::jpeg::JpegEncoder;
use image::{GrayImage, ImageEncoder, RgbImage};
use messages::{BayerOrder, Team};
use serde_json::Value;
use std::path::Path;
use std::process::Output;
use std::sync::OnceLock;
use support::{Scratch, output_of};

/// A robot on the rendered pitch.
struct Robot {
    team: Team,
    id: u32,
    pose: Pose,
}

fn robot(team: Team, id: u32, x_mm: f64, y_mm: f64, degrees: f64) -> Robot {
    let position = FieldPoint::new(x_mm, y_mm);
    Robot { team, id, pose: Pose { position, orientation: degrees.to_radians() } }
}

fn robots() -> [Robot; 4] {
    [
        robot(Team::Yellow, 0, -600.0, 300.0, 0.0),
        robot(Team::Yellow, 4, 500.0, -700.0, 100.0),
        robot(Team::Blue, 1, 40.0, 20.0, -60.0),
        robot(Team::Blue, 3, 900.0, 500.0, 175.0),
    ]
}

const BALL: [f64; 2] = [-200.0, -300.0];
/// A yellow square without anything beside it.
const LONE_PATCH: [f64; 2] = [-700.0, -500.0];

/// The default pitch with robots, ball and a lone team patch.
fn painted() -> &'static RgbImage {
    static PICTURE: OnceLock<RgbImage> = OnceLock::new();
    PICTURE.get_or_init(|| paint(&Config::default()))
}

/// Each pixel is the mean of a grid of points.
fn paint(config: &Config) -> RgbImage {
    let camera = CameraModel::new(&config.geometry, config.camera.width, config.camera.height);
    let camera = camera.unwrap();
    let color = |name: &str| {
        let color = config.colors.iter().find(|color| color.name == name).unwrap();
        color.looks.map(f64::from)
    };
    let point_color = |point: ImagePoint| {
        let top = camera.field_from_image(point, config.robots.height_mm);
        for robot in robots() {
            let (sin, cos) = robot.pose.orientation.sin_cos();
            let (dx, dy) =
                (top.x_mm - robot.pose.position.x_mm, top.y_mm - robot.pose.position.y_mm);
            let Some(patch) =
                topmost_patch(&config.robots, [cos * dx + sin * dy, cos * dy - sin * dx])
            else {
                continue;
            };
            // The default layout: the team's patch, then one identification patch.
            let wears =
                |known: &&config::IdentityConfig| (known.team, known.id) == (robot.team, robot.id);
            return match patch {
                0 => color(config.teams.color(robot.team)),
                _ => color(&config.robots.identities.iter().find(wears).unwrap().colors[0]),
            };
        }
        if (top.x_mm - LONE_PATCH[0]).abs().max((top.y_mm - LONE_PATCH[1]).abs()) < 17.0 {
            return color(&config.teams.yellow.color);
        }
        let middle = camera.field_from_image(point, config.ball.diameter_mm / 2.0);
        if middle.distance(FieldPoint::new(BALL[0], BALL[1])) < config.ball.diameter_mm / 2.0 {
            return color(&config.ball.color);
        }
        [25.0, 28.0, 26.0]
    };
    const GRID: i32 = 4;
    RgbImage::from_fn(config.camera.width, config.camera.height, |column, row| {
        let mut sum = [0.0; 3];
        for index in 0..GRID * GRID {
            let offset = |step: i32| (f64::from(step) + 0.5) / f64::from(GRID) - 0.5;
            let x_px = f64::from(column) + offset(index % GRID);
            let y_px = f64::from(row) + offset(index / GRID);
            let color = point_color(ImagePoint::new(x_px, y_px));
            sum.iter_mut().zip(color).for_each(|(sum, value)| *sum += value);
        }
        image::Rgb(sum.map(|sum| (sum / f64::from(GRID * GRID)).round() as u8))
    })
}

/// The same picture as raw sensor data.
fn raw(picture: &RgbImage, camera: &CameraConfig) -> GrayImage {
    let mut frame = vec![0; (camera.width * camera.height) as usize];
    mosaic(picture.as_raw(), camera.width as usize, camera.bayer_order, &mut frame);
    GrayImage::from_raw(camera.width, camera.height, frame).unwrap()
}

fn detect(scratch: &Scratch, args: &[&str]) -> Output {
    output_of(scratch, &[&["detect"], args].concat())
}

fn lines(output: &Output) -> Vec<Value> {
    let text = std::str::from_utf8(&output.stdout).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn name(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn keys(object: &Value) -> Vec<&str> {
    let mut keys: Vec<&str> = object.as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}

#[test]
fn rendered_objects_are_found_and_documented_keys_give_their_positions() {
    let scratch = Scratch::new("detect-json");
    let config = Config::default();
    let picture = scratch.path.join("painted.png");
    painted().save(&picture).unwrap();
    let output = detect(&scratch, &["--json", name(&picture)]);
    assert!(output.status.success(), "{output:?}");
    let answers = lines(&output);
    let [answer] = &answers[..] else { panic!("{output:?}") };
    assert_eq!(keys(answer), ["ball", "image", "rejected", "robots"]);
    assert_eq!(answer["image"], name(&picture));

    let camera = CameraModel::new(&config.geometry, 640, 480).unwrap();
    let found = answer["robots"].as_array().unwrap();
    assert_eq!(found.len(), robots().len(), "{answer:#}");
    for (robot, found) in robots().iter().zip(found) {
        assert_eq!(
            keys(found),
            [
                "confidence",
                "heading_field_deg",
                "heading_image_deg",
                "id",
                "team",
                "x_mm",
                "x_px",
                "y_mm",
                "y_px"
            ]
        );
        assert_eq!(found["team"], robot.team.name(), "{answer:#}");
        assert_eq!(found["id"], robot.id, "{answer:#}");
        let of = |key: &str| found[key].as_f64().unwrap();
        let place = FieldPoint::new(of("x_mm"), of("y_mm"));
        // A pixel is 4 mm wide.
        assert!(place.distance(robot.pose.position) < 2.0, "{found:#}");
        let turned = of("heading_field_deg").to_radians() - robot.pose.orientation;
        assert!(wrap_angle(turned).to_degrees().abs() < 2.0, "{found:#}");
        let image = camera.image_from_field(robot.pose.position, config.robots.height_mm);
        assert!((of("x_px") - image.x_px).hypot(of("y_px") - image.y_px) < 0.5, "{found:#}");
        let ahead = robot.pose.field_from_robot([5.0, 0.0]);
        let ahead = camera.image_from_field(ahead, config.robots.height_mm);
        let heading = (image.y_px - ahead.y_px).atan2(ahead.x_px - image.x_px);
        let turned = of("heading_image_deg").to_radians() - heading;
        assert!(wrap_angle(turned).to_degrees().abs() < 2.0, "{found:#}");
        assert!((0.5..=1.0).contains(&of("confidence")), "{found:#}");
    }

    let ball = &answer["ball"];
    assert_eq!(keys(ball), ["x_mm", "x_px", "y_mm", "y_px"]);
    let place = FieldPoint::new(ball["x_mm"].as_f64().unwrap(), ball["y_mm"].as_f64().unwrap());
    assert!(place.distance(FieldPoint::new(BALL[0], BALL[1])) < 1.5, "{ball:#}");

    let rejected = answer["rejected"].as_array().unwrap();
    let [rejected] = &rejected[..] else { panic!("{answer:#}") };
    assert_eq!(keys(rejected), ["reason", "team", "x_px", "y_px"]);
    assert_eq!(rejected["team"], "yellow");
    assert_eq!(rejected["reason"], "no identification patch in range");
    let place = FieldPoint::new(LONE_PATCH[0], LONE_PATCH[1]);
    let image = camera.image_from_field(place, config.robots.height_mm);
    assert!((rejected["x_px"].as_f64().unwrap() - image.x_px).abs() < 0.5, "{rejected:#}");
    assert!((rejected["y_px"].as_f64().unwrap() - image.y_px).abs() < 0.5, "{rejected:#}");
}

#[test]
fn raw_bayer_is_taken_as_it_is_in_any_order() {
    let scratch = Scratch::new("detect-raw");
    for order in ["rggb", "grbg", "gbrg", "bggr"] {
        let text = format!("[camera]\nbayer_order = \"{order}\"\n");
        let file = scratch.write(&format!("{order}.toml"), &text);
        let config = Config::load(&file).unwrap();
        let (color, grey) = (scratch.path.join("color.png"), scratch.path.join("grey.png"));
        let picture = painted();
        picture.save(&color).unwrap();
        raw(picture, &config.camera).save(&grey).unwrap();
        let args = ["--json", "--config", name(&file), name(&color), name(&grey)];
        let output = detect(&scratch, &args);
        assert!(output.status.success(), "{output:?}");
        let mut answers = lines(&output);
        for answer in &mut answers {
            answer["image"].take();
        }
        let [from_color, from_grey] = &answers[..] else { panic!("{output:?}") };
        assert_eq!(from_color["robots"].as_array().unwrap().len(), robots().len(), "{order}");
        assert_eq!(from_color, from_grey, "{order}");
    }
}

/// With red and blue swapped, some robots change teams, and most vanish.
#[test]
fn a_wrong_bayer_order_is_suggested_to_be_another() {
    let scratch = Scratch::new("detect-order");
    let camera = CameraConfig { bayer_order: BayerOrder::Bggr, ..CameraConfig::default() };
    let picture = scratch.path.join("raw.png");
    raw(painted(), &camera).save(&picture).unwrap();
    let output = detect(&scratch, &[name(&picture)]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("with camera.bayer_order = \"bggr\" 4 of 10 would be"), "{said}");
    let file = scratch.write("bggr.toml", "[camera]\nbayer_order = \"bggr\"\n");
    let output = detect(&scratch, &["--config", name(&file), name(&picture)]);
    assert_eq!(String::from_utf8(output.stderr).unwrap(), "");
}

/// If its points are mirrored as well, a mirrored picture shows the same robots.
#[test]
fn a_mirrored_view_is_as_good_as_any() {
    let scratch = Scratch::new("detect-mirrored");
    let picture = scratch.path.join("mirrored.png");
    let mut mirrored = painted().clone();
    image::imageops::flip_horizontal_in_place(&mut mirrored);
    mirrored.save(&picture).unwrap();
    let mut config = Config::default();
    config.camera.mirrored = true;
    for pair in &mut config.geometry.points {
        pair.image_px[0] = 639.0 - pair.image_px[0];
    }
    let file = scratch.write("mirrored.toml", &commented_toml(&config));
    let output = detect(&scratch, &["--json", "--config", name(&file), name(&picture)]);
    assert_eq!(String::from_utf8(output.stderr.clone()).unwrap(), "");
    let found = lines(&output)[0]["robots"].as_array().unwrap().clone();
    assert_eq!(found.len(), robots().len(), "{output:?}");
    for (robot, found) in robots().iter().zip(&found) {
        let of = |key: &str| found[key].as_f64().unwrap();
        let place = FieldPoint::new(of("x_mm"), of("y_mm"));
        assert!(place.distance(robot.pose.position) < 2.0, "{found:#}");
        let turned = of("heading_field_deg").to_radians() - robot.pose.orientation;
        assert!(wrap_angle(turned).to_degrees().abs() < 2.0, "{found:#}");
    }
}

#[test]
fn a_grey_photograph_is_said_to_have_no_colour() {
    let scratch = Scratch::new("detect-grey");
    for (name_of_it, is_raw_like) in [("grey.png", true), ("grey.jpg", false)] {
        let picture = scratch.path.join(name_of_it);
        let grey = image::DynamicImage::from(painted().clone()).into_luma8();
        if is_raw_like {
            grey.save(&picture).unwrap();
        } else {
            image::DynamicImage::from(grey).into_rgb8().save(&picture).unwrap();
        }
        let output = detect(&scratch, &[name(&picture)]);
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(said.contains("no pixel has a colour"), "{name_of_it}: {said}");
    }
}

/// The picture as a JPEG, optionally stored upside down.
fn jpeg(picture: &RgbImage, is_upside_down: bool) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut bytes, 95);
    let mut stored = picture.clone();
    if is_upside_down {
        image::imageops::rotate180_in_place(&mut stored);
        // One entry: tag 0x0112, orientation, is 3.
        let exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x03\0\0\0\0\0\0\0";
        encoder.set_exif_metadata(exif.to_vec()).unwrap();
    }
    let (width, height) = stored.dimensions();
    encoder.write_image(&stored, width, height, image::ExtendedColorType::Rgb8).unwrap();
    bytes
}

#[test]
fn a_camera_held_upside_down_says_so_in_its_picture() {
    let scratch = Scratch::new("detect-exif");
    for is_upside_down in [false, true] {
        let path = scratch.path.join("robots.jpg");
        std::fs::write(&path, jpeg(painted(), is_upside_down)).unwrap();
        let output = detect(&scratch, &["--json", name(&path)]);
        let found = lines(&output)[0]["robots"].as_array().unwrap().clone();
        assert_eq!(found.len(), robots().len(), "{output:?}");
        for (robot, found) in robots().iter().zip(&found) {
            assert_eq!(
                (&found["team"], &found["id"]),
                (&robot.team.name().into(), &robot.id.into())
            );
            let [x, y] = ["x_mm", "y_mm"].map(|key| found[key].as_f64().unwrap());
            assert!(FieldPoint::new(x, y).distance(robot.pose.position) < 4.0, "{found:#}");
        }
    }
}

/// A decoder fills missing data with grey, which would silently hide robots there.
#[test]
fn a_cut_off_jpeg_is_an_error() {
    let scratch = Scratch::new("detect-cut");
    let (cut, whole) = (scratch.path.join("cut.jpg"), scratch.path.join("whole.jpg"));
    let bytes = jpeg(painted(), false);
    std::fs::write(&whole, &bytes).unwrap();
    for share in [0.1, 0.5, 0.99] {
        std::fs::write(&cut, &bytes[..(share * bytes.len() as f64) as usize]).unwrap();
        let output = detect(&scratch, &["--json", name(&cut), name(&whole)]);
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        let [answer] = &lines(&output)[..] else { panic!("{output:?}") };
        assert_eq!(answer["image"], name(&whole));
        let complaint = String::from_utf8(output.stderr).unwrap();
        assert!(complaint.contains("cut.jpg: the JPEG is cut off"), "{complaint}");
    }
}

#[test]
fn files_that_are_no_pictures_are_reported_and_the_others_are_processed() {
    let scratch = Scratch::new("detect-errors");
    let good = scratch.path.join("good.png");
    painted().save(&good).unwrap();
    let small = scratch.path.join("small.png");
    RgbImage::new(320, 240).save(&small).unwrap();
    let noise = scratch.write("noise.png", "This is not a picture.");
    let missing = scratch.path.join("missing.png");
    let nothing = scratch.path.join("nothing");
    std::fs::create_dir(&nothing).unwrap();

    let bad = [&missing, &small, &noise, &nothing];
    let mut args = vec!["--json"];
    args.extend(bad.iter().map(|path| name(path)));
    args.push(name(&good));
    let output = detect(&scratch, &args);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let answers = lines(&output);
    let [answer] = &answers[..] else { panic!("{output:?}") };
    assert_eq!(answer["image"], name(&good));
    assert_eq!(answer["robots"].as_array().unwrap().len(), robots().len());

    let complaints = String::from_utf8(output.stderr).unwrap();
    for path in bad {
        let about = |line: &&str| line.contains(name(path));
        assert_eq!(complaints.lines().filter(about).count(), 1, "{path:?} in\n{complaints}");
    }
    for hint in ["320×240", "camera.width", "not a readable PNG or JPEG", "no PNG or JPEG in"] {
        assert!(complaints.contains(hint), "{hint:?} is missing in\n{complaints}");
    }
}

#[test]
fn a_wrong_configuration_looks_at_nothing() {
    let scratch = Scratch::new("detect-config");
    let config = scratch.write("wrong.toml", "[camera]\nwidht = 640\n");
    let picture = scratch.path.join("painted.png");
    painted().save(&picture).unwrap();
    let output = detect(&scratch, &["--config", name(&config), name(&picture)]);
    assert!(!output.status.success() && output.stdout.is_empty(), "{output:?}");
    assert!(String::from_utf8(output.stderr).unwrap().contains("widht"));
}

#[test]
fn overlays_have_the_pictures_names_and_never_overwrite_them() {
    let scratch = Scratch::new("detect-overlay");
    let config = Config::default();
    let picture = painted();
    let (first, second) = (scratch.path.join("first"), scratch.path.join("second"));
    for folder in [&first, &second] {
        std::fs::create_dir(folder).unwrap();
        picture.save(folder.join("a.png")).unwrap();
    }
    picture.save(first.join("b.png")).unwrap();
    let overlays = scratch.path.join("overlays/new");
    let args = ["--overlay", name(&overlays), name(&first), name(&second)];
    let output = detect(&scratch, &args);
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(text.matches("4 robots, the ball, 1 rejected").count(), 3, "{text}");
    let mut names: Vec<String> = std::fs::read_dir(&overlays)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(names, ["a-2.png", "a.png", "b.png"]);
    let overlay = image::open(overlays.join("a.png")).unwrap().into_rgb8();
    assert_eq!(overlay.width() % config.camera.width, 0);
    assert!(overlay.width() > config.camera.width);
    let outlined = config.colors.iter().find(|color| color.name == "orange").unwrap().looks;
    assert!(overlay.pixels().any(|pixel| pixel.0 == outlined), "nothing is outlined");

    // Again only on request.
    let output = detect(&scratch, &args);
    assert!(!output.status.success(), "{output:?}");
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("a.png exists; --force overwrites it"), "{said}");
    assert!(detect(&scratch, &[&args[..], &["--force"]].concat()).status.success());

    let output = detect(&scratch, &["--overlay", name(&first), name(&first)]);
    assert!(!output.status.success(), "{output:?}");
    assert!(String::from_utf8(output.stderr).unwrap().contains("use another folder"));
    assert_eq!(image::open(first.join("a.png")).unwrap().into_rgb8(), *picture);
}
