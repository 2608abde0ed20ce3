//! Setting up from the frames of a running group, as the console does: requests and answers in JSON.

mod support;

use config::Config;
use geometry::{CameraModel, FieldPoint};
use serde_json::{Value, json};
use std::io::Write;
use std::process::Stdio;
use support::{Group, touchline};

/// The answer, and whether the program called it one.
fn ask(group: &Group, kind: &str, request: &Value) -> (bool, Value) {
    let mut program = touchline(&group.scratch, &["setup-worker", kind, "--instance", "test"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    program.stdin.take().unwrap().write_all(request.to_string().as_bytes()).unwrap();
    let output = program.wait_with_output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let answer = serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {text:?}"));
    (output.status.success(), answer)
}

fn answered(group: &Group, kind: &str, request: &Value) -> Value {
    let (is_answered, answer) = ask(group, kind, request);
    assert!(is_answered, "{kind}: {answer}");
    answer
}

/// Robots found in one frame with these changes.
fn robots_with(group: &Group, set: &Value) -> usize {
    let tried = answered(group, "try", &json!({ "set": set }));
    tried["robots"].as_array().unwrap().iter().filter(|robot| robot["found"] == 1).count()
}

#[test]
fn a_pitch_is_set_up_from_its_own_frames() {
    let mut group = Group::start("setup-worker", "", &[]);
    group.wait_until_working();

    // The pitch is found without any marks, and the lines make the camera of it.
    let found = answered(&group, "find-field", &json!({}));
    assert_eq!(found["found"], true, "{found}");
    let points = found["points"].clone();
    let fitted = answered(
        &group,
        "calibrate",
        &json!({ "points": points, "as_found": true, "camera_height_mm": 2200 }),
    );
    assert_eq!(fitted["lines"]["used"], true, "{}", fitted["lines"]);
    let geometry = fitted["set"].as_object().unwrap();
    let mut table = toml::Table::new();
    for (key, value) in geometry {
        let key = key.strip_prefix("geometry.").unwrap();
        table.insert(key.into(), toml::Value::try_from(value).unwrap());
    }
    let mut config = Config::default();
    let painted = CameraModel::new(&config.geometry, 640, 480).unwrap();
    config.geometry = table.try_into().unwrap();
    let model = CameraModel::new(&config.geometry, 640, 480).unwrap();
    for [x, y] in
        [[-1000.0, 800.0], [1000.0, 800.0], [1000.0, -800.0], [-1000.0, -800.0], [0.0, 0.0]]
    {
        let seen =
            [&painted, &model].map(|model| model.image_from_field(FieldPoint::new(x, y), 0.0));
        let off_px = (seen[0].x_px - seen[1].x_px).hypot(seen[0].y_px - seen[1].y_px);
        assert!(off_px < 0.5, "({x}, {y}) is {off_px:.2} px off");
    }
    assert_eq!(robots_with(&group, &fitted["set"]), 10);

    // Colours that find nothing, and colours learned from the same frames.
    let colors = |change: &dyn Fn(&mut Value)| {
        let mut colors = json!(Config::default().colors);
        colors.as_array_mut().unwrap().iter_mut().for_each(change);
        colors
    };
    let none = colors(&|color| color["red"] = json!([254, 255]));
    assert_eq!(robots_with(&group, &json!({ "colors": none })), 0);
    let learned = answered(&group, "learn", &json!({ "frames": 3, "set": { "colors": none } }));
    assert_eq!(learned["robots"], 30, "{learned}");
    assert_eq!(robots_with(&group, &learned["set"]), 10);

    // Mistakes are refused with a reason.
    for (kind, request, said) in [
        ("calibrate", json!({ "points": [] }), "point"),
        ("calibrate", json!({ "pionts": [] }), "pionts"),
        ("learn", json!({ "frames": 0 }), "frames"),
        (
            "learn",
            json!({ "samples": [{ "color": "mauve", "px": [1, 1] }], "auto": false }),
            "mauve",
        ),
        ("try", json!({ "set": { "filter.no_such_key": 1 } }), "no_such_key"),
        ("try", json!({ "set": { "field.length_mm": null } }), "field.length_mm"),
        ("try", json!([1, 2]), "request"),
    ] {
        let (is_answered, answer) = ask(&group, kind, &request);
        let message = answer["error"]["message"].as_str().unwrap_or_default();
        assert!(!is_answered && message.contains(said), "{kind} {request}: {answer}");
    }
    let stopped = group.touchline(&["stop"]);
    assert!(stopped.status.success(), "{stopped:?}");
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}
