//! Counting the messages of programs that have no business on a topic.

use crate::roster::NodeKey;

/// Senders that are told apart between two questions; the messages of further ones count for the last.
const MOST_STRANGERS: usize = 16;

/// A program that has published on a topic on which only processes of the group are believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stranger {
    /// The program.
    pub sender: NodeKey,
    /// Its messages, none of which was believed.
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
        if place.is_none() && self.list.len() < MOST_STRANGERS {
            self.list.push(Stranger { sender, messages: 1 });
        } else if let Some(place) = place.or(self.list.len().checked_sub(1)) {
            self.list[place].messages += 1;
        }
    }

    /// The strangers so far; begins anew.
    pub fn take(&mut self) -> Vec<Stranger> {
        std::mem::take(&mut self.list)
    }
}
