//! Writing messages into shared memory.

use super::standby::Port;
use super::{BusError, failed};
use crate::eventcount::EventCount;
use crate::roster::NodeKey;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher as IpcPublisher;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample as IpcSample;
use iceoryx2::sample_mut_uninit::SampleMutUninit;
use messages::topics::TopicName;
use messages::{Header, Message};
use std::mem::MaybeUninit;
use std::rc::Rc;

/// Writes messages into shared memory and wakes the processes that sleep on the topic.
pub struct Publisher<E: Message, H: Header> {
    port: Rc<IpcPublisher<ipc::Service, [E], H>>,
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
        Self { port: Rc::new(port), bell: Rc::new(Bell { published, notifier }), topic }
    }

    /// The port, for [`Bus::refresh`](super::Bus::refresh).
    pub(super) fn as_port(&self) -> Rc<dyn Port> {
        Rc::clone(&self.port) as Rc<dyn Port>
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

impl<E: Message, H: Header> Port for IpcPublisher<ipc::Service, [E], H> {
    fn refresh(&self, _stands_by: bool) -> Result<(), BusError> {
        self.update_connections().map_err(failed("any", "connect to the readers"))
    }
}

/// A message in shared memory; given back when dropped.
pub struct Received<E: Message, H: Header> {
    pub(super) sample: IpcSample<ipc::Service, [E], H>,
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
