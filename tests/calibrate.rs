//! `touchline calibrate`: from points to a configuration, or to a complaint that names the culprit.
//!
//! The labelled photographs are not ours to redistribute: they are looked for beside the checkout,
//! and without them that part is not tested, loudly.

mod support;

use common::config::Config;
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

/// Corners of a pitch that fills a picture of 640 × 480, a little from the side.
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
fn a_labelled_pitch_tells_how_high_its_camera_hangs() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/real/agh");
    let Ok(labels) = std::fs::read_to_string(folder.join("labels.json")) else {
        eprintln!("SKIPPED: the labelled pictures of {} are not there", folder.display());
        return;
    };
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
    // A hand-made estimate from the same labels.
    assert!((height - 2070.0).abs() < 100.0, "{height}");
    assert!((x + 104.0).abs() < 100.0 && (y - 160.0).abs() < 100.0, "{x} {y}");
    assert_eq!(image::image_dimensions(overlay).unwrap(), (1920, 1440));
}
