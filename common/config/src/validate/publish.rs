//! Checks of addresses in `[publish]`.

use super::super::Config;
use super::super::problem::{Problem, quoted};
use std::net::{Ipv4Addr, SocketAddrV4};

pub(super) fn check(config: &Config, problems: &mut Vec<Problem>) {
    let publish = &config.publish;
    for output in publish.outputs() {
        for (index, text) in output.to.iter().enumerate() {
            let path = format!("publish.{}.to[{index}]", output.name);
            problems.extend(receiver_problem(&path, text));
        }
    }
    for (index, text) in publish.commands.allow.iter().enumerate() {
        if text.parse::<Ipv4Addr>().is_err() {
            let message = format!("{} is not an IPv4 address", quoted(text));
            let problem = Problem::new(format!("publish.commands.allow[{index}]"), message);
            problems.push(problem.help("for example \"192.168.1.20\""));
        }
    }
    for (index, text) in publish.interfaces.iter().enumerate() {
        if text.trim().is_empty() {
            let path = format!("publish.interfaces[{index}]");
            problems.push(Problem::new(path, "must not be blank"));
        }
    }
}

fn receiver_problem(path: &str, text: &str) -> Option<Problem> {
    match text.parse::<SocketAddrV4>() {
        Ok(address) if address.port() == 0 => {
            Some(Problem::new(path, format!("{} has no port", quoted(text))))
        }
        Ok(address) if address.ip().is_unspecified() => {
            Some(Problem::new(path, format!("{} is no receiver", quoted(text))))
        }
        Ok(_) => None,
        Err(_) => {
            let message = format!("{} is not an IPv4 address with a port", quoted(text));
            Some(Problem::new(path, message).help("for example \"224.5.23.2:10006\""))
        }
    }
}

/// Commands that nobody may send.
pub(super) fn warn(config: &Config, warnings: &mut Vec<Problem>) {
    let commands = &config.publish.commands;
    if commands.enabled && commands.allow.is_empty() {
        let message = "is empty: commands from every address are dropped";
        let warning = Problem::new("publish.commands.allow", message);
        warnings.push(warning.related("publish.commands.enabled"));
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{accepted, refused};
    use crate::Config;

    #[test]
    fn receivers_must_be_addresses_with_ports() {
        refused("publish.ssl.to[0]", "224.5.23.2:10006", |config| {
            config.publish.ssl.to = vec!["224.5.23.2".into()];
        });
        refused("publish.json.to[1]", "not an IPv4 address", |config| {
            config.publish.json.to.push("localhost:10030".into());
        });
        refused("publish.vss.to[0]", "no port", |config| {
            config.publish.vss.to = vec!["10.0.0.1:0".into()];
        });
        refused("publish.vss.to[0]", "no receiver", |config| {
            config.publish.vss.to = vec!["0.0.0.0:10015".into()];
        });
        refused("publish.tracked.to", "at least 1", |config| config.publish.tracked.to.clear());
        refused("publish.commands.allow[0]", "192.168.1.20", |config| {
            config.publish.commands.allow = vec!["192.168.1.0/24".into()];
        });
        refused("publish.interfaces[0]", "blank", |config| {
            config.publish.interfaces = vec![" ".into()];
        });
        refused("publish.ttl", "255", |config| config.publish.ttl = 256);
        accepted(|config| {
            config.publish.ssl.to.push("192.168.1.255:10006".into());
            config.publish.commands.allow.push("192.168.1.20".into());
        });
    }

    #[test]
    fn commands_from_nowhere_are_a_warning() {
        let mut config = Config::default();
        config.publish.commands.allow.clear();
        assert_eq!(config.warnings(), []);
        config.publish.commands.enabled = true;
        assert_eq!(config.warnings().len(), 1);
    }
}
