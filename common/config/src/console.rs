//! Configuration of the console, the page in a browser.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};

/// The port at which the console is looked for first.
const PORT: u16 = 7733;

/// The console: a page to set up and watch the group by in a browser; see docs/console.md.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ConsoleConfig {
    /// Whether the group has one.
    pub enabled: bool,
    /// Address and port. If the port is taken, the next free one is used. An address other than
    /// 127.0.0.1 or `::1` can be reached from other computers, which then need the token that is
    /// printed at the start; "0.0.0.0:7733" stands for all addresses of this computer.
    pub listen: String,
    /// Names under which browsers may ask for the page besides the addresses of this computer, for
    /// example behind a proxy: "touchline.example.org". Browsers of this computer need a token too when
    /// they use such a name.
    pub allow_hosts: Vec<String>,
    /// Whether nothing can be changed from the page.
    pub read_only: bool,
    /// Directories whose recordings can be looked at in the page, besides those that were made there:
    /// `["/home/team/matches"]`.
    pub recordings: Vec<String>,
}

impl Default for ConsoleConfig {
    fn default() -> Self {
        let address = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), PORT);
        Self {
            enabled: true,
            listen: address.to_string(),
            allow_hosts: Vec::new(),
            read_only: false,
            recordings: Vec::new(),
        }
    }
}

impl ConsoleConfig {
    /// The address to listen at; the default one if the text is none, which a checked configuration
    /// excludes.
    pub fn address(&self) -> SocketAddr {
        self.listen.parse().unwrap_or(SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), PORT))
    }
}
