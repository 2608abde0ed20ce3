//! Senders of commands and the robots that obey them. Each robot obeys the command sent last. A sender that
//! publishes faster than the group reads is named; the filter gives every sender the same share
//! (`filter/src/intake.rs`).

use super::view::GroupView;
use client::bus::{Bus, BusError, Subscriber, participants};
use client::clock::monotonic_ns;
use client::instance::Instance;
use client::roster::NodeKey;
use config::Config;
use control::Event;
use control::report::Commander;
use messages::topics;
use messages::{Attendant, Commands, EventKind, Team};
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Largest lead of a command's time stamp; the filter rejects later ones too.
const MOST_AHEAD_NS: u64 = 1_000_000_000;
/// Most senders tracked; the one silent for longest is dropped first.
const MOST_SENDERS: usize = 32;
/// Messages of a sender in one round of reading that show that its buffer was full.
const FLOOD: u64 = topics::COMMANDS.buffer as u64 - 4;
/// Time after which a flood is over.
const FLOOD_NS: u64 = 2_000_000_000;
/// Shortest time between two events about a sender.
const PAUSE_NS: u64 = 10_000_000_000;

/// A sender: a process, or a user behind the gateway.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Sender {
    node: NodeKey,
    user: u32,
}

#[derive(Debug, Default)]
struct Known {
    messages: u64,
    heard_ns: u64,
    /// When it last filled its buffer.
    flooded_ns: Option<u64>,
    told_ns: Option<u64>,
    name: String,
    /// Time of its last command to each robot, by team and number.
    robots: BTreeMap<(u32, u32), u64>,
}

/// Reads `commands`.
pub struct CommanderWatch {
    instance: Instance,
    commands: Subscriber<Commands, ()>,
    timeout_ns: u64,
    /// The configured robots, by team and number: commands for other numbers have no effect.
    robots: BTreeSet<(u32, u32)>,
    senders: HashMap<Sender, Known>,
}

impl CommanderWatch {
    /// Connects.
    pub fn new(instance: &Instance, config: &Config, bus: &Bus) -> Result<Self, BusError> {
        let mut it = Self {
            robots: BTreeSet::new(),
            instance: instance.clone(),
            commands: bus.subscriber(&topics::COMMANDS)?,
            timeout_ns: 0,
            senders: HashMap::new(),
        };
        it.use_config(config);
        Ok(it)
    }

    /// Goes over to another configuration; what is known of the senders stays.
    pub fn use_config(&mut self, config: &Config) {
        let identities = config.robots.identities.iter();
        self.robots = identities.map(|it| (it.team as u32, it.id)).collect();
        self.timeout_ns = (config.filter.command_timeout_ms * 1e6) as u64;
    }

    /// Reads new commands, and reports senders that publish too many.
    pub fn collect(&mut self, view: &GroupView) -> Result<(), BusError> {
        let now_ns = monotonic_ns();
        let mut received = Vec::new();
        let rounds = topics::COMMANDS.buffer / topics::COMMANDS.borrowed + 1;
        self.commands.receive_fairly(rounds, |message| {
            received.extend(message.message().map(|commands| (message.sender(), *commands)));
        })?;
        let mut counts: HashMap<NodeKey, u64> = HashMap::new();
        for (node, commands) in received {
            *counts.entry(node).or_default() += 1;
            self.take(node, &commands, now_ns);
        }
        for (sender, known) in &mut self.senders {
            if counts.get(&sender.node).is_none_or(|&count| count < FLOOD) {
                continue;
            }
            known.flooded_ns = Some(now_ns);
            if known.told_ns.is_none_or(|told| now_ns.saturating_sub(told) >= PAUSE_NS) {
                known.told_ns = Some(now_ns);
                let what = format!(
                    "process {} ({}) publishes commands faster than they can be used: the filter takes the \
                     same share from every sender, and drops the rest of this one's",
                    sender.node.pid(),
                    known.name
                );
                let supervisor = Attendant::Supervisor.name();
                view.log(Event::new(EventKind::Other, supervisor, sender.node.pid(), &what, ""));
            }
        }
        Ok(())
    }

    fn take(&mut self, node: NodeKey, commands: &Commands, now_ns: u64) {
        if commands.t_sent_ns > now_ns.saturating_add(MOST_AHEAD_NS) {
            return;
        }
        let sender = Sender { node, user: commands.user };
        if !self.senders.contains_key(&sender) {
            self.make_room();
            let name = participants::name_of(&self.instance, sender.node).unwrap_or_default();
            self.senders.insert(sender, Known { name, ..Known::default() });
        }
        let Some(known) = self.senders.get_mut(&sender) else { return };
        known.messages += 1;
        known.heard_ns = now_ns;
        for wheels in commands.wheels() {
            let robot = (wheels.team, wheels.robot_id);
            if self.robots.contains(&robot) {
                let sent_ns = known.robots.entry(robot).or_default();
                *sent_ns = (*sent_ns).max(commands.t_sent_ns);
            }
        }
    }

    fn make_room(&mut self) {
        if self.senders.len() < MOST_SENDERS {
            return;
        }
        let oldest = self.senders.iter().min_by_key(|(_, known)| known.heard_ns);
        if let Some(oldest) = oldest.map(|(sender, _)| *sender) {
            self.senders.remove(&oldest);
        }
    }

    /// Senders whose commands have not timed out.
    pub fn report(&self) -> Vec<Commander> {
        commanders(&self.senders, monotonic_ns(), self.timeout_ns)
    }
}

fn commanders(senders: &HashMap<Sender, Known>, now_ns: u64, timeout_ns: u64) -> Vec<Commander> {
    let is_valid = |sent_ns: &u64| now_ns.saturating_sub(*sent_ns) <= timeout_ns;
    let mut newest: BTreeMap<(u32, u32), u64> = BTreeMap::new();
    for (robot, sent_ns) in senders.values().flat_map(|known| &known.robots) {
        let newest = newest.entry(*robot).or_default();
        *newest = (*newest).max(*sent_ns);
    }
    let robot_name = |(team, robot_id): (u32, u32)| {
        let team = Team::from_number(team).map_or("unknown", Team::name);
        format!("{team} {robot_id}")
    };
    let mut all: Vec<Commander> = senders
        .iter()
        .filter_map(|(sender, known)| {
            let valid = known.robots.iter().filter(|(_, sent_ns)| is_valid(sent_ns));
            let (obeyed, overruled): (Vec<_>, Vec<_>) =
                valid.partition(|(robot, sent_ns)| newest.get(robot) == Some(sent_ns));
            let names = |robots: Vec<(&(u32, u32), &u64)>| -> Vec<String> {
                robots.into_iter().map(|(robot, _)| robot_name(*robot)).collect()
            };
            let is_gateway = known.name == Attendant::Gateway.name();
            let commander = Commander {
                pid: sender.node.pid(),
                name: known.name.clone(),
                user: is_gateway.then_some(sender.user),
                robots: names(obeyed),
                overruled: names(overruled),
                messages: known.messages,
                floods: known.flooded_ns.is_some_and(|at| now_ns.saturating_sub(at) < FLOOD_NS),
            };
            let commands_any = !(commander.robots.is_empty() && commander.overruled.is_empty());
            commands_any.then_some(commander)
        })
        .collect();
    all.sort_by_key(|it| (it.pid, it.user));
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;
    const NOW_NS: u64 = 10_000 * MS;

    fn known(name: &str, robots: &[((u32, u32), u64)]) -> Known {
        let robots = robots.iter().map(|&(robot, ms_ago)| (robot, NOW_NS - ms_ago * MS)).collect();
        Known { name: name.into(), messages: 7, robots, ..Known::default() }
    }

    fn sender(pid: u32, user: u32) -> Sender {
        Sender { node: NodeKey::new(pid, 0), user }
    }

    #[test]
    fn the_command_sent_last_acts_from_any_sender() {
        let (yellow, blue) = (Team::Yellow as u32, Team::Blue as u32);
        let senders: HashMap<Sender, Known> = [
            (
                sender(1, 0),
                known("drive", &[((yellow, 0), 20), ((yellow, 1), 40), ((blue, 3), 900)]),
            ),
            (sender(2, 1001), known("gateway", &[((yellow, 1), 10), ((blue, 2), 5)])),
            (sender(2, 1002), known("gateway", &[((blue, 2), 100)])),
            (sender(3, 0), known("silent", &[((blue, 4), 500)])),
        ]
        .into();
        let all = commanders(&senders, NOW_NS, 250 * MS);
        let words: Vec<_> =
            all.iter().map(|it| (it.user, it.robots.join(", "), it.overruled.join(", "))).collect();
        let text = |text: &str| text.to_string();
        assert_eq!(
            words,
            [
                (None, text("yellow 0"), text("yellow 1")),
                (Some(1001), text("yellow 1, blue 2"), text("")),
                (Some(1002), text(""), text("blue 2")),
            ]
        );
    }
}
