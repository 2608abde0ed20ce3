//! `touchline score` on photographs of real pitches, labelled completely by hand.
//!
//! The photographs may not be redistributed: they are beside the checkout. With `--nocapture` the score
//! of every picture is printed.

mod support;

use serde_json::Value;
use std::path::{Path, PathBuf};
use support::{Scratch, output_of};

/// The labels of a set of pictures.
fn labels(set: &str) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    root.join("../shared/real").join(set).join("labels.json")
}

/// The score of a set of pictures with `tests/data/<set>.toml`.
fn score(set: &str) -> Value {
    let labels = labels(set);
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/data/{set}.toml"));
    let args = ["score", labels.to_str().unwrap(), "--config", config.to_str().unwrap()];
    let scratch = Scratch::new(&format!("real-{set}"));
    print!("{}", String::from_utf8_lossy(&output_of(&scratch, &args).stdout));
    let output = output_of(&scratch, &[&args[..], &["--json"]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn total(score: &Value, key: &str) -> u64 {
    score["total"][key].as_u64().unwrap_or_else(|| panic!("no total.{key} in {score:#}"))
}

#[test]
#[ignore = "needs ../shared, pictures that are not ours to give away"]
fn every_robot_and_the_ball_of_the_vsss_pitch_are_found() {
    let score = score("vsss");
    assert_eq!(total(&score, "robots"), 6);
    assert_eq!(total(&score, "right"), 6, "{score:#}");
    assert_eq!(total(&score, "phantoms"), 0, "{score:#}");
    assert_eq!((total(&score, "balls"), total(&score, "balls_right")), (1, 1), "{score:#}");
}

/// Clear robots of all pictures that `agh.toml` finds under their own name within 3 px and 6°, minus
/// one.
const AGH_RIGHT_AT_LEAST: u64 = 59;

#[test]
#[ignore = "needs ../shared, pictures that are not ours to give away"]
fn robots_and_the_ball_of_the_mirosot_pitch_are_found_under_all_lamps() {
    let score = score("agh");
    assert_eq!(total(&score, "robots"), 60);
    assert!(total(&score, "right") >= AGH_RIGHT_AT_LEAST, "{score:#}");
    assert_eq!(total(&score, "wrong_identity"), 0, "{score:#}");
    assert_eq!(total(&score, "phantoms"), 0, "{score:#}");
    assert_eq!(total(&score, "balls_right"), total(&score, "balls"), "{score:#}");
}

/// Sets of three pictures to learn from: each half of the six, and one with the brightest and the
/// darkest lamp.
const TAUGHT: [[&str; 3]; 3] = [
    ["b_all1.png", "b_r0.png", "b_white1.png"],
    ["b_whitez4.png", "b_yellow1.png", "b_zd1.png"],
    ["b_all1.png", "b_whitez4.png", "b_yellow1.png"],
];

#[test]
#[ignore = "needs ../shared, pictures that are not ours to give away"]
fn colours_learned_under_some_lamps_hold_under_others() {
    let path = labels("agh");
    let scratch = Scratch::new("real-learned");
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/agh.toml");
    let folder = path.parent().unwrap();
    let labels: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let (mut robots, mut right) = (0, 0);
    for (number, taught) in TAUGHT.iter().enumerate() {
        let learned = scratch.path.join(format!("{number}.toml"));
        let pictures = taught.map(|file| folder.join(file).display().to_string());
        let [path, config, learned] = [&path, &config, &learned].map(|path| path.to_str().unwrap());
        let mut args = vec!["learn", "--samples", path, "--config", config, "-o", learned];
        args.extend(pictures.iter().map(String::as_str));
        let output = output_of(&scratch, &args);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));

        let mut others = labels.clone();
        let images = others["images"].as_array_mut().unwrap();
        images.retain(|image| !taught.contains(&image["file"].as_str().unwrap()));
        for image in images {
            image["file"] = folder.join(image["file"].as_str().unwrap()).to_str().unwrap().into();
        }
        let others = scratch.write("others.json", &others.to_string());
        let args = ["score", others.to_str().unwrap(), "--config", learned, "--json"];
        let score: Value = serde_json::from_slice(&output_of(&scratch, &args).stdout).unwrap();
        println!("from {taught:?}: {}", score["total"]);
        robots += total(&score, "robots");
        right += total(&score, "right");
        assert_eq!(total(&score, "wrong_identity"), 0, "{score:#}");
        assert_eq!(total(&score, "balls_right"), total(&score, "balls"), "{score:#}");
    }
    assert_eq!(robots, 90);
    assert!(100 * right >= 99 * robots, "{right} of {robots}");
}
