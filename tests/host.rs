//! A group and its computer: shared memory, rights, other users, the service manager.
//!
//! Tests that need root are ignored by default; `scripts/check` runs them if it is root.

mod support;

use rustix::process::Signal;
use serde_json::Value;
use std::fs;
use std::os::unix::fs::{PermissionsExt, chown, symlink};
use std::os::unix::net::UnixDatagram;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, Instant};
use support::{Group, PATIENCE, Scratch, output_of, shared_memory, touchline};

/// User id of `nobody` on every Linux.
const NOBODY: u32 = 65534;

/// The program at a place where every user can reach it.
fn program_for_all(scratch: &Scratch) -> PathBuf {
    fs::set_permissions(&scratch.path, fs::Permissions::from_mode(0o755)).unwrap();
    let program = scratch.path.join("touchline");
    fs::copy(env!("CARGO_BIN_EXE_touchline"), &program).unwrap();
    program
}

fn as_nobody(program: &Path, runtime: &Path, args: &[&str]) -> Output {
    Command::new(program)
        .args(args)
        .env("TOUCHLINE_RUNTIME_DIR", runtime)
        .uid(NOBODY)
        .gid(NOBODY)
        .output()
        .unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Runs a shell script in a mount namespace of its own with a /dev/shm of this many megabytes. `$T` is
/// the program, `$D` a directory.
fn with_shared_memory(scratch: &Scratch, megabytes: u32, script: &str) -> Output {
    let mount = format!("mount -t tmpfs -o size={megabytes}m tmpfs /dev/shm || exit 99");
    Command::new("unshare")
        .args(["-m", "sh", "-c", &format!("{mount}\n{script}")])
        .env("T", env!("CARGO_BIN_EXE_touchline"))
        .env("D", &scratch.path)
        .env("TOUCHLINE_NO_CONSOLE", "1")
        .env("TOUCHLINE_RUNTIME_DIR", scratch.path.join("run"))
        .env("XDG_STATE_HOME", scratch.path.join("state"))
        .output()
        .unwrap()
}

/// `touchline … | head`: the reader may end before all output is written.
#[test]
fn nobody_has_to_read_to_the_end() {
    let scratch = Scratch::new("pipe");
    for line in [
        "topics",
        "topics --json",
        "topics --format c",
        "doctor --json",
        "score --synthetic --frames 1",
        "run --frames 20",
    ] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let arguments: Vec<&str> = line.split(' ').collect();
        let output = touchline(&scratch, &arguments)
            .stdout(writer)
            .stderr(std::process::Stdio::piped())
            .spawn()
            .and_then(|child| child.wait_with_output())
            .unwrap();
        let complaints = text(&output.stderr);
        assert!(output.status.success(), "{line}: {:?} {complaints}", output.status);
        assert!(!complaints.contains("panicked"), "{line}: {complaints}");
    }
}

#[test]
#[ignore = "needs root, for a /dev/shm of its own"]
fn too_little_shared_memory_is_said_before_anything_starts() {
    let scratch = Scratch::new("small-shm");
    let script = r#""$T" run --frames 40 --quiet; code=$?; ls /dev/shm; exit $code"#;
    let output = with_shared_memory(&scratch, 20, script);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("20 MB are free") && said.contains("--shm-size="), "{said}");
    assert_eq!(text(&output.stdout), "", "something was left in shared memory");
    assert!(!scratch.path.join("run").exists());
}

#[test]
#[ignore = "needs root, for a /dev/shm of its own"]
fn shared_memory_that_others_fill_in_a_match_costs_nothing() {
    let scratch = Scratch::new("full-shm");
    // The tracker dies when no byte is left: its spare has all the memory it needs.
    let script = r#"
        "$T" run --frames 800 --quiet --report "$D/report.json" &
        group=$!
        tries=0
        until "$T" status --json >"$D/status" 2>/dev/null && grep -q '"complete": true' "$D/status" &&
            [ "$(grep -c '"state": "spare"' "$D/status")" = 3 ]; do
            tries=$((tries + 1)); [ $tries -lt 100 ] || { kill $group; exit 98; }; sleep 0.1
        done
        # Until everybody has met everybody.
        sleep 1
        tracker=$("$T" status | sed -n 's/^ *tracker \([0-9]*\) (active)$/\1/p')
        dd if=/dev/zero of=/dev/shm/filler bs=4k 2>/dev/null
        sleep 1; kill -9 "$tracker" || exit 97; sleep 2
        rm /dev/shm/filler
        wait $group; code=$?; ls /dev/shm; exit $code"#;
    let output = with_shared_memory(&scratch, 100, script);
    assert!(output.status.success(), "{output:?}");
    assert_eq!(text(&output.stdout), "", "something was left in shared memory");
    let report = fs::read(scratch.path.join("report.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    // A grabber that is late on a busy machine is a separate matter.
    for nothing in ["missing_in_world", "duplicates_in_world"] {
        assert_eq!(report["frames"][nothing], 0, "{nothing}: {report:#}");
    }
    for stage in ["grabber", "classifier", "filter"] {
        assert_eq!(report["stages"][stage]["restarts"], 0, "{stage}: {report:#}");
    }
    // Its next spare found no memory, reported that, and was retried.
    let said = text(&output.stderr);
    assert!(!said.contains("SIGBUS"), "{said}");
    assert!(said.contains("not enough shared memory"), "{said}");
}

#[test]
#[ignore = "needs root, for a /dev/shm of its own"]
fn a_group_is_taken_over_when_not_a_byte_of_shared_memory_is_left() {
    let scratch = Scratch::new("adopt-full-shm");
    let script = r#"
        complete() {
            tries=0
            until "$T" status --json >"$D/status" 2>/dev/null && grep -q '"complete": true' "$D/status" &&
                [ "$(grep -c '"state": "spare"' "$D/status")" = 3 ]; do
                tries=$((tries + 1)); [ $tries -lt 300 ] || exit 98; sleep 0.1
            done
        }
        "$T" run --quiet & group=$!
        complete
        sleep 1
        tracker=$("$T" status | sed -n 's/^ *tracker \([0-9]*\) (active)$/\1/p')
        dd if=/dev/zero of=/dev/shm/filler bs=4k 2>/dev/null
        kill -9 $group
        "$T" run --adopt --quiet --report "$D/report.json" & group=$!
        sleep 2; kill -9 "$tracker" || exit 97; sleep 2
        kill -0 $group || exit 96
        rm /dev/shm/filler
        complete
        sleep 2
        "$T" stop >/dev/null || exit 95
        wait $group; code=$?; ls /dev/shm; exit $code"#;
    let output = with_shared_memory(&scratch, 100, script);
    assert!(output.status.success(), "{output:?}");
    assert_eq!(text(&output.stdout), "", "something was left in shared memory");
    let report = fs::read(scratch.path.join("report.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    assert!(report["frames"]["world"].as_u64() > Some(80), "{report:#}");
    for nothing in ["missing_in_world", "duplicates_in_world"] {
        assert_eq!(report["frames"][nothing], 0, "{nothing}: {report:#}");
    }
    for stage in ["grabber", "classifier", "filter"] {
        assert_eq!(report["stages"][stage]["restarts"], 0, "{stage}: {report:#}");
    }
    let said = text(&output.stderr);
    assert!(!said.contains("SIGBUS") && said.contains("the match goes on"), "{said}");
}

/// A container started with a read-only root has such a `/dev/shm`.
#[test]
#[ignore = "needs root, for a /dev/shm of its own"]
fn a_shared_memory_that_is_read_only_is_named_at_once_by_whoever_needs_it() {
    let scratch = Scratch::new("read-only");
    let script = r#"
        # Read-only in a mount namespace of its own: for this one command.
        read_only() {
            timeout 10 unshare -m sh -c 'mount --bind /dev/shm /dev/shm &&
                mount -o remount,bind,ro /dev/shm || exit 98; exec "$@"' sh "$@"
        }
        read_only "$T" run --frames 5 --quiet; echo "run $?"
        read_only "$T" doctor; echo "doctor $?"
        ls "$D/run" 2>/dev/null
        "$T" run --instance later --quiet >/dev/null 2>&1 & group=$!
        for i in $(seq 200); do "$T" status --instance later >/dev/null 2>&1 && break; sleep 0.1; done
        read_only "$T" status --instance later; echo "status $?"
        kill $group; wait $group; echo "ended $?""#;
    let output = with_shared_memory(&scratch, 256, script);
    let said = text(&output.stdout) + &text(&output.stderr);
    for part in ["run 1", "doctor 1", "status 1", "ended 0"] {
        assert!(said.lines().any(|line| line == part), "{part}: {said}");
    }
    let named = said.matches("/dev/shm is mounted read-only").count();
    assert_eq!(named, 3, "{said}");
    assert!(!said.contains("leftovers          dead group"), "the run left something: {said}");
    assert!(said.contains("mount -o remount,rw /dev/shm"), "{said}");
}

/// A program with another version of iceoryx2 gets an error at once, instead of waiting for ever.
#[test]
fn another_version_of_iceoryx2_is_named_at_once() {
    let mut group = Group::start("version", "", &[]);
    group.wait_until_working();
    let namespace = group.namespace();
    // A program that has tried to attach, and a topic created by another one.
    let theirs = format!("/dev/shm/{}00_node.0_9_3.global_mgmt", namespace.prefix());
    fs::write(&theirs, "").unwrap();
    for command in ["status", "doctor"] {
        let said = text(&group.touchline(&[command]).stdout);
        assert!(said.contains("a program with iceoryx2 0.9.3 has tried to attach"), "{said}");
    }
    let deadline = Instant::now() + PATIENCE;
    while !group.stderr().contains("a program with iceoryx2 0.9.3 has tried to attach") {
        assert!(Instant::now() < deadline, "{}", group.stderr());
        std::thread::sleep(Duration::from_millis(50));
    }
    fs::remove_file(&theirs).unwrap();

    // A group of another version.
    let notes = [group.instance.directory(), namespace.directory()].map(|it| it.join("memory"));
    let own = fs::read_to_string(&notes[0]).unwrap();
    for note in &notes {
        fs::write(note, own.replace("iceoryx2=0.10.0", "iceoryx2=0.9.3")).unwrap();
    }
    let mut poses =
        client::consumer::Consumer::new(group.instance.clone(), "test", &messages::topics::WORLD);
    let refusal = poses.next(PATIENCE).err().expect("an error").to_string();
    assert!(refusal.contains("uses iceoryx2 0.9.3, and this program 0.10.0"), "{refusal}");
    let output = group.touchline(&["status"]);
    let said = text(&output.stderr);
    assert!(!output.status.success() && said.contains("uses iceoryx2 0.9.3"), "{said}");
    let output = group.touchline(&["doctor"]);
    let said = text(&output.stdout);
    assert!(said.contains("PROBLEM  iceoryx2") && said.contains("uses iceoryx2 0.9.3"), "{said}");
    notes.iter().for_each(|note| fs::write(note, &own).unwrap());
    group.wait_until_working();
}

/// A request gets a current answer, and reports a supervisor that cannot answer.
#[test]
fn a_supervisor_that_is_stopped_is_named_at_once() {
    let mut group = Group::start("stopped", "", &[]);
    group.wait_until_working();
    group.signal_supervisor(Signal::STOP);
    let pid = group.supervisor_pid();
    let output = group.touchline(&["status"]);
    group.signal_supervisor(Signal::CONT);
    let said = text(&output.stderr);
    assert!(!output.status.success(), "{output:?}");
    assert!(said.contains(&format!("(pid {pid}) is stopped")), "{said}");
    assert!(said.contains(&format!("kill -CONT {pid}")), "{said}");
    group.wait_until_working();
}

#[test]
fn nothing_of_a_running_group_is_for_other_users() {
    let mut group = Group::start("private", "", &[]);
    group.wait_until_working();
    let is_private = |path: &Path| {
        let mode = fs::symlink_metadata(path).unwrap().permissions().mode();
        assert_eq!(mode & 0o077, 0, "{} has mode {mode:o}", path.display());
    };
    let paths = shared_memory(&group.namespace());
    assert!(paths.len() > 20, "{paths:?}");
    for path in paths {
        // The file may have just been removed.
        if path.exists() {
            is_private(&path);
        }
    }
    // In a directory closed to others, iceoryx2's own files may have any mode; ours are 0600.
    let directory = group.instance.directory();
    is_private(directory);
    is_private(directory.parent().unwrap());
    let mut ours = 0;
    for entry in fs::read_dir(directory).unwrap().flatten() {
        if entry.file_type().unwrap().is_file() {
            is_private(&entry.path());
            ours += 1;
        }
    }
    assert!(ours >= 3, "lock, configuration and record: {ours}");
}

#[test]
#[ignore = "needs root, to be another user"]
fn other_users_neither_look_nor_harm() {
    let mut group = Group::start("strangers", "", &[]);
    let before = group.wait_until_working();
    let program = program_for_all(&group.scratch);
    let runtime = group.instance.directory().parent().unwrap().to_path_buf();
    for command in [["status", "--instance", "test"], ["stop", "--instance", "test"]] {
        let output = as_nobody(&program, &runtime, &command);
        assert!(!output.status.success(), "{command:?}: {output:?}");
    }
    // Another user's files under the group's own names.
    let planted: Vec<PathBuf> = ["planted.data", "planted.connection"]
        .map(|name| Path::new("/dev/shm").join(group.namespace().prefix().to_owned() + name))
        .into();
    for path in &planted {
        fs::write(path, [0xFF; 5000]).unwrap();
        chown(path, Some(NOBODY), Some(NOBODY)).unwrap();
    }
    let world = before["frames"]["world"].as_u64().unwrap();
    let after = group
        .wait_for("further frames", |status| status["frames"]["world"].as_u64() > Some(world + 40));
    assert_eq!(after["frames"]["missing_in_world"], 0, "{after:#}");
    for stage in ["grabber", "classifier", "tracker", "filter"] {
        assert_eq!(Group::pid_of(&after, stage), Group::pid_of(&before, stage), "{after:#}");
    }
    let output = group.touchline(&["doctor"]);
    let said = text(&output.stdout);
    for path in &planted {
        let named = format!("{} has a name of this group's", path.display());
        assert!(said.contains(&named) && said.contains("(uid 65534)"), "{said}");
    }
    // Neither the end of this group nor the next start is affected.
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success(), "{}", group.stderr());
    assert!(planted.iter().all(|path| path.exists()) && !group.instance.directory().exists());
    let output =
        output_of(&group.scratch, &["run", "--instance", "test", "--frames", "10", "--quiet"]);
    assert!(output.status.success(), "{output:?}");
    planted.iter().for_each(|path| fs::remove_file(path).unwrap());
}

#[test]
#[ignore = "needs root, to be another user"]
fn a_runtime_directory_that_somebody_else_prepared_is_refused() {
    let scratch = Scratch::new("prepared");
    let program = program_for_all(&scratch);
    let run = ["run", "--frames", "10", "--quiet"];

    // Created by another user as a trap, in both forms.
    let theirs = scratch.path.join("theirs");
    fs::create_dir(&theirs).unwrap();
    let output = as_nobody(&program, &theirs, &run);
    let said = text(&output.stderr);
    assert!(!output.status.success() && said.contains("belongs to another user"), "{said}");
    chown(&theirs, Some(NOBODY), Some(NOBODY)).unwrap();
    let output = touchline(&scratch, &run).env("TOUCHLINE_RUNTIME_DIR", &theirs).output().unwrap();
    let said = text(&output.stderr);
    assert!(!output.status.success() && said.contains("belongs to another user"), "{said}");
    assert_eq!(fs::read_dir(&theirs).unwrap().count(), 0, "something was put there");

    let link = scratch.path.join("link");
    symlink(&theirs, &link).unwrap();
    let output = touchline(&scratch, &run).env("TOUCHLINE_RUNTIME_DIR", &link).output().unwrap();
    let said = text(&output.stderr);
    assert!(!output.status.success() && said.contains("is a symbolic link"), "{said}");

    // No permission to create one at all.
    let output = as_nobody(&program, &scratch.path.join("forbidden"), &run);
    let said = text(&output.stderr);
    let names_it = said.contains("forbidden") && said.contains("Permission denied");
    assert!(!output.status.success() && names_it, "{said}");

    // Counter-check that the user can run the program at all: without an obstacle.
    let output = as_nobody(&program, &theirs, &run);
    assert!(output.status.success(), "{output:?}");
    assert_eq!(
        fs::read_dir(&scratch.path).unwrap().flatten().count(),
        3,
        "link, program and theirs stay"
    );
}

#[test]
fn doctor_says_what_it_sees_and_leaves_the_living_alone() {
    let mut group = Group::start("doctor", "", &[]);
    let before = group.wait_until_working();
    let output = group.touchline(&["doctor", "--clean", "--json"]);
    let findings: Value = serde_json::from_slice(&output.stdout).unwrap();
    let about: Vec<&str> =
        findings.as_array().unwrap().iter().filter_map(|one| one["about"].as_str()).collect();
    for thing in ["shared memory", "runtime directory", "disk", "processors", "real time", "clock"]
    {
        assert!(about.contains(&thing), "{findings:#}");
    }
    let world = before["frames"]["world"].as_u64().unwrap();
    let after = group
        .wait_for("further frames", |status| status["frames"]["world"].as_u64() > Some(world + 40));
    assert_eq!(after["frames"]["missing_in_world"], 0, "{after:#}");
}

#[test]
fn a_service_manager_hears_when_the_group_is_ready_lives_and_ends() {
    let scratch = Scratch::new("manager");
    let path = scratch.path.join("notify");
    let manager = UnixDatagram::bind(&path).unwrap();
    manager.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    let mut group = Group::start_with(
        "service",
        "",
        &[],
        &[("NOTIFY_SOCKET", path.to_str().unwrap()), ("WATCHDOG_USEC", "1000000")],
    );
    let mut heard: Vec<String> = Vec::new();
    let listen = |heard: &mut Vec<String>, until: &dyn Fn(&[String]) -> bool| {
        let deadline = Instant::now() + PATIENCE;
        while !until(heard) {
            assert!(Instant::now() < deadline, "only heard {heard:?}");
            let mut bytes = [0; 256];
            if let Ok(length) = manager.recv(&mut bytes) {
                heard.push(text(&bytes[..length]));
            }
        }
    };
    let count = |heard: &[String], what: &str| {
        heard.iter().filter(|said| said.lines().any(|line| line == what)).count()
    };
    listen(&mut heard, &|heard| count(heard, "READY=1") == 1);
    let status = group.wait_until_working();
    let signs = count(&heard, "WATCHDOG=1");
    listen(&mut heard, &|heard| count(heard, "WATCHDOG=1") >= signs + 3);
    assert_eq!(count(&heard, "STOPPING=1"), 0, "{heard:?}");
    // Stages are not the service.
    for stage in ["grabber", "filter"] {
        let environment = format!("/proc/{}/environ", Group::pid_of(&status, stage));
        let environment = text(&fs::read(environment).unwrap());
        assert!(!environment.contains("NOTIFY_SOCKET"), "{environment}");
    }
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    listen(&mut heard, &|heard| count(heard, "STOPPING=1") == 1);
    assert_eq!(count(&heard, "READY=1"), 1, "{heard:?}");
}

#[test]
#[ignore = "needs systemd-analyze"]
fn the_unit_file_is_understood() {
    let scratch = Scratch::new("unit");
    let unit = fs::read_to_string("scripts/touchline@.service").unwrap();
    let unit = unit.replace("/usr/local/bin/touchline", env!("CARGO_BIN_EXE_touchline"));
    let unit = scratch.write("touchline@match.service", &unit);
    let output = Command::new("systemd-analyze").arg("verify").arg(&unit).output().unwrap();
    let said = text(&output.stderr);
    let complaints: Vec<&str> = said.lines().filter(|line| line.contains("touchline@")).collect();
    assert_eq!(complaints, Vec::<&str>::new());
}

/// The wall clock may be set at any moment, so no decision uses it. All its uses are on this list, with
/// reasons. `scripts/test-v4l2` sets the clock during a run.
#[test]
fn the_wall_clock_is_only_for_people() {
    let reasons = [
        (
            "common/client/src/bus/participants.rs",
            "a file's time, only ever asked whether it is another one",
        ),
        ("common/client/src/clock.rs", "where it is read"),
        ("grabber/src/camera/link.rs", "for people: t_capture_wall_ns"),
        ("grabber/src/camera/timeline.rs", "for people: t_capture_wall_ns"),
        ("grabber/src/playback/mod.rs", "for people: t_capture_wall_ns"),
        ("grabber/src/genicam/mod.rs", "Aravis' stamps, by way of WallClock, which notices"),
        ("tests/trials/src/chaos/mod.rs", "a seed, when none is given"),
        ("src/console/reading.rs", "for people and programs: times in what clients get"),
        ("src/console/recording.rs", "the name of a recording's file"),
        ("common/control/src/event.rs", "for people: times of events"),
        ("src/publisher/worker.rs", "for programs of the leagues: times in their packets"),
        ("src/recorder/mod.rs", "once for each recording"),
        ("src/recorder/ports.rs", "the age of events, which have no other time"),
    ];
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let crates = ["grabber", "classifier", "tracker", "filter", "tests/trials", "."]
        .map(|name| root.join(name));
    let common = fs::read_dir(root.join("common")).unwrap().map(|entry| entry.unwrap().path());
    let mut folders: Vec<PathBuf> =
        crates.into_iter().chain(common).map(|path| path.join("src")).collect();
    let mut readers = Vec::new();
    while let Some(folder) = folders.pop() {
        for path in fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let source = fs::read_to_string(&path).unwrap_or_default();
            if ["wall_ns()", "SystemTime", "Realtime"].iter().any(|word| source.contains(word)) {
                readers.push(path.strip_prefix(root).unwrap().to_string_lossy().into_owned());
            }
        }
    }
    let mut known = reasons.map(|(path, _)| path);
    readers.sort();
    known.sort_unstable();
    readers.iter_mut().for_each(|path| *path = path.trim_start_matches("./").into());
    assert_eq!(readers, known, "see the comment at this test");
}
