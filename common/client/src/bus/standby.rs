//! Ports that are not used for a long time.
//!
//! iceoryx2 connects a port to new processes, and drops connections to processes that have ended, when
//! the port sends or receives. Meanwhile the memory and the descriptors of every process that has come
//! and gone stay: those of readers with a writer that has nothing to say, those of writers with a process
//! that only stands by. So every process of the group refreshes its ports with each heartbeat.
//!
//! A connection with unread messages is kept until they are read, also when its writer has ended. A
//! process that stands by does not read, because its successor's work begins with those messages. It
//! moves them into its own queue instead, and forgets them there when newer messages have overtaken
//! them.

use super::BusError;

/// Time for which messages of a writer that has ended are kept at least, and which no successor is
/// behind.
const KEPT_NS: u64 = 1_000_000_000;

/// A port of this process.
pub(super) trait Port {
    /// Connects to new processes and drops connections to processes that have ended.
    fn refresh(&self, stands_by: bool) -> Result<(), BusError>;
}

/// When a message was moved into the queue of a process that stands by.
#[derive(Debug, Clone, Copy)]
pub(super) struct Kept {
    at_ns: u64,
    /// Number of messages on the topic until then.
    published: u32,
}

impl Kept {
    pub fn now(now_ns: u64, published: u32) -> Self {
        Self { at_ns: now_ns, published }
    }

    /// Whether a buffer of this many messages has been filled with newer ones since.
    pub fn is_overtaken(self, now_ns: u64, published: u32, buffer: u32) -> bool {
        let newer = published.wrapping_sub(self.published);
        now_ns.saturating_sub(self.at_ns) >= KEPT_NS && newer >= buffer
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_overtaken_by_a_whole_buffer_and_not_at_once() {
        let kept = Kept::now(5, u32::MAX);
        assert!(!kept.is_overtaken(5 + KEPT_NS, 62, 64), "63 newer messages");
        assert!(kept.is_overtaken(5 + KEPT_NS, 63, 64));
        assert!(!kept.is_overtaken(4 + KEPT_NS, 5000, 64));
    }
}
