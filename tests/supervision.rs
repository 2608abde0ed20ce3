//! Refused system calls and a hostile environment do not end a match.

mod support;

use rustix::process::{Pid, Resource, Rlimit, Signal, getrlimit, prlimit};
use serde_json::Value;
use std::fs;
use std::io::{ErrorKind, Read, Write};
use std::os::fd::AsFd;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};
use support::{Group, Scratch, is_stage, output_of};

const SPARED: [&str; 3] = ["classifier", "tracker", "filter"];

fn has_spares(status: &Value) -> bool {
    status["complete"] == true
        && SPARED.iter().all(|stage| {
            let processes = status["stages"][stage]["processes"].as_array().unwrap();
            processes.iter().any(|process| process["state"] == "spare")
        })
}

fn world(status: &Value) -> u64 {
    status["frames"]["world"].as_u64().unwrap()
}

fn says(status: &Value, words: &str) -> bool {
    status["events"]
        .as_array()
        .unwrap()
        .iter()
        .any(|event| event["what"].as_str().unwrap().contains(words))
}

/// Waits for this many more frames in `world`.
fn wait_for_more(group: &mut Group, frames: u64) -> Value {
    let before = group.wait_until_working();
    group.wait_for("more frames", |status| world(status) >= world(&before) + frames)
}

fn assert_nothing_lost(status: &Value) {
    for nothing in ["missing_in_world", "duplicates_in_world", "never_captured"] {
        assert_eq!(status["frames"][nothing], 0, "{nothing}: {status:#}");
    }
}

/// Whether a limit that was lowered can be raised again (`CAP_SYS_RESOURCE`).
fn is_privileged() -> bool {
    let mut child = Command::new("sleep").arg("60").spawn().unwrap();
    let pid = Some(Pid::from_child(&child));
    let limit = |most: u64| Rlimit { current: Some(4), maximum: Some(most) };
    prlimit(pid, Resource::Nofile, limit(4)).unwrap();
    let is_privileged = prlimit(pid, Resource::Nofile, limit(64)).is_ok();
    child.kill().unwrap();
    child.wait().unwrap();
    is_privileged
}

/// Kills a stage's process and waits for the next one.
fn kill_and_wait(group: &mut Group, stage: &str) -> Value {
    let pid = Group::pid_of(&group.wait_for("spares", has_spares), stage);
    group.signal(pid, Signal::KILL);
    group.wait_for("a replacement", |status| {
        has_spares(status) && Group::pid_of(status, stage) != pid
    })
}

fn end(mut group: Group) {
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success(), "{}", group.stderr());
    group.assert_nothing_left();
}

#[test]
fn without_descriptors_the_match_goes_on_and_spares_come_back_with_them() {
    let mut group = Group::start("no-descriptors", "", &[]);
    let status = group.wait_for("spares", has_spares);
    let pid = Pid::from_raw(group.supervisor_pid() as i32);
    // The highest limit that may be restored.
    let most = fs::read_to_string("/proc/sys/fs/nr_open").unwrap().trim().parse().unwrap();
    let maximum = getrlimit(Resource::Nofile).maximum.map_or(most, |own: u64| own.min(most));
    let limit = |current, maximum| {
        prlimit(pid, Resource::Nofile, Rlimit { current: Some(current), maximum: Some(maximum) })
    };
    // If it is permitted to raise the limit, the supervisor must not do so by itself.
    let is_privileged = is_privileged();
    limit(4, if is_privileged { 4 } else { maximum }).unwrap();
    for stage in SPARED {
        group.signal(Group::pid_of(&status, stage), Signal::KILL);
        std::thread::sleep(Duration::from_millis(300));
    }
    std::thread::sleep(Duration::from_millis(500));
    group.assert_running();
    limit(maximum.min(1024), maximum).unwrap();
    let after = group
        .wait_for("spares again", |after| has_spares(after) && world(after) > world(&status) + 80);
    assert_nothing_lost(&after);
    if is_privileged {
        assert!(says(&after, "start the"), "it was not said: {after:#}");
        assert!(says(&after, "works again"), "its end was not said: {after:#}");
    }
    end(group);
}

/// The supervisor may put files back meanwhile.
fn remove_whole(directory: &Path) {
    while let Err(error) = fs::remove_dir_all(directory) {
        assert_eq!(error.kind(), ErrorKind::DirectoryNotEmpty, "{error}");
    }
}

#[test]
fn a_runtime_directory_that_is_removed_comes_back_and_nobody_starts_a_second_group() {
    let mut group = Group::start("no-directory", "", &[]);
    group.wait_for("spares", has_spares);
    let directory = group.instance.directory().to_path_buf();
    for what in ["lock", "directory", "directory and base"] {
        match what {
            "lock" => fs::remove_file(directory.join("supervisor.lock")).unwrap(),
            "directory" => remove_whole(&directory),
            _ => remove_whole(directory.parent().unwrap()),
        }
        let second = output_of(&group.scratch, &["run", "--instance", "test", "--frames", "5"]);
        let said = String::from_utf8_lossy(&second.stderr).into_owned();
        assert!(!second.status.success() && said.contains("is running already"), "{what}: {said}");
        let status = kill_and_wait(&mut group, "tracker");
        assert_nothing_lost(&status);
        // The refused program held the lock for a while, so this may take several looks.
        let restored = if what == "lock" { "removed the lock" } else { "removed the directory" };
        group.wait_for(what, |status| {
            says(status, restored) && directory.join("supervisor.lock").exists()
        });
    }
    // Longer than the stages live without a supervisor.
    let begun = Instant::now();
    let pids = SPARED.map(|stage| Group::pid_of(&group.wait_for("spares", has_spares), stage));
    while begun.elapsed() < Duration::from_secs(4) {
        let _ = fs::remove_dir_all(&directory);
        std::thread::sleep(Duration::from_millis(10));
    }
    let status = wait_for_more(&mut group, 40);
    assert_eq!(SPARED.map(|stage| Group::pid_of(&status, stage)), pids, "{status:#}");
    let stopped = group.touchline(&["stop"]);
    assert!(stopped.status.success(), "{stopped:?}");
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

#[test]
fn a_terminal_that_is_closed_does_not_end_the_match() {
    let mut group = Group::start("hang-up", "", &[]);
    group.wait_for("spares", has_spares);
    group.signal_supervisor(Signal::HUP);
    let status =
        group.wait_for("the hint", |status| says(status, "touchline status --instance test"));
    assert!(!says(&status, "ended"), "{status:#}");
    assert_nothing_lost(&kill_and_wait(&mut group, "filter"));
    end(group);
}

#[test]
fn nohup_is_obeyed() {
    let scratch = Scratch::new("nohup");
    let program = env!("CARGO_BIN_EXE_touchline");
    let script =
        "trap '' HUP; exec \"$0\" run --instance test --frames 160 --quiet --report \"$1\"";
    let mut run = Command::new("sh")
        .args(["-c", script, program])
        .arg(scratch.path.join("report"))
        .env("TOUCHLINE_NO_CONSOLE", "1")
        .env("TOUCHLINE_RUNTIME_DIR", scratch.path.join("run"))
        .stderr(fs::File::create(scratch.path.join("stderr")).unwrap())
        .spawn()
        .unwrap();
    std::thread::sleep(Duration::from_secs(1));
    let pid = Pid::from_child(&run);
    rustix::process::kill_process(pid, Signal::HUP).unwrap();
    assert!(run.wait().unwrap().success());
    let said = fs::read_to_string(scratch.path.join("stderr")).unwrap();
    assert!(!said.contains("SIGHUP"), "{said}");
    let report = fs::read(scratch.path.join("report")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    assert_eq!(report["frames"]["captured"], 160, "{report:#}");
}

#[test]
fn a_reader_that_stops_reading_holds_up_nothing() {
    let (mut reader, mut writer) = std::io::pipe().unwrap();
    // The pipe is full from the beginning and never read.
    let flags = rustix::fs::fcntl_getfl(writer.as_fd()).unwrap();
    rustix::fs::fcntl_setfl(&writer, flags | rustix::fs::OFlags::NONBLOCK).unwrap();
    while writer.write(&[b'-'; 512]).is_ok() {}
    rustix::fs::fcntl_setfl(&writer, flags).unwrap();
    let mut group = Group::start_speaking_to("stalled-reader", writer);
    for stage in SPARED {
        assert_nothing_lost(&kill_and_wait(&mut group, stage));
    }
    let stopped = group.touchline(&["stop"]);
    assert!(stopped.status.success(), "{stopped:?}");
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
    let mut said = Vec::new();
    reader.read_to_end(&mut said).unwrap();
}

#[test]
fn a_stalled_grabber_is_noticed_and_its_gap_is_short() {
    let mut group = Group::start("stalled-grabber", "", &[]);
    let status = wait_for_more(&mut group, 40);
    let pid = Group::pid_of(&status, "grabber");
    group.signal(pid, Signal::STOP);
    let status = group.wait_for("a new grabber", |status| {
        status["complete"] == true && Group::pid_of(status, "grabber") != pid
    });
    assert!(says(&status, "killed: it gives no frames"), "{status:#}");
    let status = wait_for_more(&mut group, 40);
    let gap = status["frames"]["never_captured"].as_u64().unwrap();
    assert!(gap > 0 && gap < 150, "formerly 167 frames and more: {gap}");
    end(group);
}

#[test]
fn a_supervisor_that_was_frozen_says_what_it_has_not_seen() {
    let mut group = Group::start("frozen", "", &[]);
    let before = group.wait_for("spares", has_spares);
    let pids = SPARED.map(|stage| Group::pid_of(&before, stage));
    let grabber = Group::pid_of(&before, "grabber");
    for _ in 0..2 {
        group.signal_supervisor(Signal::STOP);
        std::thread::sleep(Duration::from_secs(3));
        group.signal_supervisor(Signal::CONT);
        wait_for_more(&mut group, 80);
    }
    let after = wait_for_more(&mut group, 40);
    assert_nothing_lost(&after);
    assert!(after["frames"]["not_seen"].as_u64() > Some(100), "{after:#}");
    assert_eq!(SPARED.map(|stage| Group::pid_of(&after, stage)), pids, "somebody was blamed");
    assert_eq!(Group::pid_of(&after, "grabber"), grabber, "the grabber was blamed");
    end(group);
}

/// As with `ulimit -v`: the frames of a new grabber cannot be mapped.
#[test]
fn a_grabber_that_the_supervisor_cannot_see_is_left_alone() {
    let mut group = Group::start("no-address-space", "", &[]);
    let before = group.wait_for("spares", has_spares);
    let supervisor = group.supervisor_pid();
    let pid = Pid::from_raw(supervisor as i32);
    let stat = fs::read_to_string(format!("/proc/{supervisor}/statm")).unwrap();
    let pages: u64 = stat.split(' ').next().unwrap().parse().unwrap();
    let limit = pages * rustix::param::page_size() as u64 + (4 << 20);
    let old = getrlimit(Resource::As);
    let limit = Rlimit { current: Some(limit), maximum: old.maximum };
    let old = prlimit(pid, Resource::As, limit).unwrap();
    let grabber = Group::pid_of(&before, "grabber");
    group.signal(grabber, Signal::KILL);
    std::thread::sleep(Duration::from_secs(1));
    let grabbers = || -> Vec<u32> {
        let entries = fs::read_dir("/proc").unwrap().flatten();
        let pids = entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
        let scratch = group.scratch.path.join("run").into_os_string().into_string().unwrap();
        pids.filter(|&pid: &u32| {
            let line = fs::read_to_string(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            is_stage(pid) && line.contains("grabber") && line.contains(&scratch)
        })
        .collect()
    };
    let first = grabbers();
    assert_eq!(first.len(), 1, "one grabber");
    for _ in 0..20 {
        std::thread::sleep(Duration::from_millis(200));
        assert_eq!(grabbers(), first, "it was killed because nobody saw it");
    }
    prlimit(pid, Resource::As, old).unwrap();
    let after = wait_for_more(&mut group, 80);
    assert_eq!(Group::pid_of(&after, "grabber"), first[0]);
    let gap = after["frames"]["never_captured"].as_u64().unwrap();
    assert!(gap < 150, "what was not seen counts as never captured: {after:#}");
    assert_eq!(after["frames"]["missing_in_world"], 0, "{after:#}");
    end(group);
}

fn wait_until_said(group: &mut Group, what: &str, times: usize) {
    let deadline = Instant::now() + support::PATIENCE;
    while group.stderr().matches(what).count() < times {
        group.assert_running();
        assert!(Instant::now() < deadline, "{what:?} was not said: {}", group.stderr());
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn a_fault_in_the_monitor_does_not_end_the_supervisor() {
    let variables = [("TOUCHLINE_FAULT", "monitor@150")];
    let mut group = Group::start_with("monitor-fault", "", &[], &variables);
    wait_until_said(&mut group, "the monitor has panicked", 1);
    wait_until_said(&mut group, "the monitor has met a fault", 1);
    // There is a status only if there is another monitor.
    let status = group.wait_for("another monitor", |now| has_spares(now) && world(now) > 20);
    assert_nothing_lost(&status);

    // Another program truncates shared memory: touching it is a SIGBUS.
    let path = group.namespace().event_count_path("events");
    let count = fs::OpenOptions::new().write(true).open(path).unwrap();
    count.set_len(0).unwrap();
    let tracker = Group::pid_of(&status, "tracker");
    group.signal(tracker, Signal::KILL);
    wait_until_said(&mut group, "the monitor has met a fault", 2);
    let status = group.wait_for("a third monitor", |now| has_spares(now) && world(now) > 20);
    assert_nothing_lost(&status);
    assert_ne!(Group::pid_of(&status, "tracker"), tracker, "{status:#}");
    assert_nothing_lost(&kill_and_wait(&mut group, "filter"));
    end(group);
}
