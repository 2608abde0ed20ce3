//! The interface on which processes of a group must agree: for programs of different versions in one
//! match, and for clients in other languages.

use crate::topics::{Topic, Visitor, visit_all};
use crate::{Described, Header, Message};
use serde::{Deserialize, Serialize};

/// Must rise when the shared state besides messages (stage pages, roster, the group's record) or the
/// location of iceoryx2's files changes.
const FILES_VERSION: u32 = 4;

/// Everything one program must share with another to work in the same group.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Interface {
    /// Version of the files in the runtime directory.
    pub files_version: u32,
    /// Message types of the topics.
    pub topics: Vec<TopicInterface>,
}

/// Message types of a topic.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TopicInterface {
    /// Name of the topic.
    pub topic: String,
    /// Versioned type name of an element.
    pub element: String,
    /// Size of an element in bytes.
    pub element_bytes: usize,
    /// Versioned type name of the header; `()` for none.
    pub header: String,
    /// Size of the header in bytes.
    pub header_bytes: usize,
}

impl Interface {
    /// The interface of this program.
    pub fn own() -> Self {
        struct Interfaces(Vec<TopicInterface>);
        impl Visitor for Interfaces {
            fn visit<E: Message + Described, H: Header + Described>(
                &mut self,
                topic: &'static Topic<E, H>,
            ) {
                self.0.push(of(topic));
            }
        }
        let mut interfaces = Interfaces(Vec::new());
        visit_all(&mut interfaces);
        let topics = interfaces.0;
        Self { files_version: FILES_VERSION, topics }
    }

    /// Readable reasons why processes with the two interfaces cannot work together; empty if they can.
    /// A topic that only one of them has is no conflict.
    pub fn conflicts_with(&self, other: &Self) -> Vec<String> {
        let mut conflicts = Vec::new();
        if self.files_version != other.files_version {
            conflicts.push(format!(
                "files in the runtime directory: version {} against {}",
                self.files_version, other.files_version
            ));
        }
        for topic in &self.topics {
            let counterpart = other.topics.iter().find(|there| there.topic == topic.topic);
            if let Some(there) = counterpart.filter(|there| *there != topic) {
                conflicts.push(format!("topic {}: {topic} against {there}", topic.topic));
            }
        }
        conflicts
    }
}

impl std::fmt::Display for TopicInterface {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({} bytes)", self.element, self.element_bytes)?;
        match self.header_bytes {
            0 => Ok(()),
            bytes => write!(f, " with {} ({bytes} bytes)", self.header),
        }
    }
}

fn of<E: Message, H: Header>(topic: &Topic<E, H>) -> TopicInterface {
    let names = topic.type_names();
    TopicInterface {
        topic: topic.name.to_string(),
        element: names.element.into(),
        element_bytes: size_of::<E>(),
        header: names.header.into(),
        header_bytes: size_of::<H>(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_named_and_additions_are_no_conflict() {
        let own = Interface::own();
        assert_eq!(own.conflicts_with(&own), Vec::<String>::new());

        let mut other = own.clone();
        other.topics.push(TopicInterface { topic: "new".into(), ..own.topics[0].clone() });
        assert!(own.conflicts_with(&other).is_empty() && other.conflicts_with(&own).is_empty());

        let world = other.topics.iter_mut().find(|topic| topic.topic == "world").unwrap();
        world.element = "touchline/WorldFrame/999".into();
        let [conflict] = &own.conflicts_with(&other)[..] else { panic!("one topic differs") };
        assert!(conflict.contains("world") && conflict.contains("WorldFrame/999"), "{conflict}");

        let other = Interface { files_version: own.files_version + 1, ..own.clone() };
        assert_eq!(own.conflicts_with(&other).len(), 1);
    }

    #[test]
    fn every_topic_has_a_versioned_name_and_all_are_listed() {
        let own = Interface::own();
        for topic in &own.topics {
            let versioned = |name: &str| {
                name.starts_with("touchline/")
                    && name
                        .rsplit_once("/")
                        .is_some_and(|(_, version)| version.parse::<u32>().is_ok())
            };
            assert!(topic.element == "u8" || versioned(&topic.element), "{topic}");
            assert!(topic.header_bytes == 0 || versioned(&topic.header), "{topic}");
        }
        let table = include_str!("topics.rs");
        let constants =
            table.matches("\npub const ").count() - table.matches("\npub const fn").count();
        assert_eq!(own.topics.len(), constants, "a topic of the table is missing here");
    }
}
