//! Clients of the console that mean no good: endless bodies, endless heads, frames that no web socket sends.

mod browser;
mod support;

use browser::{Browser, credit};
use rustix::process::Signal;
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use support::{Group, PATIENCE};

const CONSOLE: &str = "[camera]\nfps = 40\n[console]\nlisten = \"127.0.0.1:0\"\n";
/// Clients of a kind.
const CLIENTS: usize = 20;

fn start(name: &str) -> (Group, Browser) {
    let mut group = Group::start_without(name, CONSOLE, "TOUCHLINE_NO_CONSOLE");
    group.wait_until_working();
    let browser = Browser::of(&mut group);
    (group, browser)
}

/// Ends the group, which must not have felt anything.
fn end(mut group: Group) {
    let status = group.wait_until_working();
    assert_eq!(status["attendants"]["console"]["restarts"], 0, "{status:#}");
    assert_eq!(status["frames"]["missing_in_world"], 0, "{status:#}");
    group.signal_supervisor(Signal::TERM);
    assert!(group.wait_until_ended().success());
    group.assert_nothing_left();
}

/// Most memory that the console's process ever had, bytes.
fn peak_bytes(browser: &Browser) -> u64 {
    let status = browser.get("/api/status").json();
    let pid = status["attendants"]["console"]["pid"].as_u64().unwrap();
    let text = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    line.trim().trim_end_matches(" kB").parse::<u64>().unwrap() * 1024
}

fn head(browser: &Browser, path: &str, length: usize) -> String {
    format!(
        "POST {path} HTTP/1.1\r\nHost: {}\r\nOrigin: {}\r\nContent-Length: {length}\r\n\r\n",
        browser.address,
        browser.origin()
    )
}

#[test]
fn bodies_of_a_hundred_megabytes_are_refused_and_take_no_memory() {
    const BYTES: usize = 100_000_000;
    let (group, browser) = start("console-bodies");
    assert_eq!(browser.get("/").status, 200);
    let before = peak_bytes(&browser);
    let part = vec![b' '; 1 << 20];
    for path in ["/api/reload", "/api/mark", "/api/setup/try", "/api/recordings/a/b.mcap/compare"] {
        let mut stream = browser.connect().unwrap();
        stream.write_all(head(&browser, path, BYTES).as_bytes()).unwrap();
        let mut sent = 0;
        // The console closes long before the end.
        while sent < BYTES && stream.write_all(&part).is_ok() {
            sent += part.len();
        }
        assert!(sent < BYTES, "{path} took everything");
    }
    // The same without saying how much is to come.
    let mut stream = browser.connect().unwrap();
    let head =
        head(&browser, "/api/reload", 0).replace("Content-Length: 0", "Transfer-Encoding: chunked");
    stream.write_all(head.as_bytes()).unwrap();
    let chunk = [format!("{:x}\r\n", part.len()).as_bytes(), &part, b"\r\n"].concat();
    let mut sent = 0;
    while sent < BYTES && stream.write_all(&chunk).is_ok() {
        sent += part.len();
    }
    assert!(sent < BYTES, "everything was taken in chunks");
    let grown = peak_bytes(&browser).saturating_sub(before);
    assert!(grown < 32 << 20, "{grown} bytes more");
    end(group);
}

/// Whether the other end has closed. Nothing is waited for.
fn is_closed(stream: &mut TcpStream) -> bool {
    stream.set_nonblocking(true).unwrap();
    let mut buffer = [0; 4096];
    loop {
        match stream.read(&mut buffer) {
            Ok(0) => return true,
            Ok(_) => {}
            Err(error) => return error.kind() != std::io::ErrorKind::WouldBlock,
        }
    }
}

#[test]
fn clients_that_send_a_byte_now_and_then_are_disconnected() {
    let (group, browser) = start("console-loris");
    let whole_head = head(&browser, "/api/mark", 1000);
    let mut drips: Vec<(TcpStream, Vec<u8>, usize)> = Vec::new();
    for number in 0..CLIENTS {
        let mut stream = browser.connect().unwrap();
        // Half of them never end their head, the others their body.
        let text = match number % 2 {
            0 => format!(
                "GET /api/hello HTTP/1.1\r\nHost: {}\r\nX: {}",
                browser.address,
                "x".repeat(9999)
            ),
            _ => {
                stream.write_all(whole_head.as_bytes()).unwrap();
                " ".repeat(999)
            }
        };
        drips.push((stream, text.into_bytes(), 0));
    }
    let deadline = Instant::now() + PATIENCE;
    while !drips.is_empty() {
        assert!(Instant::now() < deadline, "{} are still connected", drips.len());
        drips.retain_mut(|(stream, text, at)| {
            if is_closed(stream) {
                return false;
            }
            let byte = [text[*at % text.len()]];
            *at += 1;
            stream.write_all(&byte).is_ok()
        });
        assert_eq!(browser.get("/api/hello").status, 200);
        std::thread::sleep(Duration::from_millis(100));
    }
    end(group);
}

/// A frame of a web socket: first byte, masked or not, claimed length, content.
fn frame(first: u8, is_masked: bool, claimed: u64, content: &[u8]) -> Vec<u8> {
    let mask = if is_masked { 0x80 } else { 0 };
    let mut bytes = vec![first];
    match claimed {
        0..126 => bytes.push(mask | claimed as u8),
        126..65_536 => {
            bytes.push(mask | 126);
            bytes.extend((claimed as u16).to_be_bytes());
        }
        _ => {
            bytes.push(mask | 127);
            bytes.extend(claimed.to_be_bytes());
        }
    }
    // A mask of zeros changes nothing.
    bytes.extend([0; 4].iter().filter(|_| is_masked));
    bytes.extend(content);
    bytes
}

#[test]
fn frames_that_no_web_socket_sends_end_only_their_own_socket() {
    let (group, browser) = start("console-frames");
    let mut good = browser.socket("/api/live");
    let text = 0x81;
    let rubbish: Vec<Vec<u8>> = vec![
        frame(text, false, 2, b"{}"),
        frame(text, true, u64::MAX, b"{}"),
        frame(text, true, 1 << 63, b""),
        frame(text, true, 70_000, &[b'x'; 70_000]),
        frame(text, true, 4, &[0xff, 0xfe, 0xc0, 0x80]),
        // Reserved bits, unknown kinds, a ping in parts, a ping that is too long.
        frame(0xf1, true, 2, b"{}"),
        frame(0x83, true, 2, b"{}"),
        frame(0x8f, true, 2, b"{}"),
        frame(0x09, true, 2, b"{}"),
        frame(0x89, true, 200, &[0; 200]),
        // A continuation of nothing, a beginning in a beginning, a close with half a reason.
        frame(0x80, true, 2, b"{}"),
        [frame(0x01, true, 1, b"{"), frame(0x01, true, 1, b"}")].concat(),
        frame(0x88, true, 1, &[3]),
        // Binary, where text is expected, and endless parts of a message.
        frame(0x82, true, 4, &[0, 1, 2, 3]),
        [frame(0x01, true, 1, b"{"), frame(0x00, true, 60_000, &[b' '; 60_000]).repeat(4)].concat(),
        vec![0xff; 5000],
        vec![0; 5000],
    ];
    for path in ["/api/live", "/api/picture", "/api/world", "/foxglove"] {
        for bytes in &rubbish {
            let mut socket = browser.socket(path);
            // It may be closed in the middle.
            let _ = socket.get_mut().write_all(bytes);
        }
        // Places are free again.
        let want = json!({ "want": ["world"] });
        assert!(credit(&mut good, &want)["world"]["seq"].is_u64(), "{path}");
    }
    let status: Value = browser.get("/api/status").json();
    assert_eq!(status["instance"], "test");
    end(group);
}
