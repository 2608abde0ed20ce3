//! Recordings of matches in which the configuration changes.

mod support;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};
use support::{Group, PATIENCE, output_of, touchline};

/// A recorder that ends with the test.
struct Recorder {
    process: Child,
    file: PathBuf,
}

impl Recorder {
    fn start(group: &Group, name: &str, args: &[&str]) -> Self {
        let file = group.scratch.path.join(name);
        let base = ["record", file.to_str().unwrap(), "--instance", "test", "--keep-free", "1M"];
        let topics = ["--topics", "frames,runs,detections,world,commands,scene", "--quiet"];
        let args: Vec<&str> = base.iter().chain(&topics).chain(args).copied().collect();
        let process = touchline(&group.scratch, &args).stdout(Stdio::null()).spawn().unwrap();
        let recorder = Self { process, file };
        recorder.wait_for_bytes(1_000_000);
        recorder
    }

    fn wait_for_bytes(&self, bytes: u64) {
        let deadline = Instant::now() + PATIENCE;
        while self.file.metadata().map_or(0, |data| data.len()) < bytes {
            assert!(Instant::now() < deadline, "{} does not grow", self.file.display());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn finish(mut self) -> PathBuf {
        kill_process(Pid::from_child(&self.process), Signal::INT).unwrap();
        self.process.wait().unwrap();
        self.file.clone()
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn reload(group: &Group, key: &str) {
    let output = group.touchline(&["reload", "--set", key]);
    assert!(output.status.success(), "{key}: {output:?}");
}

fn info(group: &Group, file: &Path) -> Value {
    let output = output_of(&group.scratch, &["info", "--json", file.to_str().unwrap()]);
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}

fn revisions(info: &Value) -> Vec<u64> {
    let list = info["configurations"].as_array().unwrap();
    list.iter().map(|it| it["revision"].as_u64().unwrap()).collect()
}

/// Verifies a recording: nothing is different, and everything but the first moment is checked.
fn assert_exact(group: &Group, file: &Path) {
    let output = output_of(&group.scratch, &["replay", "--verify", file.to_str().unwrap()]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{text}");
    assert!(!text.contains("configuration"), "{text}");
    for channel in ["runs", "detections", "world"] {
        let line = text.lines().find(|line| line.trim_start().starts_with(channel)).unwrap();
        let mut numbers = line.split_whitespace().skip(1).map(|word| word.parse::<u64>().unwrap());
        let [equal, different, unchecked] = std::array::from_fn(|_| numbers.next().unwrap());
        assert_eq!(different, 0, "{text}");
        // Frames in progress when the recording started.
        assert!(equal > 60 && unchecked < 70, "{text}");
    }
}

/// Goes through colours, geometry, filter and the supervisor's keys, with kills in between, and records all of
/// it, the end of it, and in several files.
#[test]
fn a_match_with_changes_is_computed_again_bit_for_bit() {
    let mut group = Group::start("record-reloads", "[camera]\nfps = 30\n", &[]);
    group.wait_until_working();
    let first = Recorder::start(&group, "first.mcap", &[]);
    let small = Recorder::start(&group, "small.mcap", &["--max-size", "10M"]);
    let orange = "colors.orange.green=[60, 185]";
    reload(&group, "filter.actuation_delay_ms=61");
    reload(&group, orange);
    let status = group.wait_until_working();
    group.signal(Group::pid_of(&status, "tracker"), Signal::KILL);
    let late = Recorder::start(&group, "late.mcap", &[]);
    reload(&group, "geometry.camera_mm=[10.0, 0.0, 2200.0]");
    let output = group.touchline(&["rollback"]);
    assert!(output.status.success(), "{output:?}");
    reload(&group, "supervisor.stall_min_ms=31");
    reload(&group, "tracker.min_region_px=5");
    let status = group.wait_until_working();
    group.signal(Group::pid_of(&status, "classifier"), Signal::KILL);
    let world = status["frames"]["world"].as_u64().unwrap();
    let status = group
        .wait_for("more frames", |status| status["frames"]["world"].as_u64() > Some(world + 100));
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");

    let file = first.finish();
    let found = info(&group, &file);
    assert_eq!(revisions(&found), [1, 2, 3, 4, 5, 6, 7], "{found:#}");
    let times: Vec<f64> = found["configurations"]
        .as_array()
        .unwrap()
        .iter()
        .map(|it| it["after_s"].as_f64().unwrap())
        .collect();
    assert!(times.windows(2).all(|pair| pair[0] < pair[1]) && times[0] == 0.0, "{times:?}");
    let second = &found["configurations"][1]["changes"][0];
    assert!(second.as_str().unwrap().contains("filter.actuation_delay_ms: "), "{second}");
    assert_exact(&group, &file);
    let shown = output_of(&group.scratch, &["info", file.to_str().unwrap()]);
    let shown = String::from_utf8(shown.stdout).unwrap();
    assert!(shown.contains("configuration 2 after ") && shown.contains("→ 61.0"), "{shown}");
    let args = ["info", "--config", "--revision", "2", file.to_str().unwrap()];
    let text = String::from_utf8(output_of(&group.scratch, &args).stdout).unwrap();
    let config = config::Config::parse(&text, "printed").unwrap();
    assert_eq!(config.filter.actuation_delay_ms, 61.0);

    let file = late.finish();
    let found = info(&group, &file);
    assert_eq!(revisions(&found).last(), Some(&7), "{found:#}");
    assert_exact(&group, &file);

    small.finish();
    let second = group.scratch.path.join("small-2.mcap");
    assert!(second.exists());
    let mut file = group.scratch.path.join("small.mcap");
    for number in 2.. {
        let output = output_of(&group.scratch, &["replay", "--verify", file.to_str().unwrap()]);
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success() && !text.contains("configuration"), "{text}");
        file = group.scratch.path.join(format!("small-{number}.mcap"));
        if !file.exists() {
            break;
        }
    }
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}
