//! Recordings of real groups: killed, damaged, recomputed.

mod support;

use rustix::process::Signal;
use serde_json::Value;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};
use support::{Group, PATIENCE, Scratch, output_of, touchline};

/// A recorder that ends with the test.
struct Recorder(Child);

impl Recorder {
    fn start(scratch: &Scratch, file: &Path, args: &[&str]) -> Self {
        let base = ["record", file.to_str().unwrap(), "--instance", "test", "--keep-free", "1M"];
        let args: Vec<&str> = base.iter().chain(args).copied().collect();
        Self(touchline(scratch, &args).stdout(Stdio::piped()).spawn().unwrap())
    }

    fn signal(&mut self, signal: Signal) -> String {
        let pid = rustix::process::Pid::from_child(&self.0);
        rustix::process::kill_process(pid, signal).unwrap();
        let mut text = String::new();
        std::io::Read::read_to_string(&mut self.0.stdout.take().unwrap(), &mut text).unwrap();
        self.0.wait().unwrap();
        text
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn wait_for_bytes(file: &Path, bytes: u64) {
    let deadline = Instant::now() + PATIENCE;
    while file.metadata().map_or(0, |data| data.len()) < bytes {
        assert!(Instant::now() < deadline, "{} does not grow", file.display());
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn info(scratch: &Scratch, file: &Path) -> Value {
    let output = output_of(scratch, &["info", "--json", file.to_str().unwrap()]);
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}

fn messages(info: &Value, channel: &str) -> u64 {
    info["channels"][channel]["messages"].as_u64().unwrap_or(0)
}

/// The figures of a line of `replay --verify`: equal, different, not checked.
fn verified(text: &str, channel: &str) -> [u64; 3] {
    let line = text.lines().find(|line| line.trim_start().starts_with(channel));
    let line = line.unwrap_or_else(|| panic!("no {channel} in {text}"));
    let mut numbers = line.split_whitespace().skip(1).map(|word| word.parse().unwrap());
    std::array::from_fn(|_| numbers.next().unwrap())
}

#[test]
fn a_match_with_kills_is_computed_again_bit_for_bit() {
    let mut group = Group::start("record-kills", "", &[]);
    let mut status = group.wait_until_working();
    let file = group.scratch.path.join("match.mcap");
    let topics = "frames,runs,detections,world,commands,truth,health,scene";
    let mut recorder = Recorder::start(&group.scratch, &file, &["--topics", topics, "--quiet"]);
    wait_for_bytes(&file, 4_000_000);
    for stage in ["filter", "tracker", "classifier", "filter"] {
        let pid = Group::pid_of(&status, stage);
        group.signal(pid, Signal::KILL);
        let world = status["frames"]["world"].as_u64().unwrap();
        status = group.wait_for("a replacement", |status| {
            status["complete"] == true
                && Group::pid_of(status, stage) != pid
                && status["frames"]["world"].as_u64() > Some(world + 40)
        });
    }
    let said = recorder.signal(Signal::INT);
    assert!(said.contains("dropped      none"), "{said}");

    let info = info(&group.scratch, &file);
    assert_eq!(info["is_complete"], true, "{info:#}");
    for channel in ["frames", "runs", "detections", "world", "commands", "truth", "scene", "ball"] {
        assert!(messages(&info, channel) > 100, "{channel}: {info:#}");
    }
    let output = output_of(&group.scratch, &["replay", "--verify", file.to_str().unwrap()]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{text}");
    for channel in ["runs", "detections", "world"] {
        let [equal, different, unchecked] = verified(&text, channel);
        assert_eq!(different, 0, "{text}");
        // Frames in progress when the recording started.
        assert!(equal > 100 && unchecked < 70, "{text}");
    }
}

#[test]
fn a_changed_recording_is_found_out() {
    // Every output of a recording with modified frames must differ.
    let group = Group::start("record-changed", "", &["--frames", "200"]);
    let file = group.scratch.path.join("match.mcap");
    let mut recorder = Recorder::start(&group.scratch, &file, &["--quiet"]);
    wait_for_bytes(&file, 8_000_000);
    recorder.signal(Signal::INT);

    let changed = group.scratch.path.join("changed.mcap");
    let mut writer = recording::Writer::create(&changed, &recording::Channel::ALL).unwrap();
    let mut world_is_next = true;
    for entry in recording::Reader::open(&file).unwrap() {
        let entry = entry.unwrap();
        let mut data = entry.data.into_owned();
        if entry.channel == recording::Channel::World && std::mem::take(&mut world_is_next) {
            // The last nonzero byte, in the memory of the ball's track.
            *data.last_mut().unwrap() ^= 1;
        }
        writer.write(entry.channel, entry.t_sent_ns, entry.t_sent_ns, &data).unwrap();
    }
    writer.finish().unwrap();
    let output = output_of(&group.scratch, &["replay", "--verify", changed.to_str().unwrap()]);
    let text = String::from_utf8(output.stdout).unwrap();
    // The first world cannot be checked, since the one before it is missing; the second depends on it.
    assert!(!output.status.success(), "{text}");
    assert!(verified(&text, "world")[1] >= 1, "{text}");
    assert!(text.contains("different    world of frame"), "{text}");
}

#[test]
fn a_killed_recorder_leaves_all_but_the_last_moment() {
    let mut group = Group::start("record-killed", "", &[]);
    group.wait_until_working();
    let file = group.scratch.path.join("match.mcap");
    let mut recorder = Recorder::start(&group.scratch, &file, &["--quiet"]);
    wait_for_bytes(&file, 10_000_000);
    let captured_until_ns = client::clock::wall_ns();
    recorder.signal(Signal::KILL);

    // The file can be read as it is, and is reported as incomplete.
    let before = info(&group.scratch, &file);
    assert_eq!(before["is_complete"], false, "{before:#}");
    let end_ns = before["begins_wall_ns"].as_u64().unwrap() as f64
        + before["seconds"].as_f64().unwrap() * 1e9;
    let lost_s = (captured_until_ns as f64 - end_ns) / 1e9;
    // 0.1 s on a machine that is not busy with tests.
    assert!(lost_s < 2.0, "lost {lost_s} s");

    // The next recorder with this name recovers the file and writes another one.
    let mut second = Recorder::start(&group.scratch, &file, &["--quiet"]);
    wait_for_bytes(&group.scratch.path.join("match-2.mcap"), 1_000_000);
    second.signal(Signal::INT);
    let after = info(&group.scratch, &file);
    assert_eq!(after["is_complete"], true, "{after:#}");
    assert_eq!(after["channels"], before["channels"], "nothing readable is lost");
    let second = info(&group.scratch, &group.scratch.path.join("match-2.mcap"));
    assert_eq!(second["is_complete"], true, "{second:#}");
}

#[test]
fn a_full_disk_ends_the_recording_and_not_the_match() {
    let mut group = Group::start("record-full", "", &[]);
    let status = group.wait_until_working();
    let file = group.scratch.path.join("match.mcap");
    // A limit on file sizes simulates a full disk.
    let limited = format!(
        "trap '' XFSZ; ulimit -f 8000; exec {} record {} --instance test --quiet --keep-free 1M",
        env!("CARGO_BIN_EXE_touchline"),
        file.display()
    );
    let output = std::process::Command::new("sh")
        .args(["-c", &limited])
        .env("TOUCHLINE_RUNTIME_DIR", group.scratch.path.join("run"))
        .output()
        .unwrap();
    assert!(!output.status.success(), "{output:?}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("match.mcap: write"), "{output:?}");
    let before = info(&group.scratch, &file);
    assert!(messages(&before, "frames") > 5, "{before:#}");
    let output = output_of(&group.scratch, &["recover", file.to_str().unwrap()]);
    assert!(output.status.success(), "{output:?}");
    let after = info(&group.scratch, &file);
    assert_eq!((&after["channels"], &after["is_complete"]), (&before["channels"], &true.into()));

    let world = status["frames"]["world"].as_u64().unwrap();
    group
        .wait_for("further frames", |status| status["frames"]["world"].as_u64() > Some(world + 40));
}

#[test]
fn files_are_rotated_and_the_oldest_removed() {
    let mut group = Group::start("record-rotate", "", &[]);
    group.wait_until_working();
    let file = group.scratch.path.join("match.mcap");
    let args = ["--quiet", "--max-size", "26M", "--keep", "2"];
    let mut recorder = Recorder::start(&group.scratch, &file, &args);
    let fourth = group.scratch.path.join("match-4.mcap");
    wait_for_bytes(&fourth, 1_000_000);
    recorder.signal(Signal::INT);
    assert!(!file.exists() && !group.scratch.path.join("match-2.mcap").exists());
    for number in [3, 4] {
        let path = group.scratch.path.join(format!("match-{number}.mcap"));
        if path.exists() {
            let info = info(&group.scratch, &path);
            assert_eq!((&info["is_complete"], messages(&info, "setup")), (&true.into(), 1));
        }
    }
}

#[test]
fn files_that_hold_less_than_a_second_are_refused_with_the_figure() {
    let mut group = Group::start("record-small", "", &[]);
    group.wait_until_working();
    let file = group.scratch.path.join("match.mcap");
    for size in ["500", "12K", "25M"] {
        let args = ["record", file.to_str().unwrap(), "--instance", "test", "--max-size", size];
        let output = output_of(&group.scratch, &args);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success(), "{said}");
        // 640×480 pixels and their results, 80 times.
        assert!(said.contains("a second of this group's recording may take 25887 kB"), "{said}");
        assert!(!file.exists());
    }
}

#[test]
#[ignore = "needs root, for a disk of its own"]
fn a_small_disk_keeps_what_is_to_stay_free() {
    let mut group = Group::start("record-disk", "", &[]);
    group.wait_until_working();
    let disk = group.scratch.path.join("disk");
    std::fs::create_dir(&disk).unwrap();
    let script = r#"
        mount -t tmpfs -o size=24m none "$D" || exit 99
        "$T" record "$D/match.mcap" --instance test --quiet --keep-free 1M >&2; echo "code $?"
        echo "free $(stat -f -c '%a * %S' "$D" | tr -d ' ' | tr '*' ' ')"
        "$T" info --json "$D/match.mcap" | grep is_complete
        # Now one that was never finished, on a disk that is full.
        head -c 9000000 "$D/match.mcap" > "$D/cut.mcap"; rm "$D/match.mcap"
        dd if=/dev/zero of="$D/filler" bs=64k 2>/dev/null
        "$T" recover "$D/cut.mcap" --output "$D/../copy.mcap" 2>&1; echo "code $?"
        "$T" recover "$D/cut.mcap" --output "$D/copy.mcap" 2>&1; echo "code $?"
        ls "$D"; truncate -s -100000 "$D/filler"
        "$T" recover "$D/cut.mcap" 2>&1; echo "code $?"
        "$T" info --json "$D/cut.mcap" | grep is_complete"#;
    let output = std::process::Command::new("unshare")
        .args(["-m", "sh", "-c", script])
        .env("D", &disk)
        .env("T", env!("CARGO_BIN_EXE_touchline"))
        .env("TOUCHLINE_RUNTIME_DIR", group.scratch.path.join("run"))
        .output()
        .unwrap();
    let (said, complaints) = [&output.stdout, &output.stderr]
        .map(|text| String::from_utf8_lossy(text).into_owned())
        .into();
    assert!(complaints.contains("stopped: less than 1.0 MB are free"), "{complaints}");
    let free = said.lines().find_map(|line| line.strip_prefix("free ")).unwrap();
    let free: u64 = free.split(' ').map(|number| number.parse::<u64>().unwrap()).product();
    assert!((1_000_000..4_000_000).contains(&free), "{free} bytes were left free");
    assert_eq!(said.matches("\"is_complete\": true").count(), 2, "{said} {complaints}");
    let codes: Vec<&str> = said.lines().filter_map(|line| line.strip_prefix("code ")).collect();
    assert_eq!(codes, ["1", "0", "1", "0"], "{said} {complaints}");
    assert!(said.contains("No space left on device"), "{said}");
    // The incomplete copy was removed, and the copy on the other disk is complete.
    assert!(said.contains("\ncut.mcap\nfiller\n"), "{said}");
    let copy = info(&group.scratch, &group.scratch.path.join("copy.mcap"));
    assert_eq!(copy["is_complete"], true, "{copy:#}");
}

/// An unfinished recording of three messages.
fn unfinished(scratch: &Scratch, name: &str) -> std::path::PathBuf {
    let path = scratch.path.join(name);
    let channels = [recording::Channel::World, recording::Channel::Commands];
    let mut writer = recording::Writer::create(&path, &channels).unwrap();
    for t_ns in 1..=3 {
        writer.write(recording::Channel::World, t_ns, t_ns, &[1, 2, 3]).unwrap();
        writer.flush().unwrap();
    }
    let bytes = std::fs::read(&path).unwrap();
    writer.finish().unwrap();
    std::fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn nothing_is_overwritten_unasked() {
    let scratch = Scratch::new("record-over");
    let path = unfinished(&scratch, "match.mcap");
    let before = std::fs::read(&path).unwrap();
    let file = path.to_str().unwrap();
    let other = scratch.write("other", "mine");
    let other_name = other.to_str().unwrap();
    let refused = |args: &[&str], why: &str| {
        let output = output_of(&scratch, args);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains(why), "{args:?}: {said}");
        assert_eq!(std::fs::read(&path).unwrap(), before, "{args:?}");
    };
    for (option, command) in [("--output", "recover"), ("--csv", "export")] {
        refused(&[command, file, option, other_name], "exists; --force overwrites it");
        refused(&[command, file, option, file], "is read by this command");
        refused(&[command, file, option, file, "--force"], "is read by this command");
    }
    refused(&["run", "--source", &format!("recording:{file}"), "--report", file], "");
    assert_eq!(std::fs::read(&other).unwrap(), b"mine");
    let output = output_of(&scratch, &["recover", file, "--output", other_name, "--force"]);
    assert!(output.status.success(), "{output:?}");
    assert_eq!(messages(&info(&scratch, &other), "world"), 3);
    // In place: no byte of it moves.
    assert!(output_of(&scratch, &["recover", file]).status.success());
    assert!(std::fs::read(&path).unwrap().starts_with(&before));
    let names: Vec<_> = std::fs::read_dir(&scratch.path).unwrap().flatten().collect();
    assert_eq!(names.len(), 2, "{names:?}");
}

#[test]
fn files_that_are_no_recordings_are_refused_with_a_reason() {
    let scratch = Scratch::new("record-no");
    let file = scratch.write("no.mcap", "nothing of the kind");
    for command in [&["info"][..], &["replay", "--verify"], &["recover"]] {
        let args: Vec<&str> = command.iter().copied().chain([file.to_str().unwrap()]).collect();
        let output = output_of(&scratch, &args);
        assert!(!output.status.success(), "{output:?}");
        assert!(String::from_utf8_lossy(&output.stderr).contains("not an MCAP file"), "{output:?}");
    }
}
