//! The user at the other end of a connection of this computer, from the kernel's tables of connections.

use std::fs;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

/// Established, in `include/net/tcp_states.h`. Other states have no user: a socket that its program has closed
/// counts as root's.
const ESTABLISHED: &str = "01";

/// The user whose socket at `peer` is connected to ours at `local`; `None` if the table does not say.
pub fn user_of(peer: SocketAddr, local: SocketAddr) -> Option<u32> {
    let (peer, local) = (canonical(peer), canonical(local));
    // A connection to an IPv4 address is in the first, whatever kind of socket we have.
    ["/proc/net/tcp", "/proc/net/tcp6"]
        .iter()
        .find_map(|path| find(&fs::read_to_string(path).ok()?, peer, local))
}

/// An IPv4 address that came through an IPv6 socket as what it is.
pub fn canonical(address: SocketAddr) -> SocketAddr {
    SocketAddr::new(address.ip().to_canonical(), address.port())
}

/// Finds the user in a table.
pub fn find(table: &str, peer: SocketAddr, local: SocketAddr) -> Option<u32> {
    table.lines().skip(1).find_map(|line| {
        let mut fields = line.split_ascii_whitespace().skip(1);
        let (at, to, state) = (fields.next()?, fields.next()?, fields.next()?);
        if state != ESTABLISHED || address(at)? != peer || address(to)? != local {
            return None;
        }
        // Between: queues, timer, retransmissions.
        let user = fields.nth(3)?.parse().ok()?;
        let inode: u64 = fields.nth(1)?.parse().ok()?;
        // A socket without inode has been closed.
        (inode != 0).then_some(user)
    })
}

/// `0100007F:1E35`: four bytes at a time, in the byte order of the machine.
fn address(text: &str) -> Option<SocketAddr> {
    let (ip, port) = text.split_once(':')?;
    let port = u16::from_str_radix(port, 16).ok()?;
    let word = |index: usize| {
        let digits = ip.get(8 * index..8 * index + 8)?;
        Some(u32::from_str_radix(digits, 16).ok()?.to_ne_bytes())
    };
    let ip = match ip.len() {
        8 => IpAddr::V4(Ipv4Addr::from(word(0)?)),
        32 => {
            let mut bytes = [0; 16];
            for (index, part) in bytes.chunks_exact_mut(4).enumerate() {
                part.copy_from_slice(&word(index)?);
            }
            IpAddr::V6(Ipv6Addr::from(bytes)).to_canonical()
        }
        _ => return None,
    };
    Some(SocketAddr::new(ip, port))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{TcpListener, TcpStream};

    #[test]
    fn the_user_of_a_connection_is_found() {
        for place in ["127.0.0.1:0", "[::1]:0", "[::]:0"] {
            // Some machines have no IPv6.
            let Ok(listener) = TcpListener::bind(place) else { continue };
            let port = listener.local_addr().unwrap().port();
            let ip = if place.starts_with("127") { "127.0.0.1" } else { "::1" };
            let client = TcpStream::connect((ip, port)).unwrap();
            let (server, peer) = listener.accept().unwrap();
            let local = server.local_addr().unwrap();
            let user = user_of(peer, local);
            assert_eq!(user, Some(rustix::process::getuid().as_raw()), "{place}");
            drop(client);
            assert_eq!(user_of(peer, local), None, "closed, so it is nobody's");
        }
    }

    #[test]
    fn tables_are_read_as_the_kernel_writes_them() {
        let table = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n   \
             0: 0100007F:9C40 0100007F:1E35 01 00000000:00000000 00:00000000 00000000  1000        0 41 1\n   \
             1: 0100007F:9C41 0100007F:1E35 06 00000000:00000000 00:00000000 00000000     0        0 42 1\n   \
             2: 0100007F:9C42 0100007F:1E35 01 00000000:00000000 00:00000000 00000000     0        0 0 1\n   \
             3: nonsense\n";
        let at = |port| SocketAddr::from(([127, 0, 0, 1], port));
        if cfg!(target_endian = "little") {
            assert_eq!(find(table, at(0x9c40), at(0x1e35)), Some(1000));
        }
        assert_eq!(find(table, at(0x9c41), at(0x1e35)), None, "no longer established");
        assert_eq!(find(table, at(0x9c42), at(0x1e35)), None, "closed");
        assert_eq!(find(table, at(0x9c43), at(0x1e35)), None);
        assert_eq!(find("", at(1), at(2)), None);
    }
}
