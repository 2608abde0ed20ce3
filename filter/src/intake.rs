//! Fair choice among the senders of commands.
//!
//! A frame's `world` has room for [`MAX_USED_COMMANDS`](messages::MAX_USED_COMMANDS) messages, and every program of the group's user
//! can publish `commands` at any rate. If messages were taken in the order in which they arrive, a program
//! that sends without pause would keep all others out. So messages wait in a queue per sender, and the
//! filter takes one of each sender in turn:
//!
//! ```text
//! for each message: append it to its sender's queue; drop the queue's oldest beyond 64
//! while the filter takes messages and any queue has one:
//!     take the oldest message of the next sender, in cyclic order
//! ```
//!
//! This is max-min fairness: a sender that sends less than its share loses nothing and does not wait, and
//! a flood is its sender's own loss.

use crate::Filter;
use client::bus::{BusError, Subscriber};
use client::roster::NodeKey;
use messages::Commands;
use messages::topics;
use std::collections::{BTreeMap, VecDeque};
use std::ops::Bound;

/// Messages that wait for each sender: those of two frames.
const MAX_WAITING: usize = topics::COMMANDS.buffer;
/// Senders with waiting messages: more than can publish at the same time.
const MAX_SENDERS: usize = 32;

/// The waiting commands of all senders.
#[derive(Debug, Default)]
pub struct Intake {
    waiting: BTreeMap<NodeKey, VecDeque<Commands>>,
    /// The sender served last.
    last: Option<NodeKey>,
}

impl Intake {
    /// Reads what all senders have published.
    pub fn collect(&mut self, commands: &Subscriber<Commands, ()>) -> Result<(), BusError> {
        // Enough rounds to empty every sender's buffer.
        let rounds = topics::COMMANDS.buffer / topics::COMMANDS.borrowed + 1;
        commands.receive_fairly(rounds, |received| {
            if let Some(message) = received.message() {
                self.put(received.sender(), message);
            }
        })
    }

    fn put(&mut self, sender: NodeKey, commands: &Commands) {
        if self.waiting.len() >= MAX_SENDERS && !self.waiting.contains_key(&sender) {
            return;
        }
        let waiting = self.waiting.entry(sender).or_default();
        if waiting.len() == MAX_WAITING {
            waiting.pop_front();
        }
        waiting.push_back(*commands);
    }

    /// Gives the filter as many messages as it takes before its next frame.
    pub fn deliver(&mut self, filter: &mut Filter) {
        while filter.takes_commands()
            && let Some(commands) = self.next()
        {
            filter.command(&commands);
        }
    }

    fn next(&mut self) -> Option<Commands> {
        let after = self.last.map_or(Bound::Unbounded, Bound::Excluded);
        let following = self.waiting.range((after, Bound::Unbounded)).next();
        let sender = *following.or_else(|| self.waiting.iter().next())?.0;
        self.last = Some(sender);
        let waiting = self.waiting.get_mut(&sender)?;
        let commands = waiting.pop_front();
        if waiting.is_empty() {
            self.waiting.remove(&sender);
        }
        commands
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sender(pid: u32) -> NodeKey {
        NodeKey::new(pid, 0)
    }

    fn command(seq: u64) -> Commands {
        Commands { seq, ..bytemuck::Zeroable::zeroed() }
    }

    #[test]
    fn a_flood_is_its_sender_s_own_loss() {
        let mut intake = Intake::default();
        for seq in 0..1000 {
            intake.put(sender(1), &command(seq));
        }
        for seq in 2000..2011 {
            intake.put(sender(2), &command(seq));
        }
        intake.put(sender(3), &command(3000));
        let taken: Vec<u64> = (0..32).map_while(|_| intake.next()).map(|it| it.seq).collect();
        assert_eq!(taken.iter().filter(|&&seq| seq >= 2000).count(), 12, "{taken:?}");
        let flood: Vec<u64> = taken.into_iter().filter(|&seq| seq < 1000).collect();
        let oldest = 1000 - MAX_WAITING as u64;
        assert_eq!(flood, (oldest..oldest + 20).collect::<Vec<_>>());
    }

    #[test]
    fn every_sender_has_its_turn() {
        let mut intake = Intake::default();
        for seq in 0..9 {
            intake.put(sender(1 + (seq % 3) as u32), &command(seq));
        }
        // A round may end anywhere; the next one goes on from there.
        assert_eq!(intake.next().map(|it| it.seq), Some(0));
        intake.put(sender(1), &command(9));
        let rest: Vec<u64> = std::iter::from_fn(|| intake.next()).map(|it| it.seq).collect();
        assert_eq!(rest, [1, 2, 3, 4, 5, 6, 7, 8, 9]);
        assert!(intake.waiting.is_empty());
    }
}
