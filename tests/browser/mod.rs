//! A client of the console that says exactly what a test wants it to say.
#![allow(dead_code)] // each test program uses its own part of this

use crate::support::{Group, PATIENCE};
use serde_json::Value;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};
use touchline::console::Place;
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

/// A console as clients find it.
#[derive(Clone)]
pub struct Browser {
    pub address: SocketAddr,
    pub place: Place,
}

/// An answer.
pub struct Answer {
    pub status: u16,
    pub headers: String,
    pub body: Vec<u8>,
}

impl Answer {
    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|error| {
            panic!("{error}: {} {}", self.status, String::from_utf8_lossy(&self.body))
        })
    }

    /// A header's value.
    pub fn header(&self, name: &str) -> Option<&str> {
        let lines = self.headers.lines().filter_map(|line| line.split_once(": "));
        lines.filter(|(key, _)| key.eq_ignore_ascii_case(name)).map(|(_, value)| value).next()
    }

    pub fn error(&self) -> String {
        self.json()["error"]["message"].as_str().unwrap_or_default().into()
    }
}

impl Browser {
    /// The console of a group, as soon as it answers.
    pub fn of(group: &mut Group) -> Self {
        let deadline = Instant::now() + PATIENCE;
        loop {
            if let Some(place) = Place::read(&group.instance) {
                let mut address = place.address;
                if address.ip().is_unspecified() {
                    address.set_ip(std::net::Ipv4Addr::LOCALHOST.into());
                }
                let browser = Self { address, place };
                if let Some(answer) = browser.try_get("/api/hello")
                    && answer.status == 200
                {
                    return browser;
                }
            }
            group.assert_running();
            assert!(Instant::now() < deadline, "no console\n{}", group.stderr());
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// A connection, with a limit for every read and write.
    pub fn connect(&self) -> std::io::Result<TcpStream> {
        let stream = TcpStream::connect(self.address)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        stream.set_write_timeout(Some(PATIENCE))?;
        Ok(stream)
    }

    /// Sends these bytes; the answer, if there is one.
    pub fn say(&self, bytes: &[u8]) -> Option<Answer> {
        let mut stream = self.connect().ok()?;
        // The server may answer and close before it has read everything.
        let _ = stream.write_all(bytes);
        read_answer(&mut stream)
    }

    /// A request with this first line, these headers besides `Host`, and this body.
    pub fn ask(&self, line: &str, headers: &[(&str, &str)], body: &str) -> Option<Answer> {
        let mut text = format!("{line} HTTP/1.1\r\nConnection: close\r\n");
        if !headers.iter().any(|(name, _)| name.eq_ignore_ascii_case("host")) {
            text += &format!("Host: {}\r\n", self.address);
        }
        for (name, value) in headers {
            text += &format!("{name}: {value}\r\n");
        }
        if !body.is_empty() {
            text += &format!("Content-Length: {}\r\n", body.len());
        }
        self.say(format!("{text}\r\n{body}").as_bytes())
    }

    pub fn try_get(&self, path: &str) -> Option<Answer> {
        self.ask(&format!("GET {path}"), &[], "")
    }

    pub fn get(&self, path: &str) -> Answer {
        self.try_get(path).unwrap_or_else(|| panic!("no answer to GET {path}"))
    }

    /// The origin of the console's own page.
    pub fn origin(&self) -> String {
        format!("http://{}", self.address)
    }

    /// A change, as the page sends it.
    pub fn post(&self, path: &str, body: &Value) -> Answer {
        let headers = [("Origin", &*self.origin()), ("Content-Type", "application/json")];
        self.ask(&format!("POST {path}"), &headers, &body.to_string())
            .unwrap_or_else(|| panic!("no answer to POST {path}"))
    }

    /// A web socket with these headers; the status if it is refused.
    pub fn socket_with(
        &self,
        path: &str,
        headers: &[(&'static str, &str)],
    ) -> Result<WebSocket<TcpStream>, u16> {
        let url = format!("ws://{}{path}", self.address);
        let mut request = url.into_client_request().unwrap();
        for (name, value) in headers {
            request.headers_mut().insert(*name, value.parse().unwrap());
        }
        match tungstenite::client(request, self.connect().map_err(|_| 0u16)?) {
            Ok((socket, _)) => Ok(socket),
            Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(answer))) => {
                Err(answer.status().as_u16())
            }
            Err(error) => panic!("{error}"),
        }
    }

    pub fn socket(&self, path: &str) -> WebSocket<TcpStream> {
        self.socket_with(path, &[]).unwrap()
    }
}

/// Sends a credit to `/api/live` and waits for the answer.
pub fn credit(socket: &mut WebSocket<TcpStream>, want: &Value) -> Value {
    socket.send(Message::text(want.to_string())).unwrap();
    serde_json::from_str(&next(socket).into_text().unwrap()).unwrap()
}

/// The next message that is not a ping.
pub fn next(socket: &mut WebSocket<TcpStream>) -> Message {
    loop {
        let message = socket.read().unwrap();
        if !message.is_ping() && !message.is_pong() {
            return message;
        }
    }
}

fn read_answer(stream: &mut TcpStream) -> Option<Answer> {
    let mut bytes = Vec::new();
    let mut buffer = [0; 65_536];
    loop {
        let length = stream.read(&mut buffer).unwrap_or(0);
        bytes.extend(&buffer[..length]);
        let head = bytes.windows(4).position(|four| four == b"\r\n\r\n");
        let Some(head) = head.filter(|_| length > 0 || !bytes.is_empty()) else {
            if length == 0 {
                return None;
            }
            continue;
        };
        let headers = String::from_utf8_lossy(&bytes[..head]).into_owned();
        let status = headers.split(' ').nth(1)?.parse().ok()?;
        let answer = Answer { status, headers, body: bytes[head + 4..].to_vec() };
        let promised = answer.header("content-length").and_then(|it| it.parse().ok());
        if length == 0 || promised.is_some_and(|promised: usize| answer.body.len() >= promised) {
            return Some(answer);
        }
    }
}
