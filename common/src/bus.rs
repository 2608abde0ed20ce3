//! Publishing and subscribing: iceoryx2 with this project's rules built in.
//!
//! * Writers never wait: safe overflow is on, back-pressure discards.
//! * A reader believes the group's own processes: on topics that are not open to every program, messages of
//!   others are counted and dropped ([`Stranger`]).
//! * A reader that wants to sleep until there is something asks for wake-ups; one that polls, or
//!   only stands by, costs the writer nothing.

pub mod participants;
mod ports;
mod strangers;

pub use ports::{Loan, Publisher, Received, Subscriber};
pub use strangers::Stranger;

use crate::config::WakeUpStrategy;
use crate::eventcount::EventCount;
use crate::instance::namespace::IPC_VERSION;
use crate::instance::{Instance, InstanceError, Namespace};
use crate::memory::{self, SHARED_MEMORY};
use crate::roster::{NodeKey, Roster};
use crate::topics::Topic;
use crate::wake_up::WakeUp;
use bytemuck::Pod;
use iceoryx2::port::DegradationAction;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::{Publisher as IpcPublisher, PublisherCreateError};
use iceoryx2::port::subscriber::SubscriberCreateError;
use iceoryx2::prelude::*;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory as PublishSubscribeFactory;
use std::fmt::Debug;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// What may travel: plain data of fixed layout with a versioned type name.
pub trait Message: Pod + Debug + ZeroCopySend {}
impl<T: Pod + Debug + ZeroCopySend> Message for T {}

/// What may travel beside a message's elements.
pub trait Header: Message + Default {}
impl<T: Message + Default> Header for T {}

/// What went wrong between processes.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The instance's directory or names.
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// /dev/shm is full.
    #[error(
        "topic {topic}: not enough shared memory: {} kB are free in {SHARED_MEMORY}, see `touchline doctor`",
        free >> 10
    )]
    NoMemory {
        /// Topic, or the process's own node.
        topic: &'static str,
        /// Bytes that are free.
        free: u64,
    },
    /// All places are taken, by the living or by dead ones that nobody has cleared.
    #[error(
        "topic {topic}: {action}: all places are taken; `touchline topics` shows how many there are"
    )]
    Full {
        /// Topic.
        topic: &'static str,
        /// What was tried.
        action: &'static str,
    },
    /// Another version of iceoryx2 has made it, or it is damaged.
    #[error(
        "topic {topic}: it was made by a program with another version of iceoryx2 than {IPC_VERSION}, or is \
         damaged; `touchline doctor` names it: end that program, then stop and start the group"
    )]
    Strange {
        /// Topic.
        topic: &'static str,
    },
    /// iceoryx2 refused; the text says what was tried and its answer.
    #[error("topic {topic}: {action}: {reason}")]
    Ipc {
        /// Topic, or the process's own node.
        topic: &'static str,
        /// What was tried.
        action: &'static str,
        /// iceoryx2's answer.
        reason: String,
    },
}

/// Nothing is made when there is hardly any shared memory left.
fn check_memory(topic: &'static str) -> Result<(), BusError> {
    memory::check_margin().map_err(|free| BusError::NoMemory { topic, free })
}

/// Has the memory at hand that the messages of an ordinary match will need.
fn fill_in<E: Message, H: Header>(
    port: &IpcPublisher<ipc::Service, [E], H>,
    topic: &Topic<E, H>,
    capacity: usize,
) -> Result<(), BusError> {
    // The first place of a new segment; the others follow at equal distances.
    let first = port.loan_slice_uninit(capacity).map_err(failed(topic.name, "loan a message"))?;
    let begin = std::ptr::from_ref(first.header()).cast::<u8>();
    let memory = topic.memory(capacity);
    let (distance, bytes) = (memory.message_bytes, memory.ordinary_message_bytes);
    let is_filled_in = if bytes == distance {
        memory::fill_in(begin, (memory.usual_places * distance) as usize)
    } else {
        let mut places = (0..memory.usual_places).map(|place| (place * distance) as usize);
        places.all(|offset| memory::fill_in(begin.wrapping_add(offset), bytes as usize))
    };
    if is_filled_in {
        return Ok(());
    }
    let free = memory::free_bytes().unwrap_or(0);
    Err(BusError::NoMemory { topic: topic.name, free })
}

fn failed<E: Debug>(topic: &'static str, action: &'static str) -> impl FnOnce(E) -> BusError {
    move |error| BusError::Ipc { topic, action, reason: format!("{error:?}") }
}

fn refused<E: Debug>(
    topic: &'static str,
    action: &'static str,
    is_full: impl FnOnce(&E) -> bool,
) -> impl FnOnce(E) -> BusError {
    move |error| match is_full(&error) {
        true => BusError::Full { topic, action },
        false => failed(topic, action)(error),
    }
}

/// Tries again for a while where all places are taken: the supervisor clears those of dead processes
/// several times a second.
fn when_there_is_a_place<T>(
    patience: Duration,
    mut connect: impl FnMut() -> Result<T, BusError>,
) -> Result<T, BusError> {
    let begun = Instant::now();
    loop {
        match connect() {
            Err(BusError::Full { .. }) if begun.elapsed() < patience => {
                std::thread::sleep(PLACE_RETRY);
            }
            outcome => return outcome,
        }
    }
}

/// How long a place on a topic is waited for.
const PLACE_PATIENCE: Duration = Duration::from_secs(2);
const PLACE_RETRY: Duration = Duration::from_millis(20);

/// A process's membership in an instance.
pub struct Bus {
    node: Node<ipc::Service>,
    namespace: Namespace,
    roster: Rc<Roster>,
    /// How long a place on a topic is waited for.
    patience: Duration,
}

/// A topic that will not go as long as this is there.
pub struct Kept<E: Message, H: Header> {
    _service: PublishSubscribeFactory<ipc::Service, [E], H>,
}

/// Who is connected to a topic.
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
        // Its log lines repeat what the returned errors say, without saying which topic.
        iceoryx2::prelude::set_log_level(LogLevel::Fatal);
        // In a directory of others nothing would come of it, and nobody would say why.
        instance.check_directory()?;
        memory::check_place().map_err(InstanceError::from)?;
        check_memory("node")?;
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
        Ok(Self { node, namespace, roster, patience: PLACE_PATIENCE })
    }

    /// Where the group is in shared memory.
    pub fn namespace(&self) -> &Namespace {
        &self.namespace
    }

    /// Enters this process in the group's [roster](crate::roster): what it publishes is believed. For
    /// processes of the group alone, before they publish anything.
    pub fn enter_roster(&self) {
        self.roster.enter(NodeKey::of(self.node.id()));
    }

    /// Has the messages of a program believed that is none of the group's, because the user permits it.
    pub fn admit(&self, sender: NodeKey) {
        self.roster.enter(sender);
    }

    /// Joins the instance as [`join`](Self::join), for a process that will read most topics and has
    /// something better to do than to wait for a place: it tries again.
    pub fn join_as_reader(instance: &Instance, process: &str) -> Result<Self, BusError> {
        memory::check_room_for_readers()
            .map_err(|free| BusError::NoMemory { topic: "all", free })?;
        Ok(Self { patience: Duration::ZERO, ..Self::join(instance, process)? })
    }

    /// A writer whose messages have up to `capacity` elements.
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
        let port = when_there_is_a_place(self.patience, || {
            self.open(topic)?
                .publisher_builder()
                .initial_max_slice_len(capacity)
                .allocation_strategy(AllocationStrategy::Static)
                .max_loaned_samples(topic.loaned)
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
                .map_err(refused(topic.name, action, is_full))
        })?;
        fill_in(&port, topic, capacity)?;
        let published = self.event_count(topic.name)?;
        let notifier = topic.notifies.then(|| self.notifier(topic.name)).transpose()?;
        Ok(Publisher::new(port, published, notifier, topic.name))
    }

    /// A reader. It is connected at once: from now on the newest messages wait for it.
    pub fn subscriber<E: Message, H: Header>(
        &self,
        topic: &Topic<E, H>,
    ) -> Result<Subscriber<E, H>, BusError> {
        self.subscribe(topic, topic.buffer, 0)
    }

    /// A reader that only ever wants the newest message.
    pub fn newest_only<E: Message, H: Header>(
        &self,
        topic: &Topic<E, H>,
    ) -> Result<Subscriber<E, H>, BusError> {
        self.subscribe(topic, 1, 0)
    }

    /// A reader that also wants what was published before it came ([`Topic::history`]).
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
        let (port, borrowed) = when_there_is_a_place(self.patience, || {
            let service = self.open(topic)?;
            // Where the topic was made with less, less is what there is.
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
            Ok((port, made.subscriber_max_borrowed_samples()))
        })?;
        // One message is with the caller, and one may be kept by it.
        let capacity = borrowed.min(topic.borrowed).saturating_sub(2).clamp(1, topic.buffer);
        let roster = (!topic.is_open).then(|| Rc::clone(&self.roster));
        Ok(Subscriber::new(port, topic, capacity, misses_a_writer, roster))
    }

    /// Keeps a topic that it neither writes nor reads. A topic goes with the last process that knows it;
    /// if the next one that makes it is killed while it does, nobody can.
    pub fn keep<E: Message, H: Header>(&self, topic: &Topic<E, H>) -> Result<Kept<E, H>, BusError> {
        when_there_is_a_place(self.patience, || Ok(Kept { _service: self.open(topic)? }))
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

    /// What a reader sleeps on until the topic has something new.
    pub fn wake_up<E, H>(&self, topic: &Topic<E, H>) -> Result<WakeUp, BusError> {
        self.wake_up_by(topic, WakeUpStrategy::Event)
    }

    /// What a reader waits on, in the given way, until the topic has something new.
    pub fn wake_up_by<E, H>(
        &self,
        topic: &Topic<E, H>,
        strategy: WakeUpStrategy,
    ) -> Result<WakeUp, BusError> {
        Ok(WakeUp::new(self.event_count(topic.name)?, strategy))
    }

    fn event_count(&self, topic: &'static str) -> Result<EventCount, BusError> {
        EventCount::open(&self.namespace.event_count_path(topic))
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
        // A topic that is there is taken as it was made: how much is kept of large frames only the
        // group's own processes know.
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

    fn notifier(&self, topic: &'static str) -> Result<Notifier<ipc::Service>, BusError> {
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

/// Processes in one instance, the dead and not yet cleaned ones included.
const MAX_NODES: usize = 32;

fn service_name(topic: &'static str) -> Result<ServiceName, BusError> {
    ServiceName::new(topic).map_err(failed(topic, "name it"))
}
