//! What clients of the console send: requests, credits, subscriptions, texts of configurations.
#![no_main]

use config::Preset;
use config::snapshot::Snapshot;
use grabber::source::Source;
use libfuzzer_sys::fuzz_target;
use touchline::console::access::{Asked, Caller, Kind, Policy};
use touchline::console::{Place, changing, foxglove, live, peer, pictures, saving};
use touchline::supervisor::Overrides;

fuzz_target!(|data: &[u8]| {
    if let Ok(request) = changing::ReloadRequest::parse(data) {
        let now = Snapshot::first(Preset::Vsss3v3.config());
        if let Ok(plan) = request.plan(&now, &Overrides::default(), &Source::External) {
            assert_eq!(plan.config.problems(), []);
        }
    }
    let Ok(text) = std::str::from_utf8(data) else { return };
    let _ = live::Credit::parse(text).map(|credit| credit.kinds());
    let _ = pictures::Wish::parse(text);
    let _ = foxglove::Said::parse(text);
    let (local, peer) = (([127, 0, 0, 1], 7733).into(), ([127, 0, 0, 1], 40_000).into());
    let _ = peer::find(text, peer, local);
    let now = Preset::Mirosot5v5.config();
    if let Some(merged) = saving::merge(text, &now, &Overrides::default(), &Source::External) {
        assert!(config::Config::parse(&merged.text, "fuzz").is_ok_and(|config| config == now));
    }
    // Lines as headers: no user is known, and no line is a token.
    let mut lines = text.lines();
    let mut next = || lines.next().filter(|line| !line.is_empty());
    let asked = Asked {
        host: next(),
        origin: next(),
        site: next(),
        bearer: next(),
        cookie: next(),
        query: next(),
    };
    let place =
        Place { address: local, change: "c".repeat(32), watch: "w".repeat(32), read_only: false };
    let policy = Policy { place, allow_hosts: vec!["a.example".into()], owner: 1000 };
    let caller = Caller { local, peer, user: None };
    for kind in [Kind::Page, Kind::Read, Kind::Socket, Kind::Change] {
        let is_token = |it: &str| policy.rights_of(it).is_some();
        let has_token =
            [asked.bearer, asked.cookie, asked.query].into_iter().flatten().any(is_token);
        assert!(has_token || policy.decide(&caller, kind, &asked).is_err());
    }
});
