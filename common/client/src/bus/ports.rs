//! Writing messages into shared memory, and reading them in place.

use super::strangers::{Stranger, Strangers};
use super::{BusError, failed};
use crate::eventcount::EventCount;
use crate::roster::{NodeKey, Roster};
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher as IpcPublisher;
use iceoryx2::port::subscriber::Subscriber as IpcSubscriber;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample as IpcSample;
use iceoryx2::sample_mut_uninit::SampleMutUninit;
use messages::topics::{Topic, TopicName};
use messages::{Header, Message};
use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::mem::MaybeUninit;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Writes messages into shared memory and wakes the processes that sleep on the topic.
pub struct Publisher<E: Message, H: Header> {
    port: IpcPublisher<ipc::Service, [E], H>,
    bell: Rc<Bell>,
    topic: TopicName,
}

/// Wakes the processes that sleep on a topic.
struct Bell {
    published: EventCount,
    notifier: Option<Notifier<ipc::Service>>,
}

impl Bell {
    fn ring(&self) {
        self.published.advance();
        if let Some(notifier) = &self.notifier {
            // A listener that is dead, or whose socket is full because it does not read, must not
            // concern the writer.
            let _ = notifier.notify();
        }
    }
}

impl<E: Message, H: Header> Publisher<E, H> {
    /// Creates a publisher that advances the topic's event count and, if there is one, its iceoryx2
    /// event.
    pub(super) fn new(
        port: IpcPublisher<ipc::Service, [E], H>,
        published: EventCount,
        notifier: Option<Notifier<ipc::Service>>,
        topic: TopicName,
    ) -> Self {
        Self { port, bell: Rc::new(Bell { published, notifier }), topic }
    }

    /// Whether this publisher has sent the message.
    pub fn has_sent(&self, received: &Received<E, H>) -> bool {
        received.sample.origin() == self.port.id()
    }

    /// Borrows a message of `length` elements from shared memory, to be filled in place. Dropping it
    /// returns it unpublished.
    pub fn loan(&mut self, length: usize) -> Result<Loan<E, H>, BusError> {
        let sample =
            self.port.loan_slice_uninit(length).map_err(failed(self.topic, "loan a message"))?;
        Ok(Loan { sample, bell: Rc::clone(&self.bell), topic: self.topic })
    }
}

impl<E: Message> Publisher<E, ()> {
    /// Publishes a copy of one element.
    pub fn publish(&mut self, message: &E) -> Result<(), BusError> {
        let mut loan = self.loan(1)?;
        loan.elements()[0] = *message;
        loan.send()
    }
}

/// A message in shared memory that is not published yet.
pub struct Loan<E: Message, H: Header> {
    sample: SampleMutUninit<ipc::Service, [MaybeUninit<E>], H>,
    bell: Rc<Bell>,
    topic: TopicName,
}

impl<E: Message, H: Header> Loan<E, H> {
    /// The elements, with stale content: zeros or an old message.
    #[allow(unsafe_code)]
    pub fn elements(&mut self) -> &mut [E] {
        let elements = self.sample.payload_mut();
        // SAFETY: the memory is initialised, since the system hands out shared memory filled with
        // zeros and only messages are ever written to it; and any bytes are a valid `E`, since
        // every `Message` is `Pod`. The pointer and length come from the slice itself.
        unsafe { std::slice::from_raw_parts_mut(elements.as_mut_ptr().cast::<E>(), elements.len()) }
    }

    /// The elements and the header, to be filled together.
    #[allow(unsafe_code)]
    pub fn parts(&mut self) -> (&mut [E], &mut H) {
        let header: *mut H = self.sample.user_header_mut();
        let elements = self.elements();
        // SAFETY: header and payload are disjoint parts of the sample, and both borrows end with
        // the borrow of `self`.
        (elements, unsafe { &mut *header })
    }

    /// Publishes the message and wakes the processes that sleep on the topic.
    #[allow(unsafe_code)]
    pub fn send(self) -> Result<(), BusError> {
        // SAFETY: initialised, see `elements`.
        let sample = unsafe { self.sample.assume_init() };
        sample.send().map_err(failed(self.topic, "publish"))?;
        self.bell.ring();
        Ok(())
    }
}

/// Reads messages in place and in order: from the group's own processes, and on open topics from every
/// program.
///
/// iceoryx2 keeps one queue per writer and empties them in no particular order. After a hand-over, a
/// reader that has fallen behind finds messages of the dead process and of its successor, and must get
/// them in the order of their numbers. So all received messages are first moved into an ordered queue
/// of our own.
pub struct Subscriber<E: Message, H: Header> {
    port: IpcSubscriber<ipc::Service, [E], H>,
    topic: TopicName,
    seq: fn(&[E], &H) -> u64,
    /// Most messages in the queue.
    capacity: usize,
    queue: RefCell<VecDeque<Received<E, H>>>,
    misses_a_writer: Arc<AtomicBool>,
    /// Trusted senders; `None` on a topic that is open to every program.
    roster: Option<Rc<Roster>>,
    /// The node last found on the roster. The next message nearly always comes from the same node.
    believed: Cell<u128>,
    strangers: RefCell<Strangers>,
}

impl<E: Message, H: Header> Subscriber<E, H> {
    /// Creates a subscriber that holds up to `capacity` messages besides those its caller holds.
    /// `misses_a_writer` becomes true when it could not connect to a writer.
    pub(super) fn new(
        port: IpcSubscriber<ipc::Service, [E], H>,
        topic: &Topic<E, H>,
        capacity: usize,
        misses_a_writer: Arc<AtomicBool>,
        roster: Option<Rc<Roster>>,
    ) -> Self {
        Self {
            port,
            topic: topic.name,
            seq: topic.seq,
            capacity,
            queue: RefCell::new(VecDeque::with_capacity(capacity)),
            misses_a_writer,
            roster,
            believed: Cell::new(0),
            strangers: RefCell::default(),
        }
    }

    /// Whether there is, or was, a writer whose messages are not received, because descriptors or
    /// memory did not suffice to connect to it. iceoryx2 does not retry; only a new subscriber helps.
    pub fn misses_a_writer(&self) -> bool {
        self.misses_a_writer.load(Ordering::Relaxed)
    }

    /// The oldest unread message, if there is one.
    pub fn receive(&self) -> Result<Option<Received<E, H>>, BusError> {
        let mut queue = self.queue.borrow_mut();
        while queue.len() < self.capacity {
            let Some(sample) = self.port.receive().map_err(failed(self.topic, "receive"))? else {
                break;
            };
            if !self.believes(&sample) {
                continue;
            }
            let received = Received { sample };
            let seq = self.seq_of(&received);
            // Nearly always the message belongs at the end.
            let before = queue.iter().rev().take_while(|queued| self.seq_of(queued) > seq).count();
            let place = queue.len() - before;
            queue.insert(place, received);
        }
        Ok(queue.pop_front())
    }

    /// Whether a message comes from a process of the group, or the topic is open to every program.
    /// Other messages are counted.
    fn believes(&self, sample: &IpcSample<ipc::Service, [E], H>) -> bool {
        let Some(roster) = &self.roster else { return true };
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

    /// Senders of the messages rejected since the last call.
    pub fn take_strangers(&self) -> Vec<Stranger> {
        self.strangers.borrow_mut().take()
    }

    fn seq_of(&self, received: &Received<E, H>) -> u64 {
        (self.seq)(received.elements(), received.header())
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

/// A message in shared memory; given back when dropped.
pub struct Received<E: Message, H: Header> {
    sample: IpcSample<ipc::Service, [E], H>,
}

impl<E: Message, H: Header> Received<E, H> {
    /// The node that published it.
    pub fn sender(&self) -> NodeKey {
        NodeKey::of(&self.sample.header().node_id())
    }

    /// The elements.
    pub fn elements(&self) -> &[E] {
        self.sample.payload()
    }

    /// The first element: the whole message, on topics with one element per message. `None` for an
    /// empty slice, which no process of the group publishes, but another program might.
    pub fn message(&self) -> Option<&E> {
        self.elements().first()
    }

    /// The header.
    pub fn header(&self) -> &H {
        self.sample.user_header()
    }
}
