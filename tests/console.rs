//! The console of a running group, seen by its clients.

mod browser;
mod support;

use browser::{Browser, credit, next};
use rustix::process::{Signal, getuid};
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use support::{Group, PATIENCE};

/// Any free port: tests of several checkouts may run at the same time.
const CONSOLE: &str = "[camera]\nfps = 40\n[console]\nlisten = \"127.0.0.1:0\"\n";

/// A group with a console; other tests have none.
fn start(name: &str, config: &str) -> Group {
    Group::start_without(name, config, "TOUCHLINE_NO_CONSOLE")
}

fn end(mut group: Group) {
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

#[test]
fn a_page_sees_what_the_group_sees() {
    let mut group = start("console", CONSOLE);
    group.wait_until_working();
    let browser = Browser::of(&mut group);
    let told = group.stderr();
    assert!(told.contains(&format!("console at http://{}/", browser.address)), "{told}");

    let page = browser.get("/");
    assert_eq!(page.status, 200);
    assert!(page.header("content-security-policy").unwrap().contains("default-src 'self'"));
    assert_eq!(page.header("x-content-type-options"), Some("nosniff"));
    let hello = browser.get("/api/hello").json();
    assert_eq!((&hello["rights"], &hello["instance"]), (&json!("change"), &json!("test")));
    assert_eq!(browser.get("/api/status").json()["instance"], "test");
    let model = browser.get("/api/model").json();
    assert_eq!(model["robots"].as_array().unwrap().len(), 10);
    assert_eq!(browser.get("/api/nothing").status, 404);

    let mut live = browser.socket("/api/live");
    let kinds = ["detections", "world", "runs", "status", "events"];
    let (mut seen, mut after) = (Value::Null, json!({}));
    let deadline = Instant::now() + PATIENCE;
    // The match has begun when all robots are tracked. The first of each kind may come in another answer.
    let is_begun = |seen: &Value| {
        seen["world"]["robots"].as_array().is_some_and(|robots| robots.len() == 10)
            && ["detections", "runs", "status"].iter().all(|kind| seen[kind].is_object())
    };
    while !is_begun(&seen) {
        assert!(Instant::now() < deadline, "{seen}");
        let news = credit(&mut live, &json!({ "want": kinds, "after": after }));
        for (kind, news) in news.as_object().unwrap() {
            assert_ne!(after[kind], news["seq"], "{kind} is not new");
            after[kind] = news["seq"].clone();
            seen[kind] = news.clone();
        }
    }
    assert_eq!(seen["detections"]["robots"][0]["outline_px"].as_array().unwrap().len(), 4);
    assert_eq!(seen["runs"]["runs"].as_array().unwrap().len() % 4, 0);
    assert_eq!(seen["status"]["instance"], "test");
    assert!(seen["world"]["ball"]["position_mm"].is_array(), "{seen}");
    // Nothing is wanted: an empty answer after a second.
    assert_eq!(credit(&mut live, &json!({})), json!({}));

    let mut pictures = browser.socket("/api/picture");
    let mut last = 0;
    for (scale, width) in [(1, 640), (2, 320), (4, 160)] {
        pictures.send(json!({ "scale": scale }).to_string().into()).unwrap();
        let bytes = next(&mut pictures).into_data();
        let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
        let header: Value = serde_json::from_slice(&bytes[4..4 + length]).unwrap();
        let picture = image::load_from_memory(&bytes[4 + length..]).unwrap();
        assert_eq!((picture.width(), header["width"].as_u64()), (width, Some(u64::from(width))));
        assert!(header["seq"].as_u64().unwrap() > last, "{header}");
        last = header["seq"].as_u64().unwrap();
    }
    let pixel = browser.get(&format!("/api/pixel?x=320&y=240&seq={last}")).json();
    let still = browser.get(&format!("/api/frame.png?seq={last}"));
    let still = image::load_from_memory(&still.body).unwrap().into_rgb8();
    assert_eq!(json!(still.get_pixel(320, 240).0), pixel["rgb"]);
    assert_eq!(browser.get("/api/pixel?x=640&y=0").status, 400);
    assert_eq!(browser.get("/api/frame.png?seq=0").status, 410);

    let mut world = browser.socket("/api/world");
    let mut frames = Vec::new();
    for _ in 0..5 {
        let text = next(&mut world).into_text().unwrap();
        let pose: Value = serde_json::from_str(&text).unwrap();
        frames.push(pose["frame"].as_u64().unwrap());
    }
    assert!(frames.windows(2).all(|pair| pair[0] < pair[1]), "{frames:?}");
    end(group);
}

#[test]
fn viewers_subscribe_to_the_channels_of_recordings() {
    let mut group = start("console-viewer", CONSOLE);
    group.wait_until_working();
    let browser = Browser::of(&mut group);
    let protocol = [("sec-websocket-protocol", "foxglove.websocket.v1")];
    let mut viewer = browser.socket_with("/foxglove", &protocol).unwrap();
    let mut said =
        || -> Value { serde_json::from_str(&next(&mut viewer).into_text().unwrap()).unwrap() };
    assert_eq!(said()["op"], "serverInfo");
    let channels = said()["channels"].as_array().unwrap().clone();
    let number = |channel: &Value| channel["id"].as_u64().unwrap() + 100;
    let subscription = |it: &Value| json!({ "id": number(it), "channelId": it["id"] });
    let subscriptions: Vec<Value> = channels.iter().map(subscription).collect();
    let subscribe = json!({ "op": "subscribe", "subscriptions": subscriptions });
    viewer.send(tungstenite::Message::text(subscribe.to_string())).unwrap();
    let mut missing: Vec<u64> = channels.iter().map(number).collect();
    let deadline = Instant::now() + PATIENCE;
    while !missing.is_empty() {
        assert!(Instant::now() < deadline, "{missing:?} of {channels:?}");
        let bytes = next(&mut viewer).into_data();
        assert_eq!(bytes[0], 1);
        let id = u64::from(u32::from_le_bytes(bytes[1..5].try_into().unwrap()));
        missing.retain(|&it| it != id);
        let content = &bytes[13..];
        let channel = channels.iter().find(|it| number(it) == id).unwrap();
        match channel["topic"].as_str().unwrap() {
            "frames" => {
                let frame = recording::decode_frame(content).unwrap();
                assert_eq!(frame.pixels.len(), 640 * 480);
            }
            "world" => {
                let world = recording::decode_message::<messages::WorldFrame>(content).unwrap();
                assert!(world.frame.seq > 0);
            }
            "scene" => assert!(serde_json::from_slice::<Value>(content).unwrap().is_object()),
            _ => {}
        }
    }
    end(group);
}

#[test]
fn a_killed_console_comes_back_at_its_address_and_the_group_does_not_notice() {
    let mut group = start("console-killed", CONSOLE);
    group.wait_until_working();
    let browser = Browser::of(&mut group);
    let pid = |status: &Value| status["attendants"]["console"]["pid"].as_u64();
    let before = group.wait_for("the console", |status| pid(status).is_some());
    group.signal(pid(&before).unwrap() as u32, Signal::KILL);
    group.wait_for("another console", |status| {
        pid(status).is_some_and(|it| Some(it) != pid(&before))
    });
    let again = Browser::of(&mut group);
    assert_eq!(again.place, browser.place, "same address, same tokens");
    let status = group.wait_until_working();
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    end(group);
}

#[test]
fn two_groups_have_consoles_side_by_side_and_no_console_means_none() {
    let mut group = start("console-two", CONSOLE);
    let browser = Browser::of(&mut group);
    // The same fixed port for another one.
    let config = format!("[console]\nlisten = \"{}\"\n", browser.address);
    let file = group.scratch.write("second.toml", &config);
    let run = ["run", "--instance", "second", "--seconds", "3", "--config", file.to_str().unwrap()];
    let mut second = support::touchline(&group.scratch, &run);
    let output = second.env_remove("TOUCHLINE_NO_CONSOLE").output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains("console at"), "{said}");
    assert!(!said.contains(&format!("{}/", browser.address)), "{said}");
    let output = support::touchline(&group.scratch, &[&run[..], &["--no-console"]].concat())
        .env_remove("TOUCHLINE_NO_CONSOLE")
        .output()
        .unwrap();
    assert!(!String::from_utf8_lossy(&output.stderr).contains("console"));
    let told = group.touchline(&["console"]);
    assert!(String::from_utf8_lossy(&told.stdout).contains(&browser.origin()), "{told:?}");
    end(group);
}

#[test]
fn foreign_names_pages_and_users_are_refused() {
    let mut group = start("console-safe", CONSOLE);
    let browser = Browser::of(&mut group);
    let get = |headers: &[(&str, &str)]| browser.ask("GET /api/hello", headers, "").unwrap();
    assert_eq!(get(&[("Host", "evil.example")]).status, 421);
    assert_eq!(get(&[("Host", "evil.example:7733")]).status, 421);
    assert_eq!(get(&[("Origin", "http://evil.example")]).status, 403);
    assert_eq!(get(&[("Sec-Fetch-Site", "cross-site")]).status, 403);
    let foreign = [("origin", "http://evil.example")];
    for path in ["/api/live", "/api/picture", "/api/world"] {
        assert_eq!(browser.socket_with(path, &foreign).err(), Some(403), "{path}");
        let own = browser.origin();
        assert!(browser.socket_with(path, &[("origin", &own)]).is_ok(), "{path}");
    }
    for path in ["/page/../Cargo.toml", "/page/%2e%2e%2fplace.rs", "/page//etc/passwd", "/..", "//"]
    {
        let answer = browser.get(path);
        assert!([400, 404].contains(&answer.status), "{path}: {}", answer.status);
    }
    // The first address has the token, which becomes a cookie.
    let token = browser.place.watch.clone();
    let answer = browser.get(&format!("/?token={token}"));
    let cookie = answer.header("set-cookie").unwrap();
    assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"), "{cookie}");
    assert!(!String::from_utf8_lossy(&answer.body).contains(&token));
    assert!(browser.get("/?token=wrong").header("set-cookie").is_none());

    if getuid().is_root() {
        // Another user of this computer, by a program that everybody has.
        let as_nobody = |path: &str| {
            let url = format!("http://{}{path}", browser.address);
            let mut command = std::process::Command::new("setpriv");
            command.args(["--reuid=65534", "--regid=65534", "--clear-groups"]);
            command.args(["curl", "-s", "-o", "/dev/null", "-w", "%{http_code}", &url]);
            command.output().ok().filter(|output| output.status.success())
        };
        if let Some(output) = as_nobody("/api/status") {
            assert_eq!(output.stdout, b"401");
            let watching = as_nobody(&format!("/?token={token}")).unwrap();
            assert_eq!(watching.stdout, b"200");
        }
    }
    end(group);
}

#[test]
fn nothing_that_clients_do_ends_or_blocks_the_console() {
    let mut group = start("console-storm", CONSOLE);
    group.wait_until_working();
    let browser = Browser::of(&mut group);
    // Connections that say nothing, or only half of something.
    let mut silent = Vec::new();
    for index in 0..1000u32 {
        // The limit of descriptors of this process may be lower.
        let Ok(mut stream) = browser.connect() else { break };
        if index % 2 == 0 {
            let _ = std::io::Write::write_all(&mut stream, b"GET /api/hello HTTP/1.1\r\nHost: ");
        }
        silent.push(stream);
        if index % 100 == 0 {
            assert_eq!(browser.get("/api/hello").status, 200, "after {index}");
        }
    }
    assert_eq!(browser.get("/api/hello").status, 200);
    drop(silent);

    let garbage: [&[u8]; 6] = [
        b"\0\0\0\0",
        b"GET\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
        &[b'A'; 100_000],
    ];
    for bytes in garbage {
        if let Some(answer) = browser.say(bytes) {
            assert!(answer.status >= 400, "{}", answer.status);
        }
    }
    // Sockets beyond the limit are refused, and their places are free again when they close.
    let mut sockets = Vec::new();
    while let Ok(socket) = browser.socket_with("/api/live", &[]) {
        sockets.push(socket);
        assert!(sockets.len() < 1000, "without limit");
    }
    assert!(sockets.len() >= 16, "{}", sockets.len());
    for (index, socket) in sockets.iter_mut().enumerate() {
        // Garbage closes the socket it came from.
        let rubbish = ["", "{", "[1,2", "{\"want\":7}"][index % 4];
        let _ = socket.send(tungstenite::Message::text(rubbish));
    }
    drop(sockets);
    let deadline = Instant::now() + PATIENCE;
    let mut live = loop {
        match browser.socket_with("/api/live", &[]) {
            Ok(socket) => break socket,
            Err(status) => assert_eq!(status, 503),
        }
        assert!(Instant::now() < deadline);
        std::thread::sleep(Duration::from_millis(20));
    };
    let want = json!({ "want": ["world"] });
    assert!(credit(&mut live, &want)["world"]["seq"].is_u64());
    // A message beyond the limit.
    let _ = live.send(tungstenite::Message::text("x".repeat(1 << 20)));
    let status = group.wait_until_working();
    assert_eq!(status["attendants"]["console"]["restarts"], 0, "{status:#}");
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    end(group);
}
