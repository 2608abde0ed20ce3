//! Every system call of the supervisor fails once in every place where it is made, in the middle of a match
//! and during a take-over, and the match continues. `src/supervisor/sys.rs` makes them fail.

mod support;

use rustix::process::Signal;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;
use std::time::Duration;
use support::{Group, PATIENCE};

const FAULTS: (&str, &str) = ("TOUCHLINE_SYSTEM_FAULTS", "once");
const SPARED: [&str; 3] = ["classifier", "tracker", "filter"];
/// The frame that kills every process; its evidence is kept by a thread.
const POISON: u64 = 160;

/// Every place in the supervisor's sources where a call is made that can be made to fail, as `file:line`.
fn all_places() -> BTreeSet<String> {
    let (mut places, mut folders) = (BTreeSet::new(), vec![PathBuf::from("src/supervisor")]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let text = fs::read_to_string(&path).unwrap();
            let is_call = |line: &str| {
                let code = line.split("//").next().unwrap();
                ["sys::ask(", "sys::fault(", "sys::check("].iter().any(|it| code.contains(it))
            };
            let numbered = (1..).zip(text.lines()).filter(|(_, line)| is_call(line));
            places.extend(numbered.map(|(number, _)| format!("{}:{number}", path.display())));
        }
    }
    places
}

fn failed_places(said: &str) -> BTreeSet<String> {
    let place = |line: &str| {
        let rest = line.strip_prefix("touchline: made to fail at ")?;
        Some(rest.split(": ").next()?.to_string())
    };
    said.lines().filter_map(place).collect()
}

fn is_whole(status: &Value) -> bool {
    status["complete"] == true
        && SPARED.iter().all(|stage| {
            let processes = status["stages"][stage]["processes"].as_array().unwrap();
            processes.iter().any(|process| process["state"] == "spare")
        })
}

fn world(status: &Value) -> u64 {
    status["frames"]["world"].as_u64().unwrap()
}

fn replace(group: &mut Group, stage: &str, signal: Signal) -> Value {
    let pid = Group::pid_of(&group.wait_for("spares", is_whole), stage);
    group.signal(pid, signal);
    group
        .wait_for("a replacement", |status| is_whole(status) && Group::pid_of(status, stage) != pid)
}

#[test]
fn a_match_survives_every_call_refused_once() {
    let poison = format!("tracker@{POISON}");
    let variables = [FAULTS, ("TOUCHLINE_FAULT", poison.as_str())];
    // At this rate what is kept for late readers lasts for 1.6 s: a stage whose process and spare have died of the
    // same frame may be refused its next start, too, and has to be begun from nothing on a busy machine.
    // The publisher is an attendant, which the supervisor starts too.
    let config =
        "[camera]\nfps = 40.0\n[publish]\njson.enabled = true\njson.to = [\"127.0.0.1:1\"]\n";
    let mut group = Group::start_with("faults", config, &[], &variables);
    group.wait_for("the frame after the poisoned one", |status| {
        is_whole(status) && world(status) > POISON + 10
    });
    for stage in SPARED {
        replace(&mut group, stage, Signal::KILL);
    }
    // A stall: the supervisor checks whether the late process got a processor.
    replace(&mut group, "filter", Signal::STOP);
    let restarted = group.touchline(&["restart", "tracker"]);
    assert!(restarted.status.success(), "{restarted:?}");
    // The first time the new configuration cannot be written.
    let reload = |group: &Group| group.touchline(&["reload", "--set", "tracker.min_region_px=7"]);
    let refused = reload(&group);
    assert!(!refused.status.success(), "{refused:?}");
    let reloaded = reload(&group);
    assert!(reloaded.status.success(), "{reloaded:?}");
    // The supervisor may write into it meanwhile.
    while fs::remove_dir_all(group.instance.directory()).is_err() {}
    let config = group.instance.config_path();
    let status =
        group.wait_for("everything put back", |status| is_whole(status) && config.exists());
    std::thread::sleep(Duration::from_secs(2));
    let status = group.wait_for("more frames", |now| world(now) > world(&status) + 80);
    for nothing in ["never_captured", "duplicates_in_world"] {
        assert_eq!(status["frames"][nothing], 0, "{nothing}: {status:#}");
    }
    let missing = status["frames"]["missing_in_world"].as_u64().unwrap();
    assert!(missing <= 1, "more than the poisoned frame: {status:#}");
    assert_eq!(status.get("degraded"), None, "{status:#}");
    let said = group.stderr();

    // And a supervisor that takes over.
    let pids = SPARED.map(|stage| Group::pid_of(&status, stage));
    group.replace_supervisor_with(&[FAULTS]);
    // The publisher, too, which could not be prepared at first.
    let status = group.wait_for("the match", |status| {
        is_whole(status) && world(status) > 80 && status["attendants"]["publisher"]["pid"].is_u64()
    });
    assert_eq!(SPARED.map(|stage| Group::pid_of(&status, stage)), pids, "{}", group.stderr());
    assert_eq!(status["configuration"]["revision"], 2, "{said}");
    replace(&mut group, "classifier", Signal::KILL);
    std::thread::sleep(Duration::from_secs(2));
    let status = group.wait_for("no trouble", |status| status.get("degraded").is_none());
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    assert_eq!(status["frames"]["duplicates_in_world"], 0, "{status:#}");

    let failed = &failed_places(&said) | &failed_places(&group.stderr());
    let all = all_places();
    assert!(all.len() > 30, "{all:?}");
    let never: Vec<_> = all.difference(&failed).collect();
    assert!(never.is_empty(), "these calls were never made to fail: {never:?}");
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success(), "within {PATIENCE:?}: {}", group.stderr());
    group.assert_nothing_left();
}
