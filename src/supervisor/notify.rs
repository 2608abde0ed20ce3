//! Notifies systemd, or another service manager with its protocol, that the group is complete, is alive,
//! or ends.
//!
//! The protocol (`sd_notify(3)`) is one datagram of `NAME=value` lines to the socket that
//! `$NOTIFY_SOCKET` names. An ordinary shell sets no socket; then all of this does nothing. Sending never
//! blocks: a service manager that does not read must not stop a match.

use std::env;
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

/// Socket of the service manager.
const SOCKET_VARIABLE: &str = "NOTIFY_SOCKET";
/// Watchdog period in microseconds.
const WATCHDOG_VARIABLE: &str = "WATCHDOG_USEC";
/// Process that the watchdog expects.
const WATCHDOG_PID_VARIABLE: &str = "WATCHDOG_PID";
/// Variables that the supervisor's own processes must not inherit: they are not the service.
pub const VARIABLES: [&str; 3] = [SOCKET_VARIABLE, WATCHDOG_VARIABLE, WATCHDOG_PID_VARIABLE];

/// Keep-alive messages per watchdog period …
const SIGNS_PER_INTERVAL: u32 = 4;
/// … but never more often than one in this time.
const SIGN_MIN: Duration = Duration::from_millis(250);

/// Connection to the service manager.
#[derive(Debug, Default)]
pub struct Notifier {
    socket: Option<UnixDatagram>,
    sign_every: Option<Duration>,
    last_sign: Option<Instant>,
    is_ready: bool,
}

impl Notifier {
    /// Connects as the environment says. An unusable socket is reported, and the match goes on: the
    /// service manager reports more when its own time limit ends.
    pub fn from_environment() -> Self {
        let number = |variable| env::var(variable).ok()?.parse::<u64>().ok();
        let Some(name) = env::var_os(SOCKET_VARIABLE).filter(|name| !name.is_empty()) else {
            return Self::default();
        };
        let is_for_us =
            number(WATCHDOG_PID_VARIABLE).is_none_or(|pid| pid == u64::from(std::process::id()));
        let watchdog = number(WATCHDOG_VARIABLE).filter(|&us| us > 0 && is_for_us);
        match connect(name.as_encoded_bytes()) {
            Ok(socket) => Self::new(socket, watchdog.map(Duration::from_micros)),
            Err(error) => {
                runtime::tell!("touchline: {SOCKET_VARIABLE} {}: {error}", name.display());
                Self::default()
            }
        }
    }

    fn new(socket: UnixDatagram, watchdog: Option<Duration>) -> Self {
        Self {
            socket: Some(socket),
            sign_every: watchdog.map(|interval| (interval / SIGNS_PER_INTERVAL).max(SIGN_MIN)),
            ..Self::default()
        }
    }

    /// Reports once that the group is complete.
    pub fn ready(&mut self) {
        if !self.is_ready {
            self.is_ready = true;
            self.send("READY=1\nSTATUS=The match is running");
        }
    }

    /// Sends a keep-alive message when one is due; call it in every round of the loop.
    pub fn alive(&mut self, now: Instant) {
        let Some(every) = self.sign_every else { return };
        if self.last_sign.is_none_or(|last| now.saturating_duration_since(last) >= every) {
            self.last_sign = Some(now);
            self.send("WATCHDOG=1");
        }
    }

    /// Reports that the group ends.
    pub fn stopping(&self) {
        self.send("STOPPING=1\nSTATUS=The match is ending");
    }

    fn send(&self, message: &str) {
        if let Some(socket) = &self.socket {
            // Ignore a full or vanished socket: the fault is the service manager's.
            let _ = socket.send(message.as_bytes());
        }
    }
}

/// Connects to a path or, after an `@`, to a name in the abstract namespace.
fn connect(name: &[u8]) -> io::Result<UnixDatagram> {
    let address = match name {
        [b'@', name @ ..] => SocketAddr::from_abstract_name(name)?,
        [b'/', ..] => SocketAddr::from_pathname(String::from_utf8_lossy(name).as_ref())?,
        _ => {
            let reason = "must begin with '/' or '@'";
            return Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
        }
    };
    let socket = UnixDatagram::unbound()?;
    socket.connect_addr(&address)?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn manager(address: &SocketAddr) -> UnixDatagram {
        let manager = UnixDatagram::bind_addr(address).unwrap();
        manager.set_nonblocking(true).unwrap();
        manager
    }

    fn heard(manager: &UnixDatagram) -> Vec<String> {
        let mut bytes = [0; 256];
        let mut heard = Vec::new();
        while let Ok(length) = manager.recv(&mut bytes) {
            heard.push(String::from_utf8_lossy(&bytes[..length]).into_owned());
        }
        heard
    }

    fn says(name: &[u8], manager: &UnixDatagram) {
        let watchdog = Duration::from_secs(4);
        let mut notifier = Notifier::new(connect(name).unwrap(), Some(watchdog));
        notifier.ready();
        notifier.ready();
        assert_eq!(heard(manager), ["READY=1\nSTATUS=The match is running"]);

        let start = Instant::now();
        for tick in 0..=400 {
            notifier.alive(start + tick * Duration::from_millis(5));
        }
        assert_eq!(heard(manager), ["WATCHDOG=1"; 3], "once a second in two seconds");

        notifier.stopping();
        assert_eq!(heard(manager), ["STOPPING=1\nSTATUS=The match is ending"]);
    }

    #[test]
    fn a_path_socket_receives_all_messages() {
        let path = env::temp_dir().join(format!("tl-notify-{}", std::process::id()));
        let manager = manager(&SocketAddr::from_pathname(&path).unwrap());
        says(path.as_os_str().as_encoded_bytes(), &manager);
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn an_abstract_socket_receives_all_messages() {
        let name = format!("tl-notify-{}", std::process::id());
        let manager = manager(&SocketAddr::from_abstract_name(&name).unwrap());
        says(format!("@{name}").as_bytes(), &manager);
    }

    #[test]
    fn a_manager_that_does_not_read_or_is_gone_never_blocks() {
        let name = format!("tl-notify-deaf-{}", std::process::id());
        let deaf = manager(&SocketAddr::from_abstract_name(&name).unwrap());
        let socket = connect(format!("@{name}").as_bytes()).unwrap();
        let notifier = Notifier::new(socket, None);
        for _ in 0..10_000 {
            notifier.stopping();
        }
        drop(deaf);
        notifier.stopping();
    }

    #[test]
    fn without_a_watchdog_no_keep_alive_is_sent() {
        let name = format!("tl-notify-none-{}", std::process::id());
        let manager = manager(&SocketAddr::from_abstract_name(&name).unwrap());
        let mut notifier = Notifier::new(connect(format!("@{name}").as_bytes()).unwrap(), None);
        notifier.alive(Instant::now());
        assert_eq!(heard(&manager), Vec::<String>::new());
    }

    #[test]
    fn invalid_socket_names_are_refused() {
        assert!(connect(b"relative").is_err() && connect(b"/nonexistent/socket").is_err());
    }
}
