//! The console's page: its types, its pure parts, and the page in a browser against a live group. The tests
//! themselves are in `tests/console`.

mod offline;
mod support;

use config::Config;
use config::snapshot::Snapshot;
use geometry::settings::PatchRole;
use geometry::{CameraModel, FieldPoint, Pose};
use offline::Offline;
use recording::{Channel, Setup, Writer, encode_frame};
use rustix::process::Signal;
use std::path::{Path, PathBuf};
use std::process::Command;
use support::{Group, Scratch};

/// Any free port: tests of several checkouts may run at the same time.
const CONFIG: &str = "[camera]\nfps = 40\n[console]\nlisten = \"127.0.0.1:0\"\n";

/// A pitch that no preset describes. The synthetic match goes on painting it when the configuration is replaced.
const PITCH: &str = r#"
preset = "mirosot-triangles"
[camera]
fps = 10
[synthetic]
max_speed_mm_s = 300
[console]
listen = "127.0.0.1:0"
[field]
length_mm = 1900
width_mm = 1500
goal_width_mm = 360
goal_depth_mm = 120
center_circle_radius_mm = 170
[geometry]
camera_mm = [-60, 50, 2100]
points = [
    { field_mm = [-950, 750], image_px = [80, 52] },
    { field_mm = [950, 750], image_px = [572, 38] },
    { field_mm = [950, -750], image_px = [590, 440] },
    { field_mm = [-950, -750], image_px = [62, 425] },
]
[geometry.distortion]
k1 = -0.05
"#;
/// Its colours; the name, and the looks. With those of the preset a fifth of the robots is found; the ball
/// is as orange as anybody's.
const COLORS: [(&str, [u8; 3]); 8] = [
    ("orange", [205, 95, 40]),
    ("yellow", [200, 200, 90]),
    ("blue", [45, 90, 200]),
    ("green", [90, 150, 40]),
    ("cyan", [60, 170, 140]),
    ("pink", [220, 90, 110]),
    ("violet", [110, 45, 120]),
    ("red", [120, 20, 30]),
];

fn directory() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/console")
}

/// Runs a program of Node.js in the directory of the page's tests.
fn node(arguments: &[&str], variables: &[(&str, &str)]) {
    let mut command = Command::new("node");
    command.args(arguments).envs(variables.iter().copied()).current_dir(directory());
    let output = command.output().expect("node runs");
    let text = [output.stdout, output.stderr].concat();
    println!("{}", String::from_utf8_lossy(&text));
    assert!(output.status.success(), "{arguments:?}");
}

#[test]
#[ignore = "needs Node.js, and `npm ci` in tests/console"]
fn types_of_the_page() {
    node(&["node_modules/typescript/bin/tsc", "--project", "."], &[]);
}

#[test]
#[ignore = "needs Node.js"]
fn pure_parts_of_the_page() {
    node(&["--test", "unit.test.mjs"], &[]);
}

#[test]
#[ignore = "needs Node.js, Chromium, and `npm ci` in tests/console"]
fn the_page_in_a_browser() {
    in_a_browser("console-page", CONFIG, "page.test.mjs");
}

#[test]
#[ignore = "needs Node.js, Chromium, and `npm ci` in tests/console"]
fn a_pitch_set_up_in_a_browser() {
    let color =
        |(name, looks): &(_, _)| format!("[[colors]]\nname = \"{name}\"\nlooks = {looks:?}\n");
    let colors: String = COLORS.iter().map(color).collect();
    let config = format!("{PITCH}{colors}");
    let mut group = Group::start_without("console-setup", &config, "TOUCHLINE_NO_CONSOLE");
    test_page(&mut group, "setup.test.mjs", "");
    // The file that was saved, on pictures of this pitch: a match of its own would be painted as the file says.
    let film = group.scratch.path.join("film.mcap");
    let record =
        ["record", film.to_str().unwrap(), "--seconds", "4", "--quiet", "--topics", "frames"];
    let recorded = group.touchline(&record);
    assert!(recorded.status.success(), "{recorded:?}");
    let saved = std::fs::read_to_string(group.scratch.path.join("config.toml")).unwrap();
    let scratch = Scratch::new("console-setup-film");
    let kept = scratch.path.join("film.mcap");
    std::fs::rename(film, &kept).unwrap();
    end(group);
    let source = format!("recording:{},loop", kept.display());
    let mut again = Group::start("console-setup-again", &saved, &["--source", &source]);
    again.wait_for("ten robots and the ball with the saved file", |status| {
        status["found"]["robots"] == 10 && status["found"]["ball"] == true
    });
    end(again);
}

#[test]
#[ignore = "needs Node.js, Chromium, and `npm ci` in tests/console"]
fn the_page_under_rough_conditions() {
    in_a_browser("console-rough", CONFIG, "rough.test.mjs");
}

#[test]
#[ignore = "needs Node.js, Chromium, and `npm ci` in tests/console"]
fn recordings_in_a_browser() {
    in_a_browser("console-archive-page", CONFIG, "recordings.test.mjs");
}

#[test]
#[ignore = "needs Node.js, Chromium, and `npm ci` in tests/console"]
fn the_reason_for_a_covered_patch_in_a_browser() {
    let scratch = Scratch::new("console-covered");
    let file = scratch.path.join("covered.mcap");
    let robot = record_with_covered_patch(&file);
    let config = scratch.write("console.toml", CONFIG);
    let source = format!("recording:{}", file.display());
    let args = ["--source", &source, "--config", config.to_str().unwrap()];
    test_in_browser(Group::start_console(scratch, &args), "covered.test.mjs", &robot);
}

/// Frames with a patch of a robot covered in the second half; the robot's name.
fn record_with_covered_patch(path: &Path) -> String {
    const FRAMES: u64 = 400;
    const COVER_PX: f64 = 9.0;
    let config = Config::parse(CONFIG, "test").unwrap();
    let camera = &config.camera;
    let model = CameraModel::new(&config.geometry, camera.width, camera.height).unwrap();
    let first = Snapshot::first(config.clone());
    let setup = Setup {
        touchline_version: "test".into(),
        instance: "test".into(),
        wall_minus_monotonic_ns: 0,
        config_toml: first.to_text(),
        revision: 1,
        accepted_wall_ns: 0,
    };
    let mut writer = Writer::create(path, &[Channel::Setup, Channel::Frames]).unwrap();
    let mut game = Offline::new(&config);
    let identity = &config.robots.identities[0];
    let patches = config.robots.patches.iter();
    let centers: Vec<[f64; 2]> = patches
        .filter(|patch| patch.role == PatchRole::Identification)
        .map(|patch| {
            let count = patch.outline_mm.len() as f64;
            [0, 1].map(|axis| patch.outline_mm.iter().map(|point| point[axis]).sum::<f64>() / count)
        })
        .collect();
    let mut data = Vec::new();
    for number in 0..FRAMES {
        let is_it = |it: &&messages::TruthRobot| {
            it.team == identity.team as u32 && it.robot_id == identity.id
        };
        let robot = *game.game.truth().robots().iter().find(is_it).expect("it plays");
        let position = FieldPoint::new(robot.x_mm, robot.y_mm);
        let pose = Pose { position, orientation: robot.orientation };
        let mut pixels = Vec::new();
        game.look(|picture| {
            if number >= FRAMES / 2 {
                for &center in &centers {
                    let place = pose.field_from_robot(center);
                    let at = model.image_from_field(place, config.robots.height_mm);
                    cover(picture, camera.width as usize, [at.x_px, at.y_px], COVER_PX);
                }
            }
            pixels = picture.to_vec();
        });
        game.think();
        let t_ns = game.header.t_capture_ns;
        if number == 0 {
            writer.write(Channel::Setup, t_ns, t_ns, &setup.encode()).unwrap();
        }
        encode_frame(&game.header, &pixels, &mut data);
        writer.write(Channel::Frames, t_ns, t_ns, &data).unwrap();
        game.advance();
    }
    writer.finish().unwrap();
    format!("{} {}", identity.team.name(), identity.id)
}

/// Paints a dark disc.
fn cover(picture: &mut [u8], width: usize, [x_px, y_px]: [f64; 2], radius_px: f64) {
    for (index, pixel) in picture.iter_mut().enumerate() {
        let (x, y) = ((index % width) as f64, (index / width) as f64);
        if (x - x_px).hypot(y - y_px) < radius_px {
            *pixel = 25;
        }
    }
}

/// Runs tests of the page against a group with this configuration.
fn in_a_browser(name: &str, config: &str, tests: &str) {
    let group = Group::start_without(name, config, "TOUCHLINE_NO_CONSOLE");
    test_in_browser(group, tests, "");
}

/// Runs tests of the page against a group, and ends the group. `robot`: the one that a test is about.
fn test_in_browser(mut group: Group, tests: &str, robot: &str) {
    test_page(&mut group, tests, robot);
    end(group);
}

fn test_page(group: &mut Group, tests: &str, robot: &str) {
    group.wait_until_working();
    let told = group.stderr();
    let address = told.split_whitespace().find(|word| word.starts_with("http://"));
    let address = address.expect("an address");
    node(&["--test", tests], &[("TOUCHLINE_CONSOLE", address), ("TOUCHLINE_ROBOT", robot)]);
}

fn end(mut group: Group) {
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}
