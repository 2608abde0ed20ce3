//! Other publishers on the addresses to which we send: two visions on one field confuse every receiver, and
//! nobody sees why. A socket joins each multicast group to which SSL-Vision packets are sent, and looks for
//! packets of other senders about the same camera. Trackers are not looked for: several on one address are
//! usual, and receivers choose by their uuid.

use super::interfaces::Interface;
use super::sender::{OwnPorts, v4};
use protocols::Message;
use protocols::ssl_vision::{Source, WrapperPacket};
use rustix::net::{
    AddressFamily, RecvFlags, SocketFlags, SocketType, bind, recvfrom, socket_with, sockopt,
};
use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddrV4;
use std::os::fd::OwnedFd;

/// Time after its last packet for which another publisher counts.
const MEMORY_NS: u64 = 3_000_000_000;
/// Most packets read in one round.
const READ_AT_A_TIME: usize = 256;
/// Most other publishers remembered.
const MAX_RIVALS: usize = 16;

/// A packet of another publisher.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Rival {
    /// The address to which both send.
    pub to: SocketAddrV4,
    /// Its own address.
    pub from: SocketAddrV4,
    /// The kind of program, as it says itself.
    pub source: &'static str,
}

/// Looks for other publishers.
#[derive(Default)]
pub struct RivalWatch {
    groups: Vec<SocketAddrV4>,
    camera_id: u32,
    listeners: Vec<Listener>,
    seen: BTreeMap<Rival, u64>,
}

struct Listener {
    to: SocketAddrV4,
    interfaces: Vec<Interface>,
    socket: OwnedFd,
}

impl RivalWatch {
    /// Looks at these addresses, for packets about this camera.
    pub fn new(receivers: impl IntoIterator<Item = SocketAddrV4>, camera_id: u32) -> Self {
        let groups = receivers.into_iter().filter(|to| to.ip().is_multicast()).collect();
        Self { groups, camera_id, ..Self::default() }
    }

    /// Joins the groups on these interfaces; to be called when they may have changed. A group that cannot be
    /// joined is tried again.
    pub fn refresh(&mut self, interfaces: &[Interface]) {
        for &to in &self.groups {
            let is_joined = |it: &Listener| it.to == to && it.interfaces == interfaces;
            if !interfaces.is_empty() && !self.listeners.iter().any(is_joined) {
                self.listeners.retain(|listener| listener.to != to);
                if let Ok(socket) = join(to, interfaces) {
                    let interfaces = interfaces.to_vec();
                    self.listeners.push(Listener { to, interfaces, socket });
                }
            }
        }
    }

    /// Reads what has arrived; returns other publishers not seen for a while.
    pub fn look(&mut self, own: &OwnPorts, now_ns: u64) -> Vec<Rival> {
        let mut buffer = [0; 2048];
        let mut news = vec![];
        self.seen.retain(|_, at_ns| now_ns.saturating_sub(*at_ns) < MEMORY_NS);
        for listener in &self.listeners {
            for _ in 0..READ_AT_A_TIME {
                let flags = RecvFlags::DONTWAIT;
                let Ok((_, length, from)) = recvfrom(&listener.socket, &mut buffer[..], flags)
                else {
                    break;
                };
                let Some(from) = v4(from) else { continue };
                let is_local =
                    listener.interfaces.iter().any(|interface| interface.address == *from.ip());
                if is_local && own.has(from.port()) {
                    continue;
                }
                let Some(source) = source_of(&buffer[..length], self.camera_id) else { continue };
                let rival = Rival { to: listener.to, from, source };
                if !self.seen.contains_key(&rival) {
                    if self.seen.len() >= MAX_RIVALS {
                        continue;
                    }
                    news.push(rival.clone());
                }
                self.seen.insert(rival, now_ns);
            }
        }
        news
    }

    /// Other publishers at the moment.
    pub fn present(&self) -> impl ExactSizeIterator<Item = &Rival> {
        self.seen.keys()
    }
}

/// The kind of program that sent a packet about this camera; `None` for all other packets.
fn source_of(bytes: &[u8], camera_id: u32) -> Option<&'static str> {
    let packet = WrapperPacket::decode(bytes).ok()?;
    if packet.detection.as_ref()?.camera_id != camera_id {
        return None;
    }
    Some(match packet.source() {
        Source::Unknown => "a program that does not say what it is",
        Source::Other => "another program",
        Source::SslVision => "SSL-Vision",
        Source::VisionProcessor => "SSL vision-processor",
        Source::GrSim => "grSim",
        Source::ErForceSim => "ER-Force's simulator",
    })
}

fn join(to: SocketAddrV4, interfaces: &[Interface]) -> io::Result<OwnedFd> {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = socket_with(AddressFamily::INET, SocketType::DGRAM, flags, None)?;
    sockopt::set_socket_reuseaddr(&socket, true)?;
    // Bound to the group itself, so that it takes nothing from receivers on this machine.
    bind(&socket, &to)?;
    for interface in interfaces {
        let (group, address) = (to.ip(), &interface.address);
        sockopt::set_ip_add_membership_with_ifindex(&socket, group, address, interface.index)?;
    }
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocols::ssl_vision::DetectionFrame;

    #[test]
    fn only_packets_about_the_same_camera_count() {
        let packet = |camera_id, source: Source| {
            let detection = Some(DetectionFrame { camera_id, ..Default::default() });
            let source = Some(source as i32);
            WrapperPacket { detection, geometry: None, source }.encode_to_vec()
        };
        assert_eq!(source_of(&packet(0, Source::GrSim), 0), Some("grSim"));
        assert_eq!(source_of(&packet(1, Source::GrSim), 0), None);
        assert_eq!(source_of(&WrapperPacket::default().encode_to_vec(), 0), None);
        assert_eq!(source_of(b"anything", 0), None);
    }
}
