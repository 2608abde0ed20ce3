//! Programs that attach: in other languages, and to playback of a recording.

mod support;

use client::bus::Received;
use client::consumer::{Consumer, Event};
use messages::topics;
use messages::{Team, TruthFrame};
use rustix::process::Signal;
use serde_json::Value;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use support::{Group, PATIENCE, Scratch, output_of, touchline};

/// One against one, so that the path to the ball is mostly free.
const SMALL: &str = "
[robots]
identities = [
    { team = \"yellow\", id = 0, colors = [\"green\"] },
    { team = \"blue\", id = 1, colors = [\"cyan\"] },
]
";

/// A program that ends with the test.
struct Program(Child);

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The Python interpreter for the programs.
fn python() -> PathBuf {
    std::env::var_os("TOUCHLINE_PYTHON").map_or("python3".into(), PathBuf::from)
}

fn script(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts/python").join(name)
}

#[test]
fn layouts_for_other_languages_are_those_of_this_program() {
    let scratch = Scratch::new("layouts");
    for (format, file) in
        [("python", "scripts/python/touchline_messages.py"), ("c", "scripts/touchline.h")]
    {
        let output = output_of(&scratch, &["topics", "--format", format]);
        assert!(output.status.success(), "{output:?}");
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
        let committed = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(
            committed == String::from_utf8(output.stdout).unwrap(),
            "{file} is out of date: touchline topics --format {format} > {file}"
        );
    }
}

/// Checks the C header with a compiler; the sizes are asserted in the header itself.
fn check_header(compiler: &str, language: &str, standard: &str) {
    let header = Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts/touchline.h");
    let output = Command::new(compiler)
        .args([standard, "-Wall", "-Werror", "-fsyntax-only", "-x", language])
        .arg(&header)
        .output()
        .unwrap_or_else(|error| panic!("{compiler}: {error}"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn the_header_is_good_c() {
    check_header("cc", "c", "-std=c11");
}

#[test]
#[ignore = "needs a C++ compiler: Debian's g++"]
fn the_header_is_good_cpp() {
    check_header("c++", "c++", "-std=c++17");
}

#[test]
fn topics_are_listed_with_what_goes_on() {
    let mut group = Group::start("topics", "", &[]);
    group.wait_until_working();
    let output = output_of(&group.scratch, &["topics", "--json", "--instance", "test"]);
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    let topics = document["topics"].as_array().unwrap();
    let world = topics.iter().find(|topic| topic["name"] == "world").unwrap();
    assert!(world["element"].as_str().unwrap().starts_with("touchline/WorldFrame/"), "{world:#}");
    assert!(world["live"]["messages_per_s"].as_f64() > Some(5.0), "{world:#}");
    assert!(world["live"]["subscribers"].as_u64() >= Some(2), "{world:#}");
    let prefix = document["iceoryx2"]["prefix"].as_str().unwrap();
    assert_eq!(prefix, group.namespace().prefix());
    let output = output_of(&group.scratch, &["topics", "--format", "config", "--instance", "test"]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains(prefix) && text.contains("root-path"), "{text}");
}

/// True distance of the robot from the ball.
fn distance(truth: &TruthFrame) -> f64 {
    let robot = truth.robots().iter().find(|r| (r.team, r.robot_id) == (Team::Blue as u32, 1));
    let robot = robot.expect("the robot is on the pitch");
    (robot.x_mm - truth.ball_x_mm).hypot(robot.y_mm - truth.ball_y_mm)
}

/// Watches the truth until the robot has been at the ball for two seconds on end, except for its kicks.
fn wait_until_at_the_ball(group: &Group) {
    let mut truth = Consumer::new(group.instance.clone(), "test", &topics::TRUTH);
    let deadline = Instant::now() + PATIENCE;
    let mut recent = std::collections::VecDeque::new();
    while Instant::now() < deadline {
        if let Some(Event::Message(received)) = truth.next(Duration::from_secs(1)).unwrap() {
            let Some(truth) = received.message() else { continue };
            recent.push_back(distance(truth) < 200.0);
            if recent.len() > 160 {
                recent.pop_front();
                if recent.iter().filter(|&&near| near).count() > 130 {
                    return;
                }
            }
        }
    }
    let near = recent.iter().filter(|&&near| near).count();
    panic!("the robot was at the ball in {near} of the last {} frames", recent.len());
}

#[test]
fn a_strategy_in_rust_drives_a_robot_to_the_ball() {
    // Beside this test: target/debug/deps/attach-…, target/debug/examples/drive_to_ball.
    let test = std::env::current_exe().unwrap();
    let example = test.parent().unwrap().parent().unwrap().join("examples/drive_to_ball");
    assert!(example.exists(), "{}: `cargo build --examples` makes it", example.display());
    let mut group = Group::start("rust", SMALL, &[]);
    group.wait_until_working();
    let strategy = Command::new(example)
        .arg("test")
        .env("TOUCHLINE_RUNTIME_DIR", group.scratch.path.join("run"))
        .stdin(Stdio::null())
        .spawn()
        .unwrap();
    let _strategy = Program(strategy);
    wait_until_at_the_ball(&group);
}

#[test]
fn a_consumer_outlives_its_group() {
    let mut group = Group::start("outlives", "", &[]);
    group.wait_until_working();
    let mut world = Consumer::new(group.instance.clone(), "test", &topics::WORLD);
    let mut wait_for = |what: &str, wanted: fn(&Event<Received<_, _>>) -> bool| {
        let deadline = Instant::now() + PATIENCE;
        while Instant::now() < deadline {
            if world.next(Duration::from_secs(1)).unwrap().as_ref().is_some_and(wanted) {
                return;
            }
        }
        panic!("waited for {what} in vain");
    };
    wait_for("the group", |event| matches!(event, Event::Joined));
    wait_for("a message", |event| matches!(event, Event::Message(_)));
    let output = output_of(&group.scratch, &["stop", "--instance", "test"]);
    assert!(output.status.success(), "{output:?}");
    group.wait_until_ended();
    wait_for("the end", |event| matches!(event, Event::Left));

    let mut second = touchline(&group.scratch, &["run", "--instance", "test", "--quiet"]);
    let mut second = Program(second.stdout(Stdio::null()).spawn().unwrap());
    wait_for("the next group", |event| matches!(event, Event::Joined));
    wait_for("its numbers", |event| matches!(event, Event::Restarted));
    wait_for("its messages", |event| matches!(event, Event::Message(_)));
    let output = output_of(&group.scratch, &["stop", "--instance", "test"]);
    assert!(output.status.success(), "{output:?}");
    second.0.wait().unwrap();
}

/// Exported files can be read: the table by any program, the pictures by `detect`.
fn check_exports(scratch: &Scratch, file: &Path) {
    let (table, pictures) = (scratch.path.join("poses.csv"), scratch.path.join("frames"));
    let (table_arg, pictures_arg) = (table.to_str().unwrap(), pictures.to_str().unwrap());
    let file = file.to_str().unwrap();
    let args = ["export", file, "--csv", table_arg, "--png", pictures_arg, "--every", "100"];
    let output = output_of(scratch, &args);
    assert!(output.status.success(), "{output:?}");
    let table = std::fs::read_to_string(table).unwrap();
    let columns = table.lines().next().unwrap().split(',').count();
    assert!(table.lines().all(|line| line.split(',').count() == columns));
    for source in ["detections,", "world,", "truth,"] {
        let rows = table.lines().filter(|line| line.starts_with(source)).count();
        assert!(rows > 1000, "{rows} rows of {source}");
    }
    let output = output_of(scratch, &["detect", "--json", pictures_arg]);
    let lines = String::from_utf8(output.stdout).unwrap();
    assert!((1..=4).contains(&lines.lines().count()), "{lines}");
    assert!(lines.lines().all(|line| line.contains("\"robots\"")), "{lines}");
}

/// Playback as fast as the group can gives everything that was recorded.
fn check_fast(file: &Path, recorded: u64) {
    let scratch = Scratch::new("fast");
    let report = scratch.path.join("report.json");
    let source = format!("recording:{},fast", file.display());
    let args = ["--source", &source, "--report", report.to_str().unwrap()];
    let mut group = Group::start_plain("fast-group", &args);
    assert!(group.wait_until_ended().success(), "{}", group.stderr());
    let report: Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
    // By the stages' own counts: on a busy machine the monitor itself might miss some.
    assert_eq!(report["stages"]["grabber"]["frames_out"], recorded, "{report:#}");
    assert_eq!(report["stages"]["filter"]["frames_out"], recorded, "{report:#}");
    assert_eq!(report["latency_us"]["capture_to_world"]["max"], 0.0, "it is of the past");
    let found = report["accuracy"]["world"]["found_ratio"].as_f64();
    assert!(found > Some(0.95), "{report:#}");
}

/// Frame by frame, with a pause after which a camera would be given up.
fn check_steps(file: &Path) {
    let source = format!("recording:{},step", file.display());
    let mut group = Group::start_plain("step-group", &["--source", &source]);
    let grabber_is =
        |status: &Value, state| status["stages"]["grabber"]["processes"][0]["state"] == state;
    let before = group.wait_for("a grabber that waits", |status| grabber_is(status, "waiting"));
    let step = |group: &Group, frames: &str| {
        let output = group.touchline(&["step", frames]);
        assert!(output.status.success(), "{output:?}");
        let text = String::from_utf8(output.stdout).unwrap();
        text.lines().map(|line| line.split(':').next().unwrap().to_string()).collect::<Vec<_>>()
    };
    assert_eq!(step(&group, "3"), ["frame 0", "frame 1", "frame 2"]);
    std::thread::sleep(Duration::from_secs(4));
    assert_eq!(step(&group, "1"), ["frame 3"]);
    let after = group.wait_for("four frames", |status| status["frames"]["world"] == 4);
    assert_eq!(
        after["stages"]["grabber"]["processes"][0]["pid"],
        before["stages"]["grabber"]["processes"][0]["pid"],
        "waiting is no stall: {after:#}"
    );

    drop(group);
    let mut other = Group::start("no-steps", "", &[]);
    other.wait_until_working();
    let output = other.touchline(&["step"]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("recording:FILE,step"), "{output:?}");
}

/// Records a match of this many frames, all topics.
fn record(file: &Path, frames: u64) {
    let mut group = Group::start("recorded", "", &["--frames", &frames.to_string()]);
    let args = ["record", file.to_str().unwrap(), "--instance", "test", "--keep-free", "1M"];
    let topics =
        ["--topics", "frames,runs,detections,world,commands,truth,health,scene", "--quiet"];
    let args: Vec<&str> = args.iter().chain(&topics).copied().collect();
    let mut recorder =
        Program(touchline(&group.scratch, &args).stdout(Stdio::null()).spawn().unwrap());
    group.wait_until_ended();
    let pid = rustix::process::Pid::from_child(&recorder.0);
    rustix::process::kill_process(pid, Signal::INT).unwrap();
    assert!(recorder.0.wait().unwrap().success());
}

#[test]
fn a_recording_is_played() {
    let scratch = Scratch::new("played");
    let file = scratch.path.join("match.mcap");
    record(&file, 400);
    check_exports(&scratch, &file);
    let info = output_of(&scratch, &["info", "--json", file.to_str().unwrap()]);
    let info: Value = serde_json::from_slice(&info.stdout).unwrap();
    let recorded = info["channels"]["frames"]["messages"].as_u64().unwrap();
    let source = format!("recording:{}", file.display());
    let report = scratch.path.join("report.json");
    let args = ["--source", &source, "--report", report.to_str().unwrap()];
    // Without a configuration, the recorded one is used; the group ends with the recording.
    let mut played = Group::start_plain("played-group", &args);
    assert!(played.wait_until_ended().success(), "{}", played.stderr());
    let report: Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
    assert_eq!(report["frames"]["captured"], recorded, "{report:#}");
    assert_eq!(report["frames"]["missing_in_world"], 0, "{report:#}");
    let found = report["accuracy"]["world"]["found_ratio"].as_f64();
    assert!(found > Some(0.95), "the recorded truth is played, too: {report:#}");

    drop(played);
    check_fast(&file, recorded);
    check_steps(&file);
}

mod python {
    use super::*;

    #[test]
    #[ignore = "needs a Python with iceoryx2, named by TOUCHLINE_PYTHON"]
    fn a_reader_in_python_believes_the_group_alone() {
        let mut group = Group::start("python-believes", "", &[]);
        group.wait_until_working();
        let mut vandal = Program(group.start_touchline(&["bystander", "--rubbish", "20000"]));
        group.wait_for("the vandal", |status| status["strangers"].is_array());
        let program = "
import touchline
group = touchline.Group('test', 'reader')
topics = {name: group.reader(name) for name in ('world', 'frames')}
for name, reader in topics.items():
    last = None
    for _ in range(160):
        elements, header = reader.next(10)
        seq = (header or elements[0].frame).seq
        assert last is None or seq == last + 1, f'{name}: {seq} after {last}'
        last = seq
print('believed')
";
        let reader = Command::new(python())
            .args(["-B", "-c", program])
            .env("TOUCHLINE_RUNTIME_DIR", group.scratch.path.join("run"))
            .env("PYTHONPATH", script(""))
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&reader.stderr).into_owned();
        assert!(reader.status.success(), "{said}");
        assert!(matches!(vandal.0.try_wait(), Ok(None)), "the test is too weak");
    }

    #[test]
    #[ignore = "needs a Python with iceoryx2, named by TOUCHLINE_PYTHON"]
    fn a_strategy_in_python_drives_a_robot_to_the_ball() {
        let mut group = Group::start("python", SMALL, &[]);
        group.wait_until_working();
        let strategy = Command::new(python())
            .arg(script("drive_to_ball.py"))
            .args(["--instance", "test", "--team", "blue", "--robot", "1"])
            .env("TOUCHLINE_RUNTIME_DIR", group.scratch.path.join("run"))
            .stdin(Stdio::null())
            .spawn()
            .unwrap();
        let _strategy = Program(strategy);
        wait_until_at_the_ball(&group);
    }

    #[test]
    #[ignore = "needs a Python with mcap and mcap-protobuf-support, named by TOUCHLINE_PYTHON"]
    fn a_recording_is_read_by_the_official_library() {
        let scratch = Scratch::new("read");
        let file = scratch.path.join("match.mcap");
        record(&file, 200);
        let mut check = Command::new(python());
        let output = check.arg(script("check_recording.py")).arg(&file).output().unwrap();
        assert!(output.status.success(), "{output:?}");
    }
}

/// As in docs/attaching.md: the example becomes a crate outside of the workspace.
#[test]
fn a_strategy_in_a_crate_of_its_own_needs_client_and_messages_alone() {
    let scratch = Scratch::new("own-crate");
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let dependency = |name: &str| {
        let path = root.join("common").join(name);
        format!("{name} = {{ package = \"touchline-{name}\", path = {path:?} }}\n")
    };
    let manifest = format!(
        "[package]\nname = \"strategy\"\nversion = \"0.1.0\"\nedition = \"2024\"\n\n[dependencies]\n{}{}\n[workspace]\n",
        dependency("client"),
        dependency("messages")
    );
    scratch.write("Cargo.toml", &manifest);
    fs::create_dir(scratch.path.join("src")).unwrap();
    fs::copy(root.join("examples/poses.rs"), scratch.path.join("src/main.rs")).unwrap();
    fs::copy(root.join("Cargo.lock"), scratch.path.join("Cargo.lock")).unwrap();
    let cargo = |arguments: &[&str]| {
        let mut cargo = Command::new(env!("CARGO"));
        cargo.args(arguments).arg("--offline").current_dir(&scratch.path);
        let output = cargo.env("CARGO_TARGET_DIR", scratch.path.join("target")).output().unwrap();
        assert!(output.status.success(), "{arguments:?}: {output:?}");
        String::from_utf8(output.stdout).unwrap()
    };
    let tree = cargo(&["tree", "--edges", "normal", "--prefix", "none"]);
    for heavy in ["nalgebra ", "schemars ", "touchline-config ", "image ", "mcap "] {
        assert!(!tree.contains(heavy), "{heavy}: {tree}");
    }
    cargo(&["build"]);

    let mut group = Group::start("own", SMALL, &[]);
    group.wait_until_working();
    let strategy = Command::new(scratch.path.join("target/debug/strategy"))
        .arg("test")
        .env("TOUCHLINE_RUNTIME_DIR", group.instance.directory().parent().unwrap())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut strategy = Program(strategy);
    let mut said = String::new();
    BufReader::new(strategy.0.stdout.take().unwrap()).read_line(&mut said).unwrap();
    assert!(said.starts_with("team ") && said.contains(" mm, "), "{said}");
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
}
