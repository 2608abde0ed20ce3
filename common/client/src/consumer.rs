//! Reading a group's messages from another program: a logger, a strategy, a display.
//!
//! A [`Consumer`] reads one topic. It waits for its group to start, continues when the group is started
//! again, delivers every message once and in order, and reports how many were lost. The whole program
//! is a loop over [`Consumer::next`]; see `examples/`.

use crate::bus::{Bus, BusError, Received, Subscriber, participants};
use crate::instance::{Instance, InstanceError};
use crate::memory;
use crate::wake_up::WakeUp;
use messages::ProcessKind;
use messages::topics::Topic;
use messages::{Header, Message};
use std::time::{Duration, Instant};

/// Silence after which the consumer checks whether the group still exists.
const SILENCE: Duration = Duration::from_secs(1);
/// Interval between checks for a group that does not exist yet.
const LOOK: Duration = Duration::from_millis(100);

/// One event in the life of a consumer of messages `M`.
#[derive(Debug)]
pub enum Event<M> {
    /// The group exists, and messages will come.
    Joined,
    /// A message.
    Message(M),
    /// This many numbers were skipped before the next message: frames never captured, or messages
    /// overwritten because this consumer did not read them in time.
    Missed(u64),
    /// Numbers start again with the next message: another group has started.
    Restarted,
    /// The group has ended. The consumer waits for the next one.
    Left,
}

/// Reads a topic of a group whenever that group exists.
pub struct Consumer<E: Message, H: Header> {
    instance: Instance,
    name: String,
    topic: &'static Topic<E, H>,
    connection: Option<Connection<E, H>>,
    order: Order,
    /// A message to deliver after the event that precedes it.
    pending: Option<Received<E, H>>,
    heard: Instant,
}

struct Connection<E: Message, H: Header> {
    // Dropped in this order: the node must outlive its ports.
    subscriber: Subscriber<E, H>,
    wake_up: WakeUp,
    bus: Bus,
}

impl<E: Message, H: Header> Consumer<E, H> {
    /// Creates a consumer of a topic; `name` is shown by tools. It touches nothing until the group
    /// exists.
    pub fn new(instance: Instance, name: &str, topic: &'static Topic<E, H>) -> Self {
        Self {
            instance,
            name: name.into(),
            topic,
            connection: None,
            order: Order::default(),
            pending: None,
            heard: Instant::now(),
        }
    }

    /// Waits for the next event, but no longer than `timeout`; then returns `None`. An error means that
    /// the group exists and cannot be attached to.
    pub fn next(&mut self, timeout: Duration) -> Result<Option<Event<Received<E, H>>>, BusError> {
        let deadline = Instant::now() + timeout;
        loop {
            let Some(connection) = &mut self.connection else {
                if is_there(&self.instance) {
                    self.connection = Some(self.connect()?);
                    self.heard = Instant::now();
                    return Ok(Some(Event::Joined));
                }
                // These errors do not go away by waiting.
                memory::check_place().map_err(InstanceError::from)?;
                if let Ok(Some(namespace)) = self.instance.namespace() {
                    namespace.check_version()?;
                }
                let left = deadline.saturating_duration_since(Instant::now());
                if left.is_zero() {
                    return Ok(None);
                }
                std::thread::sleep(left.min(LOOK));
                continue;
            };
            let received = match self.pending.take() {
                Some(pending) => return Ok(Some(Event::Message(pending))),
                None => connection.subscriber.receive()?,
            };
            if let Some(received) = received {
                self.heard = Instant::now();
                let seq = (self.topic.seq)(received.elements(), received.header());
                let t_ns = (self.topic.t_capture_ns)(received.elements(), received.header());
                match self.order.announce(seq, t_ns, received, &mut self.pending) {
                    Some(event) => return Ok(Some(event)),
                    None => continue,
                }
            }
            if self.heard.elapsed() > SILENCE {
                self.heard = Instant::now();
                // Another group may have started meanwhile, under other names in shared memory.
                let is_elsewhere = self
                    .instance
                    .namespace()
                    .is_ok_and(|namespace| namespace.as_ref() != Some(connection.bus.namespace()));
                if is_elsewhere || !is_there(&self.instance) {
                    self.connection = None;
                    return Ok(Some(Event::Left));
                }
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            connection.wake_up.wait(left.min(SILENCE));
        }
    }

    fn connect(&self) -> Result<Connection<E, H>, BusError> {
        let bus = Bus::join(&self.instance, &self.name)?;
        let subscriber = bus.subscriber(self.topic)?;
        let wake_up = bus.wake_up(self.topic)?;
        Ok(Connection { subscriber, wake_up, bus })
    }
}

/// Whether the group exists: a supervisor, or stages that outlive their supervisor.
pub fn is_there(instance: &Instance) -> bool {
    if instance.is_supervised() {
        return true;
    }
    participants::living(instance).is_ok_and(|living| {
        living.iter().any(|process| ProcessKind::ALL.iter().any(|k| k.name() == process.name))
    })
}

/// Position of a message relative to the messages before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Position {
    /// It follows the last one, is the first, or the topic is not numbered.
    Next,
    /// Numbers before it were skipped.
    After {
        /// Number of skipped messages.
        missed: u64,
    },
    /// It or a later one was delivered already.
    Repeated,
    /// Numbers have started again, which happens only when another group starts.
    Restarted,
}

/// Follows the message numbers of a topic.
#[derive(Debug, Clone, Copy, Default)]
pub struct Order {
    last: Option<(u64, u64)>,
}

impl Order {
    /// Finds the position of a message from its number and the capture time of its frame (0 on topics
    /// without numbers), and remembers it as the last one unless it is a repetition.
    pub fn position(&mut self, seq: u64, t_capture_ns: u64) -> Position {
        if t_capture_ns == 0 {
            return Position::Next;
        }
        let position = match self.last {
            None => Position::Next,
            Some((last, _)) if seq > last => match seq - last - 1 {
                0 => Position::Next,
                missed => Position::After { missed },
            },
            Some((_, last_ns)) if t_capture_ns > last_ns => Position::Restarted,
            Some(_) => return Position::Repeated,
        };
        self.last = Some((seq, t_capture_ns));
        position
    }

    /// The event for a message; `None` for a repetition. If another event comes first, the message is
    /// left in `pending`.
    pub(crate) fn announce<M>(
        &mut self,
        seq: u64,
        t_capture_ns: u64,
        message: M,
        pending: &mut Option<M>,
    ) -> Option<Event<M>> {
        let event = match self.position(seq, t_capture_ns) {
            Position::Repeated => return None,
            Position::Next => return Some(Event::Message(message)),
            Position::After { missed } => Event::Missed(missed),
            Position::Restarted => Event::Restarted,
        };
        *pending = Some(message);
        Some(event)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_repetitions_and_new_groups_are_told_apart() {
        let mut order = Order::default();
        assert_eq!(order.position(100, 1000), Position::Next, "the first may have any number");
        assert_eq!(order.position(101, 1010), Position::Next);
        assert_eq!(order.position(101, 1010), Position::Repeated);
        assert_eq!(order.position(104, 1040), Position::After { missed: 2 });
        assert_eq!(order.position(102, 1020), Position::Repeated, "too late");
        assert_eq!(order.position(0, 9000), Position::Restarted);
        assert_eq!(order.position(1, 9010), Position::Next);
        assert_eq!(order.position(0, 0), Position::Next, "no numbers");
    }
}
