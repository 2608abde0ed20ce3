//! Whole groups with garbage on their topics and a hostile environment.

mod support;

use bytemuck::{bytes_of_mut, cast_slice_mut};
use client::bus::Bus;
use messages::topics::{self, Topic};
use messages::{Header, Message};
use messages::{MAX_RUNS, MAX_STATUS_BYTES, TrackStatus, TruthFrame, WorldFrame};
use rustix::process::Signal;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::time::{Duration, Instant};
use support::{Group, PATIENCE, Scratch, output_of};

const STAGES: [&str; 4] = ["grabber", "classifier", "tracker", "filter"];

fn pids(status: &Value) -> [u32; 4] {
    STAGES.map(|stage| Group::pid_of(status, stage))
}

fn wait_for_more(group: &mut Group, frames: u64) -> Value {
    let status = group.wait_until_working();
    let world = status["frames"]["world"].as_u64().unwrap();
    group.wait_for("further frames", |status| {
        status["complete"] == true && status["frames"]["world"].as_u64() > Some(world + frames)
    })
}

/// Zeros, ones, NaNs, infinities, and noise.
fn fill(bytes: &mut [u8], kind: usize, noise: &mut u64) {
    let patterns =
        [0, u64::MAX, f64::NAN.to_bits(), f64::INFINITY.to_bits(), 0x7FC0_0000_7FC0_0000];
    for chunk in bytes.chunks_mut(8) {
        // Marsaglia's xorshift.
        *noise ^= *noise << 13;
        *noise ^= *noise >> 7;
        *noise ^= *noise << 17;
        let word = patterns.get(kind).unwrap_or(noise).to_ne_bytes();
        chunk.copy_from_slice(&word[..chunk.len()]);
    }
}

/// Publishes messages of all these lengths with every kind of garbage.
fn publish_garbage<E: Message, H: Header>(bus: &Bus, topic: &Topic<E, H>, lengths: &[usize]) {
    let most = lengths.iter().copied().max().unwrap_or(0);
    let mut publisher = bus.publisher(topic, most).unwrap();
    let mut noise = 0x9E37_79B9_7F4A_7C15;
    for kind in 0..12 {
        for &length in lengths {
            let mut message = publisher.loan(length).unwrap();
            let (elements, header) = message.parts();
            fill(cast_slice_mut(elements), kind, &mut noise);
            fill(bytes_of_mut(header), kind, &mut noise);
            message.send().unwrap();
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Compares the group's present poses with the truth.
fn assert_poses_are_right(group: &Group) {
    let bus = Bus::join(&group.instance, "judge").unwrap();
    let truths = bus.subscriber(&topics::TRUTH).unwrap();
    let worlds = bus.subscriber(&topics::WORLD).unwrap();
    let mut known: BTreeMap<u64, TruthFrame> = BTreeMap::new();
    let mut judged = 0;
    let deadline = Instant::now() + PATIENCE;
    while judged < 40 {
        assert!(Instant::now() < deadline, "no poses");
        while let Some(truth) = truths.receive().unwrap() {
            known.extend(truth.message().map(|truth| (truth.seq, *truth)));
        }
        while let Some(world) = worlds.receive().unwrap() {
            let world: &WorldFrame = world.message().unwrap();
            let Some(truth) = known.get(&world.frame.seq) else { continue };
            judged += 1;
            assert_eq!(world.robots().len(), truth.robots().len());
            for (robot, truth) in world.robots().iter().zip(truth.robots()) {
                assert_eq!((robot.team, robot.robot_id), (truth.team, truth.robot_id));
                if robot.status == TrackStatus::Measured as u32 {
                    let off_mm = (robot.x_mm - truth.x_mm).hypot(robot.y_mm - truth.y_mm);
                    assert!(off_mm < 15.0, "{off_mm} mm off: {robot:?} is at {truth:?}");
                }
            }
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn garbage_on_every_topic_is_harmless() {
    check_that_garbage_is_harmless("rubbish", false);
}

#[test]
fn garbage_of_one_of_its_own_processes_is_harmless() {
    check_that_garbage_is_harmless("rubbish-own", true);
}

/// `is_of_group`: the sender passes for a process of the group.
fn check_that_garbage_is_harmless(name: &str, is_of_group: bool) {
    let mut group = Group::start(name, "", &[]);
    let before = group.wait_until_working();
    {
        let bus = Bus::join(&group.instance, "vandal").unwrap();
        if is_of_group {
            bus.enter_roster();
        }
        publish_garbage(&bus, &topics::COMMANDS, &[0, 1, 7]);
        publish_garbage(&bus, &topics::FRAMES, &[0, 1, 1000, 640 * 480]);
        publish_garbage(&bus, &topics::RUNS, &[0, 1, 1000, MAX_RUNS]);
        publish_garbage(&bus, &topics::DETECTIONS, &[0, 1, 2]);
        publish_garbage(&bus, &topics::WORLD, &[0, 1, 2]);
        publish_garbage(&bus, &topics::HEALTH, &[0, 1, 5]);
        publish_garbage(&bus, &topics::CAMERA, &[0, 1, 2]);
        publish_garbage(&bus, &topics::LIGHT, &[0, 1, 2]);
        publish_garbage(&bus, &topics::GATEWAY, &[0, 1, 2]);
        publish_garbage(&bus, &topics::STATUS, &[0, 1, MAX_STATUS_BYTES]);
    }
    let after = wait_for_more(&mut group, 80);
    assert_eq!(pids(&after), pids(&before), "somebody was replaced: {after:#}");
    assert_eq!(after["frames"]["missing_in_world"], 0, "{after:#}");
    for stage in ["classifier", "tracker", "filter"] {
        let dropped = after["stages"][stage]["dropped"].as_object().unwrap();
        let has_dropped = dropped.values().any(|count| count.as_u64() > Some(0));
        assert_eq!(has_dropped, is_of_group, "counted by the {stage}: {after:#}");
    }
    let strangers = after["strangers"].as_array().cloned().unwrap_or_default();
    let topics: Vec<_> = strangers.iter().filter_map(|it| it["topic"].as_str()).collect();
    let expected: &[&str] = match is_of_group {
        true => &[],
        false => &[
            "frames",
            "runs",
            "detections",
            "world",
            "health",
            "camera",
            "status",
            "light",
            "gateway",
        ],
    };
    for topic in expected {
        assert!(topics.contains(topic), "{topic}: {after:#}");
    }
    assert_eq!(topics.len(), expected.len(), "{after:#}");
    assert_poses_are_right(&group);

    // The state that a successor uses is not corrupted either.
    for stage in ["classifier", "tracker", "filter"] {
        group.signal(Group::pid_of(&after, stage), Signal::KILL);
        let status = wait_for_more(&mut group, 40);
        assert_eq!(status["frames"]["missing_in_world"], 0, "{stage}: {status:#}");
    }
    assert_poses_are_right(&group);
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

#[test]
fn a_configuration_that_changes_on_disk_does_not_change_the_match() {
    let mut group = Group::start("changed", "", &[]);
    group.wait_until_working();
    group.scratch.write("config.toml", "[camera]\nwidth = 12\nrubbish");
    let snapshot = fs::read(group.instance.config_path()).unwrap();
    // The second victim is the first one's spare; its successor starts from the file.
    for _ in 0..2 {
        let status = group.wait_until_working();
        group.signal(Group::pid_of(&status, "tracker"), Signal::KILL);
        let status = wait_for_more(&mut group, 40);
        assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    }
    assert_eq!(fs::read(group.instance.config_path()).unwrap(), snapshot);
    assert_poses_are_right(&group);
}

#[test]
fn a_machine_that_was_away_blames_nobody() {
    let mut group = Group::start("away", "", &[]);
    let before = group.wait_for("a complete group", |status| {
        let states = status["stages"].as_object().unwrap().values().flat_map(|stage| {
            stage["processes"].as_array().unwrap().iter().map(|process| &process["state"])
        });
        states.filter(|state| *state == "spare").count() == 3
            && status["frames"]["world"].as_u64() > Some(40)
    });
    let all: Vec<u32> = before["stages"]
        .as_object()
        .unwrap()
        .values()
        .flat_map(|stage| stage["processes"].as_array().unwrap())
        .map(|process| process["pid"].as_u64().unwrap() as u32)
        .collect();
    group.signal_supervisor(Signal::STOP);
    for &pid in &all {
        group.signal(pid, Signal::STOP);
    }
    std::thread::sleep(Duration::from_secs(2));
    // The supervisor continues first and finds every process late.
    group.signal_supervisor(Signal::CONT);
    for &pid in &all {
        group.signal(pid, Signal::CONT);
    }
    let after = wait_for_more(&mut group, 80);
    assert_eq!(pids(&after), pids(&before), "somebody was blamed: {after:#}");
    assert_eq!(after["frames"]["missing_in_world"], 0, "{after:#}");
    assert_eq!(after["frames"]["duplicates_in_world"], 0, "{after:#}");
    assert_poses_are_right(&group);
}

#[test]
fn a_stale_lock_and_rubbish_in_the_runtime_directory_stop_nobody() {
    let scratch = Scratch::new("stale");
    let directory = scratch.path.join("run/test");
    fs::create_dir_all(&directory).unwrap();
    // Left by a supervisor whose process id belongs to another process now.
    fs::write(directory.join("supervisor.lock"), format!("{}\n", std::process::id())).unwrap();
    for name in ["group.json", "control", "config.toml"] {
        fs::write(directory.join(name), b"\xff\xfe rubbish 18446744073709551616 [").unwrap();
    }
    let output = output_of(&scratch, &["stop", "--instance", "test"]);
    assert!(!output.status.success(), "it would have ended somebody else: {output:?}");
    let args = ["run", "--instance", "test", "--frames", "40", "--quiet"];
    let output = output_of(&scratch, &args);
    assert!(output.status.success(), "{output:?}");
    // It existed before, and stays.
    assert!(fs::read_dir(&directory).unwrap().next().is_none());
}
