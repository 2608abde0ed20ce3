//! What the publisher puts on a network, and what it takes from one.
//!
//! Each test that multicasts has a network of its own: it unshares the network namespace of its thread, and
//! everything it starts is inside. That needs root, so these tests are ignored by default; `scripts/check` runs
//! them if it is root. Nothing is ever sent on the machine's own interfaces.

mod support;

use client::consumer::{Consumer, Event};
use messages::topics;
use messages::{Team, TruthFrame, WorldFrame};
use protocols::firasim::{self, Command as WheelCommand, Commands, Packet};
use protocols::ssl_tracked::{self, TrackerPacket};
use protocols::ssl_vision::{DetectionFrame, Source, WrapperPacket};
use protocols::{Message, ONE_FRAME_BYTES};
use rustix::process::Signal;
use rustix::thread::{UnshareFlags, unshare_unsafe};
use serde_json::Value;
use std::collections::BTreeMap;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use support::{Group, PATIENCE, Scratch, output_of};

const SSL: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(224, 5, 23, 2), 10_006);
const TRACKED: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(224, 5, 23, 2), 10_010);
const VSS: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(224, 5, 23, 2), 10_015);
const FIRASIM: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(224, 0, 0, 1), 10_002);
const JSON: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 10_030);

/// Moves this thread, and with it all that it starts, into a network of its own that has nothing but a
/// loopback interface.
fn own_network() {
    #[allow(unsafe_code)]
    // SAFETY: only the network changes; descriptors are shared as before.
    unsafe {
        unshare_unsafe(UnshareFlags::NEWNET).unwrap();
    }
    network("link set lo up");
    network("link set lo multicast on");
    network("route add 224.0.0.0/4 dev lo");
}

fn network(command: &str) {
    let status = Command::new("ip").args(command.split(' ')).status().unwrap();
    assert!(status.success(), "ip {command}");
}

/// A socket that receives what is sent to this address.
fn receiver(at: SocketAddrV4) -> UdpSocket {
    let socket = rustix::net::socket_with(
        rustix::net::AddressFamily::INET,
        rustix::net::SocketType::DGRAM,
        rustix::net::SocketFlags::CLOEXEC,
        None,
    )
    .unwrap();
    rustix::net::sockopt::set_socket_reuseaddr(&socket, true).unwrap();
    rustix::net::bind(&socket, &at).unwrap();
    let socket = UdpSocket::from(socket);
    if at.ip().is_multicast() {
        socket.join_multicast_v4(at.ip(), &Ipv4Addr::LOCALHOST).unwrap();
    }
    socket.set_read_timeout(Some(PATIENCE)).unwrap();
    socket
}

/// The next packet.
fn packet(socket: &UdpSocket) -> Vec<u8> {
    let mut buffer = [0; 65_536];
    let (length, _) = socket.recv_from(&mut buffer).expect("a packet");
    buffer[..length].to_vec()
}

/// The next detection frame.
fn detection(socket: &UdpSocket) -> DetectionFrame {
    loop {
        let bytes = packet(socket);
        let packet = WrapperPacket::decode(&bytes[..]).expect("a packet of SSL-Vision");
        if let Some(detection) = packet.detection {
            return detection;
        }
    }
}

fn start(name: &str, config: &str, args: &[&str]) -> (Group, Value) {
    let mut group = Group::start(name, config, args);
    let status = group.wait_for("a group with a publisher", |status| {
        status["complete"] == true
            && status["frames"]["world"].as_u64() > Some(5)
            && status["publisher"]["pid"].is_u64()
    });
    (group, status)
}

const ALL: &str = "preset = \"vsss-3v3\"\n[camera]\nfps = 40\n[publish]\nssl.enabled = true\n\
                   tracked.enabled = true\nfirasim.enabled = true\nvss.enabled = true\njson.enabled = true\n";

/// Reads the next messages of a topic until one satisfies the condition.
fn until<E: messages::Message>(consumer: &mut Consumer<E, ()>, mut is_it: impl FnMut(&E) -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while Instant::now() < deadline {
        if let Some(Event::Message(received)) = consumer.next(Duration::from_secs(1)).unwrap()
            && received.message().is_some_and(&mut is_it)
        {
            return;
        }
    }
    panic!("no such message");
}

/// 100 frames of `world`, by number.
fn worlds(group: &Group) -> BTreeMap<u32, Box<WorldFrame>> {
    let mut worlds = BTreeMap::new();
    let mut consumer = Consumer::new(group.instance.clone(), "test", &topics::WORLD);
    until(&mut consumer, |world| {
        worlds.insert(world.frame.seq as u32, Box::new(*world));
        worlds.len() == 100
    });
    worlds
}

#[test]
fn a_run_without_configuration_publishes_nothing() {
    let mut group = Group::start("publish-nothing", "", &[]);
    let status = group.wait_until_working();
    assert!(status["publisher"].is_null() && status["attendants"]["publisher"].is_null());
    let output = output_of(&group.scratch, &["publisher", "--instance", "test"]);
    assert!(!output.status.success());
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("nothing is enabled in [publish]"), "{said}");
}

#[test]
fn an_address_that_is_none_is_refused_before_anything_starts() {
    let scratch = Scratch::new("publish-wrong");
    let path = scratch.path.join("match.toml");
    std::fs::write(&path, "[publish]\nssl.enabled = true\nssl.to = [\"224.5.23.2\"]\n").unwrap();
    let output = output_of(&scratch, &["run", "--config", path.to_str().unwrap()]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && said.contains("\"224.5.23.2:10006\""), "{said}");
}

#[test]
#[ignore = "needs root, for a network of its own"]
fn every_protocol_says_what_world_says() {
    own_network();
    let sockets = [SSL, TRACKED, FIRASIM, VSS, JSON].map(receiver);
    let (mut group, _) = start("publish-all", ALL, &[]);
    let worlds = worlds(&group);
    let [ssl, tracked, firasim, vss, json] = &sockets;
    let mut compared = [0; 4];
    let deadline = Instant::now() + PATIENCE;
    let mut last = None;
    while compared.iter().any(|&count| count < 50) {
        assert!(Instant::now() < deadline, "{compared:?} packets agree with `world`");
        let bytes = packet(tracked);
        assert!(bytes.len() <= ONE_FRAME_BYTES);
        let frame = TrackerPacket::decode(&bytes[..]).unwrap().tracked_frame.unwrap();
        assert!(Some(frame.frame_number) > last, "{last:?}, then {}", frame.frame_number);
        last = Some(frame.frame_number);
        if let Some(world) = worlds.get(&frame.frame_number) {
            compare_tracked(world, &frame);
            compared[0] += 1;
        }
        let bytes = packet(firasim);
        let environment = firasim::Environment::decode(&bytes[..]).unwrap();
        if let Some(world) = worlds.get(&environment.step) {
            let frame = environment.frame.unwrap();
            let robots = frame.robots_yellow.iter().chain(&frame.robots_blue);
            for (robot, it) in world.robots().iter().zip(robots) {
                assert_eq!((it.x, it.y), (robot.x_mm * 1e-3, robot.y_mm * 1e-3));
                assert_eq!(it.robot_id, robot.robot_id);
            }
            compared[1] += 1;
        }
        let of_vss = detection(vss);
        if let Some(world) = worlds.get(&of_vss.frame_number) {
            let robots = of_vss.robots_yellow.iter().chain(&of_vss.robots_blue);
            for (robot, it) in world.robots().iter().zip(robots) {
                assert_eq!((it.x, it.y), (robot.x_mm as f32, robot.y_mm as f32));
                assert_eq!(it.robot_id, Some(robot.robot_id));
            }
            assert!((of_vss.t_capture - world.frame.t_capture_wall_ns as f64 * 1e-9).abs() < 1e-6);
            compared[2] += 1;
        }
        let text: Value = serde_json::from_slice(&packet(json)).unwrap();
        if let Some(world) = worlds.get(&(text["frame"].as_u64().unwrap() as u32)) {
            let robot = &world.robots()[0];
            let team = if robot.team == 0 { "yellow" } else { "blue" };
            let x_mm = text[team][robot.robot_id.to_string()][0].as_f64().unwrap();
            assert!((x_mm - robot.x_mm).abs() <= 0.05 + 1e-9, "{text}");
            compared[3] += 1;
        }
    }
    // SSL-Vision tells what each frame alone shows, and the geometry once a second.
    let (mut frames, mut geometries) = (0, 0);
    while frames < 40 || geometries < 1 {
        let bytes = packet(ssl);
        assert!(bytes.len() <= ONE_FRAME_BYTES);
        let packet = WrapperPacket::decode(&bytes[..]).unwrap();
        assert_eq!(packet.source(), Source::Other);
        if let Some(geometry) = packet.geometry {
            geometries += 1;
            assert_eq!(geometry.field.field_length, 1500);
            assert_eq!(geometry.calib.len(), 1);
        }
        if let Some(detection) = packet.detection {
            frames += 1;
            let age_s = detection.t_sent - detection.t_capture;
            assert!(age_s > 0.0 && age_s < 10.0, "{detection:?}");
            let robots = detection.robots_yellow.iter().chain(&detection.robots_blue);
            assert!(robots.clone().count() >= 4, "{detection:?}");
            assert!(robots.into_iter().all(|robot| robot.robot_id.is_some_and(|id| id < 3)));
        }
    }
    let status = group.try_status().unwrap();
    let publisher = &status["publisher"];
    for name in ["ssl", "tracked", "firasim", "vss", "json"] {
        let protocol = &publisher["protocols"][name];
        assert!(protocol["sent"].as_u64() > Some(50), "{publisher:#}");
        assert_eq!(
            (&protocol["failed"], &protocol["large"]),
            (&0.into(), &0.into()),
            "{publisher:#}"
        );
        assert_eq!(protocol["problem"], "", "{publisher:#}");
    }
    assert_eq!(publisher["rivals"], 0, "{publisher:#}");
    // The clock of a test machine may not be synchronised.
    let problem = publisher["problem"].as_str().unwrap();
    assert!(problem.is_empty() || problem.starts_with("the clock"), "{problem}");
    let text = String::from_utf8(group.touchline(&["status"]).stdout).unwrap();
    assert!(text.contains("publisher    packets: firasim "), "{text}");
}

fn compare_tracked(world: &WorldFrame, frame: &ssl_tracked::TrackedFrame) {
    assert_eq!(frame.timestamp, world.frame.t_capture_wall_ns as f64 * 1e-9);
    assert_eq!(frame.robots.len(), world.robots().len());
    for (robot, it) in world.robots().iter().zip(&frame.robots) {
        let team = Team::from_number(robot.team).unwrap();
        assert_eq!(it.robot_id.id, Some(robot.robot_id));
        assert_eq!(format!("{:?}", it.robot_id.team()).to_lowercase(), team.name());
        assert_eq!(it.pos.x, (robot.x_mm * 1e-3) as f32);
        assert_eq!(it.orientation, robot.orientation as f32);
        assert_eq!(it.vel_angular, Some(robot.omega as f32));
    }
}

/// A stage is killed every second; the frame numbers in the packets have no gap and no repeat.
#[test]
#[ignore = "needs root, for a network of its own"]
fn the_death_of_stages_is_not_seen_in_frame_numbers() {
    own_network();
    let socket = receiver(SSL);
    let (mut group, _) = start("publish-deaths", ALL, &[]);
    let reader = std::thread::spawn(move || {
        let mut numbers = vec![];
        let mut sizes = vec![];
        // Ended by the last packet: the group is gone.
        socket.set_read_timeout(Some(Duration::from_secs(3))).unwrap();
        let mut buffer = [0; 65_536];
        while let Ok((length, _)) = socket.recv_from(&mut buffer) {
            let packet = WrapperPacket::decode(&buffer[..length]).unwrap();
            sizes.push(length);
            let detection = packet.detection.into_iter();
            numbers.extend(detection.map(|it| (it.frame_number, it.t_capture, it.t_sent)));
        }
        (numbers, sizes)
    });
    for stage in ["classifier", "tracker", "filter", "tracker", "filter", "classifier"] {
        let status = group.wait_for("a spare", |status| {
            let processes = status["stages"][stage]["processes"].as_array();
            processes.is_some_and(|all| all.iter().any(|process| process["state"] == "spare"))
        });
        group.signal(Group::pid_of(&status, stage), Signal::KILL);
        std::thread::sleep(Duration::from_secs(1));
    }
    group.signal_supervisor(Signal::TERM);
    group.wait_until_ended();
    let (numbers, sizes) = reader.join().unwrap();
    assert!(numbers.len() > 200, "{} frames", numbers.len());
    for pair in numbers.windows(2) {
        let ((before, captured, sent), (number, later, sent_later)) = (pair[0], pair[1]);
        assert_eq!(number, before + 1, "a gap or a repeat");
        assert!(later > captured && sent_later >= sent, "times go back at frame {number}");
    }
    assert!(sizes.iter().all(|&size| size <= ONE_FRAME_BYTES));
    group.assert_nothing_left();
}

/// The publisher itself dies: what it sends afterwards has higher numbers.
#[test]
#[ignore = "needs root, for a network of its own"]
fn a_publisher_that_dies_returns_with_higher_numbers() {
    own_network();
    let socket = receiver(SSL);
    let (mut group, status) = start("publish-own-death", ALL, &[]);
    let before = detection(&socket).frame_number;
    let pid = status["publisher"]["pid"].as_u64().unwrap();
    group.signal(pid as u32, Signal::KILL);
    group.wait_for("another publisher", |status| {
        status["publisher"]["pid"].as_u64().is_some_and(|it| it != pid)
            && status["publisher"]["restarts"] == 1
    });
    let mut last = before;
    for _ in 0..80 {
        let number = detection(&socket).frame_number;
        assert!(number > last, "{number} after {last}");
        last = number;
    }
    let status = group.wait_for("its counters", |status| {
        status["publisher"]["protocols"]["ssl"]["sent"].as_u64() > Some(10)
    });
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
}

/// The only interface goes down and returns: said, counted and tried again, and no frame is lost.
#[test]
#[ignore = "needs root, for a network of its own"]
fn a_dead_network_is_said_and_tried_again() {
    own_network();
    let socket = receiver(SSL);
    let (mut group, _) = start("publish-dead", ALL, &[]);
    detection(&socket);
    network("link set lo down");
    let status = group.wait_for("a problem", |status| {
        let protocols = &status["publisher"]["protocols"];
        protocols["ssl"]["problem"] != "" && protocols["tracked"]["problem"] != ""
    });
    let ssl = &status["publisher"]["protocols"]["ssl"];
    let problem = ssl["problem"].as_str().unwrap();
    assert!(problem.contains("224.5.23.2:10006"), "{problem}");
    assert!(ssl["failed"].as_u64() > Some(0), "{ssl}");
    let events = status["events"].as_array().unwrap();
    let is_told = |event: &Value| event["what"].as_str().unwrap().starts_with("ssl: 224.5.23.2");
    assert!(events.iter().any(is_told), "{events:#?}");
    network("link set lo up");
    network("route replace 224.0.0.0/4 dev lo");
    group.wait_for("no problem", |status| {
        let protocols = status["publisher"]["protocols"].as_object().unwrap();
        protocols.values().all(|protocol| protocol["problem"] == "")
    });
    // The membership ended with the interface.
    let socket = receiver(SSL);
    detection(&socket);
    let status = group.try_status().unwrap();
    assert_eq!(
        (&status["frames"]["missing_in_world"], &status["publisher"]["restarts"]),
        (&0.into(), &0.into())
    );
}

/// Another vision on the same address is named, with its address and kind.
#[test]
#[ignore = "needs root, for a network of its own"]
fn a_second_publisher_on_the_same_address_is_named() {
    own_network();
    let (mut group, status) = start("publish-rival", ALL, &[]);
    assert_eq!(status["publisher"]["rivals"], 0);
    let rival = UdpSocket::bind("127.0.0.1:0").unwrap();
    let from = rival.local_addr().unwrap().to_string();
    let stop = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false));
    let sending = {
        let stop = stop.clone();
        std::thread::spawn(move || {
            let packet = WrapperPacket {
                detection: Some(DetectionFrame::default()),
                geometry: None,
                source: Some(Source::GrSim as i32),
            };
            while !stop.load(std::sync::atomic::Ordering::Relaxed) {
                rival.send_to(&packet.encode_to_vec(), SSL).unwrap();
                std::thread::sleep(Duration::from_millis(50));
            }
        })
    };
    let status = group.wait_for("the rival's name", |status| status["publisher"]["rivals"] == 1);
    let problem = status["publisher"]["problem"].as_str().unwrap();
    assert!(problem.contains(&from) && problem.contains("grSim"), "{problem}");
    stop.store(true, std::sync::atomic::Ordering::Relaxed);
    sending.join().unwrap();
    group.wait_for("that it is gone", |status| status["publisher"]["rivals"] == 0);
}

/// Malformed packets, packets from elsewhere, and commands that a robot obeys.
#[test]
#[ignore = "needs root, for a network of its own"]
fn only_commands_are_taken_from_the_network() {
    own_network();
    network("addr add 10.99.0.1/32 dev lo");
    let config = "preset = \"vsss-3v3\"\n[camera]\nfps = 40\n[publish.commands]\nenabled = true\n";
    let (mut group, _) = start("publish-commands", config, &[]);
    let port = SocketAddrV4::new(Ipv4Addr::LOCALHOST, firasim::COMMANDS_PORT);
    let client = UdpSocket::bind("127.0.0.1:0").unwrap();
    let turning = WheelCommand { id: 0, yellowteam: true, wheel_left: -8.0, wheel_right: 8.0 };
    let cmd = Some(Commands { robot_commands: vec![turning] });
    let commands = Packet { cmd, replace: None }.encode_to_vec();
    // Random bytes are hardly ever a message; what begins like one is mutilated.
    let mut state = 3u64;
    for index in 0..1000 {
        let rubbish: Vec<u8> = (0..index % 200 + 1)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (state >> 56) as u8 | 0x80
            })
            .collect();
        client.send_to(&rubbish, port).unwrap();
        if index % 100 == 99 {
            let sent = index + 1;
            group.wait_for("dropped packets", |status| status["publisher"]["malformed"] == sent);
        }
    }
    let stranger = UdpSocket::bind("10.99.0.1:0").unwrap();
    for _ in 0..10 {
        stranger.send_to(&commands, port).unwrap();
    }
    let status = group.wait_for("dropped strangers", |status| {
        status["publisher"]["not_allowed"].as_u64() == Some(10)
    });
    assert_eq!(status["publisher"]["commands"], 0, "{status:#}");
    assert_eq!(status["publisher"]["restarts"], 0);

    // It turns on the spot as told: 8 rad/s · 26 mm / 32.5 mm = 6.4 rad/s.
    let mut truth = Consumer::new(group.instance.clone(), "test", &topics::TRUTH);
    let mut agreeing = 0;
    until::<TruthFrame>(&mut truth, |truth| {
        client.send_to(&commands, port).unwrap();
        let robot = truth.robots[..truth.robot_count as usize]
            .iter()
            .find(|robot| (robot.team, robot.robot_id) == (Team::Yellow as u32, 0))
            .unwrap();
        let turns = robot.v_mm_s.abs() < 1.0 && (robot.omega - 6.4).abs() < 0.01;
        agreeing = if turns { agreeing + 1 } else { 0 };
        agreeing == 10
    });
    let status = group.wait_for("the commander", |status| {
        let commanders = status["commanders"].as_array();
        commanders.is_some_and(|all| all.iter().any(|it| it["name"] == "publisher"))
    });
    assert!(status["publisher"]["commands"].as_u64() > Some(0));
    drop(truth);
    group.signal_supervisor(Signal::TERM);
    group.wait_until_ended();
    group.assert_nothing_left();
}

/// `run --publish` is enough to be a simulator of the VSSS.
#[test]
#[ignore = "needs root, for a network of its own"]
fn one_option_makes_a_simulator() {
    own_network();
    let socket = receiver(FIRASIM);
    let (mut group, _) = start(
        "publish-option",
        "preset = \"vsss-3v3\"\n[camera]\nfps = 40\n",
        &["--publish", "firasim,commands"],
    );
    let environment = firasim::Environment::decode(&packet(&socket)[..]).unwrap();
    assert_eq!(environment.field.unwrap().length, 1.5);
    let status = group.try_status().unwrap();
    let protocols = status["publisher"]["protocols"].as_object().unwrap();
    assert_eq!(protocols.keys().collect::<Vec<_>>(), ["firasim"]);
}

/// A recording becomes a log file of the SSL; played again, it is not published.
#[test]
#[ignore = "needs root, for a network of its own"]
fn a_recording_becomes_a_log_and_is_not_published_again() {
    own_network();
    let config = "preset = \"vsss-3v3\"\n[camera]\nfps = 40\n";
    let (group, _) = start("publish-log", config, &["--publish", "json"]);
    let recording = group.scratch.path.join("match.mcap");
    let recording = recording.to_str().unwrap();
    let record =
        ["record", recording, "--seconds", "3", "--topics", "frames,detections,world", "--quiet"];
    let output = group.touchline(&record);
    assert!(output.status.success(), "{output:?}");
    let run = |arguments: &[&str]| {
        let output = output_of(&group.scratch, arguments);
        assert!(output.status.success(), "{arguments:?}: {output:?}");
        output.stdout
    };
    let recorded: Value = serde_json::from_slice(&run(&["info", "--json", recording])).unwrap();
    let messages = |channel: &str| recorded["channels"][channel]["messages"].as_u64().unwrap();
    let mut sizes = vec![];
    for name in ["match.log", "match.log.gz"] {
        let log = group.scratch.path.join(name);
        let log = log.to_str().unwrap();
        run(&["export", recording, "--ssl-log", log]);
        let info: Value = serde_json::from_slice(&run(&["info", "--json", log])).unwrap();
        let packets = |kind: &str| info["packets"][kind]["packets"].as_u64().unwrap();
        let geometries = info["geometries"].as_u64().unwrap();
        assert!((2..=4).contains(&geometries), "{info:#}");
        assert_eq!(packets("vision_2014"), messages("detections") + geometries, "{info:#}");
        assert_eq!(packets("tracker_2020"), messages("world"), "{info:#}");
        assert_eq!((&info["has_index"], &info["is_complete"]), (&true.into(), &true.into()));
        assert_eq!((&info["unreadable"], &info["cameras"]["0"]["missing"]), (&0.into(), &0.into()));
        assert!(info["seconds"].as_f64() > Some(2.0), "{info:#}");
        sizes.push(std::fs::metadata(log).unwrap().len());
        let text = String::from_utf8(run(&["info", log])).unwrap();
        assert!(
            text.contains("log file of the SSL") && text.contains("camera 0: frames"),
            "{text}"
        );
    }
    assert!(sizes[1] < sizes[0], "{sizes:?} bytes");
    // Cut off in the middle, it is read as far as it goes.
    let whole = std::fs::read(group.scratch.path.join("match.log")).unwrap();
    let cut = group.scratch.path.join("cut.log");
    std::fs::write(&cut, &whole[..whole.len() / 2]).unwrap();
    let info = run(&["info", "--json", cut.to_str().unwrap()]);
    let info: Value = serde_json::from_slice(&info).unwrap();
    assert_eq!((&info["has_index"], &info["is_complete"]), (&false.into(), &false.into()));

    let replayed = [
        "run",
        "--quiet",
        "--instance",
        "again",
        "--source",
        &format!("recording:{recording},fast"),
    ];
    let report = group.scratch.path.join("report.json");
    run(&[&replayed[..], &["--report", report.to_str().unwrap()]].concat());
    let report: Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
    assert!(
        report["frames"]["world"].as_u64() > Some(50) && report["publisher"].is_null(),
        "{report:#}"
    );
}

/// Runs a program of `tests/data/publisher` in Python, with the address as its argument.
fn python(program: &str, scratch: &Scratch, arguments: &[&str]) -> std::process::Child {
    let python = std::env::var("TOUCHLINE_LEAGUES_PYTHON").unwrap_or("python3".into());
    Command::new(python)
        .arg(format!("{}/tests/data/publisher/{program}", env!("CARGO_MANIFEST_DIR")))
        .args(arguments)
        .current_dir(&scratch.path)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap()
}

/// The PyPI package `sslclient` decodes detection and geometry.
#[test]
#[ignore = "needs root, for a network of its own, and the Python package sslclient"]
fn python_sslclient_understands_us() {
    own_network();
    let (group, _) = start("publish-sslclient", ALL, &[]);
    let client = python("read_ssl.py", &group.scratch, &["60"]);
    let output = client.wait_with_output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let mut worlds = 0;
    let text = String::from_utf8(output.stdout).unwrap();
    for line in text.lines() {
        let said: Value = serde_json::from_str(line).unwrap();
        if said["field_length"].is_u64() {
            assert_eq!(said["field_length"], 1500, "{said}");
            assert_eq!((&said["lines"], &said["cameras"]), (&12.into(), &1.into()), "{said}");
        } else {
            worlds += 1;
            let robots = said["yellow"].as_object().unwrap().len();
            assert!(robots > 0 && robots <= 3, "{said}");
        }
    }
    assert!(worlds >= 60 && text.contains("field_length"), "{text}");
}

/// The PyPI package `vsss-client` reads the environment, and drives a robot to the ball.
#[test]
#[ignore = "needs root, for a network of its own, and the Python package vsss-client"]
fn python_vsss_client_drives_a_robot_to_the_ball() {
    own_network();
    let (group, _) = start(
        "publish-vsssclient",
        "preset = \"vsss-3v3\"\n[camera]\nfps = 40\n",
        &["--publish", "firasim,commands"],
    );
    let mut client = python("chase_ball.py", &group.scratch, &[]);
    let mut truth = Consumer::new(group.instance.clone(), "test", &topics::TRUTH);
    let mut near = 0;
    until::<TruthFrame>(&mut truth, |truth| {
        let robot = truth.robots[..truth.robot_count as usize]
            .iter()
            .find(|robot| (robot.team, robot.robot_id) == (Team::Yellow as u32, 0))
            .unwrap();
        let apart = (robot.x_mm - truth.ball_x_mm).hypot(robot.y_mm - truth.ball_y_mm);
        near += u32::from(apart < 80.0);
        near >= 5
    });
    let _ = client.kill();
    client.wait().unwrap();
}

/// A minute of packets at full rate, with ten more receivers: order, sizes and times. Prints how long after
/// `world` a packet was made, and received.
#[test]
#[ignore = "needs root, for a network of its own; takes a minute and prints figures"]
fn figures_of_a_minute() {
    const FRAMES: usize = 4800;
    own_network();
    let socket = receiver(VSS);
    let others: Vec<UdpSocket> = (0..10).map(|_| receiver(VSS)).collect();
    let (mut group, _) = start("publish-minute", &ALL.replace("fps = 40", "fps = 80"), &[]);
    let wall_ns = || SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos() as f64;
    let reading = std::thread::spawn(move || {
        let mut arrived: Vec<(DetectionFrame, usize, f64)> = vec![];
        while arrived.len() < FRAMES {
            let bytes = packet(&socket);
            let at_s = wall_ns() * 1e-9;
            let frame = WrapperPacket::decode(&bytes[..]).unwrap().detection.unwrap();
            arrived.push((frame, bytes.len(), at_s));
        }
        arrived
    });
    let offset_ns = wall_ns() - client::clock::monotonic_ns() as f64;
    let mut sent_s = BTreeMap::new();
    let mut consumer = Consumer::new(group.instance.clone(), "test", &topics::WORLD);
    until(&mut consumer, |world: &WorldFrame| {
        let at_s = (world.t_sent_ns as f64 + offset_ns) * 1e-9;
        sent_s.insert(world.frame.seq as u32, at_s);
        sent_s.len() == FRAMES
    });
    let arrived = reading.join().unwrap();
    for pair in arrived.windows(2) {
        assert_eq!(pair[1].0.frame_number, pair[0].0.frame_number + 1);
        assert!(pair[1].0.t_capture > pair[0].0.t_capture && pair[1].0.t_sent >= pair[0].0.t_sent);
    }
    assert!(arrived.iter().all(|(_, length, _)| *length <= ONE_FRAME_BYTES) && !others.is_empty());
    let figures = |what: &str, of: &dyn Fn(&(DetectionFrame, usize, f64)) -> f64| {
        let delays = arrived.iter().filter_map(|it| Some(of(it) - sent_s.get(&it.0.frame_number)?));
        let mut delays: Vec<f64> = delays.map(|seconds| seconds * 1e6).collect();
        delays.sort_by(f64::total_cmp);
        let at = |share: f64| delays[(share * (delays.len() - 1) as f64) as usize];
        let (count, p50, p99, max) = (delays.len(), at(0.5), at(0.99), at(1.0));
        println!("{what}, µs after `world`: p50 {p50:.0}, p99 {p99:.0}, max {max:.0} of {count}");
    };
    figures("packet made", &|it| it.0.t_sent);
    figures("packet received", &|it| it.2);
    let status = group.try_status().unwrap();
    println!("µs from capture: {}", status["latency_us"]);
}
