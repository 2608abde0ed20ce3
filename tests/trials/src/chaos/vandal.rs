//! The vandal: a program with a common bug. It publishes on topics of other processes, at the rate of a
//! camera, copies of the newest message with a wrong number, and noise.

use crate::TrialError;
use crate::args::BystanderArgs;
use bytemuck::{bytes_of_mut, cast_slice_mut};
use client::bus::{Bus, BusError, Publisher, Subscriber};
use client::instance::{Instance, RUNTIME_DIR_VARIABLE};
use messages::topics::{self, Topic};
use messages::{Header, Message};
use runtime::descriptors;
use std::io::Write as _;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::{Duration, Instant};

/// Name under which it joins the group.
pub const NAME: &str = "vandal";
/// Time between two messages on a topic.
const PERIOD: Duration = Duration::from_micros(12_500);
/// Longest wait for a message to copy.
const PATIENCE: Duration = Duration::from_secs(2);

/// The error in a message.
#[derive(Debug, Clone, Copy)]
enum Wrong {
    /// Its number is this far ahead of the newest.
    Ahead(u64),
    /// Its number is this one.
    Number(u64),
    /// It is a copy of the newest message.
    Repeated,
    /// Its bits are random.
    Noise,
}

const KINDS: [Wrong; 6] = [
    Wrong::Ahead(900),
    Wrong::Ahead(1),
    Wrong::Repeated,
    Wrong::Number(0),
    Wrong::Number(u64::MAX),
    Wrong::Noise,
];

/// The running program. Dropping it kills it.
pub struct Vandal {
    child: Child,
}

impl Vandal {
    /// Starts it; it publishes for the given time and ends.
    pub fn start(instance: &Instance, time: Duration) -> Result<Self, TrialError> {
        let places = instance.directory().parent().unwrap_or(instance.directory());
        descriptors::keep_from_programs_run_now();
        let child = Command::new("/proc/self/exe")
            .arg0("touchline")
            .args(["bystander", "--instance", instance.name()])
            .args(["--rubbish", &time.as_millis().to_string()])
            .env(RUNTIME_DIR_VARIABLE, places)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            // Without memory it cannot attach; that is no failure.
            .stderr(Stdio::null())
            .process_group(0)
            .spawn()?;
        Ok(Self { child })
    }

    /// Whether it has ended.
    pub fn has_ended(&mut self) -> bool {
        !matches!(self.child.try_wait(), Ok(None))
    }
}

impl Drop for Vandal {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// `touchline bystander --rubbish MS`: publishes invalid messages for some time.
pub fn publish_garbage(args: &BystanderArgs, time: Duration) -> Result<ExitCode, TrialError> {
    let instance = Instance::new(&args.instance)?;
    let parent = rustix::process::getppid();
    let bus = Bus::join(&instance, NAME)?;
    let mut lanes: Vec<Box<dyn Lane>> = vec![
        Lanes::open(&bus, &topics::FRAMES, |_, header, wrong| set(&mut header.seq, wrong))?,
        Lanes::open(&bus, &topics::RUNS, |_, header, wrong| set(&mut header.frame.seq, wrong))?,
        Lanes::open(&bus, &topics::DETECTIONS, |elements, _, wrong| {
            elements.iter_mut().for_each(|it| set(&mut it.frame.seq, wrong));
        })?,
        Lanes::open(&bus, &topics::WORLD, |elements, _, wrong| {
            elements.iter_mut().for_each(|it| set(&mut it.frame.seq, wrong));
        })?,
        Lanes::open(&bus, &topics::HEALTH, |elements, _, wrong| {
            for beat in elements {
                set(&mut beat.seq_out, wrong);
                set(&mut beat.dropped[0], wrong);
            }
        })?,
    ];
    let begun = Instant::now();
    let mut noise = 0x9E37_79B9_7F4A_7C15;
    // A message can be copied only once it has come.
    while lanes.iter_mut().map(|lane| lane.learn()).collect::<Result<Vec<_>, _>>()?.contains(&false)
    {
        if begun.elapsed() > PATIENCE {
            return Err("there is nothing to copy".into());
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    let begun = Instant::now();
    let mut is_told = false;
    for kind in KINDS.into_iter().cycle() {
        for lane in &mut lanes {
            lane.learn()?;
            lane.publish(&bus, kind, &mut noise)?;
        }
        if !std::mem::replace(&mut is_told, true) {
            writeln!(std::io::stdout(), "attached")?;
        }
        if begun.elapsed() >= time || rustix::process::getppid() != parent {
            break;
        }
        std::thread::sleep(PERIOD);
    }
    Ok(ExitCode::SUCCESS)
}

fn set(number: &mut u64, wrong: Wrong) {
    *number = match wrong {
        Wrong::Ahead(by) => number.wrapping_add(by),
        Wrong::Number(other) => other,
        Wrong::Repeated | Wrong::Noise => *number,
    };
}

/// A topic of any type.
trait Lane {
    /// Reads the newest message; `true` if one is known.
    fn learn(&mut self) -> Result<bool, BusError>;
    /// Publishes an invalid message.
    fn publish(&mut self, bus: &Bus, wrong: Wrong, noise: &mut u64) -> Result<(), BusError>;
}

struct Lanes<E: Message, H: Header, F> {
    topic: &'static Topic<E, H>,
    reader: Subscriber<E, H>,
    /// Created once the length of messages is known.
    writer: Option<Publisher<E, H>>,
    newest: Option<(Vec<E>, H)>,
    set_number: F,
}

impl<E: Message, H: Header, F: Fn(&mut [E], &mut H, Wrong) + 'static> Lanes<E, H, F> {
    fn open(
        bus: &Bus,
        topic: &'static Topic<E, H>,
        set_number: F,
    ) -> Result<Box<dyn Lane>, BusError> {
        let reader = bus.subscriber(topic)?;
        Ok(Box::new(Self { topic, reader, writer: None, newest: None, set_number }))
    }
}

impl<E: Message, H: Header, F: Fn(&mut [E], &mut H, Wrong)> Lane for Lanes<E, H, F> {
    fn learn(&mut self) -> Result<bool, BusError> {
        if let Some(received) = self.reader.newest()? {
            self.newest = Some((received.elements().to_vec(), *received.header()));
        }
        Ok(self.newest.is_some())
    }

    fn publish(&mut self, bus: &Bus, wrong: Wrong, noise: &mut u64) -> Result<(), BusError> {
        let Some((known, known_header)) = &self.newest else { return Ok(()) };
        let writer = match &mut self.writer {
            Some(writer) => writer,
            writer => writer.insert(bus.publisher(self.topic, known.len())?),
        };
        let mut message = writer.loan(known.len())?;
        let (elements, header) = message.parts();
        elements.copy_from_slice(known);
        *header = *known_header;
        if matches!(wrong, Wrong::Noise) {
            fill(cast_slice_mut(elements), noise);
            fill(bytes_of_mut(header), noise);
        }
        (self.set_number)(elements, header, wrong);
        message.send()
    }
}

/// Marsaglia's xorshift.
fn fill(bytes: &mut [u8], noise: &mut u64) {
    for chunk in bytes.chunks_mut(8) {
        *noise ^= *noise << 13;
        *noise ^= *noise >> 7;
        *noise ^= *noise << 17;
        chunk.copy_from_slice(&noise.to_ne_bytes()[..chunk.len()]);
    }
}
