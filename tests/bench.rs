//! `touchline bench` with a configuration and pictures of one's own.

mod support;

use image::{GrayImage, Luma};
use serde_json::Value;
use support::{Scratch, output_of};

/// A small camera, whose pictures are measured quickly.
const CONFIG: &str = "preset = \"mirosot-5v5\"\n[camera]\nwidth = 320\nheight = 240\n";

#[test]
fn own_pictures_are_measured_stage_by_stage() {
    let scratch = Scratch::new("bench-own");
    let config = scratch.write("match.toml", CONFIG);
    let picture = scratch.path.join("a.png");
    GrayImage::from_fn(320, 240, |x, y| Luma([(x * 7 + y * 13) as u8])).save(&picture).unwrap();
    let args = ["bench", "--json", "--config", config.to_str().unwrap()];
    let output = output_of(&scratch, &[&args[..], &[picture.to_str().unwrap()]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let outcome: Value = serde_json::from_slice(&output.stdout).unwrap();
    let pictures = outcome["pictures"].as_array().unwrap();
    assert_eq!(pictures.len(), 1, "{outcome:#}");
    assert_eq!(pictures[0]["picture"], picture.to_str().unwrap());
    assert_eq!((&pictures[0]["width"], &pictures[0]["height"]), (&320.into(), &240.into()));
    for stage in ["copy_us", "classifier_us", "tracker_us", "filter_us", "sum_us", "sum_p99_us"] {
        assert!(pictures[0][stage].as_f64().unwrap() > 0.0, "{stage}: {outcome:#}");
    }

    let gone = scratch.path.join("gone.png");
    let output = output_of(&scratch, &[&args[..], &[gone.to_str().unwrap()]].concat());
    assert!(!output.status.success());
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("gone.png"), "{said}");
}
