//! State of the publisher: for the report, and as events when a problem begins or ends.

use super::view::GroupView;
use client::bus::{Bus, BusError, Stranger, Subscriber};
use config::PublishConfig;
use control::Event;
use control::report::{AttendantState, Published, PublishedProtocol};
use messages::topics;
use messages::{Attendant, EventKind, OutputReport, PublisherReport, read_text};
use std::collections::BTreeMap;

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
