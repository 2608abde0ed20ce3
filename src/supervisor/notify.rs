//! Tells systemd, or whoever speaks its protocol, that the group is complete, lives, or ends.
//!
//! The protocol (`sd_notify(3)`) is one datagram of `NAME=value` lines to the socket that
//! `$NOTIFY_SOCKET` names. Nobody listens in an ordinary shell; then all of this does nothing. Nothing
//! of it is ever waited for: a service manager that does not read must not stop a match.

use std::env;
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

/// Where to send to.
const SOCKET_VARIABLE: &str = "NOTIFY_SOCKET";
/// Within how many microseconds a sign of life is expected.
const WATCHDOG_VARIABLE: &str = "WATCHDOG_USEC";
/// From which process.
const WATCHDOG_PID_VARIABLE: &str = "WATCHDOG_PID";
/// What the supervisor's own processes must not inherit: they are not the service.
pub const VARIABLES: [&str; 3] = [SOCKET_VARIABLE, WATCHDOG_VARIABLE, WATCHDOG_PID_VARIABLE];

/// Signs of life are sent so many times in the interval in which one is expected …
const SIGNS_PER_INTERVAL: u32 = 4;
/// … but never more often than this.
const SIGN_MIN: Duration = Duration::from_millis(250);

/// The line to the service manager.
#[derive(Debug, Default)]
pub struct Notifier {
    socket: Option<UnixDatagram>,
    sign_every: Option<Duration>,
    last_sign: Option<Instant>,
    is_ready: bool,
}

impl Notifier {
    /// As the environment says. A socket that cannot be used is complained about, and the match goes
    /// on: the service manager will say more when its own patience ends.
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
                common::tell!("touchline: {SOCKET_VARIABLE} {}: {error}", name.display());
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

    /// The group is complete. Said once, however often it is called.
    pub fn ready(&mut self) {
        if !self.is_ready {
            self.is_ready = true;
            self.send("READY=1\nSTATUS=The match is running");
        }
    }

    /// The supervisor goes round its loop. Sent when it is time to.
    pub fn alive(&mut self, now: Instant) {
        let Some(every) = self.sign_every else { return };
        if self.last_sign.is_none_or(|last| now.saturating_duration_since(last) >= every) {
            self.last_sign = Some(now);
            self.send("WATCHDOG=1");
        }
    }

    /// The group ends.
    pub fn stopping(&self) {
        self.send("STOPPING=1\nSTATUS=The match is ending");
    }

    fn send(&self, message: &str) {
        if let Some(socket) = &self.socket {
            // A full or vanished socket is the service manager's affair.
            let _ = socket.send(message.as_bytes());
        }
    }
}

/// A path, or after an `@` a name in the abstract namespace.
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
    fn a_socket_with_a_path_hears_all() {
        let path = env::temp_dir().join(format!("tl-notify-{}", std::process::id()));
        let manager = manager(&SocketAddr::from_pathname(&path).unwrap());
        says(path.as_os_str().as_encoded_bytes(), &manager);
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn an_abstract_socket_hears_all() {
        let name = format!("tl-notify-{}", std::process::id());
        let manager = manager(&SocketAddr::from_abstract_name(&name).unwrap());
        says(format!("@{name}").as_bytes(), &manager);
    }

    #[test]
    fn a_manager_that_does_not_read_or_is_gone_holds_up_nobody() {
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
    fn without_a_watchdog_there_are_no_signs_of_life() {
        let name = format!("tl-notify-none-{}", std::process::id());
        let manager = manager(&SocketAddr::from_abstract_name(&name).unwrap());
        let mut notifier = Notifier::new(connect(format!("@{name}").as_bytes()).unwrap(), None);
        notifier.alive(Instant::now());
        assert_eq!(heard(&manager), Vec::<String>::new());
    }

    #[test]
    fn names_that_are_no_sockets_are_refused() {
        assert!(connect(b"relative").is_err() && connect(b"/nonexistent/socket").is_err());
    }
}
