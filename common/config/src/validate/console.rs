//! Checks of addresses and names in `[console]`.

use super::super::Config;
use super::super::problem::{Problem, quoted};
use std::net::SocketAddr;
use std::path::Path;

pub(super) fn check(config: &Config, problems: &mut Vec<Problem>) {
    let console = &config.console;
    if console.listen.parse::<SocketAddr>().is_err() {
        let message = format!("{} is not an address with a port", quoted(&console.listen));
        let problem = Problem::new("console.listen", message);
        problems.push(problem.help("for example \"127.0.0.1:7733\" or \"0.0.0.0:7733\""));
    }
    for (index, host) in console.allow_hosts.iter().enumerate() {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-._:[]".contains(c);
        if host.is_empty() || !host.chars().all(is_plain) {
            let message = format!("{} is not the name of a computer", quoted(host));
            let problem = Problem::new(format!("console.allow_hosts[{index}]"), message);
            problems.push(problem.help("for example \"touchline.example.org\""));
        }
    }
    for (index, directory) in console.recordings.iter().enumerate() {
        // The console's process runs where the group was started.
        if !Path::new(directory).is_absolute() {
            let message = format!("{} does not begin with /", quoted(directory));
            let problem = Problem::new(format!("console.recordings[{index}]"), message);
            problems.push(problem.help("for example \"/home/team/matches\""));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{accepted, refused};

    #[test]
    fn addresses_and_names_are_checked() {
        accepted(|config| config.console.listen = "[::1]:0".into());
        accepted(|config| config.console.allow_hosts = vec!["a.b:8080".into()]);
        refused("console.listen", "127.0.0.1:7733", |config| {
            config.console.listen = "localhost".into();
        });
        refused("console.allow_hosts[0]", "name of a computer", |config| {
            config.console.allow_hosts = vec!["http://a/".into()];
        });
        accepted(|config| config.console.recordings = vec!["/srv/matches".into()]);
        refused("console.recordings[0]", "does not begin with /", |config| {
            config.console.recordings = vec!["matches".into()];
        });
    }
}
