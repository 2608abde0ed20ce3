//! `touchline topics`: prints what a program needs to attach to a group.

mod c;
mod python;

use super::CommandError;
use crate::cli::{TopicsArgs, TopicsFormat};
use client::bus::{Bus, BusError, Subscriber};
use client::instance::Instance;
use messages::structure::{Structure, structures_of};
use messages::topics::{Topic, Visitor, visit_all};
use messages::{Header, Message};
use schemars::JsonSchema;
use serde::Serialize;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Time between two reads: shorter than the time in which any buffer fills.
const POLL: Duration = Duration::from_millis(2);

/// Description of a topic.
#[derive(Debug, Serialize)]
struct Row {
    /// Name of the iceoryx2 service.
    name: &'static str,
    writer: &'static str,
    readers: &'static str,
    /// Type name of an element of the payload, which is a slice.
    element: &'static str,
    element_bytes: usize,
    /// Type name of the user header; `()` for none.
    header: &'static str,
    header_bytes: usize,
    /// Unread messages kept for each reader.
    buffer: usize,
    history: usize,
    /// Whether there is an iceoryx2 event of the same name, to wait on.
    notifies: bool,
    max_publishers: usize,
    max_subscribers: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    live: Option<Live>,
}

/// Activity on a topic.
#[derive(Debug, Serialize)]
struct Live {
    /// Writers connected, spares included.
    publishers: usize,
    /// Readers connected, spares included, without this program.
    subscribers: usize,
    messages_per_s: f64,
    /// Number of elements of the newest message.
    elements: Option<usize>,
}

/// The output of `--json`.
#[derive(Debug, Serialize)]
struct Document {
    instance: String,
    is_running: bool,
    /// For `iox2.config`: the place of the group's services, if it runs.
    iceoryx2: Option<Iceoryx2>,
    topics: Vec<Row>,
}

#[derive(Debug, Serialize)]
struct Iceoryx2 {
    version: &'static str,
    root_path: String,
    prefix: String,
}

/// Prints the topics in the requested format.
pub fn topics(args: TopicsArgs) -> Result<ExitCode, CommandError> {
    let instance = Instance::new(&args.instance.instance)?;
    match args.format {
        Some(TopicsFormat::Python) => runtime::say!("{}", python::module(&collect_types()))?,
        Some(TopicsFormat::C) => runtime::say!("{}", c::header(&collect_types()))?,
        Some(TopicsFormat::Config) => runtime::say!("{}", ipc_toml(&instance)?)?,
        None if args.json => {
            let document = document(&instance, args.seconds)?;
            runtime::say_line!("{}", serde_json::to_string_pretty(&document)?)?
        }
        None => runtime::say!("{}", text(&document(&instance, args.seconds)?))?,
    };
    Ok(ExitCode::SUCCESS)
}

fn document(instance: &Instance, seconds: f64) -> Result<Document, CommandError> {
    let is_running = instance.is_supervised();
    let topics = if is_running { measure(instance, seconds)? } else { rows() };
    let iceoryx2 = instance.namespace()?.map(|namespace| Iceoryx2 {
        version: "0.10",
        root_path: namespace.directory().display().to_string(),
        prefix: namespace.prefix().into(),
    });
    Ok(Document { instance: instance.name().into(), is_running, iceoryx2, topics })
}

/// The configuration file for other iceoryx2 programs: their default, with the place of this group.
fn ipc_toml(instance: &Instance) -> Result<String, CommandError> {
    let Some(namespace) = instance.namespace()? else {
        let name = instance.name();
        return Err(format!(
            "no group {name:?} is running, and where one is in shared memory is drawn when it starts; \
             start one with `touchline run`"
        )
        .into());
    };
    Ok(format!(
        "# iceoryx2 0.10 configuration to attach to the Touchline group {:?}\n{}",
        instance.name(),
        toml::to_string(&namespace.ipc_config()?)?
    ))
}

fn row<E: Message, H: Header>(topic: &'static Topic<E, H>) -> Row {
    let names = topic.type_names();
    Row {
        name: topic.name.base(),
        writer: topic.writer,
        readers: topic.readers,
        element: names.element,
        element_bytes: size_of::<E>(),
        header: names.header,
        header_bytes: size_of::<H>(),
        buffer: topic.buffer,
        history: topic.history,
        notifies: topic.notifies,
        max_publishers: topic.publishers,
        max_subscribers: topic.subscribers,
        live: None,
    }
}

fn rows() -> Vec<Row> {
    struct Rows(Vec<Row>);
    impl Visitor for Rows {
        fn visit<E: Message + JsonSchema, H: Header + JsonSchema>(
            &mut self,
            topic: &'static Topic<E, H>,
        ) {
            self.0.push(row(topic));
        }
    }
    let mut rows = Rows(Vec::new());
    visit_all(&mut rows);
    rows.0
}

/// Counts messages on a topic of any type.
trait Counter {
    /// Reads new messages; returns their number, and the number of elements of the newest one.
    fn count(&mut self) -> Result<(u64, Option<usize>), BusError>;
}

impl<E: Message, H: Header> Counter for Subscriber<E, H> {
    fn count(&mut self) -> Result<(u64, Option<usize>), BusError> {
        let (mut messages, mut elements) = (0, None);
        while let Some(received) = self.receive()? {
            messages += 1;
            elements = Some(received.elements().len());
        }
        Ok((messages, elements))
    }
}

struct Measured {
    row: Row,
    counter: Box<dyn Counter>,
    messages: u64,
}

struct Measuring<'a> {
    bus: &'a Bus,
    topics: Vec<Result<Measured, BusError>>,
}

impl Measuring<'_> {
    fn connect<E: Message, H: Header>(
        &self,
        topic: &'static Topic<E, H>,
    ) -> Result<Measured, BusError> {
        let connected = self.bus.population(topic)?;
        let mut row = row(topic);
        row.live = Some(Live {
            publishers: connected.publishers,
            subscribers: connected.subscribers,
            messages_per_s: 0.0,
            elements: None,
        });
        let counter = Box::new(self.bus.subscriber(topic)?);
        Ok(Measured { row, counter, messages: 0 })
    }
}

impl Visitor for Measuring<'_> {
    fn visit<E: Message + JsonSchema, H: Header + JsonSchema>(
        &mut self,
        topic: &'static Topic<E, H>,
    ) {
        let measured = self.connect(topic);
        self.topics.push(measured);
    }
}

fn measure(instance: &Instance, seconds: f64) -> Result<Vec<Row>, BusError> {
    let bus = Bus::join(instance, "topics")?;
    let mut measuring = Measuring { bus: &bus, topics: Vec::new() };
    visit_all(&mut measuring);
    let mut topics = measuring.topics.into_iter().collect::<Result<Vec<_>, _>>()?;
    let began = Instant::now();
    while began.elapsed().as_secs_f64() < seconds {
        std::thread::sleep(POLL);
        for topic in &mut topics {
            let (messages, elements) = topic.counter.count()?;
            topic.messages += messages;
            if let Some(live) = &mut topic.row.live {
                live.elements = elements.or(live.elements);
            }
        }
    }
    let elapsed_s = began.elapsed().as_secs_f64();
    Ok(topics
        .into_iter()
        .map(|topic| {
            let mut row = topic.row;
            if let Some(live) = &mut row.live {
                live.messages_per_s = (topic.messages as f64 / elapsed_s * 10.0).round() / 10.0;
            }
            row
        })
        .collect())
}

fn text(document: &Document) -> String {
    let Document { instance, is_running, iceoryx2, topics } = document;
    let state = if *is_running { "is running" } else { "is not running" };
    let mut text = format!("the group {instance:?} {state}\n\n");
    text += &format!(
        "  {:<12}{:>8}{:>9}{:>9}  {:<28}{:>8}  {}\n",
        "topic", "a second", "writers", "readers", "element", "bytes", "header"
    );
    for row in topics {
        let live = row.live.as_ref();
        let or_dash = |text: Option<String>| text.unwrap_or("–".into());
        text += &format!(
            "  {:<12}{:>8}{:>9}{:>9}  {:<28}{:>8}  {}\n",
            row.name,
            or_dash(live.map(|live| format!("{:.1}", live.messages_per_s))),
            or_dash(live.map(|live| live.publishers.to_string())),
            or_dash(live.map(|live| live.subscribers.to_string())),
            row.element,
            row.element_bytes,
            if row.header == "()" { "" } else { row.header },
        );
    }
    if let Some(Iceoryx2 { version, root_path, prefix }) = iceoryx2 {
        text += &format!(
            "\n  iceoryx2 {version}: root path {root_path}, prefix {prefix}\n  a configuration file for \
             other iceoryx2 programs: touchline topics --format config --instance {instance}\n"
        );
    }
    text
}

/// The types from which files are generated.
#[derive(Debug)]
struct Types {
    /// Each structure follows its parts.
    structures: Vec<Structure>,
    topics: Vec<Row>,
}

impl Types {
    /// The versioned name of a structure that is an element or a header; `None` for a part.
    fn type_name(&self, structure: &Structure) -> Option<&'static str> {
        let names = self.topics.iter().flat_map(|row| [row.element, row.header]);
        names.into_iter().find(|name| structure_name(name) == structure.name)
    }
}

/// The structure's name: `World` for `touchline/World/1`.
fn structure_name(type_name: &str) -> &str {
    type_name.split('/').nth(1).unwrap_or(type_name)
}

fn collect_types() -> Types {
    struct Found(Vec<Structure>);
    impl Found {
        fn add<T: JsonSchema + 'static>(&mut self) {
            use std::any::TypeId;
            // Bytes and `()` are not structures.
            if [TypeId::of::<u8>(), TypeId::of::<()>()].contains(&TypeId::of::<T>()) {
                return;
            }
            for structure in structures_of::<T>() {
                if !self.0.iter().any(|known| known.name == structure.name) {
                    self.0.push(structure);
                }
            }
        }
    }
    impl Visitor for Found {
        fn visit<E: Message + JsonSchema, H: Header + JsonSchema>(
            &mut self,
            _: &'static Topic<E, H>,
        ) {
            self.add::<H>();
            self.add::<E>();
        }
    }
    let mut found = Found(Vec::new());
    visit_all(&mut found);
    Types { structures: found.0, topics: rows() }
}

/// Enumerations, as `(enumeration, [(name, number)])`.
fn enumerations() -> Vec<(&'static str, Vec<(String, u64)>)> {
    use messages::*;
    fn list<T: Copy + std::fmt::Debug>(
        items: impl IntoIterator<Item = T>,
        number: impl Fn(T) -> u64,
    ) -> Vec<(String, u64)> {
        items.into_iter().map(|item| (format!("{item:?}"), number(item))).collect()
    }
    vec![
        ("Team", list(Team::ALL, |item| item as u64)),
        ("TrackStatus", list((0..16).filter_map(TrackStatus::from_number), |item| item as u64)),
        ("PixelFormat", list(PixelFormat::ALL, |item| item as u64)),
        ("BayerOrder", list(BayerOrder::ALL, |item| item as u64)),
        ("RejectReason", list(RejectReason::ALL, |item| item as u64)),
        ("ProcessKind", list(ProcessKind::ALL, |item| item as u64)),
        ("Attendant", list(Attendant::ALL, |item| item as u64)),
        ("ProcessState", list((0..16).filter_map(ProcessState::from_number), |item| item as u64)),
        ("DropReason", list(DropReason::ALL, |item| item as u64)),
        ("EventKind", list(EventKind::ALL, |item| item as u64)),
        ("CameraState", list(CameraState::ALL, |item| item as u64)),
    ]
}

/// A field's name; `class` is renamed because it is a keyword.
fn field_name(name: &str) -> &str {
    if name == "class" { "class_" } else { name }
}

/// `TOO_SMALL` for `TooSmall`.
fn upper_case(name: &str) -> String {
    let mut upper = String::new();
    for (index, letter) in name.chars().enumerate() {
        if index > 0 && letter.is_uppercase() {
            upper.push('_');
        }
        upper.extend(letter.to_uppercase());
    }
    upper
}
