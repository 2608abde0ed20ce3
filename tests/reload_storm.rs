//! Changes of the configuration again and again, while stages are killed: no frame is lost, and every result is
//! that of the configuration it names.
//!
//! The short forms belong to the ordinary suite. The long ones are for a quiet machine and print figures:
//!
//! ```text
//! cargo test --release --test reload_storm -- --ignored --nocapture
//! ```

mod observer;
mod support;

use client::clock::monotonic_ns;
use client::instance::Instance;
use config::{Config, commented_toml};
use control::{Request, ask, read_status};
use messages::ProcessKind;
use observer::{Diary, Entry, Observer, Seen, told};
use rustix::process::{Pid, Signal, kill_process};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use support::{Group, PATIENCE, output_of, touchline};

/// `touchline record`, ended with the test.
struct Recorder(Child);

impl Drop for Recorder {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The configuration number `step`: each differs from the one before in one respect, in turns.
fn configuration(base: &Config, step: u32) -> Config {
    let mut config = base.clone();
    // How often each respect was changed by now.
    let is_changed = |respect: u32| (step + 4 - respect) / 5 % 2 == 1;
    if is_changed(0) {
        // What the one calls class 0 is 1 for the other.
        config.colors.swap(0, 1);
    }
    if is_changed(1) {
        config.geometry.camera_mm[0] += 10.0;
    }
    if is_changed(2) {
        config.filter.actuation_delay_ms += 11.0;
    }
    if is_changed(3) {
        // Another layout: patches a little smaller than they are.
        for patch in &mut config.robots.patches {
            patch.outline_mm.iter_mut().for_each(|corner| *corner = corner.map(|side| 0.98 * side));
        }
    }
    if is_changed(4) {
        config.robots.identities.pop();
    }
    config
}

/// A request for the configuration in a file.
fn reload(file: PathBuf) -> Request {
    Request::Reload { file, base: None }
}

/// What a storm is made of.
struct Storm {
    name: &'static str,
    fps: f64,
    reloads: u32,
    /// Time between two changes.
    every: Duration,
    /// Time between two kills.
    kill_every: Duration,
    /// Kill only while every stage has its spare; otherwise at any moment.
    spares_kills: bool,
}

/// Plays a storm, and checks and prints what came of it.
fn play(storm: &Storm) {
    let config = format!("[camera]\nfps = {}\n", storm.fps);
    let mut group = Group::start(storm.name, &config, &[]);
    group.wait_until_working();
    let base = Config::load(&group.instance.config_path()).unwrap();
    let recording = group.scratch.path.join("storm.mcap");
    let file = recording.to_str().unwrap();
    let topics = "frames,detections,world,commands";
    let arguments = ["record", file, "--instance", "test", "--topics", topics, "--quiet"];
    let recorder = touchline(&group.scratch, &arguments).stdout(Stdio::null()).spawn().unwrap();
    let mut recorder = Recorder(recorder);
    let deadline = Instant::now() + PATIENCE;
    while recording.metadata().map_or(0, |data| data.len()) < 500_000 {
        assert!(Instant::now() < deadline, "nothing is recorded");
        std::thread::sleep(Duration::from_millis(10));
    }
    let observer = Observer::start(&group.instance);
    let diary = Diary::start(&group.instance);
    let killer = Killer::start(&group.instance, storm);

    let mut requested: BTreeMap<u32, (u64, [bool; 3])> = BTreeMap::new();
    let mut next = Instant::now();
    for step in 1..=storm.reloads {
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
        next += storm.every;
        let config = configuration(&base, step);
        let before = configuration(&base, step - 1);
        let candidate = group.scratch.write("candidate.toml", &commented_toml(&config));
        let at_ns = monotonic_ns();
        let done = ask(&group.instance, &reload(candidate), PATIENCE).unwrap().unwrap();
        let revision = done.revision.expect("something differs");
        let kinds = config::snapshot::concerned(&config::change::changes(&before, &config));
        let stages = [ProcessKind::Classifier, ProcessKind::Tracker, ProcessKind::Filter];
        requested.insert(revision, (at_ns, stages.map(|kind| kinds.contains(&kind))));
    }
    let kills = killer.finish();
    let newest = *requested.keys().last().unwrap();
    let status = group.wait_for("the last configuration", |status| {
        let configured = &status["configuration"];
        // On a machine so busy that stages stall, a configuration may be taken back.
        configured["revision"].as_u64() >= Some(newest.into())
            && configured["pending"].as_array().unwrap().is_empty()
    });
    let world = status["frames"]["world"].as_u64().unwrap();
    group.wait_for("frames under it", |status| {
        status["frames"]["world"].as_u64() > Some(world + 20)
    });
    let ((seen, gaps), diary) = (observer.stop(), diary.finish());
    for (before, after) in &gaps {
        let from_ns = before.t_capture_ns.saturating_sub(1_000_000_000);
        println!("from {} to {}:", before.seq, after.seq);
        println!("{}", told(&diary, from_ns, after.t_sent_ns.max(before.t_sent_ns)));
    }
    assert!(gaps.is_empty(), "{gaps:?}");
    kill_process(Pid::from_child(&recorder.0), Signal::INT).unwrap();
    recorder.0.wait().unwrap();

    // Every robot in a world is one of the filter's configuration.
    let robots = recorded_robots(&recording);
    for it in &seen {
        let known = &robots[&it.revisions[2]];
        assert!(it.robots.iter().all(|robot| known.contains(robot)), "{it:?}");
    }
    // Bit for bit: each output is that of the revisions which it names.
    let output = output_of(&group.scratch, &["replay", "--verify", file]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{text}");
    assert!(!text.contains("without its configuration"), "{text}");
    report(&seen, &requested, &kills, storm, &diary);
    println!("{text}");
    assert!(kills.len() as u32 >= storm.reloads / 20, "{kills:?}");
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

/// The robots of each recorded configuration, by revision.
fn recorded_robots(file: &Path) -> BTreeMap<u32, Vec<(u32, u32)>> {
    let entries = recording::Reader::open(file).unwrap().map(|entry| entry.unwrap());
    let setups = entries.filter(|entry| entry.channel == recording::Channel::Setup);
    setups
        .map(|entry| {
            let setup = recording::Setup::decode(&entry.data).unwrap();
            let config = Config::parse(&setup.config_toml, "recorded").unwrap();
            let robots = config.robots.identities.iter().map(|it| (it.team as u32, it.id));
            (setup.revision, robots.collect())
        })
        .collect()
}

/// Prints times. None of them decides the test: they depend on the machine.
fn report(
    seen: &[Seen],
    requested: &BTreeMap<u32, (u64, [bool; 3])>,
    kills: &[u64],
    storm: &Storm,
    diary: &[Entry],
) {
    let mut changes: Vec<(f64, u64, [bool; 3])> = Vec::new();
    let mut replaced = 0;
    for (&revision, &(at_ns, stages)) in requested {
        let is_under =
            |it: &&Seen| it.revisions.iter().zip(stages).all(|(&of, is)| !is || of >= revision);
        let first = seen.iter().find(is_under).expect("a world under each configuration");
        let is_exactly = first.revisions.iter().zip(stages).any(|(&of, is)| is && of == revision);
        replaced += u32::from(!is_exactly);
        changes.push((first.t_sent_ns.saturating_sub(at_ns) as f64 / 1e6, at_ns, stages));
    }
    changes.sort_by(|one, other| one.0.total_cmp(&other.0));
    let disturbances: Vec<u64> =
        requested.values().map(|(at_ns, _)| *at_ns).chain(kills.to_vec()).collect();
    let is_disturbed = |it: &&Seen| {
        let near = |at_ns: &u64| {
            it.t_capture_ns + 5_000_000 > *at_ns && it.t_sent_ns < at_ns + 250_000_000
        };
        disturbances.iter().any(near)
    };
    let (disturbed, quiet): (Vec<_>, Vec<_>) = seen.iter().partition(is_disturbed);
    let latency_ms = |list: &[&Seen]| {
        list.iter().map(|it| (it.t_sent_ns - it.t_capture_ns) as f64 / 1e6).collect::<Vec<_>>()
    };
    println!(
        "{}: {} reloads, {} kills, {} frames: 0 missing, twice or out of order",
        storm.name,
        requested.len(),
        kills.len(),
        seen.len()
    );
    println!(
        "request to first world under it, ms: {}",
        quantiles(changes.iter().map(|it| it.0).collect())
    );
    for concerned in changes.iter().map(|it| it.2).collect::<BTreeSet<_>>() {
        let times = changes.iter().filter(|it| it.2 == concerned).map(|it| it.0).collect();
        println!("  of classifier, tracker, filter replaced {concerned:?}: {}", quantiles(times));
    }
    println!("  overtaken by the next one: {replaced}");
    println!(
        "capture to world within 250 ms of a change or kill, ms: {}",
        quantiles(latency_ms(&disturbed))
    );
    println!("  of all other frames, ms: {}", quantiles(latency_ms(&quiet)));
    let (until_ms, at_ns, _) = changes[changes.len() / 2];
    println!("the median change, step by step, ms after the request:");
    println!("{}{until_ms:8.1}  first world", told(diary, at_ns, at_ns + (until_ms * 1e6) as u64));
}

fn quantiles(mut values: Vec<f64>) -> String {
    if values.is_empty() {
        return "none".into();
    }
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values[((values.len() - 1) as f64 * share).round() as usize];
    format!("median {:.1}, 90 % {:.1}, 99 % {:.1}, most {:.1}", at(0.5), at(0.9), at(0.99), at(1.0))
}

/// Kills a stage's active process now and then.
struct Killer {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Vec<u64>>,
}

impl Killer {
    fn start(instance: &Instance, storm: &Storm) -> Self {
        let (every, spares_kills) = (storm.kill_every, storm.spares_kills);
        let stop = Arc::new(AtomicBool::new(false));
        let (instance, to_stop) = (instance.clone(), Arc::clone(&stop));
        let thread = std::thread::spawn(move || {
            let mut kills = Vec::new();
            // Deterministic, and in no step with the changes.
            let mut random = 0x2545_f491_4f6c_dd1d_u64;
            let mut next = Instant::now() + every / 2;
            while !to_stop.load(Ordering::Relaxed) {
                if Instant::now() < next {
                    std::thread::sleep(Duration::from_millis(5));
                    continue;
                }
                next += every;
                random ^= random << 13;
                random ^= random >> 7;
                random ^= random << 17;
                let stage = ["classifier", "tracker", "filter"][(random % 3) as usize];
                let Ok(Some(report)) = read_status(&instance, PATIENCE) else { continue };
                let has_spare = |stage: &str| {
                    report.stages.get(stage).is_some_and(|stage| {
                        stage.processes.iter().any(|process| process.state == "spare")
                    })
                };
                if spares_kills && !["classifier", "tracker", "filter"].into_iter().all(has_spare) {
                    next = Instant::now() + Duration::from_millis(20);
                    continue;
                }
                let active = report.stages.get(stage).and_then(|stage| {
                    stage.processes.iter().find(|process| process.state == "active")
                });
                // It may be replaced at this moment.
                let pid = active.and_then(|process| Pid::from_raw(process.pid as i32));
                if pid.is_some_and(|pid| kill_process(pid, Signal::KILL).is_ok()) {
                    kills.push(monotonic_ns());
                }
            }
            kills
        });
        Self { stop, thread }
    }

    fn finish(self) -> Vec<u64> {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap()
    }
}

#[test]
fn changes_and_kills_lose_no_frame_and_mix_no_configurations() {
    play(&Storm {
        name: "storm",
        fps: 30.0,
        reloads: 12,
        every: Duration::from_millis(900),
        kill_every: Duration::from_millis(2500),
        spares_kills: true,
    });
}

#[test]
#[ignore = "takes minutes and prints figures, for a quiet machine"]
fn two_hundred_changes_in_a_hundred_seconds() {
    play(&Storm {
        name: "long-storm",
        fps: 80.0,
        reloads: 200,
        every: Duration::from_millis(500),
        kill_every: Duration::from_secs(1),
        spares_kills: false,
    });
}

/// Configurations with a mistake, and the line that it is in.
fn broken() -> Vec<(String, usize)> {
    let mistakes = [
        "fps = -1",
        "fps = \"fast\"",
        "fps = 1e9",
        "fsp = 80",
        "width = 3.5",
        "width = -640",
        "height = true",
        "height = 0",
        "bayer_order = \"rgbg\"",
        "exposure_us = \"long\"",
        "mirrored = 3",
        "width = [640]",
        "fps = ",
        "fps = 80 80",
        "= 80",
        "fps = nan",
        "height = 99999999",
        "v4l2 = 5",
        "genicam = \"x\"",
        "rolling_shutter_us = -5",
    ];
    let delays = [
        "actuation_delay_ms = -1",
        "actuation_delay_ms = \"soon\"",
        "actuation_delay = 5",
        "command_timeout_ms = -3",
        "actuation_delay_ms = [1]",
    ];
    let in_section = |section: &str, mistake: &str, line: usize| {
        (format!("{}[{section}]\n{mistake}\n", "# a comment\n".repeat(line - 2)), line)
    };
    let mut all = Vec::new();
    for line in [2, 7] {
        all.extend(mistakes.iter().map(|mistake| in_section("camera", mistake, line)));
        all.extend(delays.iter().map(|mistake| in_section("filter", mistake, line)));
    }
    all
}

#[test]
fn fifty_broken_configurations_are_refused_with_their_line() {
    let mut group = Group::start("broken", "[camera]\nfps = 30\n", &[]);
    let before = group.wait_until_working();
    let observer = Observer::start(&group.instance);
    let snapshot = std::fs::read(group.instance.config_path()).unwrap();
    let all = broken();
    assert_eq!(all.len(), 50);
    for (text, line) in all {
        let file = group.scratch.write("broken.toml", &text);
        let output = group.touchline(&["reload", "--config", file.to_str().unwrap()]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success(), "{text}: {said}");
        assert!(said.contains(&format!("broken.toml:{line}")), "{text}: {said}");
        // The supervisor does not rely on the program that asks.
        let answer = ask(&group.instance, &reload(file), PATIENCE).unwrap();
        let refused = answer.expect_err(&text);
        assert!(refused.contains(&format!(":{line}")), "{text}: {refused}");
    }
    assert_eq!(std::fs::read(group.instance.config_path()).unwrap(), snapshot);
    let after = group.wait_until_working();
    assert_eq!(after["configuration"]["revision"], 1);
    for stage in ["grabber", "classifier", "tracker", "filter"] {
        assert_eq!(Group::pid_of(&before, stage), Group::pid_of(&after, stage), "{stage}");
    }
    assert!(observer.finish().iter().all(|it| it.revisions == [1; 3]));
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

/// Configurations that pass every check and kill a stage at its first frame: each is taken back, and no frame is
/// lost. Stages die with every second revision, in turns.
fn play_killing(name: &str, fps: f64, count: u32) {
    let stages = ["classifier", "tracker", "filter"];
    let faults: Vec<String> = (0..count)
        .map(|index| format!("{}@r{}", stages[index as usize % 3], 2 + 2 * index))
        .collect();
    let faults = faults.join(";");
    let variables = [("TOUCHLINE_FAULT", faults.as_str())];
    let config = format!("[camera]\nfps = {fps}\n");
    let mut group = Group::start_with(name, &config, &[], &variables);
    group.wait_until_working();
    let base = Config::load(&group.instance.config_path()).unwrap();
    let observer = Observer::start(&group.instance);
    for index in 0..count {
        let mut config = base.clone();
        // All stages read it, so the one that dies is concerned.
        config.robots.size_mm += 1.0;
        let candidate = group.scratch.write("killing.toml", &commented_toml(&config));
        let done = ask(&group.instance, &reload(candidate), PATIENCE).unwrap().unwrap();
        assert_eq!(done.revision, Some(2 + 2 * index));
        group.wait_for("the configuration before", |status| {
            let configured = &status["configuration"];
            configured["revision"] == 3 + 2 * index
                && configured["pending"].as_array().unwrap().is_empty()
                && status["complete"] == true
        });
    }
    let status = group.wait_until_working();
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    let what = &status["configuration"]["history"].as_array().unwrap().last().unwrap()["what"];
    assert!(what.as_str().unwrap().contains("processes fail with it"), "{what}");
    assert_eq!(Config::load(&group.instance.config_path()).unwrap(), base);
    let seen = observer.finish();
    for it in &seen {
        let of_dead = it.revisions.iter().zip(stages).find(|(revision, stage)| {
            faults.split(';').any(|fault| fault == format!("{stage}@r{revision}"))
        });
        assert!(of_dead.is_none(), "{it:?}");
    }
    println!("{name}: {count} configurations taken back, {} frames: 0 missing", seen.len());
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

#[test]
fn configurations_that_kill_are_taken_back_and_cost_no_frame() {
    play_killing("killing", 30.0, 3);
}

#[test]
#[ignore = "takes minutes and prints figures, for a quiet machine"]
fn twenty_configurations_that_kill_are_taken_back() {
    play_killing("long-killing", 80.0, 20);
}
