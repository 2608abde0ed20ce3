//! Receives commands of FIRASim's clients and publishes them on `commands`.

use super::intake::{self, MAX_PACKET_BYTES, PacketFault};
use super::sender::v4;
use crate::gateway::ration::Allowance;
use client::bus::{BusError, Publisher};
use client::clock::monotonic_ns;
use config::CommandsConfig;
use messages::Commands;
use rustix::net::{AddressFamily, RecvFlags, SocketFlags, SocketType, bind, recvfrom, socket_with};
use std::io;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::os::fd::OwnedFd;

/// Packets per second that are passed on: one for each robot and frame of two teams of five at 100 Hz. The
/// filter accepts 32 messages between two frames, those of other programs included.
const PER_S: f64 = 1000.0;
/// Burst after a pause.
const AT_ONCE: f64 = 64.0;
/// Most packets received in one round, so that heartbeats are not delayed.
const READ_AT_A_TIME: usize = 256;

/// Packets received so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Passed on.
    pub taken: u64,
    /// No packets of FIRASim's clients, or impossible.
    pub malformed: u64,
    /// From addresses that are not allowed.
    pub not_allowed: u64,
    /// Beyond the permitted rate.
    pub too_many: u64,
}

/// The socket for commands.
pub struct CommandListener {
    port: Option<u16>,
    allowed: Vec<Ipv4Addr>,
    wheel_radius_mm: f64,
    socket: Option<OwnedFd>,
    ration: Allowance,
    seq: u64,
    /// Packets received so far.
    pub counts: Counts,
    /// Why there is no socket, if there should be one.
    pub problem: Option<String>,
}

impl CommandListener {
    /// A listener without a socket; [`refresh`](Self::refresh) opens it if commands are to be received.
    pub fn new(config: &CommandsConfig) -> Self {
        Self {
            port: config.enabled.then_some(config.port),
            allowed: config.allowed(),
            wheel_radius_mm: config.wheel_radius_mm,
            socket: None,
            ration: Allowance::new(PER_S, AT_ONCE, monotonic_ns()),
            seq: 0,
            counts: Counts::default(),
            problem: None,
        }
    }

    /// Opens the socket if it is not open; to be called about once a second.
    pub fn refresh(&mut self) {
        let Some(port) = self.port.filter(|_| self.socket.is_none()) else { return };
        match open(port) {
            Ok(socket) => (self.socket, self.problem) = (Some(socket), None),
            Err(error) => {
                let advice = "choose another one with publish.commands.port";
                self.problem =
                    Some(format!("commands cannot be received at port {port}: {error}; {advice}"));
            }
        }
    }

    /// The socket to wait for.
    pub fn socket(&self) -> Option<&OwnedFd> {
        self.socket.as_ref()
    }

    /// Publishes the commands that have arrived.
    pub fn receive(
        &mut self,
        now_ns: u64,
        publisher: &mut Publisher<Commands, ()>,
    ) -> Result<(), BusError> {
        let mut buffer = [0; MAX_PACKET_BYTES + 1];
        for _ in 0..READ_AT_A_TIME {
            let Some(socket) = &self.socket else { return Ok(()) };
            let Ok((_, length, from)) = recvfrom(socket, &mut buffer[..], RecvFlags::DONTWAIT)
            else {
                return Ok(());
            };
            let from = v4(from).map(|address| *address.ip());
            if let Some(commands) = self.take(from, &buffer[..length], now_ns) {
                publisher.publish(&commands)?;
            }
        }
        Ok(())
    }

    /// The commands in a packet that is allowed; all other packets are counted.
    fn take(&mut self, from: Option<Ipv4Addr>, packet: &[u8], now_ns: u64) -> Option<Commands> {
        if !from.is_some_and(|from| self.allowed.contains(&from)) {
            self.counts.not_allowed += 1;
            return None;
        }
        let mut commands = match intake::commands(packet, self.wheel_radius_mm) {
            Ok(commands) => commands?,
            Err(PacketFault::Malformed | PacketFault::TooMany(_) | PacketFault::Speeds(..)) => {
                self.counts.malformed += 1;
                return None;
            }
        };
        if self.ration.left(now_ns) == 0 {
            self.counts.too_many += 1;
            return None;
        }
        self.ration.take();
        self.counts.taken += 1;
        self.seq += 1;
        (commands.seq, commands.t_sent_ns) = (self.seq, monotonic_ns());
        Some(commands)
    }
}

fn open(port: u16) -> io::Result<OwnedFd> {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = socket_with(AddressFamily::INET, SocketType::DGRAM, flags, None)?;
    bind(&socket, &SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, port))?;
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocols::Message;
    use protocols::firasim::{Command, Commands as Asked, Packet};

    fn listener() -> CommandListener {
        CommandListener::new(&CommandsConfig { enabled: true, ..Default::default() })
    }

    fn packet() -> Vec<u8> {
        let command = Command { id: 1, yellowteam: true, wheel_left: 5.0, wheel_right: 5.0 };
        let cmd = Some(Asked { robot_commands: vec![command] });
        Packet { cmd, replace: None }.encode_to_vec()
    }

    #[test]
    fn only_allowed_addresses_command() {
        let mut listener = listener();
        let now_ns = monotonic_ns();
        let stranger = Some(Ipv4Addr::new(10, 0, 0, 9));
        assert_eq!(listener.take(stranger, &packet(), now_ns), None);
        assert_eq!(listener.take(None, &packet(), now_ns), None);
        let commands = listener.take(Some(Ipv4Addr::LOCALHOST), &packet(), now_ns).unwrap();
        assert_eq!((commands.seq, commands.wheel_count), (1, 1));
        assert_eq!(listener.take(Some(Ipv4Addr::LOCALHOST), b"x", now_ns), None);
        let expected = Counts { taken: 1, malformed: 1, not_allowed: 2, too_many: 0 };
        assert_eq!(listener.counts, expected);
    }

    #[test]
    fn a_flood_is_rationed() {
        let mut listener = listener();
        let now_ns = monotonic_ns();
        let mut take =
            |now_ns| listener.take(Some(Ipv4Addr::LOCALHOST), &packet(), now_ns).is_some();
        assert_eq!((0..500).filter(|_| take(now_ns)).count(), AT_ONCE as usize);
        assert_eq!((0..500).filter(|_| take(now_ns + 20_000_000)).count(), 20);
    }
}
