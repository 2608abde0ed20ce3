//! Programs that publish on topics reserved for the group: they cost no frame, and are named.

mod support;

use client::bus::Bus;
use client::clock::monotonic_ns;
use client::consumer::{Consumer, Event};
use config::Config;
use grabber::synthetic::SyntheticMatch;
use messages::topics;
use messages::{Commands, DetectionFrame, FrameHeader, PixelFormat, WorldFrame};
use rustix::process::Signal;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use support::{Group, PATIENCE};

const STAGES: [&str; 4] = ["grabber", "classifier", "tracker", "filter"];

fn pids(status: &Value) -> [u32; 4] {
    STAGES.map(|stage| Group::pid_of(status, stage))
}

/// Everything received on `world` until stopped: the numbers, and how many were missed.
struct Witness {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<(Vec<u64>, u64)>,
}

impl Witness {
    fn start(group: &Group) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let (instance, is_over) = (group.instance.clone(), Arc::clone(&stop));
        let thread = std::thread::spawn(move || {
            let mut world = Consumer::new(instance, "witness", &topics::WORLD);
            let (mut seen, mut missed) = (Vec::new(), 0);
            while !is_over.load(Ordering::Relaxed) {
                match world.next(Duration::from_millis(100)).unwrap() {
                    Some(Event::Message(message)) => {
                        seen.push(message.message().unwrap().frame.seq);
                    }
                    Some(Event::Missed(numbers)) => missed += numbers,
                    Some(Event::Restarted | Event::Left) => panic!("numbers begin anew"),
                    Some(Event::Joined) | None => {}
                }
            }
            (seen, missed)
        });
        Self { stop, thread }
    }

    fn finish(self) -> (Vec<u64>, u64) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap()
    }
}

fn strangers_of(status: &Value, pid: u32) -> BTreeSet<String> {
    let strangers = status["strangers"].as_array().cloned().unwrap_or_default();
    let of_pid = strangers.iter().filter(|stranger| stranger["pid"] == pid);
    of_pid.map(|stranger| stranger["topic"].as_str().unwrap().to_string()).collect()
}

#[test]
fn copies_with_wrong_numbers_cost_no_frame_and_their_sender_is_named() {
    let mut group = Group::start("strangers", "", &[]);
    let before = group.wait_until_working();
    let witness = Witness::start(&group);
    let mut vandal = group.start_touchline(&["bystander", "--rubbish", "4000"]);
    let pid = vandal.id();
    let on_all: BTreeSet<String> =
        ["frames", "runs", "detections", "world", "health"].map(String::from).into();
    let met = group
        .wait_for("the vandal named on every topic", |status| strangers_of(status, pid) == on_all);
    assert!(vandal.wait().unwrap().success(), "the vandal itself fell: the test is too weak");
    let captured = met["frames"]["captured"].as_u64().unwrap();
    let after = group.wait_for("further frames", |status| {
        status["frames"]["world"].as_u64() > Some(captured + 80)
    });
    let (seen, missed) = witness.finish();
    assert!(seen.len() > 100 && missed == 0, "{missed} of {} missed", seen.len());
    assert!(seen.windows(2).all(|pair| pair[0] < pair[1]));
    assert_eq!(pids(&after), pids(&before), "a process was replaced: {after:#}");
    for nothing in ["missing_in_world", "duplicates_in_world", "never_captured"] {
        assert_eq!(after["frames"][nothing], 0, "{nothing}: {after:#}");
    }
    let frames = &met["strangers"].as_array().unwrap()[0];
    assert_eq!(frames["name"], "vandal", "{met:#}");
    let events = after["events"].to_string();
    assert!(events.contains(&format!("process {pid} (vandal")), "{events}");
    let text = String::from_utf8(group.touchline(&["status"]).stdout).unwrap();
    assert!(text.contains(&format!("process {pid} (vandal")), "{text}");

    // A successor is not misled either.
    for stage in ["classifier", "tracker", "filter"] {
        let mut vandal = group.start_touchline(&["bystander", "--rubbish", "1500"]);
        let pid = vandal.id();
        group.wait_for("the next vandal", |status| strangers_of(status, pid) == on_all);
        let status = group.wait_until_working();
        group.signal(Group::pid_of(&status, stage), Signal::KILL);
        let world = status["frames"]["world"].as_u64().unwrap();
        let status = group.wait_for("further frames", |status| {
            status["complete"] == true && status["frames"]["world"].as_u64() > Some(world + 80)
        });
        assert_eq!(status["frames"]["missing_in_world"], 0, "{stage}: {status:#}");
        assert_eq!(status["frames"]["duplicates_in_world"], 0, "{stage}: {status:#}");
        vandal.wait().unwrap();
    }
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

#[test]
fn the_group_s_own_processes_are_known_to_a_new_supervisor() {
    let mut group = Group::start("strangers-adopted", "", &[]);
    group.wait_until_working();
    let mut vandal = group.start_touchline(&["bystander", "--rubbish", "8000"]);
    let pid = vandal.id();
    group.wait_for("the vandal", |status| !strangers_of(status, pid).is_empty());
    let witness = Witness::start(&group);
    group.replace_supervisor();
    let status = group.wait_for("the vandal named by the new supervisor", |status| {
        status["complete"] == true
            && status["frames"]["world"].as_u64() > Some(80)
            && strangers_of(status, pid).len() == 5
    });
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    let only_the_vandal = status["strangers"].as_array().unwrap().iter().all(|it| it["pid"] == pid);
    assert!(only_the_vandal, "{status:#}");
    let (seen, missed) = witness.finish();
    assert!(seen.len() > 80 && missed == 0, "{missed} of {} missed", seen.len());
    let _ = vandal.kill();
    vandal.wait().unwrap();
}

/// Feeds frames of a synthetic match at the configured rate, under a name.
fn inject(group: &Group, name: &str, numbers: std::ops::Range<u64>) {
    let config = Config::default();
    let bus = Bus::join(&group.instance, name).unwrap();
    let topic = topics::frames(config.camera.frame_bytes());
    let mut publisher = bus.publisher(&topic, config.camera.frame_bytes()).unwrap();
    let mut scene = SyntheticMatch::new(&config).unwrap();
    let begun = Instant::now();
    for (count, seq) in numbers.enumerate() {
        let mut frame = publisher.loan(config.camera.frame_bytes()).unwrap();
        let (pixels, header) = frame.parts();
        scene.render(pixels, config.camera.width as usize);
        *header = FrameHeader {
            seq,
            t_capture_ns: monotonic_ns(),
            t_sent_ns: monotonic_ns(),
            width: config.camera.width,
            height: config.camera.height,
            stride: config.camera.width,
            pixel_format: PixelFormat::Bayer8 as u32,
            bayer_order: config.camera.bayer_order as u32,
            ..FrameHeader::default()
        };
        frame.send().unwrap();
        scene.advance();
        let due = Duration::from_secs_f64((count + 1) as f64 / config.camera.fps);
        std::thread::sleep(due.saturating_sub(begun.elapsed()));
    }
}

#[test]
fn a_program_that_the_user_permits_feeds_the_frames() {
    let config = "[access]\npublishers = [\"my-camera\"]\n";
    let mut group = Group::start("external", config, &["--source", "external"]);
    group.wait_for("a grabber that waits", |status| {
        let processes = &status["stages"]["grabber"]["processes"];
        processes.as_array().is_some_and(|it| it.iter().any(|it| it["state"] == "waiting"))
    });
    let worlds = {
        let bus = Bus::join(&group.instance, "reader").unwrap();
        let worlds = bus.subscriber(&topics::WORLD).unwrap();
        // Another name is not permitted.
        inject(&group, "other-camera", 0..40);
        assert!(worlds.receive().unwrap().is_none());
        (worlds, bus)
    };
    inject(&group, "my-camera", 0..160);
    let deadline = Instant::now() + PATIENCE;
    let mut seen: Vec<WorldFrame> = Vec::new();
    while seen.last().is_none_or(|last| last.frame.seq < 159) {
        assert!(Instant::now() < deadline, "{} worlds", seen.len());
        match worlds.0.receive().unwrap() {
            Some(world) => seen.extend(world.message()),
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    }
    let first = seen[0].frame.seq;
    assert!(seen.iter().map(|world| world.frame.seq).eq(first..160), "from {first}");
    assert!(seen.last().unwrap().robots().len() >= 10);
    let status = group.wait_for("both programs named", |status| {
        status["strangers"].as_array().is_some_and(|it| it.len() == 2)
    });
    let events = status["events"].to_string();
    assert!(
        events.contains("(my-camera") && events.contains("is believed from now on"),
        "{events}"
    );
    assert_eq!(status["stages"]["grabber"]["restarts"], 0, "{status:#}");

    let refused = support::output_of(&group.scratch, &["run", "--source", "external"]);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success() && said.contains("access.publishers"), "{said}");
}

#[test]
fn results_of_frames_that_do_not_exist_are_no_progress_even_from_the_group_itself() {
    let mut group = Group::start("strangers-own", "", &[]);
    let before = group.wait_until_working();
    let bus = Bus::join(&group.instance, "impostor").unwrap();
    bus.enter_roster();
    let reader = bus.subscriber(&topics::DETECTIONS).unwrap();
    let mut writer = bus.publisher(&topics::DETECTIONS, 1).unwrap();
    let deadline = Instant::now() + PATIENCE;
    let newest: DetectionFrame = loop {
        assert!(Instant::now() < deadline, "no detections");
        match reader.newest().unwrap() {
            Some(received) => break *received.message().unwrap(),
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    };
    let mut message = newest;
    message.frame.seq += 900;
    writer.publish(&message).unwrap();
    let captured = before["frames"]["captured"].as_u64().unwrap();
    let after = group.wait_for("further frames", |status| {
        status["frames"]["world"].as_u64() > Some(captured + 160)
    });
    assert_eq!(pids(&after), pids(&before), "a process was replaced: {after:#}");
    assert_eq!(after["frames"]["missing_in_world"], 0, "{after:#}");
    assert_eq!(after["stages"]["filter"]["dropped"]["bad_header"], 1, "{after:#}");
}

/// Open descriptors of every process of the group, by stage and state.
fn descriptors(status: &Value) -> BTreeMap<String, usize> {
    let count = |pid: &Value| {
        std::fs::read_dir(format!("/proc/{pid}/fd")).map_or(usize::MAX, Iterator::count)
    };
    let mut all = BTreeMap::from([("supervisor".into(), count(&status["supervisor_pid"]))]);
    for (name, stage) in status["stages"].as_object().unwrap() {
        for process in stage["processes"].as_array().unwrap() {
            let state = process["state"].as_str().unwrap();
            all.insert(format!("{name}, {state}"), count(&process["pid"]));
        }
    }
    all
}

/// Starts a program that attaches, waits until it has, and kills it.
fn attach_and_kill(group: &Group, args: &[&str]) {
    let mut program = group.start_touchline(&[&["bystander"], args].concat());
    let mut said = String::new();
    let mut output = BufReader::new(program.stdout.take().unwrap());
    output.read_line(&mut said).unwrap();
    let is_attached = said.starts_with("attached");
    let _ = program.kill();
    let ended = program.wait_with_output().unwrap();
    assert!(is_attached, "{}", String::from_utf8_lossy(&ended.stderr));
}

#[test]
fn programs_that_attached_and_were_killed_leave_no_descriptor_open_in_any_process() {
    let mut group = Group::start("strangers-killed", "", &[]);
    group.wait_until_working();
    // Once, so that everything is connected that will be.
    attach_and_kill(&group, &[]);
    attach_and_kill(&group, &["--rubbish", "60000"]);
    std::thread::sleep(Duration::from_secs(3));
    let before = descriptors(&group.wait_until_working());
    for _ in 0..40 {
        for _ in 0..4 {
            attach_and_kill(&group, &[]);
        }
        attach_and_kill(&group, &["--rubbish", "60000"]);
    }
    let is_flat = |after: &BTreeMap<String, usize>| {
        after.len() == before.len()
            && after
                .iter()
                .all(|(process, count)| before.get(process).is_some_and(|before| count <= before))
    };
    let deadline = Instant::now() + PATIENCE;
    loop {
        let status = group.wait_until_working();
        let after = descriptors(&status);
        if is_flat(&after) {
            break;
        }
        assert!(Instant::now() < deadline, "{before:?} before, {after:?} after, {status:#}");
        std::thread::sleep(Duration::from_millis(100));
    }
    // The spares have kept nothing of the strangers, and everything of the group.
    let witness = Witness::start(&group);
    for stage in ["classifier", "tracker", "filter"] {
        let status = group.wait_until_working();
        group.signal(Group::pid_of(&status, stage), Signal::KILL);
        let world = status["frames"]["world"].as_u64().unwrap();
        let status = group.wait_for("further frames", |status| {
            status["complete"] == true && status["frames"]["world"].as_u64() > Some(world + 80)
        });
        assert_eq!(status["frames"]["missing_in_world"], 0, "{stage}: {status:#}");
        assert_eq!(status["frames"]["duplicates_in_world"], 0, "{stage}: {status:#}");
    }
    let (seen, missed) = witness.finish();
    assert!(seen.len() > 100 && missed == 0, "{missed} of {} missed", seen.len());
}

#[test]
fn strangers_on_the_monitor_s_topics_are_named_too() {
    let mut group = Group::start("strangers-status", "", &[]);
    group.wait_until_working();
    let bus = Bus::join(&group.instance, "scribbler").unwrap();
    let mut events = bus.publisher(&topics::EVENTS, 1).unwrap();
    let mut status = bus.publisher(&topics::STATUS, 100).unwrap();
    events.publish(&bytemuck::Zeroable::zeroed()).unwrap();
    status.loan(100).unwrap().send().unwrap();
    let own = std::process::id();
    let both: BTreeSet<String> = ["events", "status"].map(String::from).into();
    let status = group.wait_for("the scribbler named", |status| strangers_of(status, own) == both);
    let strangers = status["strangers"].as_array().unwrap();
    assert!(
        strangers.iter().all(|it| it["name"] == "scribbler" && it["messages"] == 1),
        "{status:#}"
    );
}

/// Publishes commands for a robot, numbered from `first` on, in bursts, until told to stop.
fn command(
    group: &Group,
    name: &'static str,
    robot: (u32, u32),
    first: u64,
    (burst, pause): (u64, Duration),
) -> (Arc<AtomicBool>, JoinHandle<u64>) {
    let stop = Arc::new(AtomicBool::new(false));
    let (instance, is_over) = (group.instance.clone(), Arc::clone(&stop));
    let (to_tell, is_attached) = std::sync::mpsc::channel();
    let thread = std::thread::spawn(move || {
        let bus = Bus::join(&instance, name).unwrap();
        let mut publisher = bus.publisher(&topics::COMMANDS, 1).unwrap();
        let mut sent = 0;
        to_tell.send(()).unwrap();
        while !is_over.load(Ordering::Relaxed) {
            for _ in 0..burst {
                let mut commands = Commands { seq: first + sent, ..bytemuck::Zeroable::zeroed() };
                commands.t_sent_ns = monotonic_ns();
                commands.wheel_count = 1;
                commands.wheels[0].team = robot.0;
                commands.wheels[0].robot_id = robot.1;
                publisher.publish(&commands).unwrap();
                sent += 1;
            }
            std::thread::sleep(pause);
        }
        sent
    });
    is_attached.recv().unwrap();
    (stop, thread)
}

#[test]
fn a_program_that_floods_commands_keeps_no_other_out_and_is_named() {
    const STRATEGY: u64 = 1 << 40;
    let mut group = Group::start("commands-flood", "", &[]);
    group.wait_until_working();
    let bus = Bus::join(&group.instance, "reader").unwrap();
    let worlds = bus.subscriber(&topics::WORLD).unwrap();
    let deadline = Instant::now() + PATIENCE;
    let robots: Vec<(u32, u32)> = loop {
        assert!(Instant::now() < deadline, "no robots");
        let newest = worlds.newest().unwrap();
        let newest = newest.as_ref().and_then(|world| world.message());
        match newest.filter(|world| world.robots().len() >= 10) {
            Some(world) => break world.robots().iter().map(|it| (it.team, it.robot_id)).collect(),
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    };
    // Some 40,000 messages a second; the filter takes 2,560.
    let flood = command(&group, "flood", robots[0], 1 << 20, (80, Duration::from_millis(2)));
    group.wait_for("the flood named", |status| {
        let commanders = status["commanders"].as_array().cloned().unwrap_or_default();
        commanders.iter().any(|it| it["name"] == "flood" && it["floods"] == true)
    });
    let strategy =
        command(&group, "strategy", robots[1], STRATEGY, (1, Duration::from_micros(12_500)));
    let mut used = BTreeSet::new();
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_secs(3) {
        while let Some(world) = worlds.receive().unwrap() {
            let world = world.message().unwrap();
            let commands = &world.commands[..world.command_count as usize];
            used.extend(commands.iter().map(|it| it.seq).filter(|&seq| seq >= STRATEGY));
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    strategy.0.store(true, Ordering::Relaxed);
    let sent = strategy.1.join().unwrap();
    flood.0.store(true, Ordering::Relaxed);
    flood.1.join().unwrap();
    // The last ones may still be under way.
    assert!(sent > 50 && used.len() as u64 + 20 >= sent, "{} of {sent} used", used.len());
    let status = group.wait_until_working();
    let text = status["events"].to_string();
    assert!(text.contains("(flood) publishes commands faster"), "{text}");
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
}
