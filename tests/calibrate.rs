//! `touchline calibrate`: from points to a configuration, or to an error that names the culprit.
//!
//! The labelled photographs may not be redistributed: they are beside the checkout, and tests that need
//! them are ignored without them.

mod support;

use config::Config;
use geometry::{CameraModel, FieldPoint};
use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;
use std::process::Output;
use support::{Scratch, output_of};

fn calibrate(scratch: &Scratch, args: &[&str]) -> Output {
    output_of(scratch, &[&["calibrate"], args].concat())
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Corners of a pitch that fills a picture of 640 × 480, slightly from the side.
const CORNERS: [&str; 4] = [
    "--at=corner-tl=60.5,50.2",
    "--at=corner-tr=590.1,44.9",
    "--at=corner-br=601.2,447.8",
    "--at=corner-bl=44.7,440.3",
];

#[test]
fn four_corners_make_a_geometry_that_is_accepted() {
    let scratch = Scratch::new("calibrate-corners");
    let output = calibrate(&scratch, &CORNERS);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let section = text(&output.stdout);
    assert!(section.starts_with("[geometry]\n"), "{section}");
    let config = Config::parse(&section, "printed").unwrap();
    assert_eq!(config.geometry.points.len(), 4);
    let said = text(&output.stderr);
    assert!(said.contains("fit whatever they are") && said.contains("not measured"), "{said}");

    let file = scratch.path.join("calibrated.toml");
    let file = file.to_str().unwrap();
    let output = calibrate(&scratch, &[&CORNERS[..], &["-o", file]].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert_eq!(Config::load(Path::new(file)).unwrap().geometry, config.geometry);
    let output = calibrate(&scratch, &[&CORNERS[..], &["-o", file]].concat());
    assert!(!output.status.success() && text(&output.stderr).contains("--force"));
}

#[test]
fn mistakes_are_named_and_nothing_is_written() {
    let scratch = Scratch::new("calibrate-mistakes");
    let file = scratch.path.join("calibrated.toml");
    let file = file.to_str().unwrap();
    let refused = |args: &[&str], part: &str| {
        let output = calibrate(&scratch, &[args, &["-o", file]].concat());
        let said = text(&output.stderr);
        assert!(!output.status.success() && said.contains(part), "{part:?} not in {said}");
        assert!(!Path::new(file).exists());
    };
    let swapped = ["--at=corner-tl=60,50", "--at=corner-tr=601,448", "--at=corner-br=590,45"];
    refused(&[&swapped[..], &CORNERS[3..]].concat(), "points 2 and 3 look swapped");
    refused(&CORNERS[..3], "3 points are marked");
    refused(&[], "no points");
    refused(&["--at=corner-xx=1,2"], "corner top left");
    refused(&["--at=corner-tl"], "PLACE=X,Y");
    refused(&["--at=wall-tl=1,2"], "wall_height_mm");
    let points =
        scratch.write("points.toml", "points = [\n  { at = \"centre\", pixel = [1, 2] },\n]");
    refused(&["--points", points.to_str().unwrap()], "pixel");
    refused(&["--points", "/nowhere/points.toml"], "/nowhere/points.toml");
}

/// Floor corners and upper edges of the wall, as labelled in one picture or in all.
#[test]
#[ignore = "needs ../shared, pictures that are not ours to give away"]
fn a_labelled_pitch_tells_how_high_its_camera_hangs() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/real/agh");
    let labels = std::fs::read_to_string(folder.join("labels.json")).unwrap();
    let labels: Value = serde_json::from_str(&labels).unwrap();
    let image = &labels["images"][0];
    let names = ["top left", "top right", "bottom right", "bottom left"];
    let mut points = "wall_height_mm = 50\npoints = [\n".to_string();
    for (kind, key) in [("corner", "field_corners_px"), ("wall", "wall_top_corners_px")] {
        for (name, pixel) in names.iter().zip(image[key].as_array().unwrap()) {
            let _ = writeln!(points, "  {{ at = \"{kind} {name}\", image_px = {pixel} }},");
        }
    }
    let scratch = Scratch::new("calibrate-agh");
    let points = scratch.write("points.toml", &(points + "]\n"));
    let (out, overlay) = (scratch.path.join("agh.toml"), scratch.path.join("overlay.png"));
    let picture = folder.join(image["file"].as_str().unwrap());
    let config = scratch.write("match.toml", "[camera]\nfps = 15\n");
    let args = [&points, &config, &picture, &overlay, &out].map(|path| path.to_str().unwrap());
    let [points, config, picture, overlay, out] = args;
    let output = calibrate(
        &scratch,
        &[
            "--points",
            points,
            "--config",
            config,
            "--picture",
            picture,
            "--overlay",
            overlay,
            "-o",
            out,
        ],
    );
    assert!(output.status.success(), "{}", text(&output.stderr));
    print!("{}", text(&output.stdout));
    let [x, y, height] = Config::load(Path::new(out)).unwrap().geometry.camera_mm;
    // A manual estimate from the same labels.
    assert!((height - 2070.0).abs() < 100.0, "{height}");
    assert!((x + 104.0).abs() < 100.0 && (y - 160.0).abs() < 100.0, "{x} {y}");
    assert_eq!(image::image_dimensions(overlay).unwrap(), (1920, 1440));
}

/// The synthetic pitch as a raw picture.
fn pitch_picture(config: &Config) -> image::GrayImage {
    let (width, height) = (config.camera.width, config.camera.height);
    let mut pixels = vec![0; (width * height) as usize];
    let mut game = grabber::synthetic::SyntheticMatch::new(config).unwrap();
    game.render(&mut pixels, width as usize);
    image::GrayImage::from_raw(width, height, pixels).unwrap()
}

/// Difference of two cameras, as root mean square over robots' tops on the pitch.
fn apart_mm(truth: &Config, found: &Config) -> f64 {
    let model = |config: &Config| CameraModel::new(&config.geometry, 640, 480).unwrap();
    let (truth, found) = (model(truth), model(found));
    let (mut sum, mut count) = (0.0, 0.0);
    for x in [-1000.0, -500.0, 0.0, 500.0, 1000.0] {
        for y in [-800.0, -400.0, 0.0, 400.0, 800.0] {
            let place = FieldPoint::new(x, y);
            let seen = truth.image_from_field(place, 75.0);
            sum += place.distance(found.field_from_image(seen, 75.0)).powi(2);
            count += 1.0;
        }
    }
    f64::sqrt(sum / count)
}

/// Each click is two pixels off in some direction; the lines of the pitch are exact.
#[test]
fn four_rough_clicks_are_refined_on_the_lines() {
    let scratch = Scratch::new("calibrate-lines");
    let truth = Config::default();
    let picture = scratch.path.join("pitch.png");
    pitch_picture(&truth).save(&picture).unwrap();
    let model = CameraModel::new(&truth.geometry, 640, 480).unwrap();
    // The keystone of the synthetic picture is not that of its lens position, which is given here.
    let lens = format!("camera_mm = {:?}\n", truth.geometry.camera_mm);
    let lens = scratch.write("lens.toml", &lens);
    for angle in [0.3f64, 1.9, 4.4] {
        let corners = [("tl", -1.0, 1.0), ("tr", 1.0, 1.0), ("br", 1.0, -1.0), ("bl", -1.0, -1.0)];
        let clicks: Vec<String> = corners
            .iter()
            .enumerate()
            .map(|(index, (name, x, y))| {
                let seen = model.image_from_field(FieldPoint::new(1100.0 * x, 900.0 * y), 0.0);
                let (sin, cos) = (angle + 2.4 * index as f64).sin_cos();
                format!("--at=corner-{name}={},{}", seen.x_px + 2.0 * cos, seen.y_px + 2.0 * sin)
            })
            .collect();
        let mut args: Vec<&str> = clicks.iter().map(String::as_str).collect();
        args.extend(["--points", lens.to_str().unwrap(), "--picture", picture.to_str().unwrap()]);
        let found = |args: &[&str]| {
            let output = calibrate(&scratch, args);
            assert!(output.status.success(), "{}", text(&output.stderr));
            let section = text(&output.stdout);
            (apart_mm(&truth, &Config::parse(&section, "printed").unwrap()), text(&output.stderr))
        };
        let (error, said) = found(&args);
        assert!(said.contains("lines       found at"), "{said}");
        assert!(error < 2.0, "{angle}: {error} mm\n{said}");
        args.push("--marks-only");
        let (rough, said) = found(&args);
        assert!(!said.contains("lines ") && rough > 3.0, "{angle}: {rough} mm");
    }
}

/// Without visible lines only the points count.
#[test]
fn where_there_are_no_lines_the_points_count() {
    let scratch = Scratch::new("calibrate-no-lines");
    let picture = scratch.path.join("empty.png");
    image::GrayImage::from_pixel(640, 480, image::Luma([40])).save(&picture).unwrap();
    let args = [&CORNERS[..], &["--picture", picture.to_str().unwrap()]].concat();
    let output = calibrate(&scratch, &args);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("lines       not used"), "{}", text(&output.stderr));
    assert_eq!(text(&output.stdout), text(&calibrate(&scratch, &CORNERS).stdout));
}

/// Well marked points are not moved by lines of another pitch, here one that is 60 mm longer.
#[test]
fn lines_that_contradict_the_points_are_not_used() {
    let scratch = Scratch::new("calibrate-other-lines");
    let truth = Config::default();
    let model = CameraModel::new(&truth.geometry, 640, 480).unwrap();
    let mut longer = truth.clone();
    longer.field.length_mm += 60.0;
    let picture = scratch.path.join("pitch.png");
    pitch_picture(&longer).save(&picture).unwrap();
    let mut points = format!("camera_mm = {:?}\npoints = [\n", truth.geometry.camera_mm);
    for x in [-1100.0, 0.0, 1100.0] {
        for y in [-900.0, 0.0, 900.0] {
            let seen = model.image_from_field(FieldPoint::new(x, y), 0.0);
            let [column, row] = [seen.x_px, seen.y_px];
            let _ =
                writeln!(points, "  {{ field_mm = [{x}, {y}], image_px = [{column}, {row}] }},");
        }
    }
    let points = scratch.write("points.toml", &(points + "]\n"));
    let args = ["--points", points.to_str().unwrap(), "--picture", picture.to_str().unwrap()];
    let output = calibrate(&scratch, &args);
    let said = text(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(
        said.contains("lines       not used") && said.contains("contradicts the points"),
        "{said}"
    );
    let found = Config::parse(&text(&output.stdout), "printed").unwrap();
    assert!(apart_mm(&truth, &found) < 0.5, "{said}");
}

/// Pictures through wide lenses, with points marked to 0.3 px and the robots' true positions.
#[test]
#[ignore = "needs ../shared, pictures that are not ours to give away"]
fn robots_seen_through_wide_lenses_are_within_a_millimetre() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/cases/lens");
    let scratch = Scratch::new("calibrate-wide");
    for case in std::fs::read_dir(&folder).unwrap().map(|case| case.unwrap().path()) {
        let file = |name: &str| case.join(name).to_str().unwrap().to_string();
        let [points, config, picture] = ["points.toml", "m.toml", "p.png"].map(file);
        let truth = std::fs::read_to_string(case.join("truth.json")).unwrap();
        let truth: Vec<Value> = serde_json::from_str(&truth).unwrap();
        for with_lines in [false, true] {
            let calibrated = scratch.path.join("calibrated.toml");
            let calibrated = calibrated.to_str().unwrap();
            let mut args =
                vec!["--points", &points, "--config", &config, "-o", calibrated, "--force"];
            if with_lines {
                args.extend(["--picture", &picture]);
            }
            let output = calibrate(&scratch, &args);
            assert!(output.status.success(), "{}", text(&output.stderr));
            let args = ["detect", "--json", "--config", calibrated, &picture];
            let output = output_of(&scratch, &args);
            let found: Value = serde_json::from_slice(&output.stdout).unwrap();
            let found = found["robots"].as_array().unwrap();
            assert_eq!(found.len(), truth.len(), "{points}");
            let mut sum = 0.0;
            for robot in &truth {
                let is_it = |found: &&Value| {
                    (&found["team"], &found["id"]) == (&robot["team"], &robot["id"])
                };
                let found = found.iter().find(is_it).unwrap();
                let off = |found_key: &str, key: &str| {
                    found[found_key].as_f64().unwrap() - robot[key].as_f64().unwrap()
                };
                sum += off("x_mm", "x").powi(2) + off("y_mm", "y").powi(2);
            }
            let rms_mm = f64::sqrt(sum / truth.len() as f64);
            println!("{points}: {rms_mm:.2} mm, lines: {with_lines}");
            assert!(rms_mm <= 1.0, "{points}: {rms_mm} mm, lines: {with_lines}");
        }
    }
}
