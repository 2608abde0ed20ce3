//! The table of protocols that are published.

use super::convert::{self, Scene};
use config::{PublishConfig, PublishedTopic};
use messages::{DetectionFrame, WorldFrame};
use protocols::Message;

/// A message to publish.
#[derive(Clone, Copy)]
pub enum Frame<'a> {
    /// From the tracker.
    Detections(&'a DetectionFrame),
    /// From the filter.
    World(&'a WorldFrame),
}

/// A protocol.
pub struct Protocol {
    /// Key of its section in `[publish]`.
    pub name: &'static str,
    /// The topic it is made from.
    pub topic: fn(&PublishConfig) -> PublishedTopic,
    /// The packet for a message; `t_sent_s` is the time of sending. `None` for a message of another topic.
    pub packet: fn(&Scene, Frame, t_sent_s: f64) -> Option<Vec<u8>>,
    /// The packet that is sent once a second besides, if there is one.
    pub every_second: fn(&Scene) -> Option<Vec<u8>>,
}

/// All protocols, in the order of [`PublishConfig::outputs`].
pub const TABLE: [Protocol; 5] = [
    Protocol {
        name: "ssl",
        topic: |publish| publish.ssl.from,
        packet: |scene, frame, t_sent_s| Some(detection(scene, frame, t_sent_s)),
        every_second: |scene| {
            let is_wanted = scene.config().publish.ssl.geometry;
            is_wanted.then(|| convert::geometry(scene).encode_to_vec())
        },
    },
    Protocol {
        name: "tracked",
        packet: |scene, frame, _| Some(convert::tracked(scene, world(frame)?).encode_to_vec()),
        ..OF_WORLD
    },
    Protocol {
        name: "firasim",
        packet: |scene, frame, _| Some(convert::environment(scene, world(frame)?).encode_to_vec()),
        ..OF_WORLD
    },
    Protocol {
        name: "vss",
        packet: |scene, frame, t_sent_s| Some(detection(scene, frame, t_sent_s)),
        ..OF_WORLD
    },
    Protocol {
        name: "json",
        packet: |_, frame, t_sent_s| Some(convert::json(world(frame)?, t_sent_s)),
        ..OF_WORLD
    },
];

/// A protocol that tells what the filter knows, and nothing besides.
const OF_WORLD: Protocol = Protocol {
    name: "",
    topic: |_| PublishedTopic::World,
    packet: |_, _, _| None,
    every_second: |_| None,
};

fn world(frame: Frame<'_>) -> Option<&WorldFrame> {
    match frame {
        Frame::World(world) => Some(world),
        Frame::Detections(_) => None,
    }
}

fn detection(scene: &Scene, frame: Frame, t_sent_s: f64) -> Vec<u8> {
    match frame {
        Frame::Detections(frame) => convert::of_detections(scene, frame, t_sent_s),
        Frame::World(world) => convert::of_world(scene, world, t_sent_s),
    }
    .encode_to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_protocol_has_its_section() {
        let publish = PublishConfig::default();
        assert_eq!(TABLE.map(|protocol| protocol.name), publish.outputs().map(|it| it.name));
    }
}
