//! The console's page: its types, its pure parts, and the page in a browser against a live group. The tests
//! themselves are in `tests/console`.

mod support;

use rustix::process::Signal;
use std::path::{Path, PathBuf};
use std::process::Command;
use support::Group;

/// Any free port: tests of several checkouts may run at the same time.
const CONFIG: &str = "[camera]\nfps = 40\n[console]\nlisten = \"127.0.0.1:0\"\n";

/// A pitch that no preset describes. The synthetic match goes on painting it when the configuration is replaced.
const PITCH: &str = r#"
preset = "mirosot-triangles"
[camera]
fps = 20
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
/// Its colours; the name, and the looks.
const COLORS: [(&str, [u8; 3]); 8] = [
    ("orange", [200, 95, 40]),
    ("yellow", [190, 180, 60]),
    ("blue", [30, 60, 160]),
    ("green", [30, 140, 60]),
    ("cyan", [60, 170, 180]),
    ("pink", [200, 100, 160]),
    ("violet", [95, 40, 150]),
    ("red", [160, 25, 40]),
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
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&text));
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
    in_a_browser("console-setup", &format!("{PITCH}{colors}"), "setup.test.mjs");
}

/// Runs tests of the page against a group with this configuration.
fn in_a_browser(name: &str, config: &str, tests: &str) {
    let mut group = Group::start_without(name, config, "TOUCHLINE_NO_CONSOLE");
    group.wait_until_working();
    let told = group.stderr();
    let address = told.split_whitespace().find(|word| word.starts_with("http://"));
    node(&["--test", tests], &[("TOUCHLINE_CONSOLE", address.expect("an address"))]);
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}
