//! The console's page: its types, its pure parts, and the page in a browser against a live group. The tests
//! themselves are in `tests/console`.

mod support;

use rustix::process::Signal;
use std::path::{Path, PathBuf};
use std::process::Command;
use support::Group;

/// Any free port: tests of several checkouts may run at the same time.
const CONFIG: &str = "[camera]\nfps = 40\n[console]\nlisten = \"127.0.0.1:0\"\n";

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
    let mut group = Group::start_without("console-page", CONFIG, "TOUCHLINE_NO_CONSOLE");
    group.wait_until_working();
    let told = group.stderr();
    let address = told.split_whitespace().find(|word| word.starts_with("http://"));
    node(&["--test", "page.test.mjs"], &[("TOUCHLINE_CONSOLE", address.expect("an address"))]);
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}
