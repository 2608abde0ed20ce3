//! The network interfaces of this machine, from the kernel's own list (rtnetlink): `/sys` shows those of
//! another network namespace.

use rustix::net::{
    AddressFamily, RecvFlags, SendFlags, SocketFlags, SocketType, netlink::SocketAddrNetlink, recv,
    sendto, socket_with,
};
use std::collections::BTreeMap;
use std::io;
use std::net::Ipv4Addr;

/// An interface with an IPv4 address.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Interface {
    /// Its number.
    pub index: u32,
    /// Its name.
    pub name: String,
    /// Its first IPv4 address.
    pub address: Ipv4Addr,
    /// Whether packets on it stay on this machine.
    pub is_loopback: bool,
    /// Whether it is up and can multicast.
    pub can_multicast: bool,
}

// Numbers of linux/if.h, linux/netlink.h, linux/rtnetlink.h, linux/if_link.h and linux/if_addr.h.
const IFF_UP: u32 = 0x1;
const IFF_LOOPBACK: u32 = 0x8;
const IFF_MULTICAST: u32 = 0x1000;
const RTM_NEWLINK: u16 = 16;
const RTM_GETLINK: u16 = 18;
const RTM_NEWADDR: u16 = 20;
const RTM_GETADDR: u16 = 22;
const NLM_F_REQUEST_DUMP: u16 = 0x301;
const NLMSG_ERROR: u16 = 2;
const NLMSG_DONE: u16 = 3;
const IFLA_IFNAME: u16 = 3;
const IFA_ADDRESS: u16 = 1;
const IFA_LOCAL: u16 = 2;
/// Bytes of `struct nlmsghdr`, `struct ifinfomsg` and `struct ifaddrmsg`.
const HEAD: usize = 16;
const LINK: usize = 16;
const ADDRESS: usize = 8;

/// All interfaces with an IPv4 address, by number.
pub fn list() -> io::Result<Vec<Interface>> {
    let mut links: BTreeMap<u32, (String, u32)> = BTreeMap::new();
    ask(RTM_GETLINK, |kind, body| {
        if kind == RTM_NEWLINK
            && let (Some(index), Some(flags)) = (u32_at(body, 4), u32_at(body, 8))
        {
            let name = attribute(body.get(LINK..).unwrap_or(&[]), IFLA_IFNAME);
            let name = name.map(|name| String::from_utf8_lossy(name).trim_end_matches('\0').into());
            links.insert(index, (name.unwrap_or_default(), flags));
        }
    })?;
    let mut interfaces: Vec<Interface> = vec![];
    ask(RTM_GETADDR, |kind, body| {
        // The first byte is the family.
        if kind != RTM_NEWADDR || body.first() != Some(&(AddressFamily::INET.as_raw() as u8)) {
            return;
        }
        let attributes = body.get(ADDRESS..).unwrap_or(&[]);
        let local = attribute(attributes, IFA_LOCAL).or(attribute(attributes, IFA_ADDRESS));
        let (Some(index), Some(&[a, b, c, d])) = (u32_at(body, 4), local) else { return };
        let is_known = interfaces.iter().any(|interface| interface.index == index);
        if let (false, Some((name, flags))) = (is_known, links.get(&index)) {
            interfaces.push(Interface {
                index,
                name: name.clone(),
                address: Ipv4Addr::new(a, b, c, d),
                is_loopback: flags & IFF_LOOPBACK != 0,
                can_multicast: flags & IFF_UP != 0 && flags & IFF_MULTICAST != 0,
            });
        }
    })?;
    interfaces.sort_by_key(|interface| interface.index);
    Ok(interfaces)
}

/// Interfaces for multicast: those wanted, by name or address; or all that can, and loopback only if there is
/// no other. Wanted interfaces that do not exist, or are down, come back as their texts.
pub fn choose<'a>(all: &[Interface], wanted: &'a [String]) -> (Vec<Interface>, Vec<&'a str>) {
    let able = || all.iter().filter(|interface| interface.can_multicast);
    if wanted.is_empty() {
        let mut chosen: Vec<Interface> =
            able().filter(|interface| !interface.is_loopback).cloned().collect();
        if chosen.is_empty() {
            chosen.extend(able().cloned());
        }
        return (chosen, vec![]);
    }
    let is_it = |interface: &Interface, text: &str| {
        interface.name == text || text.parse() == Ok(interface.address)
    };
    let mut chosen: Vec<Interface> = vec![];
    let mut missing = vec![];
    for text in wanted {
        match able().find(|interface| is_it(interface, text)) {
            Some(interface) if chosen.contains(interface) => {}
            Some(interface) => chosen.push(interface.clone()),
            None => missing.push(text.as_str()),
        }
    }
    (chosen, missing)
}

/// Asks the kernel for a list, and hands on each element's kind and body.
fn ask(request: u16, mut element: impl FnMut(u16, &[u8])) -> io::Result<()> {
    // `None` is the protocol NETLINK_ROUTE.
    let flags = SocketFlags::CLOEXEC;
    let socket = socket_with(AddressFamily::NETLINK, SocketType::RAW, flags, None)?;
    let mut message = Vec::with_capacity(HEAD + LINK);
    message.extend(((HEAD + LINK) as u32).to_ne_bytes());
    message.extend(request.to_ne_bytes());
    message.extend(NLM_F_REQUEST_DUMP.to_ne_bytes());
    message.resize(HEAD + LINK, 0);
    sendto(&socket, &message, SendFlags::empty(), &SocketAddrNetlink::new(0, 0))?;
    let mut buffer = vec![0; 1 << 16];
    loop {
        let (length, _) = recv(&socket, &mut buffer[..], RecvFlags::empty())?;
        let mut rest = &buffer[..length];
        while let (Some(length), Some(kind)) = (u32_at(rest, 0), u16_at(rest, 4)) {
            let length = length as usize;
            let Some(body) = rest.get(HEAD..length) else { return Ok(()) };
            match kind {
                NLMSG_DONE => return Ok(()),
                NLMSG_ERROR => {
                    return Err(io::Error::other("the kernel refuses its list of networks"));
                }
                kind => element(kind, body),
            }
            rest = rest.get(aligned(length)..).unwrap_or(&[]);
        }
    }
}

/// The value of an attribute in a list of `struct rtattr`.
fn attribute(mut rest: &[u8], wanted: u16) -> Option<&[u8]> {
    while let (Some(length), Some(kind)) = (u16_at(rest, 0), u16_at(rest, 2)) {
        let value = rest.get(4..usize::from(length))?;
        if kind == wanted {
            return Some(value);
        }
        rest = rest.get(aligned(length.into())..)?;
    }
    None
}

fn aligned(length: usize) -> usize {
    (length + 3) & !3
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_ne_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_ne_bytes(bytes.get(at..at + 2)?.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn interface(index: u32, name: &str, address: [u8; 4]) -> Interface {
        let is_loopback = name == "lo";
        Interface {
            index,
            name: name.into(),
            address: address.into(),
            is_loopback,
            can_multicast: true,
        }
    }

    #[test]
    fn this_machine_has_a_loopback_interface() {
        let all = list().unwrap();
        let lo = all.iter().find(|interface| interface.name == "lo").unwrap();
        assert!(lo.is_loopback && lo.address == Ipv4Addr::LOCALHOST, "{all:?}");
    }

    #[test]
    fn all_that_can_are_used_unless_some_are_named() {
        let lo = interface(1, "lo", [127, 0, 0, 1]);
        let eth0 = interface(2, "eth0", [10, 0, 0, 5]);
        let wlan0 = interface(3, "wlan0", [192, 168, 1, 5]);
        let down = Interface { can_multicast: false, ..interface(4, "eth1", [10, 1, 0, 5]) };
        let all = [lo.clone(), eth0.clone(), wlan0.clone(), down];
        assert_eq!(choose(&all, &[]), (vec![eth0.clone(), wlan0.clone()], vec![]));
        assert_eq!(choose(&all[..1], &[]), (vec![lo.clone()], vec![]));
        let wanted = ["192.168.1.5", "lo", "eth1", "eth7"].map(String::from);
        assert_eq!(choose(&all, &wanted), (vec![wlan0, lo], vec!["eth1", "eth7"]));
        let twice = ["eth0", "10.0.0.5"].map(String::from);
        assert_eq!(choose(&all, &twice), (vec![eth0], vec![]));
    }

    #[test]
    fn mutilated_lists_end() {
        for length in 0..12 {
            let bytes: Vec<u8> = (0..length).collect();
            attribute(&bytes, 3);
        }
        assert_eq!(attribute(&[0, 0, 3, 0, 1], 3), None, "an attribute shorter than its head");
    }
}
