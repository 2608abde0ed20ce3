use super::*;

const OWNER: u32 = 1000;

fn policy() -> Policy {
    Policy {
        place: Place {
            address: "127.0.0.1:7733".parse().unwrap(),
            change: "c0ffee".into(),
            watch: "abcdef".into(),
            read_only: false,
        },
        allow_hosts: vec!["pitch.example.org".into()],
        owner: OWNER,
    }
}

fn caller(local: &str, peer: &str, user: Option<u32>) -> Caller {
    Caller { local: local.parse().unwrap(), peer: peer.parse().unwrap(), user }
}

fn here(user: u32) -> Caller {
    caller("127.0.0.1:7733", "127.0.0.1:50000", Some(user))
}

fn elsewhere() -> Caller {
    caller("192.0.2.7:7733", "192.0.2.9:50000", None)
}

fn asked(host: &str) -> Asked<'_> {
    Asked { host: Some(host), ..Asked::default() }
}

#[test]
fn the_owner_may_do_everything_on_this_computer_and_others_need_a_token() {
    let policy = policy();
    for host in ["127.0.0.1:7733", "localhost:7733", "LOCALHOST:7733", "[::1]:7733"] {
        assert_eq!(policy.decide(&here(OWNER), Kind::Read, &asked(host)), Ok(Rights::Change));
    }
    let host = "127.0.0.1:7733";
    assert_eq!(policy.decide(&here(0), Kind::Read, &asked(host)), Ok(Rights::Change));
    assert_eq!(policy.decide(&here(1001), Kind::Page, &asked(host)), Err(Refusal::Token));
    let unknown = caller("127.0.0.1:7733", "127.0.0.1:50000", None);
    assert_eq!(policy.decide(&unknown, Kind::Read, &asked(host)), Err(Refusal::Token));
    let with = |token| Asked { query: Some(token), ..asked(host) };
    assert_eq!(policy.decide(&here(1001), Kind::Page, &with("abcdef")), Ok(Rights::Watch));
    assert_eq!(policy.decide(&here(1001), Kind::Page, &with("c0ffee")), Ok(Rights::Change));
    for wrong in ["", "c0ffe", "c0ffee0", "C0FFEE", "c0ffed"] {
        assert_eq!(policy.decide(&here(1001), Kind::Page, &with(wrong)), Err(Refusal::Token));
    }
}

#[test]
fn other_computers_need_a_token() {
    let policy = policy();
    let host = "192.0.2.7:7733";
    assert_eq!(policy.decide(&elsewhere(), Kind::Page, &asked(host)), Err(Refusal::Token));
    let cookie = Asked { cookie: Some("abcdef"), ..asked(host) };
    assert_eq!(policy.decide(&elsewhere(), Kind::Socket, &cookie), Ok(Rights::Watch));
    // A user number from elsewhere means nothing.
    let lies = caller("192.0.2.7:7733", "192.0.2.9:50000", Some(OWNER));
    assert_eq!(policy.decide(&lies, Kind::Read, &asked(host)), Err(Refusal::Token));
    let cookie = Asked { origin: Some("http://192.0.2.7:7733"), ..cookie };
    assert_eq!(policy.decide(&elsewhere(), Kind::Change, &cookie), Err(Refusal::WatchOnly));
    let cookie = Asked { cookie: Some("c0ffee"), ..cookie };
    assert_eq!(policy.decide(&elsewhere(), Kind::Change, &cookie), Ok(Rights::Change));
}

#[test]
fn foreign_names_are_refused() {
    let policy = policy();
    for host in
        ["evil.example:7733", "127.0.0.1:7734", "127.0.0.1", "localhost", "", "192.0.2.7:7733"]
    {
        let outcome = policy.decide(&here(OWNER), Kind::Page, &asked(host));
        assert_eq!(outcome, Err(Refusal::Host), "{host}");
    }
    assert_eq!(policy.decide(&here(OWNER), Kind::Page, &Asked::default()), Err(Refusal::Host));
    assert_eq!(
        policy.decide(&elsewhere(), Kind::Page, &asked("localhost:7733")),
        Err(Refusal::Host)
    );
    // Behind a permitted name there may be a proxy, which runs as anybody.
    for host in ["pitch.example.org", "Pitch.Example.org:443"] {
        assert_eq!(policy.decide(&here(0), Kind::Page, &asked(host)), Err(Refusal::Token));
        let token = Asked { cookie: Some("abcdef"), ..asked(host) };
        assert_eq!(policy.decide(&here(0), Kind::Page, &token), Ok(Rights::Watch));
    }
}

#[test]
fn foreign_pages_can_neither_read_nor_change() {
    let policy = policy();
    let host = "localhost:7733";
    let from = |origin| Asked { origin: Some(origin), ..asked(host) };
    for kind in [Kind::Read, Kind::Socket, Kind::Change] {
        for origin in ["http://evil.example", "null", "http://localhost:8080", "localhost:7733", ""]
        {
            let outcome = policy.decide(&here(OWNER), kind, &from(origin));
            assert_eq!(outcome, Err(Refusal::Origin), "{kind:?} {origin}");
        }
        let outcome = policy.decide(&here(OWNER), kind, &from("http://localhost:7733"));
        assert_eq!(outcome, Ok(Rights::Change), "{kind:?}");
        let foreign = Asked { site: Some("cross-site"), ..from("http://localhost:7733") };
        assert_eq!(policy.decide(&here(OWNER), kind, &foreign), Err(Refusal::Origin));
    }
    // An image in a foreign page.
    let image = Asked { site: Some("cross-site"), ..asked(host) };
    assert_eq!(policy.decide(&here(OWNER), Kind::Read, &image), Err(Refusal::Origin));
    // Programs name no origin, and use a token for changes.
    assert_eq!(policy.decide(&here(OWNER), Kind::Socket, &asked(host)), Ok(Rights::Change));
    assert_eq!(policy.decide(&here(OWNER), Kind::Change, &asked(host)), Err(Refusal::Origin));
    let program = Asked { bearer: Some("c0ffee"), ..asked(host) };
    assert_eq!(policy.decide(&here(1001), Kind::Change, &program), Ok(Rights::Change));
}

#[test]
fn a_read_only_console_changes_nothing() {
    let mut policy = policy();
    policy.place.read_only = true;
    let own = Asked { origin: Some("http://localhost:7733"), ..asked("localhost:7733") };
    assert_eq!(policy.decide(&here(OWNER), Kind::Change, &own), Err(Refusal::WatchOnly));
    assert_eq!(policy.decide(&here(OWNER), Kind::Read, &own), Ok(Rights::Watch));
}
