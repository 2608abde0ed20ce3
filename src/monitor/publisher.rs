//! State of the publisher: for the report, and as events when a problem begins or ends.

use super::report::AttendantState;
use super::view::{Event, GroupView};
use client::bus::{Bus, BusError, Stranger, Subscriber};
use config::PublishConfig;
use messages::topics;
use messages::{Attendant, EventKind, OutputReport, PublisherReport, read_text};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The publisher, which sends poses in the leagues' protocols. Counters start with its process.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Published {
    /// Its process id; absent while it does not run.
    pub pid: Option<u32>,
    /// Number of restarts.
    pub restarts: u64,
    /// Protocols that are sent, by the keys of their sections.
    pub protocols: BTreeMap<String, PublishedProtocol>,
    /// Packets with commands that were passed on.
    pub commands: u64,
    /// Packets to the command port that were malformed or impossible.
    pub malformed: u64,
    /// Packets to the command port from addresses that are not allowed.
    pub not_allowed: u64,
    /// Packets to the command port beyond the permitted rate.
    pub too_many: u64,
    /// Other publishers on the same addresses at the moment.
    pub rivals: u32,
    /// Problem that is not that of one protocol; empty when there is none.
    pub problem: String,
}

/// A published protocol.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct PublishedProtocol {
    /// Packets handed to the system, counted for each receiver and interface.
    pub sent: u64,
    /// Packets that the system refused, or for which there was no interface.
    pub failed: u64,
    /// Packets larger than one Ethernet frame.
    pub large: u64,
    /// Problem and remedy; empty when there is none.
    pub problem: String,
}

/// Reads the publisher's reports.
pub struct PublisherWatch {
    reports: Subscriber<PublisherReport, ()>,
    /// `None` if nothing is to be published.
    newest: Option<Published>,
}

impl PublisherWatch {
    /// Connects.
    pub fn new(bus: &Bus, config: &PublishConfig) -> Result<Self, BusError> {
        let newest = config.is_used().then(Published::default);
        Ok(Self { reports: bus.subscriber(&topics::PUBLISHER)?, newest })
    }

    /// Reads new reports; problems that begin or end become events.
    pub fn collect(&mut self, view: &GroupView) -> Result<(), BusError> {
        while let Some(received) = self.reports.receive()? {
            let Some(report) = received.message().map(describe) else { continue };
            let Some(before) = &mut self.newest else { continue };
            for (name, was, is) in changes(before, &report) {
                let what = match (was.is_empty(), is.is_empty()) {
                    (_, true) => format!("{name} works again"),
                    (_, false) => format!("{name}: {is}"),
                };
                view.log(Event::new(EventKind::Other, Attendant::Publisher.name(), 0, &what, ""));
            }
            *before = report;
        }
        Ok(())
    }

    /// Foreign programs that have published such reports since the last call.
    pub fn take_strangers(&self) -> Vec<Stranger> {
        self.reports.take_strangers()
    }

    /// The publisher, if there is to be one.
    pub fn report(&self, attendants: &BTreeMap<String, AttendantState>) -> Option<Published> {
        let known = attendants.get(Attendant::Publisher.name()).copied().unwrap_or_default();
        let newest = self.newest.clone()?;
        Some(Published { pid: known.pid, restarts: known.restarts, ..newest })
    }
}

/// Problems that differ: whose, before, now.
fn changes(before: &Published, now: &Published) -> Vec<(String, String, String)> {
    let of = |published: &Published, name: &str| {
        published.protocols.get(name).map(|it| it.problem.clone()).unwrap_or_default()
    };
    let names = now.protocols.keys();
    let protocols = names.map(|name| (name.clone(), of(before, name), of(now, name)));
    let own = ("publishing".to_string(), before.problem.clone(), now.problem.clone());
    protocols.chain([own]).filter(|(_, was, is)| was != is).collect()
}

fn describe(report: &PublisherReport) -> Published {
    let protocol = |output: &OutputReport| {
        let &OutputReport { sent, failed, large, .. } = output;
        let problem = read_text(&output.problem);
        (read_text(&output.name), PublishedProtocol { sent, failed, large, problem })
    };
    let &PublisherReport { commands, malformed, not_allowed, too_many, rivals, .. } = report;
    Published {
        pid: None,
        restarts: 0,
        protocols: report.outputs().iter().map(protocol).collect(),
        commands,
        malformed,
        not_allowed,
        too_many,
        rivals,
        problem: read_text(&report.problem),
    }
}

impl Published {
    /// Lines for the console and for `status`.
    pub fn lines(&self) -> Vec<String> {
        let packets = |(name, it): (&String, &PublishedProtocol)| {
            let refused =
                if it.failed > 0 { format!(" ({} refused)", it.failed) } else { String::new() };
            format!("{name} {}{refused}", it.sent)
        };
        let state = if self.pid.is_some() { "" } else { "not running, " };
        let protocols: Vec<String> = self.protocols.iter().map(packets).collect();
        let mut first = format!("{state}packets: {}", protocols.join(", "));
        if protocols.is_empty() {
            first = format!("{state}no protocol is sent");
        }
        let dropped = self.malformed + self.not_allowed + self.too_many;
        if self.commands + dropped > 0 {
            first += &format!("; commands: {}, {dropped} dropped", self.commands);
            for (count, why) in [
                (self.malformed, "malformed"),
                (self.not_allowed, "not allowed"),
                (self.too_many, "too many"),
            ] {
                if count > 0 {
                    first += &format!(", {count} {why}");
                }
            }
        }
        let problems = self.protocols.iter().map(|(name, it)| (name.as_str(), &it.problem));
        let problems = problems.chain([("publishing", &self.problem)]);
        let problems = problems.filter(|(_, problem)| !problem.is_empty());
        [first].into_iter().chain(problems.map(|(name, it)| format!("{name}: {it}"))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use messages::write_text;

    fn report() -> PublisherReport {
        let mut report = PublisherReport {
            commands: 7,
            malformed: 2,
            rivals: 1,
            output_count: 2,
            ..Zeroable::zeroed()
        };
        for (output, name) in report.outputs.iter_mut().zip(["ssl", "tracked"]) {
            output.sent = 80;
            write_text(&mut output.name, name);
        }
        report
    }

    #[test]
    fn problems_are_told_when_they_begin_and_end() {
        let fine = describe(&report());
        let mut bad = report();
        write_text(&mut bad.outputs[1].problem, "there is no route to it");
        bad.outputs[1].failed = 3;
        let bad = describe(&bad);
        assert_eq!(changes(&fine, &fine), []);
        let why = "there is no route to it".to_string();
        assert_eq!(changes(&fine, &bad), [("tracked".into(), String::new(), why.clone())]);
        assert_eq!(changes(&bad, &fine), [("tracked".into(), why, String::new())]);
        let lines = Published { pid: Some(9), ..bad }.lines();
        assert_eq!(
            lines,
            [
                "packets: ssl 80, tracked 80 (3 refused); commands: 7, 2 dropped, 2 malformed",
                "tracked: there is no route to it"
            ]
        );
        assert_eq!(Published::default().lines(), ["not running, no protocol is sent"]);
    }
}
