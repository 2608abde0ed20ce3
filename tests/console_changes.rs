//! Changes through the console of a running group.

mod browser;
mod support;

use browser::Browser;
use rustix::process::Signal;
use serde_json::{Value, json};
use std::fs;
use std::process::Command;
use std::time::{Duration, Instant};
use support::{Group, PATIENCE};

const CONSOLE: &str = "# our pitch\n[camera]\nfps = 40\n[console]\nlisten = \"127.0.0.1:0\"\n\
                       [supervisor]\norphan_timeout_s = 3\n[filter] # tuned\nactuation_delay_ms = 50 # measured\n";

fn start(name: &str) -> (Group, Browser) {
    let mut group = Group::start_without(name, CONSOLE, "TOUCHLINE_NO_CONSOLE");
    group.wait_until_working();
    let browser = Browser::of(&mut group);
    (group, browser)
}

fn end(mut group: Group) {
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

fn revision(browser: &Browser) -> u64 {
    browser.get("/api/config").json()["revision"].as_u64().unwrap()
}

#[test]
fn a_configuration_is_tried_changed_taken_back_and_saved() {
    let (mut group, browser) = start("console-change");
    let set = |value: Value| json!({ "filter.actuation_delay_ms": value });
    let reload = |base: u64, set: Value, dry: bool| {
        browser.post("/api/reload", &json!({ "base_revision": base, "set": set, "dry_run": dry }))
    };
    let before = browser.get("/api/config").json();
    assert_eq!(before["values"]["filter"]["actuation_delay_ms"], 50.0);
    assert_eq!((&before["saved"], &before["file_changed"]), (&json!(true), &json!(false)));

    let tried = reload(1, set(json!(61)), true);
    assert_eq!(tried.json()["stages"], json!(["filter"]), "{}", tried.error());
    assert_eq!(revision(&browser), 1);
    let done = reload(1, set(json!(61)), false);
    assert_eq!((done.status, &done.json()["revision"]), (200, &json!(2)));
    assert_eq!(reload(1, set(json!(62)), false).status, 409, "somebody has seen something older");
    let refused = reload(2, set(json!(-1)), false);
    assert_eq!(
        (refused.status, &refused.json()["error"]["key"]),
        (422, &json!("filter.actuation_delay_ms"))
    );
    let text = "[filter]\nactuation_delay = 5\n";
    let refused = browser.post("/api/reload", &json!({ "base_revision": 2, "text": text }));
    assert_eq!((refused.status, &refused.json()["error"]["line"]), (422, &json!(2)));
    assert_eq!(browser.post("/api/rollback", &json!({})).json()["revision"], 3);
    assert_eq!(reload(3, set(json!(63)), false).status, 200);

    // The file is written only on request, keeps its comments, and is not overwritten unseen.
    let file = group.scratch.path.join("config.toml");
    assert_eq!(fs::read_to_string(&file).unwrap(), CONSOLE);
    let config = browser.get("/api/config").json();
    assert_eq!((&config["saved"], &config["file_changed"]), (&json!(false), &json!(false)));
    fs::write(&file, format!("{CONSOLE}# by another editor\n")).unwrap();
    let save =
        |hash: &Value| browser.post("/api/save", &json!({ "path": null, "base_hash": hash }));
    assert_eq!(save(&config["hash"]).status, 409);
    let seen = browser.get("/api/config").json();
    let saved = save(&seen["hash"]);
    assert_eq!(saved.status, 200, "{}", saved.error());
    let text = fs::read_to_string(&file).unwrap();
    let expected = CONSOLE.replace("= 50 #", "= 63.0 #");
    assert_eq!(text, format!("{expected}# by another editor\n"));
    assert_eq!(browser.get("/api/config").json()["saved"], true);
    // Somewhere else, but not over anything.
    let new = group.scratch.path.join("new.toml");
    let save_as = |path: &std::path::Path| browser.post("/api/save", &json!({ "path": path }));
    assert_eq!(save_as(&new).status, 200);
    assert!(config::Config::load(&new).unwrap().filter.actuation_delay_ms == 63.0);
    assert_eq!(save_as(&new).status, 422);
    assert_eq!(save_as(&group.scratch.path.join("passwd")).status, 422);

    let status = group.wait_for("the newest configuration", |status| {
        status["configuration"]["pending"].as_array().is_some_and(Vec::is_empty)
    });
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    end(group);
}

#[test]
fn processes_are_restarted_and_moments_marked_and_recorded() {
    let (mut group, browser) = start("console-acts");
    let before = group.wait_until_working();
    let answer = browser.post("/api/restart", &json!({ "process": "tracker" }));
    assert_eq!(answer.status, 200, "{}", answer.error());
    let pid = Group::pid_of(&before, "tracker");
    group.wait_for("another tracker", |status| {
        status["complete"] == true && Group::pid_of(status, "tracker") != pid
    });
    assert_eq!(browser.post("/api/restart", &json!({ "process": "init" })).status, 422);

    assert_eq!(browser.post("/api/mark", &json!({ "text": "a goal\u{1b}[2J" })).status, 200);
    assert_eq!(browser.post("/api/mark", &json!({ "text": " " })).status, 422);
    group.wait_for("the mark", |status| {
        let mut events = status["events"].as_array().unwrap().iter();
        events.any(|event| event["kind"] == "marked" && event["what"] == "a goal[2J")
    });

    let path = group.scratch.path.join("match.mcap");
    let record = |body: Value| browser.post("/api/record", &body);
    assert_eq!(record(json!({ "start": false })).status, 409);
    let started = record(json!({ "start": true, "path": path }));
    assert_eq!(started.status, 200, "{}", started.error());
    assert_eq!(record(json!({ "start": true })).status, 409, "one at a time");
    let deadline = Instant::now() + PATIENCE;
    loop {
        let recording = browser.get("/api/status").json()["recording"].clone();
        if recording["bytes"].as_u64() > Some(100_000) {
            break;
        }
        assert!(Instant::now() < deadline, "{recording}");
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(record(json!({ "start": false })).status, 200);
    assert!(browser.get("/api/status").json()["recording"].is_null());
    let info = group.scratch.path.join("match.mcap");
    let info = support::output_of(&group.scratch, &["info", info.to_str().unwrap()]);
    assert!(info.status.success(), "{info:?}");

    let metrics = String::from_utf8(browser.get("/metrics").body).unwrap();
    assert!(metrics.contains("touchline_complete{instance=\"test\"} 1"), "{metrics}");
    let presets = browser.get("/api/presets").json();
    assert_eq!(presets.as_array().unwrap().len(), config::Preset::ALL.len());
    assert!(browser.get("/api/schema").json()["properties"]["console"].is_object());
    end(group);
}

#[test]
fn spectators_and_foreign_pages_change_nothing() {
    let (group, browser) = start("console-watch");
    let body =
        json!({ "base_revision": 1, "set": { "filter.actuation_delay_ms": 61 } }).to_string();
    let post = |headers: &[(&str, &str)]| browser.ask("POST /api/reload", headers, &body).unwrap();
    assert_eq!(post(&[]).status, 403, "no origin, no token");
    assert_eq!(post(&[("Origin", "http://evil.example")]).status, 403);
    assert_eq!(post(&[("Origin", "null")]).status, 403);
    // As a form, which needs no permission of the browser.
    let form = [("Origin", "http://evil.example"), ("Content-Type", "text/plain")];
    assert_eq!(post(&form).status, 403);
    let large = "x".repeat(2 << 20);
    let own = browser.origin();
    let answer = browser.ask("POST /api/reload", &[("Origin", &own)], &large);
    assert!(answer.is_none_or(|answer| answer.status == 413));
    // Promised, and never sent.
    let head = format!(
        "POST /api/reload HTTP/1.1\r\nHost: {}\r\nOrigin: {own}\r\nContent-Length: 100000000\r\n\r\n",
        browser.address
    );
    let mut silent = browser.connect().unwrap();
    std::io::Write::write_all(&mut silent, head.as_bytes()).unwrap();
    for path in ["/api/save", "/api/mark", "/api/record", "/api/restart", "/api/setup/try"] {
        for rubbish in ["{", "[1]", "\"\u{0}\"", "{\"x\":1}"] {
            let answer =
                browser.ask(&format!("POST {path}"), &[("Origin", &own)], rubbish).unwrap();
            assert!((400..504).contains(&answer.status), "{path} {rubbish}: {}", answer.status);
        }
    }
    assert_eq!(
        browser.ask("POST /api/setup/..%2f..", &[("Origin", &own)], "{}").unwrap().status,
        404
    );
    assert_eq!(browser.ask("DELETE /api/config", &[("Origin", &own)], "").unwrap().status, 405);
    assert_eq!(revision(&browser), 1);
    let token = format!("Bearer {}", browser.place.change);
    assert_eq!(post(&[("Authorization", &token)]).status, 200, "a program");
    assert_eq!(revision(&browser), 2);
    end(group);
}

#[test]
fn a_read_only_console_for_other_computers_needs_its_token() {
    let config = "[camera]\nfps = 40\n[console]\nlisten = \"0.0.0.0:0\"\nread_only = true\n\
                  allow_hosts = [\"pitch.example\"]\n";
    let mut group = Group::start_without("console-lan", config, "TOUCHLINE_NO_CONSOLE");
    group.wait_until_working();
    let browser = Browser::of(&mut group);
    assert!(!group.stderr().contains(&browser.place.change), "{}", group.stderr());
    let host = [("Host", "pitch.example")];
    let ask = |headers: &[(&str, &str)]| browser.ask("GET /api/hello", headers, "").unwrap();
    assert_eq!(ask(&host).status, 401, "a proxy may run as anybody");
    let cookie = format!("touchline-{}={}", browser.address.port(), browser.place.change);
    let hello = ask(&[("Host", "pitch.example"), ("Cookie", &cookie)]);
    assert_eq!(hello.json()["rights"], "watch");
    let headers =
        [("Host", "pitch.example"), ("Cookie", &cookie), ("Origin", "http://pitch.example")];
    let change = browser.ask("POST /api/rollback", &headers, "{}").unwrap();
    assert_eq!(change.status, 403);
    end(group);
}

#[test]
fn a_job_of_the_set_up_answers_and_ends_with_its_client() {
    let (group, browser) = start("console-job");
    let tried = browser.post("/api/setup/try", &json!({ "set": {} }));
    assert_eq!(tried.status, 200, "{}", tried.error());
    assert_eq!(browser.post("/api/setup/nonsense", &json!({})).status, 422);
    // A client that leaves in the middle: the worker is gone soon, and its place is free.
    let body = json!({ "frames": 60 }).to_string();
    let head = format!(
        "POST /api/setup/learn HTTP/1.1\r\nHost: {}\r\nOrigin: {}\r\nContent-Length: {}\r\n\r\n{body}",
        browser.address,
        browser.origin(),
        body.len()
    );
    let mut leaving = browser.connect().unwrap();
    std::io::Write::write_all(&mut leaving, head.as_bytes()).unwrap();
    let workers = || {
        let name = format!("setup-worker learn --instance {}", group.instance.name());
        let found =
            Command::new("pgrep").args(["-f", "-P"]).arg(console_pid(&browser)).arg(&name).output();
        found.is_ok_and(|output| !output.stdout.is_empty())
    };
    let deadline = Instant::now() + PATIENCE;
    while !workers() {
        assert!(Instant::now() < deadline, "it does not start");
        std::thread::sleep(Duration::from_millis(5));
    }
    drop(leaving);
    while workers() {
        assert!(Instant::now() < deadline, "it goes on");
        std::thread::sleep(Duration::from_millis(20));
    }
    let again = browser.post("/api/setup/try", &json!({ "set": {} }));
    assert_eq!(again.status, 200, "{}", again.error());
    end(group);
}

fn console_pid(browser: &Browser) -> String {
    browser.get("/api/status").json()["attendants"]["console"]["pid"].to_string()
}
