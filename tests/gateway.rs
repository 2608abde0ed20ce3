//! Programs of other users: what they receive, and what they cannot do.

mod support;

use bytemuck::{Zeroable, bytes_of};
use client::clock::monotonic_ns;
use client::consumer::{Consumer, Event};
use client::gateway::{Client, Greeting, KEPT, commands_type_name};
use messages::topics;
use messages::{Attendant, Commands, EventKind, ProcessKind, Team, WheelCommand, WorldFrame};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::net::{
    AddressFamily, RecvFlags, SendFlags, SocketAddrUnix, SocketFlags, SocketType, connect, recv,
    send, socket_with,
};
use rustix::process::Signal;
use serde_json::Value;
use std::fs;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};
use support::{Group, PATIENCE, Scratch, is_stage, output_of};

/// A system group of which the user running the tests is a member.
fn own_group() -> String {
    let output = Command::new("id").arg("-gn").output().unwrap();
    String::from_utf8(output.stdout).unwrap().trim().to_string()
}

fn config(clients: u32) -> String {
    format!("[access]\ngroup = \"{}\"\nclients = {clients}\n", own_group())
}

fn start(name: &str, clients: u32) -> (Group, Value) {
    let mut group = Group::start(name, &config(clients), &[]);
    let status = group.wait_for("a group with a gateway", |status| {
        status["complete"] == true
            && status["frames"]["world"].as_u64() > Some(5)
            && status["gateway"]["pid"].is_u64()
            && Path::new(status["gateway"]["socket"].as_str().unwrap()).exists()
    });
    (group, status)
}

/// The next `world`, with the number of frames missed before it.
fn world(client: &mut Client) -> (u64, Box<WorldFrame>) {
    let deadline = Instant::now() + PATIENCE;
    let mut missed = 0;
    while Instant::now() < deadline {
        match client.next(Duration::from_secs(1)).unwrap() {
            Some(Event::Message(world)) => return (missed, world),
            Some(Event::Missed(count)) => missed += count,
            _ => {}
        }
    }
    panic!("no world");
}

/// A client that ignores the protocol.
struct Raw(OwnedFd);

impl Raw {
    fn connect(path: &Path) -> Self {
        let socket =
            socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None)
                .unwrap();
        connect(&socket, &SocketAddrUnix::new(path).unwrap()).unwrap();
        Self(socket)
    }

    fn send(&self, bytes: &[u8]) -> bool {
        send(&self.0, bytes, SendFlags::NOSIGNAL).is_ok()
    }

    /// The next message; `None` at the end of the connection.
    fn receive(&self) -> Option<Vec<u8>> {
        let patience = Timespec { tv_sec: PATIENCE.as_secs() as _, tv_nsec: 0 };
        let ready = poll(&mut [PollFd::new(&self.0, PollFlags::IN)], Some(&patience)).unwrap();
        assert_eq!(ready, 1, "nothing comes");
        let mut buffer = vec![0; 1 << 16];
        let length = recv(&self.0, &mut buffer[..], RecvFlags::empty()).map_or(0, |(it, _)| it);
        buffer.truncate(length);
        (length > 0).then_some(buffer)
    }

    fn greeting(&self) -> Greeting {
        serde_json::from_slice(&self.receive().expect("a greeting")).unwrap()
    }

    fn is_cut_off(&self) -> bool {
        while self.receive().is_some() {}
        true
    }
}

#[test]
fn the_group_gets_every_frame_in_order_and_a_sleeper_disturbs_nobody() {
    let (mut group, status) = start("gateway", 8);
    let path = group.instance.gateway_path();
    assert_eq!(status["gateway"]["socket"], path.to_str().unwrap());
    let directory = group.instance.gateway_directory();
    let mode = |path: &Path| fs::symlink_metadata(path).unwrap().mode() & 0o7777;
    let own = fs::metadata(group.instance.directory()).unwrap();
    assert_eq!((mode(&directory), mode(&path)), (0o710, 0o660));
    assert_eq!(mode(group.instance.directory()), 0o700);
    assert!(fs::symlink_metadata(&path).unwrap().file_type().is_socket());
    for path in [&directory, &path] {
        let data = fs::symlink_metadata(path).unwrap();
        assert_eq!((data.uid(), data.gid()), (own.uid(), rustix::process::getegid().as_raw()));
    }
    for path in support::shared_memory(&group.namespace()) {
        // A runtime directory restored meanwhile is not readable either.
        let Ok(data) = fs::symlink_metadata(&path) else { continue };
        assert_eq!(data.mode() & 0o077, 0, "{} is open to others", path.display());
    }

    let sleeper = Raw::connect(&path);
    assert!(sleeper.greeting().fits());
    let mut client = Client::new(&path);
    let (_, first) = world(&mut client);
    let mut before = first.frame.seq;
    group.wait_for("both attached", |status| status["gateway"]["clients"] == 2);
    // Longer than the messages kept for the sleeper, in its socket and beside it.
    for _ in 0..200 {
        let (missed, world) = world(&mut client);
        assert_eq!((missed, world.frame.seq), (0, before + 1));
        assert_eq!(world.robots().len(), 10);
        before = world.frame.seq;
    }
    // From here on only the sleeper can lose messages.
    drop(client);
    let status = group.wait_for("lost messages of the sleeper", |status| {
        status["gateway"]["lost"].as_u64() > Some(0) && status["gateway"]["clients"] == 1
    });
    assert_eq!(status["frames"]["missing_in_world"], 0);

    // It wakes up: first the oldest messages, then one gap, then all kept messages in order. The group
    // continues meanwhile, so the gap's length is not predictable.
    let mut numbers = Vec::new();
    let gap = |numbers: &[u64]| numbers.windows(2).position(|pair| pair[1] > pair[0] + 1);
    while gap(&numbers).is_none_or(|at| numbers.len() <= at + KEPT) {
        let bytes = sleeper.receive().expect("the sleeper is still attached");
        assert_eq!(bytes.len(), size_of::<WorldFrame>());
        numbers.push(bytemuck::pod_read_unaligned::<WorldFrame>(&bytes).frame.seq);
    }
    assert!(numbers.windows(2).all(|pair| pair[0] < pair[1]), "{numbers:?}");
    let at = gap(&numbers).unwrap();
    assert_eq!(gap(&numbers[at + 1..]), None, "{numbers:?}");
    // The kept messages are the newest, and the number missing is the number reported lost.
    assert!(numbers[at + 1] + KEPT as u64 > before, "{before}: {numbers:?}");
    drop(sleeper);
    let status = group.wait_for("nobody attached", |status| status["gateway"]["clients"] == 0);
    assert_eq!(status["gateway"]["lost"], numbers[at + 1] - numbers[at] - 1, "{numbers:?}");
    let gateway = status["gateway"]["pid"].as_u64().unwrap() as u32;
    assert!(is_stage(gateway));
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
    assert!(!is_stage(gateway) && !directory.exists());
    assert!(!group.scratch.path.join("run").exists(), "the place of all groups is left behind");
}

#[test]
fn clients_drive_robots_and_rubbish_is_counted() {
    let (mut group, _) = start("gateway-drive", 8);
    let path = group.instance.gateway_path();
    let mut client = Client::new(&path);
    let (_, first) = world(&mut client);
    let mut commands = Commands { seq: 1 << 40, wheel_count: 1, ..Zeroable::zeroed() };
    commands.wheels[0] =
        WheelCommand { team: Team::Blue as u32, robot_id: 1, left_mm_s: -200.0, right_mm_s: 200.0 };
    let mut is_used = false;
    let deadline = Instant::now() + PATIENCE;
    while !is_used && Instant::now() < deadline {
        commands.t_sent_ns = monotonic_ns();
        commands.seq += 1;
        assert!(client.send(&commands));
        let (_, world) = world(&mut client);
        is_used =
            world.commands().iter().any(|name| name.seq > 1 << 40 && name.seq <= commands.seq);
    }
    assert!(is_used, "the filter has not used what the client sent");

    // Not a valid client: disconnected.
    for words in [b"GET / HTTP/1.1".as_slice(), bytes_of(&commands), &[0; 5000]] {
        let stranger = Raw::connect(&path);
        assert!(stranger.send(words));
        assert!(stranger.is_cut_off());
    }
    // A valid client that then sends garbage: counted.
    let rude = Raw::connect(&path);
    assert!(rude.greeting().fits());
    assert!(rude.send(commands_type_name().as_bytes()));
    let mut wrong = commands;
    wrong.wheels[0].left_mm_s = f64::NAN;
    let mut crowded = commands;
    crowded.wheel_count = u32::MAX;
    for words in [b"rubbish".as_slice(), bytes_of(&wrong), bytes_of(&crowded), &[255; 9000]] {
        assert!(rude.send(words));
    }
    group.wait_for("refused messages", |status| status["gateway"]["refused"] == 7);
    // A flood of commands, as fast as the socket accepts them.
    let flood = std::thread::spawn(move || {
        let deadline = Instant::now() + Duration::from_secs(2);
        while Instant::now() < deadline && rude.send(&[255; 792]) {}
    });
    let (_, begin) = world(&mut client);
    let mut before = begin.frame.seq;
    for _ in 0..100 {
        let (missed, world) = world(&mut client);
        assert_eq!((missed, world.frame.seq), (0, before + 1));
        before = world.frame.seq;
    }
    flood.join().unwrap();
    let status = group.try_status().unwrap();
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    assert!(status["gateway"]["refused"].as_u64() > Some(100), "{status:#}");
    assert_eq!(status["gateway"]["restarts"], 0, "{status:#}");
    for stage in ["classifier", "tracker", "filter"] {
        assert_eq!(status["stages"][stage]["restarts"], 0, "{status:#}");
    }
    assert!(before > first.frame.seq + 100);
}

/// A command for one robot.
fn turn_on_the_spot(team: Team, robot_id: u32) -> WheelCommand {
    WheelCommand { team: team as u32, robot_id, left_mm_s: -200.0, right_mm_s: 200.0 }
}

#[test]
fn a_team_is_commanded_by_its_users_alone_and_it_is_shown_who_commands_whom() {
    let own = rustix::process::getuid().as_raw();
    let teams = format!("teams.yellow = [\"{own}\"]\nteams.blue = [\"4294967294\"]\n");
    let mut group = Group::start("gateway-teams", &(config(8) + &teams), &[]);
    group.wait_for("a gateway", |status| {
        status["complete"] == true
            && status["gateway"]["pid"].is_u64()
            && Path::new(status["gateway"]["socket"].as_str().unwrap()).exists()
    });
    let mut client = Client::new(&group.instance.gateway_path());
    world(&mut client);
    let mut commands = Commands { seq: 1 << 40, wheel_count: 2, ..Zeroable::zeroed() };
    commands.wheels[0] = turn_on_the_spot(Team::Blue, 1);
    commands.wheels[1] = turn_on_the_spot(Team::Yellow, 3);
    let stop = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false));
    let is_over = std::sync::Arc::clone(&stop);
    let driver = std::thread::spawn(move || {
        while !is_over.load(std::sync::atomic::Ordering::Relaxed) {
            world(&mut client);
            commands.t_sent_ns = monotonic_ns();
            commands.seq += 1;
            assert!(client.send(&commands));
        }
    });
    let robots_of = |status: &Value, key: &str, value: Value| {
        let all = status["commanders"].as_array().cloned().unwrap_or_default();
        all.into_iter().find(|it| it[key] == value).map(|it| it["robots"].clone())
    };
    group.wait_for("the client as commander", |status| {
        robots_of(status, "user", own.into()) == Some(serde_json::json!(["yellow 3"]))
    });
    group.wait_for("what is not permitted", |status| {
        status["gateway"]["not_permitted"].as_u64() > Some(0)
    });
    group.wait_for("the match itself as commander of the others", |status| {
        let robots = robots_of(status, "name", "grabber".into());
        robots.is_some_and(|robots| robots.to_string().contains("blue 1"))
    });
    let text = String::from_utf8(group.touchline(&["status"]).stdout).unwrap();
    assert!(text.contains(&format!("user {own}: yellow 3")), "{text}");
    stop.store(true, std::sync::atomic::Ordering::Relaxed);
    driver.join().unwrap();

    let scratch = Scratch::new("gateway-nobody");
    let teams = "[access]\ngroup = \"root\"\nteams.blue = [\"no-such-user\"]\n";
    let file = scratch.write("config.toml", &teams.replace("root", &own_group()));
    let args = ["run", "--instance", "test", "--config", file.to_str().unwrap()];
    let output = output_of(&scratch, &args);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && said.contains("access.teams.blue"), "{said}");
}

/// Parameters of the other users' programs in [`floods_of_two_users_do_not_starve_a_third`].
const FLOOD_VARIABLE: &str = "TOUCHLINE_TEST_FLOOD";

#[test]
#[ignore = "a program for another test"]
fn flood() {
    let Some(path) = std::env::var_os(FLOOD_VARIABLE) else { return };
    let flooders: Vec<_> = (0..15)
        .map(|_| {
            let raw = Raw::connect(Path::new(&path));
            std::thread::spawn(move || {
                raw.send(commands_type_name().as_bytes());
                let mut commands = Commands { wheel_count: 1, ..Zeroable::zeroed() };
                commands.wheels[0] = turn_on_the_spot(Team::Yellow, 0);
                while raw.send(bytes_of(&commands)) {
                    commands.t_sent_ns = monotonic_ns();
                    commands.seq += 1;
                }
            })
        })
        .collect();
    flooders.into_iter().for_each(|it| it.join().unwrap());
}

#[test]
#[ignore = "needs root, to be several users"]
fn floods_of_two_users_do_not_starve_a_third() {
    use std::os::unix::process::CommandExt;
    let (mut group, _) = start("gateway-users", 32);
    let path = group.instance.gateway_path();
    let program = group.scratch.path.join("flood");
    fs::copy(std::env::current_exe().unwrap(), &program).unwrap();
    let mut floods: Vec<_> = [65_533, 65_534]
        .map(|uid| {
            Command::new(&program)
                .args(["--exact", "flood", "--ignored"])
                .env(FLOOD_VARIABLE, &path)
                .current_dir("/")
                .uid(uid)
                .gid(rustix::process::getegid().as_raw())
                .stdout(std::process::Stdio::null())
                .spawn()
                .unwrap()
        })
        .into();
    group.wait_for("the flooders", |status| status["gateway"]["clients"] == 30);
    let mut client = Client::new(&path);
    world(&mut client);
    let timeout_ns = (config::Config::default().filter.command_timeout_ms * 1e6) as u64;
    let begin = 1u64 << 40;
    let mut commands = Commands { seq: begin, wheel_count: 1, ..Zeroable::zeroed() };
    commands.wheels[0] = turn_on_the_spot(Team::Blue, 1);
    let (mut used, mut longest_ns, mut last_ns) = (0, 0, monotonic_ns());
    for _ in 0..400 {
        commands.t_sent_ns = monotonic_ns();
        commands.seq += 1;
        assert!(client.send(&commands));
        let (_, world) = world(&mut client);
        let own = world.commands().iter().filter(|it| it.seq > begin).count();
        if own > 0 {
            used += own;
            longest_ns = longest_ns.max(monotonic_ns() - last_ns);
            last_ns = monotonic_ns();
        }
    }
    for flood in &mut floods {
        flood.kill().unwrap();
        flood.wait().unwrap();
    }
    assert!(used >= 380, "{used} of 400 commands used");
    assert!(longest_ns < timeout_ns, "{} ms without a command", longest_ns / 1_000_000);
    let status = group.try_status().unwrap();
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    println!("{used} of 400 used, at most {} ms between two", longest_ns / 1_000_000);
}

#[test]
#[ignore = "needs a Python, named by TOUCHLINE_PYTHON"]
fn python_clients_drive_robots() {
    let (group, _) = start("gateway-python", 8);
    let python = std::env::var_os("TOUCHLINE_PYTHON").unwrap_or("python3".into());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts/python/touchline_gateway.py");
    let output = Command::new(python)
        .arg("-B")
        .arg(script)
        .arg(group.instance.gateway_path())
        .args(["--seconds", "1", "--spin", "blue", "2"])
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("blue 2: ") && text.contains(" frames, "), "{text}");
}

#[test]
fn a_gateway_that_falls_is_started_again_and_events_are_in_health() {
    let (mut group, status) = start("gateway-falls", 4);
    let path = group.instance.gateway_path();
    let mut client = Client::new(&path);
    world(&mut client);

    // No user has all places.
    let second = Raw::connect(&path);
    assert!(second.greeting().refused.is_none());
    let third = Raw::connect(&path);
    let refused = third.greeting().refused.expect("three of four places");
    assert!(refused.contains("2 of 4 places"), "{refused}");
    assert!(third.is_cut_off());

    let mut events = Consumer::new(group.instance.clone(), "test", &topics::EVENTS);
    let mut wait_for_event = |what: &str, is_it: &dyn Fn(EventKind, u32) -> bool| {
        let deadline = Instant::now() + PATIENCE;
        while Instant::now() < deadline {
            if let Some(Event::Message(received)) = events.next(Duration::from_secs(1)).unwrap()
                && let Some(event) = received.message()
                && let Some(kind) = EventKind::from_number(event.kind)
                && is_it(kind, event.process)
            {
                assert!(event.t_wall_ns > 1_600_000_000_000_000_000);
                return;
            }
        }
        panic!("no event tells of {what}");
    };

    let gateway = status["gateway"]["pid"].as_u64().unwrap() as u32;
    group.signal(gateway, Signal::KILL);
    wait_for_event("the gateway's end", &|kind, process| {
        (kind, process) == (EventKind::Ended, Attendant::Gateway as u32)
    });
    let deadline = Instant::now() + PATIENCE;
    let (mut has_left, mut has_joined) = (false, false);
    while !has_joined && Instant::now() < deadline {
        match client.next(Duration::from_secs(1)).unwrap() {
            Some(Event::Left) => has_left = true,
            Some(Event::Joined) => has_joined = has_left,
            _ => {}
        }
    }
    assert!(has_joined, "the client has not found the new gateway");
    world(&mut client);
    let status = group.wait_for("another gateway", |status| status["gateway"]["restarts"] == 1);
    let tells = |status: &Value, stage: &str, kind: &str| {
        let events = status["events"].as_array().unwrap();
        events.iter().any(|event| event["stage"] == stage && event["kind"] == kind)
    };
    assert!(tells(&status, "gateway", "ended"), "{status:#}");
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");

    group.signal(Group::pid_of(&status, "tracker"), Signal::KILL);
    wait_for_event("the tracker's end", &|_, process| process == ProcessKind::Tracker as u32);
    let status = group.wait_for("a promotion", |status| tells(status, "tracker", "promoted"));

    // The next supervisor has a gateway of its own, and clients reconnect.
    let earlier = status["gateway"]["pid"].as_u64().unwrap();
    group.replace_supervisor();
    group.wait_for("a group that was taken over", |status| {
        status["gateway"]["pid"].as_u64().is_some_and(|pid| pid != earlier)
    });
    assert!(!is_stage(earlier as u32), "the earlier gateway is still there");
    let deadline = Instant::now() + PATIENCE;
    let mut has_joined = false;
    while !has_joined && Instant::now() < deadline {
        has_joined = matches!(client.next(Duration::from_secs(1)).unwrap(), Some(Event::Joined));
    }
    assert!(has_joined, "the client has not found the next supervisor's gateway");
    world(&mut client);
}

#[test]
fn the_gateway_is_restarted_on_request() {
    let (mut group, status) = start("restarted", 8);
    let pid = status["attendants"]["gateway"]["pid"].clone();
    assert_eq!(pid, status["gateway"]["pid"], "{status:#}");
    let output = group.touchline(&["restart", "gateway"]);
    assert!(output.status.success(), "{output:?}");
    let status = group.wait_for("the new gateway", |status| {
        let new = &status["attendants"]["gateway"]["pid"];
        new.is_u64() && *new != pid && *new == status["gateway"]["pid"]
    });
    assert_eq!(status["attendants"]["gateway"]["restarts"], 1, "{status:#}");
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    let mut client = Client::new(&group.instance.gateway_path());
    world(&mut client);

    let output = group.touchline(&["restart", "referee"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("filter, gateway"), "{said}");
}

#[test]
fn a_group_of_users_that_is_not_there_is_said_before_anything_starts() {
    let scratch = Scratch::new("gateway-unknown");
    let file = scratch.write("config.toml", "[access]\ngroup = \"no-such-group\"\n");
    let file = file.to_str().unwrap();
    let output = output_of(&scratch, &["run", "--instance", "test", "--config", file]);
    assert!(!output.status.success());
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("access.group") && said.contains("no-such-group"), "{said}");
    assert!(!scratch.path.join("run").exists(), "something is left behind");
    let output = output_of(&scratch, &["doctor", "--config", file, "--json"]);
    let findings: Value = serde_json::from_slice(&output.stdout).unwrap();
    let access = findings.as_array().unwrap().iter().find(|it| it["about"] == "other users");
    assert_eq!(access.unwrap()["level"], "problem", "{findings:#}");
}
