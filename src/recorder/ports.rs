//! The recorder's subscribers. They poll, so that writers need not wake them, and copy at once, so
//! that no shared memory is held.

use super::configurations::{Revised, Revisions};
use super::queue::Recorded;
use client::bus::{Bus, BusError, Received, Subscriber};
use client::clock::{monotonic_ns, wall_ns};
use client::consumer::{Order, Position};
use client::instance::Instance;
use messages::topics::{self, Topic};
use messages::*;
use messages::{Header, Message};
use recording::{Channel, encode_frame, encode_list, encode_message};
use std::collections::BTreeMap;

/// Oldest valid time stamp of a sender; for an older or future one the time of reading counts.
const OLDEST_NS: u64 = 300_000_000;

/// Result of one round of reading.
#[derive(Debug, Default, Clone, Copy)]
pub struct Taken {
    /// Messages.
    pub messages: u64,
    /// Frame numbers have restarted.
    pub is_anew: bool,
}

/// The subscribers.
pub struct Ports {
    lanes: Vec<Box<dyn Lane>>,
    // Last, so that it outlives the ports.
    _bus: Bus,
}

impl Ports {
    /// Connects to the topics that the channels need.
    pub fn connect(instance: &Instance, channels: &[Channel]) -> Result<Self, BusError> {
        let bus = Bus::join(instance, "recorder")?;
        let derived = channels.iter().any(|channel| channel.is_derived());
        let mut lanes: Vec<Box<dyn Lane>> = Vec::new();
        // Connect from the first topic to the last, so that the frames of all results are received
        // …
        for channel in Channel::ALL {
            let is_wanted = channels.contains(&channel) || (channel == Channel::World && derived);
            if is_wanted && let Some(lane) = lane(&bus, channel)? {
                lanes.push(lane);
            }
        }
        Ok(Self { lanes, _bus: bus })
    }

    /// Reads all messages. `put` gets each message and a buffer to fill with it.
    pub fn take(&mut self, mut put: impl FnMut(Recorded<'_>)) -> Result<Taken, BusError> {
        let mut taken = Taken::default();
        // … and read from the last to the first, for the same reason.
        for lane in self.lanes.iter_mut().rev() {
            lane.take(&mut put, &mut taken)?;
        }
        Ok(taken)
    }

    /// Frame numbers never received, by channel.
    pub fn missed(&self) -> BTreeMap<Channel, u64> {
        let missed = self.lanes.iter().map(|lane| lane.missed());
        missed.filter(|(_, count)| *count > 0).collect()
    }
}

fn lane(bus: &Bus, channel: Channel) -> Result<Option<Box<dyn Lane>>, BusError> {
    Ok(match channel {
        Channel::Frames => {
            Some(open(bus, channel, &topics::FRAMES, none, |frame, now_ns, out| {
                let header = frame.header();
                encode_frame(header, frame.elements(), out);
                Some((stamp(header.t_sent_ns, now_ns), header.t_capture_ns))
            })?)
        }
        Channel::Runs => Some(open(bus, channel, &topics::RUNS, of_runs, |runs, now_ns, out| {
            let header = runs.header();
            encode_list(header, header.valid(runs.elements()), out);
            Some((stamp(header.t_sent_ns, now_ns), header.frame.t_capture_ns))
        })?),
        Channel::Detections => {
            let mut copy = bytemuck::allocation::zeroed_box::<DetectionFrame>();
            Some(open(
                bus,
                channel,
                &topics::DETECTIONS,
                of_message,
                move |received, now_ns, out| {
                    take_message(received, &mut copy, out)?;
                    Some((stamp(copy.t_sent_ns, now_ns), copy.frame.t_capture_ns))
                },
            )?)
        }
        Channel::World => {
            let mut copy = bytemuck::allocation::zeroed_box::<WorldFrame>();
            Some(open(bus, channel, &topics::WORLD, of_message, move |received, now_ns, out| {
                take_message(received, &mut copy, out)?;
                Some((stamp(copy.t_sent_ns, now_ns), copy.frame.t_capture_ns))
            })?)
        }
        Channel::Commands => {
            let mut copy = bytemuck::allocation::zeroed_box::<Commands>();
            Some(open(bus, channel, &topics::COMMANDS, none, move |received, now_ns, out| {
                take_message(received, &mut copy, out)?;
                let t_ns = stamp(copy.t_sent_ns, now_ns);
                Some((t_ns, t_ns))
            })?)
        }
        Channel::Truth => {
            let mut copy = bytemuck::allocation::zeroed_box::<TruthFrame>();
            Some(open(bus, channel, &topics::TRUTH, none, move |received, now_ns, out| {
                take_message(received, &mut copy, out)?;
                Some((stamp(copy.t_capture_ns, now_ns), copy.t_capture_ns))
            })?)
        }
        Channel::Health => {
            let mut copy = bytemuck::allocation::zeroed_box::<Heartbeat>();
            Some(open(bus, channel, &topics::HEALTH, none, move |received, now_ns, out| {
                take_message(received, &mut copy, out)?;
                let t_ns = stamp(copy.t_sent_ns, now_ns);
                Some((t_ns, t_ns))
            })?)
        }
        Channel::Events => {
            Some(open(bus, channel, &topics::EVENTS, none, move |received, now_ns, out| {
                let event = received.message()?;
                let age_ns = wall_ns().saturating_sub(event.t_wall_ns);
                encode_message(event, out);
                let t_ns = stamp(now_ns.saturating_sub(age_ns), now_ns);
                Some((t_ns, t_ns))
            })?)
        }
        Channel::Setup | Channel::Scene | Channel::Robots | Channel::Ball => None,
    })
}

fn none<E: Message, H: Header>(_: &Received<E, H>) -> Revisions {
    Revisions::default()
}

fn of_runs(received: &Received<Run, RunsHeader>) -> Revisions {
    received.header().revisions()
}

fn of_message<E: Message + Revised>(received: &Received<E, ()>) -> Revisions {
    received.message().map(Revised::revisions).unwrap_or_default()
}

/// Copies a message, clears stale entries behind its lists, and writes it to `out`.
fn take_message<T: Message + ClearStale>(
    received: &Received<T, ()>,
    copy: &mut T,
    out: &mut Vec<u8>,
) -> Option<()> {
    *copy = *received.message()?;
    copy.clear_stale();
    encode_message(copy, out);
    Some(())
}

/// Time at which a message was sent; an implausible stamp is replaced, so that invalid messages do
/// not disturb the order of a recording.
fn stamp(t_ns: u64, now_ns: u64) -> u64 {
    if (now_ns.saturating_sub(OLDEST_NS)..=now_ns).contains(&t_ns) { t_ns } else { now_ns }
}

/// One topic of any type.
trait Lane {
    fn take(
        &mut self,
        put: &mut dyn FnMut(Recorded<'_>),
        taken: &mut Taken,
    ) -> Result<(), BusError>;
    fn missed(&self) -> (Channel, u64);
}

struct TopicLane<E: Message, H: Header, F> {
    channel: Channel,
    topic: &'static Topic<E, H>,
    subscriber: Subscriber<E, H>,
    order: Order,
    missed: u64,
    revisions: fn(&Received<E, H>) -> Revisions,
    encode: F,
}

fn open<E, H, F>(
    bus: &Bus,
    channel: Channel,
    topic: &'static Topic<E, H>,
    revisions: fn(&Received<E, H>) -> Revisions,
    encode: F,
) -> Result<Box<dyn Lane>, BusError>
where
    E: Message + 'static,
    H: Header + 'static,
    F: FnMut(&Received<E, H>, u64, &mut Vec<u8>) -> Option<(u64, u64)> + 'static,
{
    let subscriber = bus.subscriber(topic)?;
    Ok(Box::new(TopicLane {
        channel,
        topic,
        subscriber,
        order: Order::default(),
        missed: 0,
        revisions,
        encode,
    }))
}

impl<E, H, F> Lane for TopicLane<E, H, F>
where
    E: Message,
    H: Header,
    F: FnMut(&Received<E, H>, u64, &mut Vec<u8>) -> Option<(u64, u64)>,
{
    fn take(
        &mut self,
        put: &mut dyn FnMut(Recorded<'_>),
        taken: &mut Taken,
    ) -> Result<(), BusError> {
        let Self { channel, topic, subscriber, order, missed, revisions, encode } = self;
        // At most one buffer at a time, so that no topic delays the others.
        for _ in 0..topic.buffer {
            let Some(received) = subscriber.receive()? else { break };
            let seq = (topic.seq)(received.elements(), received.header());
            let t_ns = (topic.t_capture_ns)(received.elements(), received.header());
            match order.position(seq, t_ns) {
                Position::Next => {}
                Position::After { missed: count } => *missed += count,
                Position::Restarted => taken.is_anew = true,
                // The stages have dropped it too.
                Position::Repeated => continue,
            }
            taken.messages += 1;
            put(Recorded {
                channel: *channel,
                revisions: revisions(&received),
                size_hint: size_of::<H>() + size_of_val(received.elements()),
                encode: &mut |out| encode(&received, monotonic_ns(), out),
            });
        }
        Ok(())
    }

    fn missed(&self) -> (Channel, u64) {
        (self.channel, self.missed)
    }
}
