//! Publishing and subscribing: iceoryx2 with this project's rules built in.
//!
//! * Writers never wait: safe overflow is on, back-pressure discards.
//!
//! * Readers accept messages of the group's own processes only, except on open topics; messages of
//!   other programs are counted and dropped ([`Stranger`]).
//! * A reader that wants to sleep asks for wake-ups. One that polls or stands by costs the writer
//!   nothing.

pub mod participants;
mod ports;
mod standby;
mod strangers;
mod subscriber;

pub use ports::{Loan, Publisher, Received};
pub use strangers::Stranger;
pub use subscriber::Subscriber;

use crate::eventcount::EventCount;
use crate::instance::namespace::IPC_VERSION;
use crate::instance::{Instance, InstanceError, Namespace};
use crate::memory::{self, SHARED_MEMORY, TopicMemory};
use crate::roster::{NodeKey, Roster};
use crate::wake_up::{Strategy, WakeUp};
use iceoryx2::port::DegradationAction;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::{Publisher as IpcPublisher, PublisherCreateError};
use iceoryx2::port::subscriber::SubscriberCreateError;
use iceoryx2::prelude::*;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory as PublishSubscribeFactory;
use messages::topics::{Topic, TopicName};
use messages::{Header, Message};
use standby::Port;
use std::cell::RefCell;
use std::fmt::Debug;
use std::rc::{Rc, Weak};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use subscriber::Parts;

/// Errors of the communication between processes.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The instance's directory or names are unusable.
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// /dev/shm is full.
    #[error(
        "topic {topic}: not enough shared memory: {} kB are free in {SHARED_MEMORY}, see `touchline doctor`",
        free >> 10
    )]
    NoMemory {
        /// Topic, or the process's own node.
        topic: TopicName,
        /// Bytes that are free.
        free: u64,
    },
    /// All slots are taken, by living processes or by dead ones not yet cleaned up.
    #[error(
        "topic {topic}: {action}: all places are taken; `touchline topics` shows how many there are"
    )]
    Full {
        /// Topic.
        topic: TopicName,
        /// The attempted action.
        action: &'static str,
    },
    /// Made by another version of iceoryx2, or damaged.
    #[error(
        "topic {topic}: it was made by a program with another version of iceoryx2 than {IPC_VERSION}, or is \
         damaged; `touchline doctor` names it: end that program, then stop and start the group"
    )]
    Strange {
        /// Topic.
        topic: TopicName,
    },
    /// iceoryx2 refused; the text has the attempted action and its answer.
    #[error("topic {topic}: {action}: {reason}")]
    Ipc {
        /// Topic, or the process's own node.
        topic: TopicName,
        /// The attempted action.
        action: &'static str,
        /// iceoryx2's answer.
        reason: String,
    },
}

/// Refuses to create anything when hardly any shared memory is left.
fn check_memory(topic: TopicName) -> Result<(), BusError> {
    memory::check_margin().map_err(|free| BusError::NoMemory { topic, free })
}

/// Allocates the memory that the messages of an ordinary match will need.
fn populate<E: Message, H: Header>(
    port: &IpcPublisher<ipc::Service, [E], H>,
    topic: &Topic<E, H>,
    capacity: usize,
) -> Result<(), BusError> {
    // The first slot of a new segment; the others follow at equal distances.
    let first = port.loan_slice_uninit(capacity).map_err(failed(topic.name, "loan a message"))?;
    let begin = std::ptr::from_ref(first.header()).cast::<u8>();
    let memory = TopicMemory::of(topic, capacity);
    let (distance, bytes) = (memory.message_bytes, memory.ordinary_message_bytes);
    let is_populated = if bytes == distance {
        memory::populate(begin, (memory.usual_slots * distance) as usize)
    } else {
        let mut places = (0..memory.usual_slots).map(|place| (place * distance) as usize);
        places.all(|offset| memory::populate(begin.wrapping_add(offset), bytes as usize))
    };
    if is_populated {
        return Ok(());
    }
    let free = memory::free_bytes().unwrap_or(0);
    Err(BusError::NoMemory { topic: topic.name, free })
}

fn failed<E: Debug>(
    topic: impl Into<TopicName>,
    action: &'static str,
) -> impl FnOnce(E) -> BusError {
    let topic = topic.into();
    move |error| BusError::Ipc { topic, action, reason: format!("{error:?}") }
}

fn refused<E: Debug>(
    topic: TopicName,
    action: &'static str,
    is_full: impl FnOnce(&E) -> bool,
) -> impl FnOnce(E) -> BusError {
    move |error| match is_full(&error) {
        true => BusError::Full { topic, action },
        false => failed(topic, action)(error),
    }
}

/// Retries while all slots are taken: the supervisor clears the slots of dead processes several times a
/// second.
fn retry_while_full<T>(
    patience: Duration,
    mut connect: impl FnMut() -> Result<T, BusError>,
) -> Result<T, BusError> {
    let begun = Instant::now();
    loop {
        match connect() {
            Err(BusError::Full { .. }) if begun.elapsed() < patience => {
                std::thread::sleep(FULL_RETRY);
            }
            outcome => return outcome,
        }
    }
}

/// Time for which a full topic is retried.
const FULL_TIMEOUT: Duration = Duration::from_secs(2);
const FULL_RETRY: Duration = Duration::from_millis(20);

/// A process's membership in an instance.
pub struct Bus {
    node: Node<ipc::Service>,
    namespace: Namespace,
    roster: Rc<Roster>,
    /// Time for which a full topic is retried.
    patience: Duration,
    /// Ports of this process.
    ports: RefCell<Vec<Weak<dyn Port>>>,
}

/// Keeps the topic's service alive until dropped.
pub struct KeptTopic<E: Message, H: Header> {
    _service: PublishSubscribeFactory<ipc::Service, [E], H>,
}

/// Number of processes connected to a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Population {
    /// Writers.
    pub publishers: usize,
    /// Readers.
    pub subscribers: usize,
}

impl Bus {
    /// Joins the instance under the name of a process, which tools show.
    pub fn join(instance: &Instance, process: &str) -> Result<Self, BusError> {
        // iceoryx2's own log lines repeat the returned errors without naming the topic.
        iceoryx2::prelude::set_log_level(LogLevel::Fatal);
        // In a directory of another user joining would fail without a usable error.
        instance.check_directory()?;
        memory::check_place().map_err(InstanceError::from)?;
        check_memory("node".into())?;
        let namespace = instance.create_namespace()?;
        namespace.check_version()?;
        let config = namespace.ipc_config()?;
        let name = NodeName::new(process).map_err(failed("node", "name it"))?;
        let node = NodeBuilder::new()
            .name(&name)
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(failed("node", "join the instance"))?;
        let roster = Roster::open(instance).map_err(failed("node", "map the roster"))?;
        let roster = Rc::new(roster);
        Ok(Self { node, namespace, roster, patience: FULL_TIMEOUT, ports: RefCell::default() })
    }

    /// The group's names in shared memory.
    pub fn namespace(&self) -> &Namespace {
        &self.namespace
    }

    /// Enters this process in the group's [roster](crate::roster), so that readers accept its messages.
    /// Only for processes of the group, before they publish anything.
    pub fn enter_roster(&self) {
        self.roster.enter(NodeKey::of(self.node.id()));
    }

    /// Connects all ports to new processes and drops connections to processes that have ended, which a
    /// port that is not used would keep. To be called with every heartbeat; `stands_by` if the process
    /// reads nothing at the moment.
    pub fn refresh(&self, stands_by: bool) -> Result<(), BusError> {
        let mut ports = self.ports.borrow_mut();
        ports.retain(|port| port.strong_count() > 0);
        ports.iter().filter_map(Weak::upgrade).try_for_each(|port| port.refresh(stands_by))
    }

    fn remember(&self, port: &Rc<dyn Port>) {
        self.ports.borrow_mut().push(Rc::downgrade(port));
    }

    /// Makes readers accept the messages of a program outside the group, because the user permits it.
    pub fn admit(&self, sender: NodeKey) {
        self.roster.enter(sender);
    }

    /// Joins the instance as [`join`](Self::join), for a process that reads most topics. It does not
    /// wait for a free slot; the caller tries again.
    pub fn join_as_reader(instance: &Instance, process: &str) -> Result<Self, BusError> {
        memory::check_room_for_readers()
            .map_err(|free| BusError::NoMemory { topic: "all".into(), free })?;
        Ok(Self { patience: Duration::ZERO, ..Self::join(instance, process)? })
    }

    /// Creates a publisher whose messages have up to `capacity` elements.
    pub fn publisher<E: Message, H: Header>(
        &self,
        topic: &Topic<E, H>,
        capacity: usize,
    ) -> Result<Publisher<E, H>, BusError> {
        check_memory(topic.name)?;
        let action = "create a publisher";
        let is_full = |error: &PublisherCreateError| {
            *error == PublisherCreateError::ExceedsMaxSupportedPublishers
        };
        let port = retry_while_full(self.patience, || {
            self.open(topic)?
                .publisher_builder()
                .initial_max_slice_len(capacity)
                .allocation_strategy(AllocationStrategy::Static)
                .max_loaned_samples(topic.loaned)
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
                .map_err(refused(topic.name, action, is_full))
        })?;
        populate(&port, topic, capacity)?;
        let published = self.event_count(topic.name)?;
        let notifier = topic.notifies.then(|| self.notifier(topic.name)).transpose()?;
        let publisher = Publisher::new(port, published, notifier, topic.name);
        self.remember(&publisher.as_port());
        Ok(publisher)
    }

    /// Creates a subscriber. It is connected at once: the newest messages are kept for it from now on.
    pub fn subscriber<E: Message, H: Header>(
        &self,
        topic: &Topic<E, H>,
    ) -> Result<Subscriber<E, H>, BusError> {
        self.subscribe(topic, topic.buffer, 0)
    }

    /// Creates a subscriber that keeps only the newest message.
    pub fn newest_only<E: Message, H: Header>(
        &self,
        topic: &Topic<E, H>,
    ) -> Result<Subscriber<E, H>, BusError> {
        self.subscribe(topic, 1, 0)
    }

    /// Creates a subscriber that also receives messages published before it ([`Topic::history`]).
    pub fn subscriber_with_history<E: Message, H: Header>(
        &self,
        topic: &Topic<E, H>,
    ) -> Result<Subscriber<E, H>, BusError> {
        self.subscribe(topic, topic.buffer, topic.history)
    }

    fn subscribe<E: Message, H: Header>(
        &self,
        topic: &Topic<E, H>,
        buffer: usize,
        history: usize,
    ) -> Result<Subscriber<E, H>, BusError> {
        check_memory(topic.name)?;
        let action = "create a subscriber";
        let misses_a_writer = Arc::new(AtomicBool::new(false));
        let is_full = |error: &SubscriberCreateError| {
            *error == SubscriberCreateError::ExceedsMaxSupportedSubscribers
        };
        let (port, service, borrowed) = retry_while_full(self.patience, || {
            let service = self.open(topic)?;
            // An existing topic may have been made with less; then less is available.
            let made = service.static_config();
            let port = service
                .subscriber_builder()
                .buffer_size(buffer.min(made.subscriber_max_buffer_size()))
                .history_request(history.min(made.history_size()))
                .set_degradation_handler({
                    let misses_a_writer = Arc::clone(&misses_a_writer);
                    move |_, _| {
                        misses_a_writer.store(true, Ordering::Relaxed);
                        DegradationAction::Ignore
                    }
                })
                .create()
                .map_err(refused(topic.name, action, is_full))?;
            let borrowed = made.subscriber_max_borrowed_samples();
            Ok((port, service, borrowed))
        })?;
        // One message is with the caller, and the caller may keep another.
        let capacity = borrowed.min(topic.borrowed).saturating_sub(2).clamp(1, topic.buffer);
        let roster = (!topic.is_open).then(|| Rc::clone(&self.roster));
        let published = self.event_count(topic.name)?;
        let parts = Parts { port, service, published, capacity, misses_a_writer, roster };
        let subscriber = Subscriber::new(topic, parts);
        self.remember(&subscriber.as_port());
        Ok(subscriber)
    }

    /// Keeps a topic's service alive without writing or reading. A service ends with its last process,
    /// and a process killed while it creates the service again can leave one that no process can open.
    pub fn keep<E: Message, H: Header>(
        &self,
        topic: &Topic<E, H>,
    ) -> Result<KeptTopic<E, H>, BusError> {
        retry_while_full(self.patience, || Ok(KeptTopic { _service: self.open(topic)? }))
    }

    /// How many processes are connected to a topic, spares included.
    pub fn population<E: Message, H: Header>(
        &self,
        topic: &Topic<E, H>,
    ) -> Result<Population, BusError> {
        let service = self.open(topic)?;
        let connected = service.dynamic_config();
        Ok(Population {
            publishers: connected.number_of_publishers(),
            subscribers: connected.number_of_subscribers(),
        })
    }

    /// A wake-up that sleeps until the topic has something new.
    pub fn wake_up<E, H>(&self, topic: &Topic<E, H>) -> Result<WakeUp, BusError> {
        self.wake_up_by(topic, Strategy::Event)
    }

    /// A wake-up that waits in the given way until the topic has something new.
    pub fn wake_up_by<E, H>(
        &self,
        topic: &Topic<E, H>,
        strategy: Strategy,
    ) -> Result<WakeUp, BusError> {
        Ok(WakeUp::new(self.event_count(topic.name)?, strategy))
    }

    fn event_count(&self, topic: TopicName) -> Result<EventCount, BusError> {
        EventCount::open(&self.namespace.event_count_path(&topic.to_string()))
            .map_err(failed(topic, "open its event count"))
    }

    fn open<E: Message, H: Header>(
        &self,
        topic: &Topic<E, H>,
    ) -> Result<PublishSubscribeFactory<ipc::Service, [E], H>, BusError> {
        let builder = || -> Result<_, BusError> {
            let name = service_name(topic.name)?;
            Ok(self.node.service_builder(&name).publish_subscribe::<[E]>().user_header::<H>())
        };
        // An existing topic is opened as it was made, because only the group's own processes know how
        // many large frames are kept.
        match builder()?.open() {
            Err(PublishSubscribeOpenError::DoesNotExist) => {}
            Err(
                PublishSubscribeOpenError::VersionMismatch
                | PublishSubscribeOpenError::ServiceInCorruptedState,
            ) => return Err(BusError::Strange { topic: topic.name }),
            opened => {
                let is_full = |error: &PublishSubscribeOpenError| {
                    *error == PublishSubscribeOpenError::ExceedsMaxNumberOfNodes
                };
                return opened.map_err(refused(topic.name, "open the topic", is_full));
            }
        }
        builder()?
            .history_size(topic.history)
            .subscriber_max_buffer_size(topic.buffer)
            .subscriber_max_borrowed_samples(topic.borrowed)
            .enable_safe_overflow(true)
            .max_publishers(topic.publishers)
            .max_subscribers(topic.subscribers)
            .max_nodes(MAX_NODES)
            .open_or_create()
            .map_err(failed(topic.name, "open the topic"))
    }

    fn notifier(&self, topic: TopicName) -> Result<Notifier<ipc::Service>, BusError> {
        self.node
            .service_builder(&service_name(topic)?)
            .event()
            .max_listeners(MAX_NODES)
            .max_notifiers(MAX_NODES)
            .max_nodes(MAX_NODES)
            .open_or_create()
            .map_err(failed(topic, "open the event"))?
            .notifier_builder()
            .create()
            .map_err(failed(topic, "create a notifier"))
    }
}

/// Processes in one instance, including dead ones that are not cleaned up yet.
const MAX_NODES: usize = 32;

fn service_name(topic: TopicName) -> Result<ServiceName, BusError> {
    ServiceName::new(&topic.to_string()).map_err(failed(topic, "name it"))
}
