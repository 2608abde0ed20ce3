//! Strangers: foreign programs that publish on protected topics, where only messages of the group's own
//! processes are accepted. They are counted, named, and admitted if the configuration permits them.

use super::view::GroupView;
use client::bus::{Bus, BusError, Stranger, Subscriber, participants};
use client::clock::monotonic_ns;
use client::instance::Instance;
use client::roster::NodeKey;
use control::Event;
use control::report::Stranger as Reported;
use messages::topics::{self, TopicName};
use messages::{Attendant, EventKind, GroupEvent, Run, RunsHeader, StatusHeader};

/// Shortest time between two events about a program.
const PAUSE_NS: u64 = 10_000_000_000;
/// Most programs kept for the report, each with a topic; the oldest is dropped first.
const MOST_KEPT: usize = 32;

/// Detects strangers.
pub struct StrangerWatch {
    instance: Instance,
    /// Names of programs that may publish on any topic.
    permitted: Vec<String>,
    // Read only to detect strangers.
    runs: Subscriber<Run, RunsHeader>,
    events: Subscriber<GroupEvent, ()>,
    status: Subscriber<u8, StatusHeader>,
    known: Vec<Known>,
}

/// A stranger on a topic.
struct Known {
    sender: NodeKey,
    told_messages: u64,
    told_ns: Option<u64>,
    report: Reported,
}

impl StrangerWatch {
    /// Connects.
    pub fn new(instance: &Instance, permitted: &[String], bus: &Bus) -> Result<Self, BusError> {
        Ok(Self {
            instance: instance.clone(),
            permitted: permitted.to_vec(),
            runs: bus.subscriber(&topics::RUNS)?,
            events: bus.subscriber(&topics::EVENTS)?,
            status: bus.subscriber(&topics::STATUS)?,
            known: Vec::new(),
        })
    }

    /// Records the strangers on `runs`, `events` and `status`, and those that other readers have met on
    /// a topic since the last call.
    pub fn collect(
        &mut self,
        bus: &Bus,
        view: &GroupView,
        met: impl IntoIterator<Item = (TopicName, Vec<Stranger>)>,
    ) -> Result<(), BusError> {
        while self.runs.receive()?.is_some() {}
        while self.events.receive()?.is_some() {}
        while self.status.receive()?.is_some() {}
        let own = [
            (topics::RUNS.name, self.runs.take_strangers()),
            (topics::EVENTS.name, self.events.take_strangers()),
            (topics::STATUS.name, self.status.take_strangers()),
        ];
        for (topic, strangers) in met.into_iter().chain(own) {
            for stranger in strangers {
                self.note(topic, stranger);
            }
        }
        self.tell(bus, view);
        Ok(())
    }

    fn note(&mut self, topic: TopicName, stranger: Stranger) {
        let topic = topic.to_string();
        let is_it =
            |known: &&mut Known| known.sender == stranger.sender && known.report.topic == topic;
        if let Some(known) = self.known.iter_mut().find(is_it) {
            known.report.messages += stranger.messages;
            return;
        }
        if self.known.len() == MOST_KEPT {
            self.known.remove(0);
        }
        let pid = stranger.sender.pid();
        let report = Reported {
            pid,
            // Looked up when there is something to report.
            name: String::new(),
            program: program_name(pid),
            topic,
            messages: stranger.messages,
        };
        let sender = stranger.sender;
        self.known.push(Known { sender, told_messages: 0, told_ns: None, report });
    }

    /// Logs news: the first message of a program at once, a flood at a limited rate.
    fn tell(&mut self, bus: &Bus, view: &GroupView) {
        let now_ns = monotonic_ns();
        for known in &mut self.known {
            let is_due = known.told_ns.is_none_or(|told| now_ns.saturating_sub(told) >= PAUSE_NS);
            if !is_due || known.told_messages == known.report.messages {
                continue;
            }
            if known.report.name.is_empty() {
                let name = participants::name_of(&self.instance, known.sender);
                known.report.name = name.unwrap_or_default();
            }
            let is_permitted = self.permitted.contains(&known.report.name);
            if is_permitted {
                bus.admit(known.sender);
            }
            let what = words(&known.report, known.told_ns.is_some(), is_permitted);
            let supervisor = Attendant::Supervisor.name();
            view.log(Event::new(EventKind::Stranger, supervisor, known.report.pid, &what, ""));
            (known.told_messages, known.told_ns) = (known.report.messages, Some(now_ns));
        }
    }

    /// All known strangers, in order of first appearance.
    pub fn report(&self) -> Vec<Reported> {
        self.known.iter().map(|known| known.report.clone()).collect()
    }
}

fn words(stranger: &Reported, goes_on: bool, is_permitted: bool) -> String {
    let Reported { pid, topic, messages, .. } = stranger;
    let name = stranger.full_name();
    if is_permitted {
        return format!(
            "process {pid} {name} is believed from now on, on all topics: access.publishers names it"
        );
    }
    let first = if goes_on { "still " } else { "" };
    format!(
        "process {pid} {name} {first}publishes on the topic {topic}, but is not of the group: {messages} messages \
         not believed"
    )
}

/// Name of a process's executable; empty when the process is gone.
fn program_name(pid: u32) -> String {
    let comm = std::fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
    comm.trim_end().into()
}
