//! Tests of real Video for Linux cameras with the kernel's driver `vivid`.
//!
//! They need a `vivid` device, named by `TOUCHLINE_VIVID`; `scripts/test-v4l2` starts a virtual machine
//! with one, and runs them there.

mod support;

use client::bus::Bus;
use config::{Config, SettingValue, commented_toml};
use messages::topics;
use messages::{BayerOrder, DetectionFrame, FrameHeader, PixelFormat};
use serde_json::Value;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};
use support::{Group, PATIENCE, Scratch, output_of};

/// The pattern of eight upright bars, and the colours to find: bar and name.
const PATTERN: &str = "100% Colorbar";
const BARS: [(u32, &str); 6] =
    [(1, "yellow"), (2, "cyan"), (3, "green"), (4, "pink"), (5, "red"), (6, "blue")];
const BAR_PX: u32 = 640 / 8;

/// The device, and a rate that the machine can sustain.
fn vivid() -> (String, f64) {
    let device = std::env::var("TOUCHLINE_VIVID")
        .expect("TOUCHLINE_VIVID names a device of vivid; scripts/test-v4l2 has one");
    let fps = std::env::var("TOUCHLINE_VIVID_FPS").ok().and_then(|fps| fps.parse().ok());
    (device, fps.unwrap_or(25.0))
}

/// A configuration of pure colours, with the camera set to show bars of them without text.
fn config(fps: f64, format: &str) -> Config {
    let mut config = Config::default();
    config.camera.fps = fps;
    // An emulated machine is slow, and this does not test the supervisor.
    config.supervisor.spares.clear();
    config.supervisor.ready_timeout_ms = 30_000.0;
    config.supervisor.orphan_timeout_s = 3.0;
    config.camera.v4l2.format = format.into();
    let controls = [("test_pattern", PATTERN), ("osd_text_mode", "None")];
    config.camera.v4l2.controls = controls
        .map(|(name, entry)| (name.to_string(), SettingValue::Text(entry.to_string())))
        .into();
    for (index, color) in config.colors.iter_mut().enumerate() {
        let pure = match color.name.as_str() {
            "yellow" => [1, 1, 0],
            "cyan" => [0, 1, 1],
            "green" => [0, 1, 0],
            "pink" => [1, 0, 1],
            "red" => [1, 0, 0],
            "blue" => [0, 0, 1],
            // Bars never have such colours, however they are converted.
            _ => {
                let grey = 100 + index as u8;
                [color.red, color.green, color.blue] = [[grey; 2], [128; 2], [160; 2]];
                continue;
            }
        };
        let [red, green, blue] = pure.map(|on| if on == 1 { [190, 255] } else { [0, 65] });
        [color.red, color.green, color.blue] = [red, green, blue];
    }
    config
}

fn start(name: &str, config: &Config, device: &str) -> Group {
    Group::start(name, &commented_toml(config), &["--source", &format!("v4l2:{device}")])
}

fn camera_state(status: &Value) -> &str {
    status["camera"]["device"]["state"].as_str().unwrap_or("none")
}

/// Frames and detections of a running group, this many of each.
fn watch(group: &Group, count: usize) -> (Vec<(FrameHeader, Duration)>, Vec<DetectionFrame>) {
    let bus = Bus::join(&group.instance, "test").unwrap();
    let frames = bus.subscriber(&topics::FRAMES).unwrap();
    let detections = bus.subscriber(&topics::DETECTIONS).unwrap();
    let (mut headers, mut found) = (Vec::new(), Vec::new());
    let deadline = Instant::now() + PATIENCE;
    while headers.len() < count || found.len() < count {
        assert!(Instant::now() < deadline, "{} frames, {}", headers.len(), group.stderr());
        while let Some(frame) = frames.receive().unwrap() {
            let age_ns = client::clock::monotonic_ns().saturating_sub(frame.header().t_capture_ns);
            headers.push((*frame.header(), Duration::from_nanos(age_ns)));
        }
        while let Some(detection) = detections.receive().unwrap() {
            found.extend(detection.message().copied());
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    (headers, found)
}

/// Forty consecutive frames. The emulated processor also runs the driver, which may be late when a
/// process joins the group; then the gap is in the driver's own numbers, and counted as lost.
fn watch_without_a_gap(
    group: &mut Group,
    about: &str,
) -> (Vec<(FrameHeader, Duration)>, Vec<DetectionFrame>) {
    let mut lost_before = 0;
    for _ in 0..3 {
        let (headers, detections) = watch(group, 40);
        let (first, last) = (headers[0].0.seq, headers[headers.len() - 1].0.seq);
        let missing = last + 1 - first - headers.len() as u64;
        if missing == 0 {
            return (headers, detections);
        }
        let status = group.wait_for("the loss to be counted", |status| {
            status["camera"]["device"]["lost"].as_u64() >= Some(lost_before + missing)
        });
        lost_before = status["camera"]["device"]["lost"].as_u64().unwrap();
        eprintln!("{about}: the driver itself has left out {missing} frames; once more");
    }
    panic!("{about}: not forty frames in a row");
}

/// Share of its bar that each colour covers, 0–1.
fn coverage(detections: &DetectionFrame, config: &Config) -> Vec<(&'static str, f64)> {
    let (width, height) = (BAR_PX as f64, f64::from(config.camera.height));
    BARS.iter()
        .map(|&(bar, name)| {
            let class = config.colors.iter().position(|color| color.name == name).unwrap() as u32;
            let center = (f64::from(bar) + 0.5) * width;
            let is_its_bar = |x: f64| (x - center).abs() < width / 2.0;
            let area: u32 = detections
                .regions()
                .iter()
                .filter(|region| region.class == class && is_its_bar(region.x_px.into()))
                .map(|region| region.pixel_count)
                .sum();
            (name, f64::from(area) / (width * height))
        })
        .collect()
}

fn check_format(format: &str, expected: (PixelFormat, BayerOrder), transfer: &str) {
    let (device, fps) = vivid();
    let config = config(fps, format);
    let mut group = start(&format!("vivid-{format}"), &config, &device);
    // Past the start, when all processes are busy.
    group.wait_for("a steady stream", |status| status["frames"]["world"].as_u64() > Some(30));
    let (headers, detections) = watch_without_a_gap(&mut group, format);
    for (header, _) in &headers {
        assert_eq!(PixelFormat::from_number(header.pixel_format), Some(expected.0), "{format}");
        if expected.0.is_bayer() {
            assert_eq!(BayerOrder::from_number(header.bayer_order), Some(expected.1), "{format}");
        }
    }
    for pair in headers.windows(2) {
        let [(first, _), (second, _)] = [pair[0], pair[1]];
        assert!(second.t_capture_ns > first.t_capture_ns, "{format}: times fall");
    }
    // The driver's own times, not those of reception: they keep the rate.
    let (first, last) = (headers[0].0, headers[headers.len() - 1].0);
    let period_ms =
        (last.t_capture_ns - first.t_capture_ns) as f64 / 1e6 / (last.seq - first.seq) as f64;
    assert!((period_ms * fps / 1000.0 - 1.0).abs() < 0.1, "{format}: {period_ms} ms a frame");
    let covered = coverage(&detections[detections.len() - 1], &config);
    for &(color, share) in &covered {
        assert!(
            (0.9..1.01).contains(&share),
            "{format}: {color} {share:.3} of its bar: {covered:?}"
        );
    }
    let status = group.wait_for("a camera report", |status| {
        status["camera"]["device"]["delivered_fps"].as_f64() > Some(0.0)
    });
    let camera = &status["camera"]["device"];
    assert_eq!(camera_state(&status), "streaming", "{status:#}");
    assert_eq!(camera["incomplete"], 0, "{status:#}");
    let description = camera["description"].as_str().unwrap();
    assert!(description.contains(transfer), "{description}");
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    eprintln!(
        "{format}: {description}; {period_ms:.2} ms a frame; worst age {:?}; {covered:.3?}",
        headers.iter().map(|&(_, age)| age).max().unwrap()
    );
}

const DIRECT: &str = "straight into shared memory";

#[test]
#[ignore = "needs the kernel's virtual camera: scripts/test-v4l2 plays one"]
fn bayer_streams_straight_into_shared_memory_with_the_right_colours() {
    for (format, order) in [
        ("RGGB", BayerOrder::Rggb),
        ("GRBG", BayerOrder::Grbg),
        ("GBRG", BayerOrder::Gbrg),
        ("BA81", BayerOrder::Bggr),
    ] {
        check_format(format, (PixelFormat::Bayer8, order), DIRECT);
    }
}

#[test]
#[ignore = "needs the kernel's virtual camera: scripts/test-v4l2 plays one"]
fn deep_bayer_streams_with_the_right_colours() {
    for (format, pixel_format) in [
        ("RG10", PixelFormat::Bayer10),
        ("BG12", PixelFormat::Bayer12),
        ("GR16", PixelFormat::Bayer16),
    ] {
        let order = match format {
            "RG10" => BayerOrder::Rggb,
            "BG12" => BayerOrder::Bggr,
            _ => BayerOrder::Grbg,
        };
        check_format(format, (pixel_format, order), DIRECT);
    }
}

#[test]
#[ignore = "needs the kernel's virtual camera: scripts/test-v4l2 plays one"]
fn yuv_and_rgb_stream_with_the_right_colours() {
    for (format, pixel_format) in [
        ("YUYV", PixelFormat::Yuyv),
        ("UYVY", PixelFormat::Uyvy),
        ("NV12", PixelFormat::Nv12),
        ("YU12", PixelFormat::I420),
        ("RGB3", PixelFormat::Rgb24),
    ] {
        check_format(format, (pixel_format, BayerOrder::Rggb), DIRECT);
    }
}

#[test]
#[ignore = "needs the kernel's virtual camera: scripts/test-v4l2 plays one"]
fn a_driver_that_cannot_write_to_shared_memory_is_copied_from() {
    let (device, fps) = vivid();
    let mut config = config(fps, "RGGB");
    config.camera.v4l2.direct = false;
    let mut group = start("vivid-copied", &config, &device);
    let status = group.wait_until_working();
    let description = status["camera"]["device"]["description"].as_str().unwrap();
    assert!(description.contains("copied"), "{description}");
    let (_, detections) = watch(&group, 20);
    let covered = coverage(&detections[detections.len() - 1], &config);
    assert!(covered.iter().all(|&(_, share)| share > 0.9), "{covered:?}");
}

#[test]
#[ignore = "needs the kernel's virtual camera: scripts/test-v4l2 plays one"]
fn cameras_are_listed_with_formats_and_controls() {
    let (device, _) = vivid();
    let scratch = Scratch::new("vivid-list");
    let output = output_of(&scratch, &["cameras", "--json"]);
    let listing: Value = serde_json::from_slice(&output.stdout).unwrap();
    let source = format!("v4l2:{device}");
    let cameras = listing["cameras"].as_array().unwrap();
    let camera = cameras.iter().find(|camera| camera["source"] == source.as_str()).unwrap();
    let named = |key: &str, name: &str| -> &Value {
        let list = camera[key].as_array().unwrap();
        list.iter().find(|item| item["name"] == name).unwrap_or_else(|| panic!("{name}: {list:#?}"))
    };
    let sizes = named("formats", "RGGB")["sizes"].as_array().unwrap();
    let size = sizes.iter().find(|size| size["size"] == "640×480").unwrap();
    assert!(size["fps"].as_array().unwrap().contains(&25.0.into()), "{size:#}");
    let refused = named("formats", "GREY")["refused"].as_str().unwrap();
    assert!(refused.contains("no colour"), "{refused}");
    let brightness = named("controls", "brightness");
    assert_eq!((&brightness["minimum"], &brightness["maximum"]), (&0.into(), &255.into()));
    let text = String::from_utf8(output_of(&scratch, &["cameras"]).stdout).unwrap();
    assert!(text.contains("brightness") && text.contains("0 to 255"), "{text}");
}

/// A group whose camera cannot stream as configured reports why in its status.
fn refused(name: &str, state: &str, reason: &str, change: impl FnOnce(&mut Config)) {
    let (device, fps) = vivid();
    let mut config = config(fps, "RGGB");
    change(&mut config);
    let mut group = start(name, &config, &device);
    let status = group.wait_for("a refusal", |status| camera_state(status) == state);
    let problem = status["camera"]["device"]["problem"].as_str().unwrap();
    assert!(problem.contains(reason), "{problem}");
    // The grabber continues and tries again.
    std::thread::sleep(Duration::from_secs(3));
    let status = group.try_status().unwrap();
    assert_eq!(status["stages"]["grabber"]["restarts"], 0, "{status:#}");
    eprintln!("{state}: {problem}");
}

#[test]
#[ignore = "needs the kernel's virtual camera: scripts/test-v4l2 plays one"]
fn unsupported_settings_are_refused_with_a_reason() {
    refused("vivid-size", "wrong_format", "it has", |config| {
        config.camera.width = 642;
        config.geometry =
            config::GeometryConfig::above(&config.field, config.camera.picture_px(), 2000.0);
    });
    refused("vivid-grey", "wrong_format", "no colour", |config| {
        config.camera.v4l2.format = "GREY".into();
    });
    refused("vivid-control", "wrong_setting", "0 to 255", |config| {
        config.camera.v4l2.controls.insert("brightness".into(), SettingValue::Number(300.0));
    });
    refused("vivid-name", "wrong_setting", "brightness", |config| {
        config.camera.v4l2.controls.insert("brightnes".into(), SettingValue::Number(3.0));
    });
}

#[test]
#[ignore = "needs the kernel's virtual camera: scripts/test-v4l2 plays one"]
fn a_camera_in_use_is_had_when_it_is_free() {
    let (device, fps) = vivid();
    let config = config(fps, "RGGB");
    let scratch = Scratch::new("vivid-busy");
    let file = scratch.write("config.toml", &commented_toml(&config));
    let mut other = support::touchline(
        &scratch,
        &["run", "--instance", "other", "--quiet", "--source", &format!("v4l2:{device}")],
    )
    .args(["--config", file.to_str().unwrap()])
    .spawn()
    .unwrap();
    let deadline = Instant::now() + PATIENCE;
    loop {
        let output = output_of(&scratch, &["status", "--instance", "other", "--json"]);
        let status: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        if camera_state(&status) == "streaming" {
            break;
        }
        assert!(Instant::now() < deadline, "the first group does not stream: {status:#}");
        std::thread::sleep(Duration::from_millis(100));
    }
    let mut group = start("vivid-second", &config, &device);
    group.wait_for("a busy camera", |status| camera_state(status) == "busy");
    let stopped = output_of(&scratch, &["stop", "--instance", "other"]);
    assert!(stopped.status.success(), "{stopped:?}");
    other.wait().unwrap();
    group.wait_for("the camera", |status| camera_state(status) == "streaming");
}

#[test]
#[ignore = "needs the kernel's virtual camera: scripts/test-v4l2 plays one"]
fn a_camera_that_is_unplugged_is_back_without_a_restart() {
    let (device, fps) = vivid();
    let driver = Path::new("/sys/bus/platform/drivers/vivid");
    let plug = |action: &str| std::fs::write(driver.join(action), "vivid.0").unwrap();
    let config = config(fps, "RGGB");
    let mut group = start("vivid-unplugged", &config, &device);
    let status = group.wait_until_working();
    let grabber = Group::pid_of(&status, "grabber");
    plug("unbind");
    let status = group.wait_for("a missing camera", |status| camera_state(status) == "missing");
    assert_eq!(status["stages"]["grabber"]["processes"][0]["state"], "waiting", "{status:#}");
    // Longer than a stall.
    std::thread::sleep(Duration::from_secs(4));
    plug("bind");
    let plugged = Instant::now();
    let world = status["frames"]["world"].as_u64().unwrap();
    let status = group.wait_for("frames", |status| {
        camera_state(status) == "streaming" && status["frames"]["world"].as_u64() > Some(world + 5)
    });
    eprintln!("back {:?} after it was plugged in", plugged.elapsed());
    assert_eq!(Group::pid_of(&status, "grabber"), grabber, "the grabber was restarted");
    assert_eq!(status["camera"]["device"]["starts"], 2, "{status:#}");
    assert!(status["frames"]["never_captured"].as_u64() > Some(0), "{status:#}");
    // Its settings are applied again: a new vivid shows other bars, and text.
    let (_, detections) = watch(&group, 10);
    let covered = coverage(&detections[detections.len() - 1], &config);
    assert!(covered.iter().all(|&(_, share)| share > 0.9), "{covered:?}");
}

#[test]
#[ignore = "needs the kernel's virtual camera: scripts/test-v4l2 plays one"]
fn frames_that_the_driver_drops_are_counted_and_the_camera_is_called_slow() {
    let (device, fps) = vivid();
    let mut config = config(fps, "RGGB");
    let controls = &mut config.camera.v4l2.controls;
    controls.insert("percentage_of_dropped_buffers".into(), SettingValue::Number(40.0));
    let mut group = start("vivid-slow", &config, &device);
    let status = group.wait_for("a slow camera", |status| camera_state(status) == "slow");
    let lost = status["camera"]["device"]["lost"].as_u64().unwrap();
    assert!(lost > 0, "{status:#}");
    let problem = status["camera"]["device"]["problem"].as_str().unwrap();
    assert!(problem.contains("frames a second come"), "{problem}");
    eprintln!("slow: {problem}");
}

/// The wall clock may be set at any moment: no part of the pipeline may depend on it, and the times of
/// a recording continue as they began.
#[test]
#[ignore = "needs the kernel's virtual camera: scripts/test-v4l2 plays one"]
fn a_clock_that_is_set_in_the_middle_of_a_match_does_not_matter() {
    let (device, fps) = vivid();
    let may_set = std::env::var_os("TOUCHLINE_SET_CLOCK").is_some();
    assert!(may_set, "TOUCHLINE_SET_CLOCK allows this test to set the machine's clock");
    let mut group = start("vivid-clock", &config(fps, "RGGB"), &device);
    group.wait_for("a steady stream", |status| status["frames"]["world"].as_u64() > Some(30));
    let file = group.scratch.path.join("match.mcap");
    let args = ["record", file.to_str().unwrap(), "--quiet", "--keep-free", "1M"];
    let mut recorder = group.start_touchline(&args);
    watch(&group, 40);
    for seconds in ["@86400", "@4000000000", "@1700000000"] {
        let set = Command::new("date").args(["-s", seconds]).output().unwrap();
        assert!(set.status.success(), "{set:?}");
        let (headers, _) = watch_without_a_gap(&mut group, seconds);
        let (header, _) = headers[headers.len() - 1];
        let wall_s = header.t_capture_wall_ns / 1_000_000_000;
        let set_s: u64 = seconds[1..].parse().unwrap();
        assert!((set_s..set_s + 60).contains(&wall_s), "{seconds}: {wall_s}");
        assert!(headers.iter().all(|&(_, age)| age < Duration::from_secs(1)), "{headers:?}");
    }
    group.signal(recorder.id(), rustix::process::Signal::INT);
    assert!(recorder.wait().unwrap().success());
    let status = group.try_status().unwrap();
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    for (stage, what) in status["stages"].as_object().unwrap() {
        assert_eq!(what["restarts"], 0, "{stage}: {status:#}");
    }
    let info = output_of(&group.scratch, &["info", "--json", file.to_str().unwrap()]);
    let info: Value = serde_json::from_slice(&info.stdout).unwrap();
    assert!(info["seconds"].as_f64() < Some(120.0), "{info:#}");
    let output = output_of(&group.scratch, &["replay", "--verify", file.to_str().unwrap()]);
    assert!(output.status.success(), "{output:?}");
    eprintln!("recorded over three settings of the clock: {} s", info["seconds"]);
}
