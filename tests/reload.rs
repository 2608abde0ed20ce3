//! Changes of the configuration in the middle of a match.

mod observer;
mod support;

use control::{Request, ask};
use observer::{Observer, Seen};
use rustix::process::Signal;
use serde_json::Value;
use std::fs;
use std::process::Output;
use std::time::{Duration, Instant};
use support::{Group, PATIENCE};

/// Several processes start at once, on a machine that may be busy.
const SMALL: &str = "[camera]\nfps = 40\n";

fn text(output: &Output) -> String {
    [&output.stdout, &output.stderr]
        .map(|bytes| String::from_utf8_lossy(bytes).into_owned())
        .concat()
}

fn revision(status: &Value) -> u64 {
    status["configuration"]["revision"].as_u64().unwrap()
}

fn reload(group: &Group, arguments: &[&str]) -> (bool, String) {
    let output = group.touchline(&[&["reload"], arguments].concat());
    (output.status.success(), text(&output))
}

#[test]
fn a_group_goes_over_to_other_configurations_without_losing_a_frame() {
    let mut group = Group::start("reload", SMALL, &[]);
    group.wait_until_working();
    let observer = Observer::start(&group.instance);
    let (done, said) = reload(&group, &["--set", "filter.actuation_delay_ms=61"]);
    assert!(done && said.contains("to be replaced: filter\n"), "{said}");
    assert!(said.contains("the group runs with revision 2"), "{said}");

    // Other classes: another order of colours. What the one calls 0 is 1 for the other.
    let mut config = config::Config::load(&group.instance.config_path()).unwrap();
    config.colors.swap(0, 1);
    let file = group.scratch.write("swapped.toml", &config::commented_toml(&config));
    for round in 0..3 {
        let (done, said) = reload(&group, &["--config", file.to_str().unwrap()]);
        assert!(done && said.contains("colors.order"), "{said}");
        // A stage dies in the middle of it.
        let status = group.wait_until_working();
        group.signal(
            Group::pid_of(&status, ["classifier", "tracker", "filter"][round]),
            Signal::KILL,
        );
        let output = group.touchline(&["rollback"]);
        assert!(output.status.success(), "{}", text(&output));
    }
    let status = group.wait_until_working();
    assert_eq!(revision(&status), 8);
    assert_eq!(status["configuration"]["history"].as_array().unwrap().len(), 8);
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");

    let seen = observer.finish();
    let last = seen.last().unwrap();
    assert_eq!((last.revisions[0], last.revisions[1]), (8, 8));
    assert!(last.revisions[2] < 8, "the filter is not concerned by colours: {last:?}");
    // No class number was taken for another's: there would be no robots then.
    let known = seen.iter().skip_while(|seen| seen.robots.len() < 10).skip(1);
    assert!(known.clone().count() > 30, "{seen:?}");
    assert!(known.clone().all(|seen| seen.robots.len() == 10), "{:?}", known.collect::<Vec<_>>());
    for numbers in [|seen: &Seen| seen.revisions[0], |seen: &Seen| seen.revisions[2]] {
        assert!(seen.windows(2).all(|pair| numbers(&pair[0]) <= numbers(&pair[1])));
    }
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

#[test]
fn what_cannot_be_is_refused_and_nothing_changes() {
    let mut group = Group::start("refuse", SMALL, &[]);
    let before = group.wait_until_working();
    let snapshot = fs::read(group.instance.config_path()).unwrap();
    for (arguments, hint) in [
        (vec!["--set", "camera.fps"], "KEY=VALUE"),
        (vec!["--set", "camera.fps=-1"], "camera.fps"),
        (vec!["--set", "colors.mauve.red=[1, 2]"], "mauve"),
        (vec!["--config", "/nowhere.toml"], "/nowhere.toml"),
    ] {
        let (done, said) = reload(&group, &arguments);
        assert!(!done && said.contains(hint), "{arguments:?}: {said}");
    }
    let broken = group.scratch.write("broken.toml", "[filter]\nactuation_delay = 5\n");
    let (done, said) = reload(&group, &["--config", broken.to_str().unwrap()]);
    assert!(
        !done && said.contains("broken.toml:2") && said.contains("actuation_delay_ms"),
        "{said}"
    );
    let (done, said) = reload(&group, &["--set", "access.clients=3"]);
    assert!(!done && said.contains("stop it and start it again"), "{said}");
    // Nothing to do is no error, and a dry run does nothing.
    let (done, said) = reload(&group, &[]);
    assert!(done && said.contains("nothing differs"), "{said}");
    let file = group.scratch.path.join("config.toml");
    let text = fs::read_to_string(&file).unwrap();
    let other = "[filter]\nactuation_delay_ms = 44\n[tracker]\nmin_region_px = 7\n";
    let other = group.scratch.write("other.toml", &format!("{text}\n{other}"));
    let arguments = ["--dry-run", "--stages", "filter", "--config", other.to_str().unwrap()];
    let (done, said) = reload(&group, &arguments);
    assert!(done && said.contains("to be replaced: filter\n"), "{said}");
    assert!(said.contains("stays as it runs: tracker.min_region_px (the file has 7)"), "{said}");
    let (done, said) = reload(&group, &["--dry-run", "--set", "tracker.min_region_px=7"]);
    assert!(done && said.contains("to be replaced: tracker\n"), "{said}");
    assert!(!group.touchline(&["rollback"]).status.success(), "there is none before");
    // Somebody who has not seen the newest configuration would undo what was changed meanwhile.
    for base in [0, 2] {
        let request = Request::Reload { file: other.clone(), base: Some(base) };
        let refusal = ask(&group.instance, &request, PATIENCE).unwrap().unwrap_err();
        assert!(refusal.contains("it is revision 1, and this change"), "{refusal}");
    }

    let after = group.wait_until_working();
    assert_eq!(revision(&after), 1);
    assert_eq!(fs::read(group.instance.config_path()).unwrap(), snapshot);
    for stage in ["grabber", "classifier", "tracker", "filter"] {
        assert_eq!(Group::pid_of(&before, stage), Group::pid_of(&after, stage), "{stage}");
    }
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

#[test]
fn a_configuration_that_kills_is_taken_back() {
    let variables = [("TOUCHLINE_FAULT", "tracker@r2")];
    let mut group = Group::start_with("condemned", SMALL, &[], &variables);
    group.wait_until_working();
    let observer = Observer::start(&group.instance);
    let (done, said) = reload(&group, &["--set", "tracker.min_region_px=7"]);
    assert!(!done && said.contains("revision 2 was taken back"), "{said}");
    let deadline = Instant::now() + Duration::from_secs(60);
    let status = group.wait_for("the configuration before", |status| {
        assert!(Instant::now() < deadline, "{status:#}");
        revision(status) == 3 && status["configuration"]["pending"].as_array().unwrap().is_empty()
    });
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    let config = config::Config::load(&group.instance.config_path()).unwrap();
    assert_ne!(config.tracker.min_region_px, 7);
    let seen = observer.finish();
    assert!(
        seen.last().unwrap().revisions[1] == 3 && seen.iter().all(|seen| seen.revisions[1] != 2)
    );
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

#[test]
fn the_next_supervisor_goes_on_with_the_newest_configuration() {
    let mut group = Group::start("composed", SMALL, &[]);
    group.wait_until_working();
    let (done, said) = reload(&group, &["--set", "filter.actuation_delay_ms=61"]);
    assert!(done, "{said}");
    // Started again with the file, which still says something else.
    group.replace_supervisor();
    let status = group.wait_until_working();
    assert_eq!(revision(&status), 2, "{status:#}");
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    let history = status["configuration"]["history"].as_array().unwrap();
    assert_eq!(history.len(), 2, "{history:?}");
    assert_eq!(history[0]["what"], "as the group was started");
    assert!(history[1]["what"].as_str().unwrap().contains("50.0 → 61.0"), "{history:?}");
    assert_eq!(history[1]["hash"], status["configuration"]["hash"]);
    assert_ne!(history[0]["hash"], history[1]["hash"]);
    let (done, said) = reload(&group, &["--set", "filter.actuation_delay_ms=62"]);
    assert!(done && said.contains("61.0 → 62.0"), "{said}");
    assert!(said.contains("revision 3"), "{said}");
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

/// Attendants are restarted only for keys that they read; the monitor goes over by itself.
#[test]
fn attendants_and_monitor_go_over_to_what_concerns_them() {
    let mut group = Group::start("reload-others", SMALL, &["--publish", "json"]);
    let pid = |status: &Value| status["attendants"]["publisher"]["pid"].as_u64();
    let status = group.wait_for("a publisher", |status| {
        pid(status).is_some() && status["complete"] == true && status["publisher"].is_object()
    });
    let first = pid(&status);
    let mut config = config::Config::load(&group.instance.config_path()).unwrap();
    config.filter.actuation_delay_ms = 61.0;
    let robots = config.robots.identities.len();
    let go_over = |group: &Group, config: &config::Config| {
        let file = group.scratch.write("next.toml", &config::commented_toml(config));
        let (done, said) = reload(group, &["--config", file.to_str().unwrap()]);
        assert!(done, "{said}");
    };
    go_over(&group, &config);
    let status = group.wait_until_working();
    assert_eq!((pid(&status), revision(&status)), (first, 2), "{status:#}");
    assert_eq!(status["found"]["robots_configured"], robots);

    config.robots.identities.pop();
    go_over(&group, &config);
    let status = group.wait_for("another publisher", |status| {
        pid(status).is_some_and(|pid| Some(pid) != first) && revision(status) == 3
    });
    assert_eq!(status["found"]["robots_configured"], robots - 1, "{status:#}");
    let second = pid(&status);

    config.camera.fps = 30.0;
    go_over(&group, &config);
    let status = group.wait_for("another rate", |status| {
        pid(status).is_some_and(|pid| Some(pid) != second) && status["camera"]["fps"] == 30.0
    });
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

#[test]
fn a_watched_file_is_used_when_it_changes_and_when_it_is_valid() {
    let mut group = Group::start("watched", SMALL, &["--watch"]);
    group.wait_until_working();
    let file = group.scratch.path.join("config.toml");
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, format!("{text}\n[filter]\nactuation_delay_ms = -4\n")).unwrap();
    let deadline = Instant::now() + Duration::from_secs(60);
    while !group.stderr().contains("actuation_delay_ms") {
        assert!(Instant::now() < deadline, "{}", group.stderr());
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(revision(&group.wait_until_working()), 1);
    fs::write(&file, format!("{text}\n[filter]\nactuation_delay_ms = 44\n")).unwrap();
    let status = group.wait_for("the new configuration", |status| revision(status) == 2);
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}
