//! Reading messages in place and in order.

use super::standby::{Kept, Port};
use super::strangers::{Stranger, Strangers};
use super::{BusError, Received, failed};
use crate::clock::monotonic_ns;
use crate::eventcount::EventCount;
use crate::roster::{NodeKey, Roster};
use iceoryx2::port::ReceiveError;
use iceoryx2::port::subscriber::Subscriber as IpcSubscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample as IpcSample;
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use messages::topics::{Topic, TopicName};
use messages::{Header, Message};
use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Reads messages in place and in order: from the group's own processes, and on open topics from every
/// program.
///
/// iceoryx2 keeps one queue per writer and empties them in no particular order. After a hand-over, a
/// reader that has fallen behind finds messages of the dead process and of its successor, and must get
/// them in the order of their numbers. So all received messages are first moved into an ordered queue
/// of our own.
pub struct Subscriber<E: Message, H: Header>(Rc<Inbox<E, H>>);

/// The parts of a subscriber.
pub(super) struct Parts<E: Message, H: Header> {
    pub port: IpcSubscriber<ipc::Service, [E], H>,
    pub service: PortFactory<ipc::Service, [E], H>,
    /// Advances with every message on the topic.
    pub published: EventCount,
    /// Most messages in the queue, besides those the caller holds.
    pub capacity: usize,
    /// Becomes true when it could not connect to a writer.
    pub misses_a_writer: Arc<AtomicBool>,
    /// Trusted senders; `None` on a topic that is open to every program.
    pub roster: Option<Rc<Roster>>,
}

struct Inbox<E: Message, H: Header> {
    topic: TopicName,
    seq: fn(&[E], &H) -> u64,
    /// Unread messages kept for it by iceoryx2.
    buffer: u32,
    parts: Parts<E, H>,
    queue: RefCell<VecDeque<Queued<E, H>>>,
    /// The node last found on the roster. The next message nearly always comes from the same node.
    believed: Cell<u128>,
    strangers: RefCell<Strangers>,
    /// Writers at the last [`refresh`](Port::refresh) of a process that stands by.
    writers: RefCell<Vec<u128>>,
    /// Whether connections to writers that have ended may be empty by now.
    is_to_clear: Cell<bool>,
}

struct Queued<E: Message, H: Header> {
    message: Received<E, H>,
    /// Set if the process stood by when it was moved into the queue.
    kept: Option<Kept>,
    /// Its writer had ended then.
    is_of_dead: bool,
}

impl<E: Message, H: Header> Subscriber<E, H> {
    pub(super) fn new(topic: &Topic<E, H>, parts: Parts<E, H>) -> Self {
        Self(Rc::new(Inbox {
            topic: topic.name,
            seq: topic.seq,
            buffer: topic.buffer as u32,
            queue: RefCell::new(VecDeque::with_capacity(parts.capacity)),
            parts,
            believed: Cell::new(0),
            strangers: RefCell::default(),
            writers: RefCell::default(),
            is_to_clear: Cell::new(false),
        }))
    }

    /// The port, for [`Bus::refresh`](super::Bus::refresh).
    pub(super) fn as_port(&self) -> Rc<dyn Port> {
        Rc::clone(&self.0) as Rc<dyn Port>
    }

    /// Whether there is, or was, a writer whose messages are not received, because descriptors or
    /// memory did not suffice to connect to it. iceoryx2 does not retry; only a new subscriber helps.
    pub fn misses_a_writer(&self) -> bool {
        self.0.parts.misses_a_writer.load(Ordering::Relaxed)
    }

    /// The oldest unread message, if there is one.
    pub fn receive(&self) -> Result<Option<Received<E, H>>, BusError> {
        let inbox = &self.0;
        let mut queue = inbox.queue.borrow_mut();
        while queue.len() < inbox.parts.capacity {
            let Some(message) = inbox.next()? else { break };
            if inbox.believes(&message.sample) {
                inbox.insert(&mut queue, Queued { message, kept: None, is_of_dead: false });
            }
        }
        Ok(queue.pop_front().map(|queued| queued.message))
    }

    /// Reads a topic on which messages have no order, the same number of messages from every writer:
    /// in each of at most so many rounds, as many as a reader may hold of one writer at a time.
    ///
    /// iceoryx2 empties one writer's queue before it looks at the next, so a program that publishes
    /// without pause would keep all others waiting. But it skips a writer of which the reader holds the
    /// most messages allowed, so they are held until the end of the round.
    pub fn receive_fairly(
        &self,
        rounds: usize,
        mut take: impl FnMut(&Received<E, H>),
    ) -> Result<(), BusError> {
        let inbox = &self.0;
        let queued: Vec<_> = inbox.queue.borrow_mut().drain(..).collect();
        queued.iter().for_each(|queued| take(&queued.message));
        drop(queued);
        for _ in 0..rounds {
            let mut held = Vec::new();
            loop {
                match inbox.parts.port.receive() {
                    Ok(Some(sample)) => held.push(Received { sample }),
                    Ok(None) | Err(ReceiveError::ExceedsMaxBorrows) => break,
                    Err(error) => return Err(failed(inbox.topic, "receive")(error)),
                }
            }
            held.iter().filter(|it| inbox.believes(&it.sample)).for_each(&mut take);
            if held.is_empty() {
                break;
            }
        }
        Ok(())
    }

    /// Senders of the messages rejected since the last call.
    pub fn take_strangers(&self) -> Vec<Stranger> {
        self.0.strangers.borrow_mut().take()
    }

    /// The newest message; all others are skipped.
    pub fn newest(&self) -> Result<Option<Received<E, H>>, BusError> {
        self.newest_that(|_| true)
    }

    /// The newest message that passes the check; all others are skipped.
    pub fn newest_that(
        &self,
        is_believed: impl Fn(&Received<E, H>) -> bool,
    ) -> Result<Option<Received<E, H>>, BusError> {
        let mut newest = None;
        while let Some(received) = self.receive()? {
            if is_believed(&received) {
                newest = Some(received);
            }
        }
        Ok(newest)
    }
}

impl<E: Message, H: Header> Inbox<E, H> {
    fn next(&self) -> Result<Option<Received<E, H>>, BusError> {
        let sample = self.parts.port.receive().map_err(failed(self.topic, "receive"))?;
        Ok(sample.map(|sample| Received { sample }))
    }

    /// Whether a message comes from a process of the group, or the topic is open to every program.
    /// Other messages are counted.
    fn believes(&self, sample: &IpcSample<ipc::Service, [E], H>) -> bool {
        let Some(roster) = &self.parts.roster else { return true };
        let node = sample.header().node_id();
        if node.value() == self.believed.get() {
            return true;
        }
        let key = NodeKey::of(&node);
        let is_of_group = roster.has(key);
        match is_of_group {
            true => self.believed.set(node.value()),
            false => self.strangers.borrow_mut().count(key),
        }
        is_of_group
    }

    fn insert(&self, queue: &mut VecDeque<Queued<E, H>>, new: Queued<E, H>) {
        let seq = self.seq_of(&new.message);
        // Nearly always the message belongs at the end.
        let is_later = |queued: &&Queued<E, H>| self.seq_of(&queued.message) > seq;
        let place = queue.len() - queue.iter().rev().take_while(is_later).count();
        queue.insert(place, new);
    }

    fn seq_of(&self, received: &Received<E, H>) -> u64 {
        (self.seq)(received.elements(), received.header())
    }

    fn writers_now(&self) -> Vec<u128> {
        let mut writers = Vec::new();
        self.parts.service.dynamic_config().list_publishers(|details| {
            writers.push(details.publisher_id.value());
            CallbackProgression::Continue
        });
        writers
    }

    /// Moves what writers that have ended left unread into the queue. iceoryx2 delivers their messages
    /// first, so this ends with the first message of a living writer, which is moved too.
    fn take_over_from_dead(&self, living: &[u128]) -> Result<(), BusError> {
        let kept = Kept::now(monotonic_ns(), self.parts.published.read());
        let mut queue = self.queue.borrow_mut();
        while let Some(message) = self.next()? {
            let is_last = living.contains(&message.sample.origin().value());
            if self.believes(&message.sample) {
                let queued = Queued { message, kept: Some(kept), is_of_dead: !is_last };
                self.insert(&mut queue, queued);
            }
            if queue.len() > self.parts.capacity {
                queue.pop_front();
            }
            if is_last {
                break;
            }
        }
        Ok(())
    }
}

impl<E: Message, H: Header> Port for Inbox<E, H> {
    fn refresh(&self, stands_by: bool) -> Result<(), BusError> {
        self.parts
            .port
            .update_connections()
            .map_err(failed(self.topic, "connect to the writers"))?;
        if !stands_by {
            return Ok(());
        }
        let living = self.writers_now();
        let before = self.writers.replace(living.clone());
        let has_one_ended = before.iter().any(|writer| !living.contains(writer));
        if has_one_ended || self.is_to_clear.take() {
            self.take_over_from_dead(&living)?;
        }
        let (now_ns, published) = (monotonic_ns(), self.parts.published.read());
        let mut queue = self.queue.borrow_mut();
        let is_overtaken = |kept: Kept| kept.is_overtaken(now_ns, published, self.buffer);
        queue.retain(|queued| {
            let is_overtaken = queued.kept.is_some_and(is_overtaken);
            // iceoryx2 drops the connection to a dead writer when it looks for a message.
            self.is_to_clear.set(self.is_to_clear.get() || is_overtaken && queued.is_of_dead);
            !is_overtaken
        });
        Ok(())
    }
}
