//! Where the console is reached, and with which tokens: a file in the runtime directory, which only the group's
//! user can read. It outlives the console's process, so that a browser finds the page again after a restart,
//! and needs no other token.

use client::instance::Instance;
use client::private;
use config::ConsoleConfig;
use qrcodegen::{QrCode, QrCodeEcc};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{self, Read, Write as _};
use std::net::{IpAddr, SocketAddr, TcpListener};

/// Ports tried after the configured one.
const MORE_PORTS: u16 = 64;
/// Bytes of a token: as many as nobody can guess.
const TOKEN_BYTES: usize = 16;

/// Address and tokens of a console.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Place {
    /// The address it listens at.
    pub address: SocketAddr,
    /// With this token, everything can be seen and changed.
    pub change: String,
    /// With this token, everything can be seen.
    pub watch: String,
    /// Nothing can be changed, whatever the token.
    pub read_only: bool,
}

impl Place {
    /// Chooses an address: that of an earlier console of the group if it is still free, or the configured
    /// one, or the next free one.
    pub fn choose(config: &ConsoleConfig, earlier: Option<&Self>) -> io::Result<Self> {
        let wanted = config.address();
        let tokens = match earlier {
            Some(earlier) => (earlier.change.clone(), earlier.watch.clone()),
            None => (token()?, token()?),
        };
        let again = earlier.map(|it| it.address).filter(|it| it.ip() == wanted.ip());
        let address = again
            .into_iter()
            .chain(candidates(wanted))
            .find_map(|address| TcpListener::bind(address).ok()?.local_addr().ok())
            // The network may come later; the process keeps trying.
            .unwrap_or(wanted);
        Ok(Self { address, change: tokens.0, watch: tokens.1, read_only: config.read_only })
    }

    /// Listens at the address, or at a later port when another program has it.
    pub fn listen(&self) -> io::Result<(TcpListener, Self)> {
        let taken = |error: &io::Error| error.kind() == io::ErrorKind::AddrInUse;
        let mut outcome = TcpListener::bind(self.address);
        for address in candidates(self.address).skip(1) {
            if !outcome.as_ref().is_err_and(taken) {
                break;
            }
            outcome = TcpListener::bind(address);
        }
        let listener = outcome?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        Ok((listener, Self { address, ..self.clone() }))
    }

    /// The place of the group's console; `None` if it has none.
    pub fn read(instance: &Instance) -> Option<Self> {
        serde_json::from_slice(&fs::read(instance.console_path()).ok()?).ok()
    }

    /// Writes it into the runtime directory, in the place of an earlier one.
    pub fn write(&self, instance: &Instance) -> io::Result<()> {
        let path = instance.console_path();
        let new = path.with_extension("new");
        private::create_file(&new)?.write_all(&serde_json::to_vec(self)?)?;
        fs::rename(&new, &path)
    }

    /// Removes what says that there is a console.
    pub fn remove(instance: &Instance) {
        let _ = fs::remove_file(instance.console_path());
    }

    /// Whether other computers can reach it.
    pub fn is_open(&self) -> bool {
        !self.address.ip().is_loopback()
    }

    /// The page's address for a browser of this computer.
    pub fn local_url(&self) -> String {
        let ip = match self.address.ip() {
            IpAddr::V4(ip) if ip.is_unspecified() => "127.0.0.1".into(),
            IpAddr::V6(ip) if ip.is_unspecified() => "[::1]".into(),
            IpAddr::V4(ip) => ip.to_string(),
            IpAddr::V6(ip) => format!("[{ip}]"),
        };
        format!("http://{ip}:{}/", self.address.port())
    }

    /// Addresses for browsers of other computers, without a token.
    fn urls(&self) -> Vec<String> {
        if !self.address.ip().is_unspecified() {
            return vec![self.local_url()];
        }
        let interfaces = crate::publisher::interfaces::list().unwrap_or_default();
        let others = interfaces.iter().filter(|it| !it.is_loopback);
        others.map(|it| format!("http://{}:{}/", it.address, self.address.port())).collect()
    }

    /// What the user is told: where the page is and, if other computers can reach it, the addresses with
    /// tokens; `with_code` with a QR code of the first.
    pub fn words(&self, with_code: bool) -> String {
        if !self.is_open() {
            return format!("console at {}\n", self.local_url());
        }
        let mut words = String::new();
        if self.address.ip().is_unspecified() {
            let _ = writeln!(words, "console at {} on this computer", self.local_url());
        }
        let urls = self.urls();
        for url in &urls {
            if !self.read_only {
                let _ = writeln!(words, "console at {url}?token={} to see and change", self.change);
            }
            let _ = writeln!(words, "console at {url}?token={} to see only", self.watch);
        }
        let token = if self.read_only { &self.watch } else { &self.change };
        if let (true, Some(url)) = (with_code, urls.first()) {
            words += &qr_code(&format!("{url}?token={token}")).unwrap_or_default();
        }
        words
    }
}

/// The configured address, and the next ports.
fn candidates(wanted: SocketAddr) -> impl Iterator<Item = SocketAddr> {
    let ports = wanted.port()..=wanted.port().saturating_add(MORE_PORTS);
    let more = if wanted.port() == 0 { 1 } else { usize::MAX };
    ports.take(more).map(move |port| SocketAddr::new(wanted.ip(), port))
}

fn token() -> io::Result<String> {
    let mut bytes = [0; TOKEN_BYTES];
    File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Two rows of a QR code in a line of text, dark on light whatever the terminal's colours are.
fn qr_code(text: &str) -> Option<String> {
    let code = QrCode::encode_text(text, QrCodeEcc::Low).ok()?;
    // The margin that readers need.
    const MARGIN: i32 = 2;
    let mut words = String::new();
    for y in (-MARGIN..code.size() + MARGIN).step_by(2) {
        words += "\x1b[30;107m";
        for x in -MARGIN..code.size() + MARGIN {
            words.push(match (code.get_module(x, y), code.get_module(x, y + 1)) {
                (true, true) => '█',
                (true, false) => '▀',
                (false, true) => '▄',
                (false, false) => ' ',
            });
        }
        words += "\x1b[0m\n";
    }
    Some(words)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn console(listen: &str) -> ConsoleConfig {
        ConsoleConfig { listen: listen.into(), ..ConsoleConfig::default() }
    }

    #[test]
    fn a_taken_port_is_followed_by_the_next_free_one() {
        let first = TcpListener::bind("127.0.0.1:0").unwrap();
        let taken = first.local_addr().unwrap();
        let place = Place::choose(&console(&taken.to_string()), None).unwrap();
        assert_ne!(place.address, taken);
        assert_eq!(place.address.ip(), taken.ip());
        let at_taken = Place { address: taken, ..place.clone() };
        let (_listener, moved) = at_taken.listen().unwrap();
        assert_ne!(moved.address, taken);
        assert_eq!(moved.change, place.change);
    }

    #[test]
    fn tokens_stay_and_differ() {
        let first = Place::choose(&console("127.0.0.1:0"), None).unwrap();
        let other = Place::choose(&console("127.0.0.1:0"), None).unwrap();
        assert_eq!(first.change.len(), 2 * TOKEN_BYTES);
        assert!(first.change != other.change && first.change != first.watch);
        let again = Place::choose(&console("127.0.0.1:0"), Some(&first)).unwrap();
        assert_eq!(again, first);
    }

    #[test]
    fn only_open_addresses_come_with_tokens() {
        let mut place = Place::choose(&console("127.0.0.1:0"), None).unwrap();
        assert!(!place.words(true).contains(&place.change));
        place.address = "192.0.2.7:7733".parse().unwrap();
        let words = place.words(true);
        assert!(words.contains(&format!("http://192.0.2.7:7733/?token={}", place.change)));
        assert!(words.contains(&place.watch) && words.contains('█'));
        place.read_only = true;
        assert!(!place.words(false).contains(&place.change));
    }
}
