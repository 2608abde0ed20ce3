//! Whatever clients of the console send is parsed or refused.

use config::Preset;
use config::snapshot::Snapshot;
use grabber::source::Source;
use proptest::prelude::*;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use touchline::console::access::{Asked, Caller, Kind, Policy, Refusal};
use touchline::console::{Place, changing, foxglove, live, peer, pictures, saving};
use touchline::supervisor::Overrides;

const KINDS: [Kind; 4] = [Kind::Page, Kind::Read, Kind::Socket, Kind::Change];

fn policy() -> Policy {
    let place = Place {
        address: SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 7733),
        change: "0123456789abcdef".into(),
        watch: "fedcba9876543210".into(),
        read_only: false,
    };
    Policy { place, allow_hosts: vec!["pitch.example.org".into()], owner: 1000 }
}

fn text() -> impl Strategy<Value = Option<String>> {
    prop_oneof![
        Just(None),
        any::<String>().prop_map(Some),
        "(http://|https://)?(localhost|127.0.0.1|evil.example|pitch.example.org)(:7733|:80)?"
            .prop_map(Some),
    ]
}

proptest! {
    #[test]
    fn texts_are_parsed_or_refused(text in any::<String>()) {
        let _ = live::Credit::parse(&text).map(|credit| credit.kinds());
        let _ = pictures::Wish::parse(&text);
        let _ = foxglove::Said::parse(&text);
        let _ = changing::ReloadRequest::parse(text.as_bytes());
        let at = SocketAddr::from(([127, 0, 0, 1], 7733));
        prop_assert_eq!(peer::find(&text, at, at), None);
    }

    #[test]
    fn any_value_of_a_key_is_planned_or_refused_with_a_reason(
        key in "(filter.gate_chi2|colors.orange.red|colors.orange|colors|geometry.points|[a-z.]{0,12})",
        value in prop_oneof![
            "[0-9]{1,4}", Just("null".to_string()), "\\[[0-9]{1,3}, [0-9]{1,3}\\]", "\"[a-z ]{0,9}\"",
            Just("{\"a\": [1, {}]}".to_string()), Just("1e999".to_string()),
        ],
    ) {
        let body = format!("{{\"base_revision\":1,\"set\":{{\"{key}\":{value}}}}}");
        if let Ok(request) = changing::ReloadRequest::parse(body.as_bytes()) {
            let now = Snapshot::first(Preset::Mirosot5v5.config());
            match request.plan(&now, &Overrides::default(), &Source::External) {
                Ok(plan) => prop_assert_eq!(plan.config.problems(), []),
                Err(failure) => prop_assert!(!failure.message.is_empty()),
            }
        }
    }

    #[test]
    fn without_the_right_name_origin_and_token_nothing_is_permitted(
        host in text(), origin in text(), site in text(), bearer in text(), cookie in text(),
        query in text(), is_here in any::<bool>(), user in prop::option::of(0u32..2000),
    ) {
        let own = Ipv4Addr::new(if is_here { 127 } else { 192 }, 0, 0, 1);
        let caller = Caller {
            local: SocketAddr::new(own.into(), 7733), peer: SocketAddr::new(own.into(), 50_000), user,
        };
        let asked = Asked {
            host: host.as_deref(), origin: origin.as_deref(), site: site.as_deref(),
            bearer: bearer.as_deref(), cookie: cookie.as_deref(), query: query.as_deref(),
        };
        for kind in KINDS {
            let Ok(_) = policy().decide(&caller, kind, &asked) else { continue };
            // No generated text is a token: only the owner is left, on this computer, under its name.
            prop_assert!(is_here && (user == Some(1000) || user == Some(0)));
            let host = asked.host.unwrap_or_default().to_ascii_lowercase();
            prop_assert!(["localhost:7733", "127.0.0.1:7733"].contains(&&*host), "{}", host);
            if let (Some(origin), true) = (asked.origin, kind != Kind::Page) {
                prop_assert!(origin.to_ascii_lowercase().ends_with(&format!("://{host}")), "{}", origin);
            }
        }
        let nobody = Asked { host: None, ..asked };
        prop_assert_eq!(policy().decide(&caller, Kind::Read, &nobody), Err(Refusal::Host));
    }

    #[test]
    fn any_file_is_merged_or_left_alone(text in any::<String>()) {
        let now = Preset::Vsss3v3.config();
        if let Some(merged) = saving::merge(&text, &now, &Overrides::default(), &Source::External) {
            prop_assert_eq!(config::Config::parse(&merged.text, "test").unwrap(), now);
        }
    }
}
