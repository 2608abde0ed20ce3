//! Sends packets: to multicast groups on each chosen interface, and to single computers and broadcast
//! addresses wherever the system routes them.
//!
//! A send never waits. What the system refuses (interface down, no route, buffer full) is counted, said
//! once until it changes, and tried again with the next packet; interfaces that appear or get another
//! address are used within a second.

use super::interfaces::{self, Interface};
use config::PublishConfig;
use rustix::io::Errno;
use rustix::net::{
    AddressFamily, SendFlags, SocketAddrAny, SocketFlags, SocketType, bind, getsockname, sendto,
    socket_with, sockopt,
};
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::os::fd::OwnedFd;
use std::sync::{Mutex, PoisonError};

/// The ports from which this process sends, by which it knows its own packets.
#[derive(Default)]
pub struct OwnPorts(Mutex<BTreeSet<u16>>);

impl OwnPorts {
    /// Whether a packet from this address is our own.
    pub fn has(&self, port: u16) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).contains(&port)
    }

    fn add(&self, port: u16) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(port);
    }
}

/// Sockets for sending.
pub struct Sender {
    wanted: Vec<String>,
    ttl: u32,
    loopback: bool,
    /// For single computers and broadcast addresses.
    direct: Option<OwnedFd>,
    /// For multicast.
    outlets: Vec<Outlet>,
    /// Current refusals, by what is refused.
    troubles: BTreeMap<String, String>,
}

/// A socket that multicasts on one interface.
struct Outlet {
    interface: Interface,
    socket: OwnedFd,
}

/// What became of a packet.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Outcome {
    /// Copies handed to the system.
    pub sent: u64,
    /// Copies that it refused, or for which there was no interface.
    pub failed: u64,
}

impl Sender {
    /// A sender without sockets; [`refresh`](Self::refresh) opens them.
    pub fn new(publish: &PublishConfig) -> Self {
        Self {
            wanted: publish.interfaces.clone(),
            ttl: publish.ttl,
            loopback: publish.loopback,
            direct: None,
            outlets: vec![],
            troubles: BTreeMap::new(),
        }
    }

    /// Opens and closes sockets as interfaces come and go; to be called about once a second.
    pub fn refresh(&mut self, own: &OwnPorts) {
        if self.direct.is_none() {
            let opened = open(own);
            self.direct = self.noted("a socket", opened);
        }
        let listed = interfaces::list();
        let Some(all) = self.noted("the list of networks", listed) else { return };
        let wanted = std::mem::take(&mut self.wanted);
        let (chosen, missing) = interfaces::choose(&all, &wanted);
        for name in &wanted {
            let is_missing = missing.contains(&name.as_str());
            let state =
                if is_missing { Err("it is down, or there is no such interface") } else { Ok(()) };
            self.note(&format!("the interface {name}"), state.map_err(String::from));
        }
        self.wanted = wanted;
        let gone = self.outlets.extract_if(.., |outlet| !chosen.contains(&outlet.interface));
        for outlet in gone.collect::<Vec<_>>() {
            let suffix = format!(" on {}", outlet.interface.name);
            self.troubles.retain(|what, _| !what.ends_with(&suffix));
        }
        for interface in chosen {
            if self.outlets.iter().all(|outlet| outlet.interface != interface) {
                let opened = self.open_outlet(&interface, own);
                let socket = self.noted(&format!("multicast on {}", interface.name), opened);
                self.outlets.extend(socket.map(|socket| Outlet { interface, socket }));
            }
        }
    }

    fn open_outlet(&self, interface: &Interface, own: &OwnPorts) -> io::Result<OwnedFd> {
        let socket = open(own)?;
        sockopt::set_ip_multicast_if_with_ifindex(
            &socket,
            &Ipv4Addr::UNSPECIFIED,
            &interface.address,
            interface.index,
        )?;
        sockopt::set_ip_multicast_ttl(&socket, self.ttl)?;
        sockopt::set_ip_multicast_loop(&socket, self.loopback)?;
        Ok(socket)
    }

    /// Sends a packet to a receiver.
    pub fn send(&mut self, to: SocketAddrV4, packet: &[u8]) -> Outcome {
        let mut outcome = Outcome::default();
        let mut refusals = vec![];
        let mut send = |socket: &OwnedFd, interface: Option<&str>| {
            let refused = send_once(socket, to, packet).err();
            *(if refused.is_some() { &mut outcome.failed } else { &mut outcome.sent }) += 1;
            refusals.push((interface.map(str::to_string), refused));
        };
        if to.ip().is_multicast() {
            for outlet in &self.outlets {
                send(&outlet.socket, Some(&outlet.interface.name));
            }
        } else if let Some(socket) = &self.direct {
            send(socket, None);
        }
        if refusals.is_empty() {
            outcome.failed += 1;
            self.note(&to.to_string(), Err("no interface is up that can multicast".into()));
        }
        // Texts are made only when something changes.
        for (interface, refused) in refusals {
            if refused.is_some() || !self.troubles.is_empty() {
                let what = match interface {
                    Some(interface) => {
                        self.note(&to.to_string(), Ok(()));
                        format!("{to} on {interface}")
                    }
                    None => to.to_string(),
                };
                self.note(&what, refused.map_or(Ok(()), |errno| Err(words(errno))));
            }
        }
        outcome
    }

    /// The current refusals, in words; empty when there are none.
    pub fn trouble(&self) -> String {
        let all = self.troubles.iter().map(|(what, why)| format!("{what}: {why}"));
        all.collect::<Vec<_>>().join("; ")
    }

    fn noted<T>(&mut self, what: &str, result: io::Result<T>) -> Option<T> {
        let (value, state) = match result {
            Ok(value) => (Some(value), Ok(())),
            Err(error) => (None, Err(error.to_string())),
        };
        self.note(what, state);
        value
    }

    fn note(&mut self, what: &str, state: Result<(), String>) {
        match state {
            Ok(()) => self.troubles.remove(what),
            Err(why) => self.troubles.insert(what.into(), why),
        };
    }
}

fn open(own: &OwnPorts) -> io::Result<OwnedFd> {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = socket_with(AddressFamily::INET, SocketType::DGRAM, flags, None)?;
    // Otherwise the system refuses broadcast addresses.
    sockopt::set_socket_broadcast(&socket, true)?;
    bind(&socket, &SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, 0))?;
    if let Ok(SocketAddr::V4(address)) = SocketAddr::try_from(getsockname(&socket)?) {
        own.add(address.port());
    }
    Ok(socket)
}

fn send_once(socket: &OwnedFd, to: SocketAddrV4, packet: &[u8]) -> Result<(), Errno> {
    loop {
        match sendto(socket, packet, SendFlags::DONTWAIT | SendFlags::NOSIGNAL, &to) {
            Err(Errno::INTR) => {}
            result => return result.map(|_| ()),
        }
    }
}

/// A refusal, with what to do about it.
fn words(errno: Errno) -> String {
    let advice = match errno {
        Errno::NETUNREACH | Errno::HOSTUNREACH => "there is no route to it",
        Errno::NETDOWN | Errno::NODEV => "the interface is down",
        Errno::AGAIN | Errno::NOBUFS => "the network takes no more packets",
        Errno::MSGSIZE => "the packet is too large",
        Errno::ACCESS | Errno::PERM => "a firewall rule forbids it",
        other => return io::Error::from(other).to_string(),
    };
    advice.into()
}

/// An IPv4 address as the system gives it.
pub fn v4(address: Option<SocketAddrAny>) -> Option<SocketAddrV4> {
    match SocketAddr::try_from(address?) {
        Ok(SocketAddr::V4(address)) => Some(address),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::UdpSocket;

    /// Nothing here multicasts: tests of that run in network namespaces.
    fn sender() -> (Sender, OwnPorts) {
        let publish = PublishConfig { interfaces: vec!["lo".into()], ..Default::default() };
        let (mut sender, own) = (Sender::new(&publish), OwnPorts::default());
        sender.refresh(&own);
        (sender, own)
    }

    #[test]
    fn a_single_computer_receives_from_our_own_port() {
        let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
        let SocketAddr::V4(to) = receiver.local_addr().unwrap() else { unreachable!() };
        let (mut sender, own) = sender();
        assert_eq!(sender.send(to, b"packet"), Outcome { sent: 1, failed: 0 });
        let mut buffer = [0; 16];
        let (length, from) = receiver.recv_from(&mut buffer).unwrap();
        assert_eq!(&buffer[..length], b"packet");
        assert!(own.has(from.port()) && !own.has(to.port()));
    }

    #[test]
    fn a_refusal_is_counted_and_said_until_it_is_over() {
        let (mut sender, _) = sender();
        let before = sender.trouble();
        // No receiver has this address, and no route leads to it.
        let nowhere = SocketAddrV4::new(Ipv4Addr::new(127, 0, 0, 1), 9);
        let too_large = vec![0; 70_000];
        assert_eq!(sender.send(nowhere, &too_large), Outcome { sent: 0, failed: 1 });
        assert!(sender.trouble().contains("127.0.0.1:9: the packet is too large"));
        assert_eq!(sender.send(nowhere, b"small"), Outcome { sent: 1, failed: 0 });
        assert_eq!(sender.trouble(), before);
    }

    #[test]
    fn an_interface_that_is_not_there_is_named() {
        let publish = PublishConfig { interfaces: vec!["eth77".into()], ..Default::default() };
        let mut sender = Sender::new(&publish);
        let group = SocketAddrV4::new(Ipv4Addr::new(224, 5, 23, 2), 10_006);
        sender.refresh(&OwnPorts::default());
        assert_eq!(sender.send(group, b"packet"), Outcome { sent: 0, failed: 1 });
        assert!(sender.trouble().contains("the interface eth77"), "{}", sender.trouble());
    }
}
