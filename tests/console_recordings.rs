//! Recordings in the console: made there, listed, looked at, compared, exported, with and without a match.

mod browser;
mod support;

use browser::Browser;
use rustix::process::Signal;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};
use support::{Group, PATIENCE, Scratch};

const CONSOLE: &str = "[camera]\nfps = 40\n[console]\nlisten = \"127.0.0.1:0\"\n";

fn end(mut group: Group) {
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

fn eventually<T>(what: &str, mut question: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + PATIENCE;
    loop {
        if let Some(answer) = question() {
            return answer;
        }
        assert!(Instant::now() < deadline, "{what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn running(browser: &Browser) -> Value {
    browser.get("/api/status").json()["recording"].clone()
}

/// Address of the recording of this name.
fn address_of(browser: &Browser, name: &str) -> String {
    let list = browser.get("/api/recordings").json();
    let all = list["recordings"].as_array().unwrap();
    let found = all.iter().find(|it| it["name"] == name).unwrap_or_else(|| panic!("{list:#}"));
    format!("/api/recordings/{}/{name}", found["place"].as_str().unwrap())
}

/// Header and picture of an answer in the form of `/frame`.
fn parts(body: &[u8]) -> (Value, &[u8]) {
    let (length, rest) = body.split_at(4);
    let (header, picture) = rest.split_at(u32::from_le_bytes(length.try_into().unwrap()) as usize);
    (serde_json::from_slice(header).unwrap(), picture)
}

/// Records some seconds with a mark, a changed configuration, and a recorder that sleeps for a while.
fn make(group: &mut Group, browser: &Browser, path: &Path) {
    let started = browser.post("/api/record", &json!({ "start": true, "path": path }));
    assert_eq!(started.status, 200, "{}", started.error());
    eventually("it grows", || (running(browser)["bytes"].as_u64() > Some(500_000)).then_some(()));
    assert_eq!(running(browser)["lost"], 0);
    assert_eq!(browser.post("/api/mark", &json!({ "text": "a goal" })).status, 200);
    let set = json!({ "base_revision": 1, "set": { "filter.actuation_delay_ms": 61 } });
    assert_eq!(browser.post("/api/reload", &set).status, 200);
    group.wait_for("the changed configuration", |status| {
        let configuration = &status["configuration"];
        configuration["revision"] == 2
            && configuration["pending"].as_array().is_some_and(Vec::is_empty)
    });
    let name = format!("record .* {}", path.display());
    let found = Command::new("pgrep").args(["-f", &name]).output().unwrap();
    let pid: u32 = String::from_utf8(found.stdout).unwrap().trim().parse().unwrap();
    group.signal(pid, Signal::STOP);
    let frames = |status: &Value| status["frames"]["captured"].as_u64();
    let before = frames(&group.wait_until_working());
    // More than the topic keeps for a reader.
    group.wait_for("frames", |status| frames(status) > before.map(|count| count + 120));
    group.signal(pid, Signal::CONT);
    eventually("the loss is told", || (running(browser)["lost"].as_u64() > Some(0)).then_some(()));
    let before = frames(&group.wait_until_working());
    group.wait_for("frames", |status| frames(status) > before.map(|count| count + 40));
    assert_eq!(browser.post("/api/record", &json!({ "start": false })).status, 200);
}

#[test]
fn a_recording_is_made_looked_at_compared_and_exported() {
    let mut group = Group::start_without("console-archive", CONSOLE, "TOUCHLINE_NO_CONSOLE");
    group.wait_for("a match with all robots", |status| status["found"]["robots"] == 10);
    let browser = Browser::of(&mut group);
    let list = browser.get("/api/recordings").json();
    assert_eq!((&list["recordings"], &list["played"]), (&json!([]), &Value::Null));
    let path = group.scratch.path.join("the match.mcap");
    make(&mut group, &browser, &path);

    let base = address_of(&browser, "the match.mcap").replace(' ', "%20");
    let about = browser.get(&base).json();
    assert_eq!(about["configurations"].as_array().unwrap().len(), 2, "{about:#}");
    let survey = eventually("everything was looked at", || {
        let survey = browser.get(&format!("{base}/survey?bins=50")).json();
        (survey["done"] == 1.0).then_some(survey)
    });
    assert!(
        survey["gaps"].as_array().unwrap().iter().any(|gap| gap["missing"].as_u64() > Some(20))
    );
    let events = survey["events"].as_array().unwrap();
    let mark = events.iter().find(|event| event["kind"] == "marked");
    assert_eq!(mark.unwrap_or_else(|| panic!("{survey:#}"))["what"], "a goal");

    let body = browser.get(&format!("{base}/frame?index=5&scale=1&runs=1")).body;
    let (frame, picture) = parts(&body);
    assert_eq!(frame["detections"]["robots"].as_array().unwrap().len(), 10, "{frame:#}");
    assert_eq!(frame["world"]["seq"], frame["seq"]);
    assert!(!frame["runs"].as_array().unwrap().is_empty());
    assert_eq!(image::load_from_memory(picture).unwrap().width(), 640);
    let png = browser.get(&format!("{base}/frame.png?index=5"));
    assert_eq!(image::load_from_memory(&png.body).unwrap().width(), 640);
    let model = browser.get(&format!("{base}/model?revision=2")).json();
    assert_eq!(model["robots"].as_array().unwrap().len(), 10);

    // With a colour that nothing has, its team is not found: with the reason, robot by robot.
    let with =
        json!({ "group": { "set": { "teams.yellow.color": "pink", "ball.color": "yellow" } } });
    let asked = browser
        .post(&format!("{base}/compare"), &json!({ "with": with, "from_s": 0, "to_s": 0.5 }));
    assert_eq!(asked.status, 200, "{}", asked.error());
    let compared = eventually("the comparison", || {
        let comparison = browser.get(&format!("{base}/survey")).json()["comparison"].clone();
        (comparison["is_done"] == true).then_some(comparison)
    });
    assert!(compared["frames"].as_u64() > Some(5), "{compared:#}");
    assert_eq!(compared["different"], compared["frames"], "{compared:#}");
    let body = browser.get(&format!("{base}/frame?index=5")).body;
    assert!(parts(&body).0["other"]["detections"].is_object());
    assert_eq!(browser.post(&format!("{base}/stop"), &json!({})).status, 200);

    let csv = browser.get(&format!("{base}/export/csv"));
    assert!(csv.header("content-disposition").unwrap().contains("the_match.csv"));
    let csv = dechunked(&csv.body);
    let table = String::from_utf8(csv).unwrap();
    assert!(table.starts_with("source,seq,"), "{}", &table[..100]);
    let file = group.scratch.path.join("table.csv");
    let export = ["export", path.to_str().unwrap(), "--csv", file.to_str().unwrap()];
    assert!(support::output_of(&group.scratch, &export).status.success());
    assert!(table == fs::read_to_string(&file).unwrap(), "as the command line writes it");
    let log = browser.get(&format!("{base}/export/ssl-log"));
    assert!(dechunked(&log.body).starts_with(b"SSL_LOG_FILE"));

    refuses_what_it_should(&browser, &base);
    // The match has felt nothing, and nothing was written.
    let status = group.wait_until_working();
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    assert_eq!(status["attendants"]["console"]["restarts"], 0, "{status:#}");
    play_it(group, &path);
}

fn refuses_what_it_should(browser: &Browser, base: &str) {
    let place = base.rsplit_once('/').unwrap().0;
    for (path, status) in [
        (format!("{base}/frame"), 400),
        (format!("{base}/frame?index=-1"), 400),
        (format!("{base}/frame?time_s=nan"), 400),
        (format!("{base}/frame?index=1&scale=9"), 422),
        (format!("{base}/frame?difference_after=99999999"), 422),
        (format!("{base}/export/exe"), 404),
        (format!("{place}/..%2f..%2fetc%2fpasswd.mcap"), 404),
        (format!("{place}/config.toml"), 404),
        (format!("{place}/nothing.mcap"), 404),
        ("/api/recordings/00000000/the%20match.mcap".into(), 404),
        ("/api/recordings/%00/a.mcap".into(), 404),
    ] {
        let answer = browser.get(&path);
        assert_eq!(answer.status, status, "{path}: {}", String::from_utf8_lossy(&answer.body));
    }
    let compare = format!("POST {base}/compare");
    for rubbish in ["{", "[]", "{\"with\":{\"preset\":7}}", "{\"with\":{\"text\":{}}}"] {
        let origin = browser.origin();
        let answer = browser.ask(&compare, &[("Origin", &origin)], rubbish).unwrap();
        assert!([400, 422].contains(&answer.status), "{rubbish}: {}", answer.status);
    }
}

/// Ends the match, and looks at its recording in a console that has no match.
fn play_it(mut group: Group, path: &Path) {
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
    let scratch = Scratch::new("console-alone");
    let copy = scratch.path.join("match.mcap");
    fs::rename(path, &copy).unwrap();
    fs::write(scratch.path.join("other.mcap"), "not played").unwrap();
    drop(group);
    let source = format!("recording:{}", copy.display());
    let config =
        scratch.write("console.toml", "[console]\nlisten = \"127.0.0.1:0\"\n[camera]\nfps = 40\n");
    let config = config.to_str().unwrap().to_string();
    let mut group = Group::start_console(scratch, &["--source", &source, "--config", &config]);
    group.wait_until_working();
    let browser = Browser::of(&mut group);
    let hello = browser.get("/api/hello").json();
    assert_eq!(hello["alone"], true, "{hello}");
    let list = browser.get("/api/recordings").json();
    assert_eq!(list["played"], copy.to_str().unwrap());
    assert_eq!(list["recordings"].as_array().unwrap().len(), 1, "only what is played: {list:#}");
    let base = address_of(&browser, "match.mcap");
    assert!(browser.get(&base).json()["frames"].as_u64() > Some(50));
    // The page would end with the recording if it were played once.
    group.wait_for("the beginning again", |status| {
        status["frames"]["captured"].as_u64() > Some(50)
            && status["source"].as_str().unwrap().contains(",loop")
    });
    end(group);
}

#[test]
fn a_damaged_or_vanishing_recording_is_told_and_ends_nothing() {
    let scratch = Scratch::new("console-shelf");
    let shelf = scratch.path.join("shelf");
    fs::create_dir_all(&shelf).unwrap();
    fs::write(shelf.join("nothing.mcap"), "no recording").unwrap();
    fs::write(shelf.join("short.mcap"), b"\x89MCAP0\r\n").unwrap();
    // Who may only watch may look, but not let compute.
    let config = format!(
        "{CONSOLE}read_only = true\nrecordings = [\"{}\", \"/nowhere\"]\n",
        shelf.display()
    );
    let mut group = Group::start_without("console-shelves", &config, "TOUCHLINE_NO_CONSOLE");
    group.wait_until_working();
    let browser = Browser::of(&mut group);
    for name in ["nothing.mcap", "short.mcap"] {
        let base = address_of(&browser, name);
        for path in ["", "/frame?index=0", "/survey", "/model"] {
            let answer = browser.get(&format!("{base}{path}"));
            assert_eq!(answer.status, 422, "{name}{path}: {}", answer.error());
        }
        let body = json!({ "with": { "revision": 1 }, "from_s": 0, "to_s": 1 });
        assert_eq!(browser.post(&format!("{base}/compare"), &body).status, 403);
        // The second one ends before anything was recorded, which makes an empty table.
        let is_whole = dechunks(&browser.get(&format!("{base}/export/csv")).body);
        assert_eq!(is_whole, name == "short.mcap", "{name}");
    }
    let base = address_of(&browser, "nothing.mcap");
    fs::remove_file(shelf.join("nothing.mcap")).unwrap();
    assert_eq!(browser.get(&base).status, 404);
    let status = group.wait_until_working();
    assert_eq!(status["attendants"]["console"]["restarts"], 0, "{status:#}");
    end(group);
}

/// The content of an answer that comes in chunks.
fn dechunked(body: &[u8]) -> Vec<u8> {
    let (content, is_whole) = read_chunks(body);
    assert!(is_whole, "it was cut off");
    content
}

/// Whether an answer that comes in chunks is whole.
fn dechunks(body: &[u8]) -> bool {
    read_chunks(body).1
}

fn read_chunks(mut body: &[u8]) -> (Vec<u8>, bool) {
    let mut content = Vec::new();
    loop {
        let Some(end) = body.windows(2).position(|pair| pair == b"\r\n") else {
            return (content, false);
        };
        let length = std::str::from_utf8(&body[..end])
            .ok()
            .and_then(|it| usize::from_str_radix(it, 16).ok());
        match length {
            Some(0) => return (content, true),
            Some(length) if body.len() >= end + 4 + length => {
                content.extend(&body[end + 2..end + 2 + length]);
                body = &body[end + 4 + length..];
            }
            _ => return (content, false),
        }
    }
}
