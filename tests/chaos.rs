//! Short `touchline chaos` runs of the real program: whatever the machine's speed, nothing may be lost.

mod support;

use serde_json::Value;
use support::{Scratch, touchline};

#[test]
fn a_match_goes_on_through_kills_and_pauses_without_losing_a_frame() {
    let scratch = Scratch::new("chaos");
    let report_path = scratch.path.join("report.json");
    let output = touchline(
        &scratch,
        &[
            "chaos",
            "--seconds",
            "8",
            "--every",
            "500",
            "--signals",
            "kill,pause,restart",
            "--bystanders",
            "--seed",
            "3",
            "--report",
            report_path.to_str().unwrap(),
        ],
    )
    .env("TMPDIR", &scratch.path)
    .output()
    .unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    let report: Value = std::fs::read(&report_path)
        .ok()
        .and_then(|json| serde_json::from_slice(&json).ok())
        .unwrap_or_else(|| panic!("no report:\n{text}\n{errors}"));

    let done = report["disturbances"].as_array().unwrap();
    for what in ["kill", "pause", "restart"] {
        assert!(
            done.iter().any(|done| done["what"] == what),
            "no {what}: the test is too weak\n{text}"
        );
    }
    let frames = &report["frames"];
    assert!(frames["captured"].as_u64() > Some(80), "{text}");
    for nothing in ["missing", "missing_unpromised", "duplicates", "out_of_order"] {
        assert_eq!(frames[nothing], 0, "{nothing}\n{text}");
    }
    for nothing in ["lost", "duplicates", "out_of_order"] {
        assert_eq!(frames["slow_reader"][nothing], 0, "slow reader: {nothing}\n{text}");
    }
    let bystanders = &report["bystanders"];
    assert_eq!(bystanders["failed"], 0, "a program could not attach\n{text}\n{errors}");
    assert!(bystanders["killed"].as_u64() > Some(3), "{text}");
    assert_eq!(report["left_out"], 0, "a stage did not come back\n{text}");
    let left = &report["left"];
    assert_eq!(left["ended_in_order"], true, "{text}\n{errors}");
    assert_eq!(left["processes"], serde_json::json!([]), "{text}");
    assert_eq!(left["shared_memory"], serde_json::json!([]), "{text}");
    assert_eq!(left["runtime_directory"], false, "{text}");
    let places: Vec<_> = std::fs::read_dir(&scratch.path)
        .unwrap()
        .flatten()
        .map(|entry| entry.file_name())
        .collect();
    assert_eq!(places, ["report.json"], "the tool itself left something behind");
}

#[test]
fn shortages_and_a_closed_terminal_lose_nothing() {
    check_that_nothing_is_lost("kill,hup,emfile");
}

#[test]
fn rubbish_on_the_topics_loses_nothing() {
    check_that_nothing_is_lost("kill,rubbish");
}

#[test]
#[ignore = "needs root, for a /dev/shm of its own"]
fn full_shared_memory_loses_nothing() {
    check_that_nothing_is_lost("kill,enospc");
}

#[test]
#[ignore = "needs root, to be another user in a /dev/shm of its own"]
fn another_user_who_takes_names_and_tries_doors_changes_nothing() {
    let report = check_that_nothing_is_lost("kill,supervisor,outsider");
    let deeds = &report["outsider"];
    assert!(
        deeds["made"].as_u64() > Some(10) && deeds["attempts"].as_u64() > Some(1000),
        "{deeds}"
    );
    assert_eq!(deeds["succeeded"], 0, "{deeds}");
}

fn check_that_nothing_is_lost(signals: &str) -> Value {
    // Tests of one program run concurrently.
    let scratch = Scratch::new(&format!("chaos-{}", signals.replace(',', "-")));
    let report_path = scratch.path.join("report.json");
    let arguments = ["chaos", "--seconds", "12", "--every", "500", "--signals", signals];
    let report_argument = ["--seed", "5", "--report", report_path.to_str().unwrap()];
    let output = touchline(&scratch, &[arguments.as_slice(), &report_argument].concat())
        .env("TMPDIR", &scratch.path)
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    let report: Value = std::fs::read(&report_path)
        .ok()
        .and_then(|json| serde_json::from_slice(&json).ok())
        .unwrap_or_else(|| panic!("no report:\n{text}\n{errors}"));
    for what in signals.split(',') {
        let done = report["disturbances"].as_array().unwrap();
        assert!(done.iter().any(|done| done["what"] == what), "no {what}\n{text}");
    }
    assert_eq!(report["supervisor_failure"], Value::Null, "{text}");
    for nothing in ["missing", "missing_unpromised", "duplicates", "out_of_order"] {
        assert_eq!(report["frames"][nothing], 0, "{nothing}\n{text}");
    }
    assert_eq!(report["left_out"], 0, "a stage did not come back\n{text}");
    let left = &report["left"];
    assert_eq!(left["ended_in_order"], true, "{text}\n{errors}");
    assert_eq!(left["shared_memory"], serde_json::json!([]), "{text}");
    report
}

#[test]
fn impossible_requests_are_refused_at_once() {
    let scratch = Scratch::new("chaos-refused");
    for (args, hint) in [
        (["chaos", "--signals", "hug"], "double"),
        (["chaos", "--stages", "referee"], "classifier"),
        (["chaos", "--report", "/nonexistent/report.json"], "/nonexistent"),
    ] {
        let output = touchline(&scratch, &args).output().unwrap();
        assert!(!output.status.success(), "{args:?} was accepted");
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(text.contains(hint), "{args:?} says {text:?}, which does not help");
    }
}
