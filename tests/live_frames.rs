//! Frames of a running group, as other programs take them.

mod support;

use client::instance::Instance;
use config::Config;
use geometry::{CameraModel, FieldPoint};
use rustix::process::Signal;
use std::time::Duration;
use support::{Group, PATIENCE, Scratch};
use touchline::live_frames::{LiveFramesError, Request, take};

const REQUEST: Request =
    Request { frames: 5, apart: Duration::from_millis(100), time_limit: PATIENCE };

#[test]
fn frames_come_whole_in_order_and_as_far_apart_as_requested() {
    let mut group = Group::start("live-frames", "[camera]\nfps = 40\n", &[]);
    let status = group.wait_until_working();
    let config = Config::load(&group.instance.config_path()).unwrap();
    let frames = take(&group.instance, &config.camera, &REQUEST).unwrap();
    assert_eq!(frames.len(), 5);
    for pair in frames.windows(2) {
        let [first, second] = [pair[0].header(), pair[1].header()];
        assert!(second.seq > first.seq);
        assert!(second.t_capture_ns - first.t_capture_ns >= 100_000_000);
    }
    let pixels = config.camera.width as usize * config.camera.height as usize;
    for frame in &frames {
        let bayer = frame.bayer(config.camera.bayer_order);
        assert_eq!(bayer.len(), pixels);
        assert_eq!(frame.rgb().len(), 3 * pixels);
        assert!(touchline::colorless::has_color(&bayer, config.camera.width as usize, 640));
    }
    // A camera of another size does not fit.
    let mut camera = config.camera.clone();
    camera.width = 320;
    let request = Request { time_limit: Duration::from_millis(300), ..REQUEST };
    let error = take(&group.instance, &camera, &request).unwrap_err();
    assert!(matches!(error, LiveFramesError::Unusable { .. }), "{error}");
    // More than it captures in the time.
    let request = Request { frames: 10_000, ..request };
    let error = take(&group.instance, &config.camera, &request).unwrap_err();
    assert!(matches!(error, LiveFramesError::TooFew { wanted: 10_000, .. }), "{error}");
    assert!(error.to_string().contains("touchline status --instance test"), "{error}");
    assert_eq!(
        group.wait_until_working()["stages"]["grabber"]["processes"],
        status["stages"]["grabber"]["processes"]
    );
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

#[test]
fn a_group_that_ends_meanwhile_or_is_not_there_is_an_error() {
    let mut group = Group::start("live-ending", "[camera]\nfps = 40\n", &[]);
    group.wait_until_working();
    let camera = Config::load(&group.instance.config_path()).unwrap().camera;
    let instance = group.instance.clone();
    let request = Request { frames: 1_000_000, ..REQUEST };
    let taking = std::thread::spawn(move || take(&instance, &camera, &request));
    group.wait_for("a reader of frames", |status| status["frames"]["world"].as_u64() > Some(30));
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    let error = taking.join().unwrap().unwrap_err();
    assert!(
        matches!(error, LiveFramesError::Ended { .. } | LiveFramesError::NoGroup(_)),
        "{error}"
    );

    let scratch = Scratch::new("live-none");
    let nowhere = Instance::below(&scratch.path.join("run"), "test").unwrap();
    let error = take(&nowhere, &Config::default().camera, &REQUEST).unwrap_err();
    assert!(matches!(error, LiveFramesError::NoGroup(_)), "{error}");
    assert!(error.to_string().contains("touchline run"), "{error}");
}

/// Runs a command on a group's frames and gives success and all that it has said.
fn run(group: &Group, args: &[&str]) -> (bool, String) {
    let output = support::output_of(&group.scratch, args);
    let text = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    (output.status.success(), text.concat())
}

/// Colours and geometry are spoilt, and found again from frames of the running match.
#[test]
fn a_running_group_is_calibrated_and_taught_and_loses_no_frame() {
    let mut group = Group::start("live-setup", "[camera]\nfps = 20\n", &[]);
    group.wait_until_working();
    let truth = Config::load(&group.instance.config_path()).unwrap();
    let mut spoilt = truth.clone();
    for pair in &mut spoilt.geometry.points {
        pair.image_px[0] += 3.0;
    }
    let orange = spoilt.colors.iter_mut().find(|color| color.name == truth.ball.color).unwrap();
    orange.green = [250, 255];
    let file = group.scratch.write("spoilt.toml", &config::commented_toml(&spoilt));
    let output = group.touchline(&["reload", "--config", file.to_str().unwrap()]);
    assert!(output.status.success(), "{output:?}");

    let model = CameraModel::new(&truth.geometry, 640, 480).unwrap();
    let corners = [("tl", -1.0, 1.0), ("tr", 1.0, 1.0), ("br", 1.0, -1.0), ("bl", -1.0, -1.0)];
    let clicks = corners.map(|(name, x, y)| {
        let seen = model.image_from_field(FieldPoint::new(1100.0 * x, 900.0 * y), 0.0);
        format!("--at=corner-{name}={:.1},{:.1}", seen.x_px + 1.0, seen.y_px - 1.0)
    });
    let lens = format!("camera_mm = {:?}\n", truth.geometry.camera_mm);
    let lens = group.scratch.write("lens.toml", &lens);
    let mut args = vec!["calibrate", "--points", lens.to_str().unwrap()];
    args.extend(clicks.iter().map(String::as_str));
    args.extend(["--from-group", "test", "--frames", "5", "--apply"]);
    let (done, said) = run(&group, &args);
    assert!(done && said.contains("lines       found at"), "{said}");
    assert!(said.contains("geometry.points") && said.contains("revision 3"), "{said}");
    assert!(said.contains("it holds until the group ends"), "{said}");
    let config = Config::load(&group.instance.config_path()).unwrap();
    let found = CameraModel::new(&config.geometry, 640, 480).unwrap();
    let seen = model.image_from_field(FieldPoint::new(500.0, 400.0), 75.0);
    let error_mm = found.field_from_image(seen, 75.0).distance(FieldPoint::new(500.0, 400.0));
    assert!(error_mm < 4.0, "{error_mm} mm\n{said}");

    let learned = group.scratch.path.join("learned.toml");
    let args = ["learn", "--auto", "--from-group", "test", "--frames", "6", "--apply", "-o"];
    let (done, said) = run(&group, &[&args[..], &[learned.to_str().unwrap()]].concat());
    assert!(done && said.contains("6 pictures"), "{said}");
    assert!(said.contains("colors.orange.green") && said.contains("revision 4"), "{said}");
    assert!(!said.contains("it holds until"), "{said}");
    let newest = Config::load(&group.instance.config_path()).unwrap();
    assert_eq!(newest.geometry, config.geometry, "only the learned keys are changed");
    assert_eq!(newest.colors, Config::load(&learned).unwrap().colors);
    let status = group.wait_for("ball and robots", |status| {
        status["configuration"]["pending"].as_array().unwrap().is_empty()
            && status["found"]["robots"] == 10
    });
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");

    let (done, said) = run(&group, &["learn", "--auto", "--from-group", "nothing"]);
    assert!(!done && said.contains("no group \"nothing\" is running"), "{said}");
    let file = file.to_str().unwrap();
    let args = ["learn", "--auto", "--from-group", "test", "--apply", "--config", file];
    let (done, said) = run(&group, &args);
    assert!(!done && said.contains("cannot be used with"), "{said}");
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}
