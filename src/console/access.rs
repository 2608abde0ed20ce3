//! Access control: decides for each request whether it is permitted, without any input or output.
//!
//! * *Host*: a foreign name that leads to this computer (DNS rebinding) is refused. Accepted are the address at
//!   which the connection arrived, the names of this computer when it came from here, and `allow_hosts`.
//! * *Origin*: browsers name the page that a request comes from. Requests of foreign pages are refused; a change
//!   must come from our own page, or with a token in a header, which no foreign page can set.
//! * *Rights*: on this computer the group's user and root may do everything, told by the owner of the
//!   connection. Everybody else needs one of two tokens: one to see, one to see and change.

use super::place::Place;
use std::net::SocketAddr;

/// The rights of a client.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rights {
    /// See everything.
    Watch,
    /// See and change everything.
    Change,
}

impl Rights {
    /// Name in answers.
    pub fn name(self) -> &'static str {
        match self {
            Self::Watch => "watch",
            Self::Change => "change",
        }
    }
}

/// The kind of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The page itself, which any link may lead to.
    Page,
    /// Data, or a part of the page.
    Read,
    /// A web socket.
    Socket,
    /// A change.
    Change,
}

/// Where a connection comes from.
#[derive(Debug, Clone, Copy)]
pub struct Caller {
    /// Our end.
    pub local: SocketAddr,
    /// The other end.
    pub peer: SocketAddr,
    /// The user at the other end, on this computer.
    pub user: Option<u32>,
}

/// The parts of a request that decide.
#[derive(Debug, Clone, Default)]
pub struct Asked<'a> {
    /// Header `Host`.
    pub host: Option<&'a str>,
    /// Header `Origin`.
    pub origin: Option<&'a str>,
    /// Header `Sec-Fetch-Site`.
    pub site: Option<&'a str>,
    /// Token from the header `Authorization`.
    pub bearer: Option<&'a str>,
    /// Token from the cookie.
    pub cookie: Option<&'a str>,
    /// Token from the address.
    pub query: Option<&'a str>,
}

/// Reason for refusing a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// A foreign name.
    #[error(
        "the console does not answer under this name; [console] allow_hosts permits further ones"
    )]
    Host,
    /// A foreign page.
    #[error("requests of other pages are refused")]
    Origin,
    /// No token, or a wrong one.
    #[error("a token is needed: open the address that `touchline console` prints")]
    Token,
    /// The right to change is needed.
    #[error("this token, or this console, only permits to watch")]
    WatchOnly,
}

/// The rules by which requests are permitted.
#[derive(Debug, Clone)]
pub struct Policy {
    /// Address and tokens.
    pub place: Place,
    /// Further names.
    pub allow_hosts: Vec<String>,
    /// The group's user.
    pub owner: u32,
}

impl Policy {
    /// The client's rights, or the reason for refusing the request.
    pub fn decide(&self, caller: &Caller, kind: Kind, asked: &Asked) -> Result<Rights, Refusal> {
        let host = asked.host.ok_or(Refusal::Host)?;
        let name = self.name(host, caller).ok_or(Refusal::Host)?;
        if !is_own_page(kind, host, asked) {
            return Err(Refusal::Origin);
        }
        let presented = [asked.bearer, asked.query, asked.cookie];
        let by_token = presented.into_iter().flatten().filter_map(|token| self.rights_of(token));
        let by_user =
            (name == Name::OfThisComputer && self.is_owner(caller)).then_some(Rights::Change);
        let rights = by_token.chain(by_user).max().ok_or(Refusal::Token)?;
        let rights = if self.place.read_only { Rights::Watch } else { rights };
        if kind == Kind::Change && rights < Rights::Change {
            return Err(Refusal::WatchOnly);
        }
        Ok(rights)
    }

    /// The rights that a token gives.
    pub fn rights_of(&self, token: &str) -> Option<Rights> {
        if is_same(token, &self.place.change) {
            Some(Rights::Change)
        } else {
            is_same(token, &self.place.watch).then_some(Rights::Watch)
        }
    }

    fn is_owner(&self, caller: &Caller) -> bool {
        caller.peer.ip().to_canonical().is_loopback()
            && caller.user.is_some_and(|user| user == self.owner || user == 0)
    }

    /// Under which kind of name the console is asked.
    fn name(&self, host: &str, caller: &Caller) -> Option<Name> {
        let local = super::peer::canonical(caller.local);
        let port = local.port();
        if local.ip().is_loopback() {
            let names = ["localhost", "127.0.0.1", "[::1]"];
            if names.iter().any(|name| host.eq_ignore_ascii_case(&format!("{name}:{port}"))) {
                return Some(Name::OfThisComputer);
            }
        }
        // Browsers leave out the port 80.
        if host == local.to_string() || port == 80 && host == local.ip().to_string() {
            return Some(if local.ip().is_loopback() { Name::OfThisComputer } else { Name::Other });
        }
        let without_port = host.rsplit_once(':').map_or(host, |(name, _)| name);
        let is_allowed = |allowed: &String| {
            host.eq_ignore_ascii_case(allowed) || without_port.eq_ignore_ascii_case(allowed)
        };
        self.allow_hosts.iter().any(is_allowed).then_some(Name::Other)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Name {
    /// Only programs of this computer use it. Behind any other one there may be a proxy, whose user says
    /// nothing about who asks.
    OfThisComputer,
    Other,
}

/// Whether a request comes from our own page, or from no page at all.
fn is_own_page(kind: Kind, host: &str, asked: &Asked) -> bool {
    let is_own = |origin: &str| {
        let rest = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
        rest.is_some_and(|rest| rest.eq_ignore_ascii_case(host))
    };
    let is_foreign_site = asked.site.is_some_and(|site| site != "same-origin" && site != "none");
    match (kind, asked.origin) {
        // Nothing happens on the page by opening it.
        (Kind::Page, _) => true,
        (_, Some(origin)) => is_own(origin) && !is_foreign_site,
        // Browsers always name the origin of a change, other programs use a token.
        (Kind::Change, None) => asked.bearer.is_some(),
        (Kind::Read | Kind::Socket, None) => !is_foreign_site,
    }
}

/// Compares in a time that does not depend on how much is right.
fn is_same(token: &str, right: &str) -> bool {
    let differs = |(a, b): (u8, u8)| a ^ b;
    let pairs = token.bytes().zip(right.bytes());
    token.len() == right.len()
        && !right.is_empty()
        && pairs.map(differs).fold(0, |all, it| all | it) == 0
}

#[cfg(test)]
#[path = "access/tests.rs"]
mod tests;
