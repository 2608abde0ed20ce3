//! Whole groups: the real program, its real processes, real signals.

mod support;

use client::bus::Bus;
use config::Config;
use grabber::synthetic::SyntheticMatch;
use messages::topics;
use messages::{FrameHeader, Team, read_text};
use rustix::process::Signal;
use serde_json::Value;
use std::time::{Duration, Instant};
use support::{Group, PATIENCE, Scratch, output_of};

const STAGES: [&str; 4] = ["grabber", "classifier", "tracker", "filter"];

fn has_spares(status: &Value) -> bool {
    ["classifier", "tracker", "filter"].iter().all(|stage| {
        let processes = status["stages"][stage]["processes"].as_array().unwrap();
        processes.iter().any(|process| process["state"] == "spare")
    })
}

#[test]
fn a_bounded_run_loses_nothing_and_finds_everything() {
    let scratch = Scratch::new("bounded-report");
    let report = scratch.path.join("report.json");
    let mut group =
        Group::start("bounded", "", &["--frames", "400", "--report", report.to_str().unwrap()]);
    assert!(group.wait_until_ended().success(), "{}", group.stderr());
    group.assert_nothing_left();

    let report: Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
    let frames = &report["frames"];
    assert_eq!(frames["captured"], 400, "{report:#}");
    assert_eq!(frames["world"], 400, "{report:#}");
    for nothing in
        ["dropped_by_grabber", "never_captured", "missing_in_world", "duplicates_in_world"]
    {
        assert_eq!(frames[nothing], 0, "{nothing}: {report:#}");
    }
    for stage in STAGES {
        assert_eq!(report["stages"][stage]["restarts"], 0, "{report:#}");
        assert_eq!(report["stages"][stage]["frames_out"], 400, "{report:#}");
    }
    let of = |level: &str, key: &str| report["accuracy"][level][key].as_f64().unwrap();
    for level in ["detections", "world"] {
        assert!(of(level, "found_ratio") >= 0.999, "{report:#}");
        assert_eq!(of(level, "wrong_identity"), 0.0, "{report:#}");
        assert!(of(level, "ball_found_ratio") >= 0.95, "{report:#}");
    }
    assert!(of("world", "position_rms_mm") < of("detections", "position_rms_mm"), "{report:#}");
    assert!(of("world", "heading_rms_deg") < of("detections", "heading_rms_deg"), "{report:#}");
    // The paper's figure for robots that stand still.
    let standing = &report["accuracy"]["world"]["standing"];
    assert!(standing["samples"].as_u64() > Some(100), "{report:#}");
    assert!(standing["position_p99_mm"].as_f64() < Some(1.0), "{report:#}");
    assert!(standing["heading_p99_deg"].as_f64() < Some(1.0), "{report:#}");
}

#[test]
fn a_killed_stage_is_replaced_while_the_camera_goes_on() {
    let mut group = Group::start("killed", "", &[]);
    let mut status = group.wait_until_working();
    let bus = Bus::join(&group.instance, "logger").unwrap();
    let events = bus.subscriber(&topics::EVENTS).unwrap();
    let mut killed = Vec::new();
    for stage in ["filter", "tracker", "classifier"] {
        let pid = Group::pid_of(&status, stage);
        killed.push(pid);
        group.signal(pid, Signal::KILL);
        let world = status["frames"]["world"].as_u64().unwrap();
        status = group.wait_for("a replacement", |status| {
            status["complete"] == true
                && Group::pid_of(status, stage) != pid
                && status["frames"]["world"].as_u64() > Some(world + 40)
        });
        assert_eq!(status["frames"]["dropped_by_grabber"], 0, "{status:#}");
        assert_eq!(status["frames"]["never_captured"], 0, "{status:#}");
        assert_eq!(status["frames"]["duplicates_in_world"], 0, "{status:#}");
    }
    let pid = Group::pid_of(&status, "grabber");
    group.signal(pid, Signal::KILL);
    let world = status["frames"]["world"].as_u64().unwrap();
    let status = group.wait_for("a new grabber", |status| {
        status["complete"] == true && status["frames"]["world"].as_u64() > Some(world + 40)
    });
    assert!(
        status["frames"]["never_captured"].as_u64() > Some(0),
        "the gap is counted: {status:#}"
    );
    assert_eq!(status["frames"]["duplicates_in_world"], 0, "numbers continue: {status:#}");
    assert!(status["events"].as_array().unwrap().len() >= 4, "{status:#}");
    // A logger has received them too.
    let mut told = Vec::new();
    while let Some(received) = events.receive().unwrap() {
        let event = received.message().unwrap();
        told.push((event.pid, read_text(&event.what)));
    }
    for pid in killed {
        let is_it = |(told, what): &(u32, String)| *told == pid && what.contains("SIGKILL");
        assert!(told.iter().any(is_it), "{pid}: {told:?}");
    }
    drop((events, bus));

    let output = output_of(&group.scratch, &["stop", "--instance", "test"]);
    assert!(output.status.success(), "{output:?}");
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

/// A kill causes several messages, and nobody reads them.
#[test]
fn a_match_goes_on_when_its_terminal_is_gone() {
    let mut group = Group::start_unheard("unheard");
    for stage in ["tracker", "filter"] {
        let pid = Group::pid_of(&group.wait_for("spares", has_spares), stage);
        group.signal(pid, Signal::KILL);
        group.wait_for("a replacement", |status| {
            status["complete"] == true && Group::pid_of(status, stage) != pid
        });
    }
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

#[test]
fn a_stalled_stage_is_replaced() {
    let mut group = Group::start("stalled", "", &[]);
    let status = group.wait_until_working();
    let pid = Group::pid_of(&status, "tracker");
    group.signal(pid, Signal::STOP);
    let world = status["frames"]["world"].as_u64().unwrap();
    let status = group.wait_for("a replacement", |status| {
        status["complete"] == true
            && Group::pid_of(status, "tracker") != pid
            && status["frames"]["world"].as_u64() > Some(world + 80)
    });
    assert_eq!(status["frames"]["never_captured"], 0, "{status:#}");
    group.signal_supervisor(Signal::INT);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

#[test]
fn a_kill_costs_no_frame_because_a_spare_takes_over() {
    let mut group = Group::start("spares", "", &[]);
    for stage in ["filter", "tracker", "classifier"] {
        let status = group.wait_for("spares", has_spares);
        group.signal(Group::pid_of(&status, stage), Signal::KILL);
        let world = status["frames"]["world"].as_u64().unwrap();
        let status = group.wait_for("further frames", |status| {
            status["frames"]["world"].as_u64() > Some(world + 40)
        });
        assert_eq!(status["frames"]["missing_in_world"], 0, "{stage}: {status:#}");
        assert_eq!(status["frames"]["duplicates_in_world"], 0, "{stage}: {status:#}");
    }
}

#[test]
fn a_frame_that_kills_two_processes_is_skipped_and_kept() {
    for stage in ["classifier", "tracker", "filter"] {
        let mut group =
            Group::start_with("poison", "", &[], &[("TOUCHLINE_FAULT", &format!("{stage}@150"))]);
        let status = group.wait_for("the group to get over it", |status| {
            status["frames"]["world"].as_u64() > Some(200)
        });
        assert_eq!(status["stages"][stage]["dropped"]["poisonous"], 1, "{status:#}");
        // On a busy machine the one that begins from nothing may stall, too.
        assert!(status["stages"][stage]["restarts"].as_u64() >= Some(2), "{status:#}");
        assert_eq!(status["frames"]["missing_in_world"], 1, "only that one: {status:#}");
        let events = status["events"].to_string();
        assert!(events.contains("asked to panic at 150"), "the last words are kept: {events}");
        let kept = group.scratch.path.join("state/touchline/test-frame-150.png");
        let deadline = std::time::Instant::now() + support::PATIENCE;
        while image::open(&kept).is_err() {
            assert!(
                std::time::Instant::now() < deadline,
                "{} is not there: {events}",
                kept.display()
            );
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
    }
}

#[test]
fn a_new_supervisor_takes_over_what_the_old_one_has_left() {
    let mut group = Group::start("takeover", "", &[]);
    let before = group.wait_for("spares", |status| {
        status["stages"]["filter"]["processes"].as_array().unwrap().len() == 2
            && status["complete"] == true
            && status["frames"]["world"].as_u64() > Some(40)
    });
    group.replace_supervisor();
    let after = group.wait_for("a group under the new supervisor", |status| {
        status["complete"] == true
            && status["supervisor_pid"] != before["supervisor_pid"]
            && status["frames"]["world"].as_u64() > Some(40)
    });
    for stage in STAGES {
        let (before, after) = (Group::pid_of(&before, stage), Group::pid_of(&after, stage));
        assert_eq!(before, after, "the {stage} was replaced\n{}", group.stderr());
    }
    assert_eq!(after["frames"]["missing_in_world"], 0, "{after:#}");
    // It also supervises what it took over.
    let pid = Group::pid_of(&after, "tracker");
    group.signal(pid, Signal::KILL);
    let world = after["frames"]["world"].as_u64().unwrap();
    let after = group.wait_for("a replacement", |status| {
        status["complete"] == true
            && Group::pid_of(status, "tracker") != pid
            && status["frames"]["world"].as_u64() > Some(world + 40)
    });
    assert_eq!(after["frames"]["missing_in_world"], 0, "{after:#}");
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

/// The new supervisor has seen nothing of a stage whose processes died together with the old
/// supervisor.
#[test]
fn a_stage_that_dies_with_the_supervisor_repeats_nothing() {
    let mut group = Group::start("dies-along", "", &[]);
    let before = group.wait_for("spares", |status| {
        has_spares(status) && status["frames"]["world"].as_u64() > Some(40)
    });
    let bus = Bus::join(&group.instance, "test").unwrap();
    let world = bus.subscriber(&topics::WORLD).unwrap();
    let mut numbers = Vec::new();
    let mut read_on = |count: usize, group: &Group| {
        let deadline = Instant::now() + PATIENCE;
        while numbers.len() < count {
            assert!(Instant::now() < deadline, "no world any more\n{}", group.stderr());
            while let Some(received) = world.receive().unwrap() {
                numbers.extend(received.message().map(|world| world.frame.seq));
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    };
    // Repetitions must have been received to be noticed.
    read_on(100, &group);
    group.kill_supervisor();
    for process in before["stages"]["filter"]["processes"].as_array().unwrap() {
        group.signal(process["pid"].as_u64().unwrap() as u32, Signal::KILL);
    }
    group.replace_supervisor();
    read_on(300, &group);
    // On a busy machine the filter may start so late that frames have been overwritten; the rest must
    // still arrive once and in order.
    assert!(numbers.is_sorted_by(|a, b| a < b), "{numbers:?}");
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
}

#[test]
fn stages_are_restarted_on_request_without_losing_a_frame() {
    let mut group = Group::start("restart", "", &[]);
    let before = group.wait_for("spares", has_spares);
    let stages = ["classifier", "tracker", "filter"];
    let output = group.touchline(&[&["restart"], &stages[..]].concat());
    assert!(output.status.success(), "{output:?}\n{:#?}\n{}", group.try_status(), group.stderr());
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let world = before["frames"]["world"].as_u64().unwrap();
    let after = group.wait_for("further frames", |status| {
        status["complete"] == true && status["frames"]["world"].as_u64() > Some(world + 40)
    });
    for stage in stages {
        let pid = Group::pid_of(&after, stage);
        assert_ne!(Group::pid_of(&before, stage), pid, "{after:#}");
        assert!(said.contains(&pid.to_string()), "{stage} {pid}: {said}");
    }
    for nothing in ["missing_in_world", "duplicates_in_world", "never_captured"] {
        assert_eq!(after["frames"][nothing], 0, "{nothing}: {after:#}");
    }

    let output = group.touchline(&["restart", "referee"]);
    assert!(!output.status.success());
    assert!(String::from_utf8_lossy(&output.stderr).contains("classifier"), "{output:?}");
}

#[test]
fn a_run_of_some_seconds_ends_then_even_when_there_is_no_camera() {
    let started = Instant::now();
    let args = ["--source", "v4l2:/dev/no-such-camera", "--seconds", "2.5"];
    let mut group = Group::start("no-camera", "", &args);
    assert!(group.wait_until_ended().success(), "{}", group.stderr());
    assert!(started.elapsed() >= Duration::from_millis(2500), "{:?}", started.elapsed());
    group.assert_nothing_left();
}

/// A stage that is asked to end while others are still starting has not failed to start.
#[test]
fn a_restart_of_a_group_that_is_still_starting_does_not_end_it() {
    // The camera starts slowly: it renders all its frames first.
    let mut group = Group::start("early", "", &["--source", "synthetic-loop:1000"]);
    group.wait_for("a report", |_| true);
    let output = group.touchline(&["restart", "classifier", "tracker", "filter"]);
    let said = format!("{output:?}\n{}", group.stderr());
    assert!(output.status.success(), "{said}");
    group.wait_until_working();
}

#[test]
fn an_upgrade_hands_over_stage_by_stage_without_losing_a_frame() {
    let mut group = Group::start("upgrade", "", &[]);
    let before = group.wait_for("spares", has_spares);
    let subscriber_bus = Bus::join(&group.instance, "witness").unwrap();
    let world = subscriber_bus.subscriber(&topics::WORLD).unwrap();
    let mut seen = Vec::new();
    let mut look = || {
        while let Some(received) = world.receive().unwrap() {
            seen.extend(received.message().map(|world| world.frame.seq));
        }
    };

    // The same program in another file, which the system takes for another program.
    let program = group.scratch.path.join("touchline-next");
    std::fs::copy(env!("CARGO_BIN_EXE_touchline"), &program).unwrap();
    let mut upgrade = group.start_touchline(&["upgrade", program.to_str().unwrap()]);
    while upgrade.try_wait().unwrap().is_none() {
        look();
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    assert!(upgrade.wait().unwrap().success(), "{}", group.stderr());
    let after = group.wait_for("the upgraded group", |status| {
        status["complete"] == true && status["frames"]["world"].as_u64() > Some(40)
    });
    look();

    assert_eq!(before["supervisor_pid"], after["supervisor_pid"], "it is the same process");
    for stage in STAGES {
        let pid = Group::pid_of(&after, stage);
        let runs = std::fs::read_link(format!("/proc/{pid}/exe")).unwrap();
        assert_eq!(runs, program, "{stage}");
    }
    // Only the grabber's own restart may cost frames, and those were never captured.
    let gaps: Vec<_> = seen.windows(2).filter(|pair| pair[1] != pair[0] + 1).collect();
    assert!(gaps.len() <= 1 && seen.is_sorted(), "{gaps:?}\n{}", group.stderr());
    assert_eq!(after["frames"]["missing_in_world"], 0, "{after:#}");

    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    drop((world, subscriber_bus));
}

#[test]
fn an_upgrade_that_does_not_fit_changes_nothing() {
    let mut group = Group::start("misfit", "", &[]);
    let before = group.wait_until_working();
    let real = env!("CARGO_BIN_EXE_touchline");
    let cases = [
        (
            "another message version",
            format!("exec {real} \"$@\" | sed s,WorldFrame/[0-9]*,WorldFrame/99,"),
            "WorldFrame/99",
        ),
        (
            "a configuration it does not take",
            format!("[ $1 = interface ] && exec {real} \"$@\"; echo no such key >&2; exit 1"),
            "no such key",
        ),
        ("no touchline at all", "echo hello".into(), "does not say"),
    ];
    for (what, script, hint) in cases {
        let program = group.scratch.write("next", &format!("#!/bin/sh\n{script}\n"));
        let mut rights = std::fs::metadata(&program).unwrap().permissions();
        std::os::unix::fs::PermissionsExt::set_mode(&mut rights, 0o755);
        std::fs::set_permissions(&program, rights).unwrap();
        let output = group.touchline(&["upgrade", program.to_str().unwrap()]);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success(), "{what}: accepted");
        assert!(text.contains(hint) && text.contains("nothing was changed"), "{what}: {text}");
    }
    let after = group.wait_until_working();
    for stage in STAGES {
        assert_eq!(Group::pid_of(&before, stage), Group::pid_of(&after, stage));
    }
    assert_eq!(after["frames"]["missing_in_world"], 0, "{after:#}");
}

#[test]
fn a_group_left_behind_is_adopted_as_it_was_run() {
    let mut group = Group::start("adopt", "[camera]\nfps = 50\n", &["--frames", "100000"]);
    let before = group.wait_until_working();
    group.signal_supervisor(Signal::KILL);
    group.wait_until_ended();
    let output = group.touchline(&["status"]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("run --adopt"), "{output:?}");
    group.replace_supervisor_by(&["run", "--instance", "test", "--adopt"]);
    let after = group.wait_for("a group under the new supervisor", |status| {
        status["complete"] == true && status["supervisor_pid"] != before["supervisor_pid"]
    });
    assert_eq!(after["camera"]["fps"], 50.0, "{after:#}");
    for stage in STAGES {
        assert_eq!(Group::pid_of(&before, stage), Group::pid_of(&after, stage), "{stage}");
    }
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();

    let output = group.touchline(&["run", "--adopt"]);
    assert!(!output.status.success());
    assert!(String::from_utf8_lossy(&output.stderr).contains("left behind"), "{output:?}");
}

#[test]
fn bad_frames_are_dropped_and_counted_with_a_reason() {
    let mut group = Group::start("bad-frames", "", &[]);
    let status = group.wait_until_working();
    let pid = Group::pid_of(&status, "classifier");

    let good = FrameHeader {
        width: 640,
        height: 480,
        stride: 640,
        pixel_format: 1,
        ..FrameHeader::default()
    };
    let bad = [
        (FrameHeader { width: 320, ..good }, 640 * 480),
        (FrameHeader { stride: 10, ..good }, 640 * 480),
        (good, 1000),
        (FrameHeader { pixel_format: 99, ..good }, 640 * 480),
        (FrameHeader { bayer_order: u32::MAX, ..good }, 640 * 480),
        (FrameHeader { height: u32::MAX, stride: u32::MAX, width: u32::MAX, ..good }, 0),
        (good, 640 * 480), // its number is an old one
        (FrameHeader { seq: u64::MAX - 1, ..good }, 640 * 480),
    ];
    {
        let bus = Bus::join(&group.instance, "rubbish").unwrap();
        // Sent as if by the grabber.
        bus.enter_roster();
        let mut injector = bus.publisher(&topics::FRAMES, 640 * 480).unwrap();
        for (header, bytes) in bad {
            let mut frame = injector.loan(bytes).unwrap();
            *frame.parts().1 = header;
            frame.send().unwrap();
        }
        let dropped = |status: &Value, reason: &str| {
            status["stages"]["classifier"]["dropped"][reason].as_u64().unwrap_or(0)
        };
        let status = group.wait_for("all bad frames counted", |status| {
            dropped(status, "wrong_size") == 4
                && dropped(status, "wrong_format") == 2
                && dropped(status, "out_of_order") == 1
                && dropped(status, "bad_header") == 1
        });
        assert_eq!(Group::pid_of(&status, "classifier"), pid, "it was not replaced: {status:#}");
        let events = status["events"].to_string();
        assert!(events.contains("dropped input") && events.contains("wrong_size"), "{events}");
        assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    }
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

#[test]
fn pictures_give_the_same_in_a_group_as_on_their_own() {
    let scratch = Scratch::new("pictures");
    let config = Config::default();
    let (width, height) = (config.camera.width, config.camera.height);
    let mut pixels = vec![0; (width * height) as usize];
    let mut scene = SyntheticMatch::new(&config).unwrap();
    scene.render(&mut pixels, width as usize);
    let picture = scratch.path.join("picture.png");
    image::GrayImage::from_raw(width, height, pixels).unwrap().save(&picture).unwrap();
    let picture = picture.to_str().unwrap();

    let output = output_of(&scratch, &["detect", picture, "--json"]);
    let alone: Value = serde_json::from_slice(&output.stdout).unwrap();
    let alone = alone["robots"].as_array().unwrap();
    assert_eq!(alone.len(), scene.truth().robots().len());

    let mut group = Group::start("shown", "", &["--source", &format!("images:{picture}")]);
    group.wait_until_working();
    let bus = Bus::join(&group.instance, "reader").unwrap();
    let detections = bus.subscriber(&topics::DETECTIONS).unwrap();
    let deadline = std::time::Instant::now() + support::PATIENCE;
    let received = loop {
        if let Some(received) = detections.newest().unwrap() {
            break received;
        }
        assert!(std::time::Instant::now() < deadline, "no detections");
        std::thread::sleep(std::time::Duration::from_millis(5));
    };
    let robots = received.message().unwrap().robots();
    assert_eq!(robots.len(), alone.len());
    for (robot, alone) in robots.iter().zip(alone) {
        let team = Team::from_number(robot.team).unwrap().name();
        assert_eq!(
            (team, robot.robot_id.number().map(u64::from)),
            (alone["team"].as_str().unwrap(), alone["id"].as_u64())
        );
        for (there, here) in [(robot.x_mm, &alone["x_mm"]), (robot.y_mm, &alone["y_mm"])] {
            assert!((f64::from(there) - here.as_f64().unwrap()).abs() < 0.1, "{robot:?} {alone}");
        }
    }
}

#[test]
fn a_group_survives_nothing_but_leaves_no_trouble_for_the_next() {
    let mut group = Group::start("massacre", "", &[]);
    let status = group.wait_until_working();
    group.signal_supervisor(Signal::KILL);
    for stage in STAGES {
        group.signal(Group::pid_of(&status, stage), Signal::KILL);
    }
    group.wait_until_ended();
    let left = support::shared_memory(&group.namespace());
    assert!(left.len() > 1, "nothing was left: the test is too weak");

    let output =
        output_of(&group.scratch, &["run", "--instance", "test", "--frames", "40", "--quiet"]);
    assert!(output.status.success(), "{output:?}");
    group.assert_nothing_left();
}

/// A strategy that stays connected from one match to the next.
#[test]
fn a_consumer_that_stays_does_not_keep_an_ended_group_alive() {
    let mut group = Group::start("stays", "", &[]);
    group.wait_until_working();
    let bus = Bus::join(&group.instance, "strategy").unwrap();
    let world = bus.subscriber(&topics::WORLD).unwrap();
    group.wait_until_working();
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());

    let status = output_of(&group.scratch, &["status", "--instance", "test"]);
    let said = String::from_utf8_lossy(&status.stderr).into_owned();
    assert!(!status.status.success() && !said.contains("--adopt"), "{said}");
    let adopted = output_of(&group.scratch, &["run", "--adopt", "--instance", "test", "--quiet"]);
    assert!(!adopted.status.success(), "an ended group was started again: {adopted:?}");

    // The next match starts with number 0.
    while world.receive().unwrap().is_some() {}
    let args = ["run", "--instance", "test", "--frames", "120", "--quiet"];
    let mut next = support::touchline(&group.scratch, &args).spawn().unwrap();
    let mut first = None;
    let deadline = Instant::now() + PATIENCE;
    while first.is_none() && Instant::now() < deadline {
        let received = world.receive().unwrap();
        first = received.and_then(|received| received.message().map(|world| world.frame.seq));
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(next.wait().unwrap().success());
    assert_eq!(first, Some(0));
    drop((world, bus));
    let output =
        output_of(&group.scratch, &["run", "--instance", "test", "--frames", "4", "--quiet"]);
    assert!(output.status.success(), "{output:?}");
    group.assert_nothing_left();
}

#[test]
fn stages_end_by_themselves_when_nobody_supervises_them_any_more() {
    let mut group = Group::start("orphans", "[supervisor]\norphan_timeout_s = 1\n", &[]);
    let status = group.wait_until_working();
    let pids = STAGES.map(|stage| Group::pid_of(&status, stage));
    group.signal_supervisor(Signal::KILL);
    group.wait_until_ended();
    assert!(pids.iter().any(|&pid| support::is_stage(pid)), "they should outlive it for a second");
    let deadline = std::time::Instant::now() + support::PATIENCE;
    while pids.iter().any(|&pid| support::is_stage(pid)) {
        assert!(std::time::Instant::now() < deadline, "orphans are still running");
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
}

#[test]
fn a_second_group_of_the_same_name_is_refused_and_harms_nothing() {
    let mut group = Group::start("twice", "", &[]);
    group.wait_until_working();
    let output = output_of(&group.scratch, &["run", "--instance", "test", "--frames", "10"]);
    assert!(!output.status.success());
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(text.contains("running already") && text.contains("touchline stop"), "{text}");
    let status = group.wait_until_working();
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
}

#[test]
fn impossible_runs_are_refused_before_anything_starts() {
    let scratch = Scratch::new("refused");
    let config = scratch.write("bad.toml", "[camera]\nfpz = 80\n");
    let config = config.to_str().unwrap();
    let cases: [(&[&str], &str); 5] = [
        (&["run", "--config", config], "fps"),
        (&["run", "--config", "/nonexistent.toml"], "/nonexistent.toml"),
        (&["run", "--source", "images:/nonexistent"], "/nonexistent"),
        (&["run", "--source", "camera"], "synthetic"),
        (&["run", "--instance", "../up", "--frames", "1"], "instance name"),
    ];
    for (args, hint) in cases {
        let output = output_of(&scratch, args);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success(), "{args:?} was accepted");
        assert!(text.contains(hint), "{args:?} says {text:?}, which does not help");
        assert!(!scratch.path.join("run").exists(), "{args:?} made a runtime directory");
    }
}
