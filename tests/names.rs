//! Names on given pictures: an SSL field, robots distinguished by shapes, robots with patches that
//! match no listed robot. The pictures are beside the checkout, and may not be redistributed.

mod support;

use serde_json::Value;
use std::path::{Path, PathBuf};
use support::{Scratch, output_of};

/// A file beside the checkout.
fn shared(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared").join(path)
}

/// Standard output of the program, which must succeed.
fn printed(scratch: &Scratch, args: &[&str]) -> Vec<u8> {
    let output = output_of(scratch, args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

fn detected(scratch: &Scratch, config: &Path, picture: &Path) -> Value {
    let [config, picture] = [config, picture].map(|path| path.to_str().unwrap());
    let text = printed(scratch, &["detect", "--json", "--config", config, picture]);
    serde_json::from_slice(&text).unwrap()
}

#[test]
#[ignore = "needs ../shared, pictures that are not ours to give away"]
fn robots_told_apart_by_shapes_are_all_found() {
    let picture = shared("real/unball/frame.png");
    let scratch = Scratch::new("names-unball");
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/unball.toml");
    let seen = detected(&scratch, &config, &picture);
    // Number, position and heading, by eye.
    let expected = [
        (0, [396.6, 156.7], 23.5),
        (1, [405.0, 229.0], 344.0),
        (2, [328.0, 268.0], 53.0),
        (3, [248.0, 298.0], 142.0),
        (4, [222.0, 183.0], 44.0),
    ];
    let robots = seen["robots"].as_array().unwrap();
    assert_eq!(robots.len(), expected.len(), "{seen:#}");
    for (id, [x, y], heading) in expected {
        let robot = robots.iter().find(|robot| robot["id"] == id).unwrap_or_else(|| panic!("{id}"));
        let number = |key: &str| robot[key].as_f64().unwrap();
        assert!((number("x_px") - x).hypot(number("y_px") - y) < 3.0, "{robot:#}");
        let turned = (number("heading_image_deg") - heading + 180.0).rem_euclid(360.0) - 180.0;
        assert!(turned.abs() < 12.0, "{robot:#}");
    }
}

#[test]
#[ignore = "needs ../shared, pictures that are not ours to give away"]
fn no_robot_gets_a_name_that_a_patch_contradicts() {
    let folder = shared("cases/mirrored-identity");
    let scratch = Scratch::new("names-mirrored");
    let seen = |config: &str| detected(&scratch, &folder.join(config), &folder.join("p.png"));
    assert_eq!(seen("right.toml")["robots"].as_array().unwrap().len(), 6);
    for config in ["mirrored.toml", "half.toml"] {
        let seen = seen(config);
        assert_eq!(seen["robots"].as_array().unwrap().len(), 0, "{seen:#}");
        let reasons = seen["rejected"].as_array().unwrap().iter();
        let mismatches =
            reasons.filter(|it| it["reason"] == "identification patches do not fit the layout");
        assert_eq!(mismatches.count(), 6, "{seen:#}");
    }
}

#[test]
#[ignore = "needs ../shared, pictures that are not ours to give away"]
fn all_robots_of_an_ssl_field_are_named_and_where_they_are() {
    let folder = shared("cases/ssl");
    let scratch = Scratch::new("names-ssl");
    let path = |name: &str| folder.join(name).to_str().unwrap().to_string();
    let [calibrated, learned] = ["calibrated.toml", "learned.toml"]
        .map(|name| scratch.path.join(name).to_str().unwrap().to_string());
    let (points, labels, config) = (path("points.toml"), path("labels.json"), path("match.toml"));
    printed(&scratch, &["calibrate", "--points", &points, "--config", &config, "-o", &calibrated]);
    printed(&scratch, &["learn", "--samples", &labels, "--config", &calibrated, "-o", &learned]);
    let text = std::fs::read_to_string(&learned).unwrap();
    let labelled: Value = serde_json::from_slice(&std::fs::read(labels).unwrap()).unwrap();
    for tolerance in ["patch_tolerance_mm = 12", "patch_tolerance_mm = 20"] {
        let text = text.replace("patch_tolerance_mm = 12", tolerance);
        let config = scratch.write("tried.toml", &text);
        let (mut expected, mut right, mut squares) = (0, 0, 0.0);
        for image in labelled["images"].as_array().unwrap() {
            let picture = folder.join(image["file"].as_str().unwrap());
            let seen = detected(&scratch, &config, &picture);
            let labels = image["robots"].as_array().unwrap();
            for found in seen["robots"].as_array().unwrap() {
                let same = |label: &&Value| ["team", "id"].iter().all(|&k| label[k] == found[k]);
                let label = labels.iter().find(same).unwrap_or_else(|| panic!("wrong: {found:#}"));
                let off = |key: &str| found[key].as_f64().unwrap() - label[key].as_f64().unwrap();
                let off_mm = off("x_mm").hypot(off("y_mm"));
                assert!(off_mm < 1.0, "{tolerance}: {found:#} {label:#}");
                if label["quality"] == "clear" {
                    (right, squares) = (right + 1, squares + off_mm * off_mm);
                }
            }
            expected += labels.iter().filter(|label| label["quality"] == "clear").count();
        }
        let rms_mm = (squares / f64::from(right)).sqrt();
        println!("{tolerance}: {right} of {expected}, {rms_mm:.3} mm rms");
        assert_eq!((expected, right as usize), (60, 60));
        assert!(rms_mm < 0.1, "{rms_mm} mm");
    }
}
