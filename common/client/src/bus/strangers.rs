//! Counts the messages of programs that may not publish on a topic.

use crate::roster::NodeKey;

/// Senders counted separately between two calls of `take`; messages of further senders count for the
/// last one.
const MAX_STRANGERS: usize = 16;

/// A program outside the group that published on a topic reserved for processes of the group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stranger {
    /// The program.
    pub sender: NodeKey,
    /// Number of its messages, all of which were rejected.
    pub messages: u64,
}

/// The strangers on a topic.
#[derive(Debug, Default)]
pub(super) struct Strangers {
    list: Vec<Stranger>,
}

impl Strangers {
    /// Counts a message.
    pub fn count(&mut self, sender: NodeKey) {
        let place = self.list.iter().position(|stranger| stranger.sender == sender);
        if place.is_none() && self.list.len() < MAX_STRANGERS {
            self.list.push(Stranger { sender, messages: 1 });
        } else if let Some(place) = place.or(self.list.len().checked_sub(1)) {
            self.list[place].messages += 1;
        }
    }

    /// Returns the strangers so far and starts counting again.
    pub fn take(&mut self) -> Vec<Stranger> {
        std::mem::take(&mut self.list)
    }
}
