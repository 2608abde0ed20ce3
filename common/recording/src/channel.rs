//! The channel table: what a recording may contain, and how each message is encoded and described.

use crate::image;
use crate::scene::{PoseInFrame, PosesInFrame, SceneUpdate};
use crate::setup::Setup;
use messages::structure::{Structure, structures_of};
use messages::topics;
use messages::{
    Commands, DetectionFrame, GroupEvent, Heartbeat, Run, RunsHeader, TruthFrame, WorldFrame,
};
use schemars::{JsonSchema, schema_for};
use serde::Serialize;

/// One channel of a recording; channels of topics have the topic's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Channel {
    /// [`Setup`], JSON; the first message, and one for each further configuration.
    Setup,
    /// Frames as `foxglove.RawImage`.
    Frames,
    /// Same as the topic: the header, then the valid runs.
    Runs,
    /// Same as the topic.
    Detections,
    /// Same as the topic.
    World,
    /// Same as the topic.
    Commands,
    /// Same as the topic.
    Truth,
    /// Same as the topic.
    Health,
    /// Same as the topic: what the supervisor saw and did, and moments that a person has marked.
    Events,
    /// The pitch, robots and ball of `world` as `foxglove.SceneUpdate`, for viewers.
    Scene,
    /// The robots of `world` as `foxglove.PosesInFrame`, for viewers.
    Robots,
    /// The ball of `world` as `foxglove.PoseInFrame`, for viewers.
    Ball,
}

/// Encoding of a channel's messages, in MCAP's terms.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Description {
    /// Encoding of messages.
    pub message_encoding: &'static str,
    /// Name of the schema.
    pub schema_name: String,
    /// Encoding of the schema.
    pub schema_encoding: &'static str,
    /// The schema.
    pub schema: Vec<u8>,
}

/// Name of the encoding of messages written in their memory layout, and of the schemas that describe
/// this layout (see [`MemorySchema`]).
pub const MEMORY: &str = "touchline-memory";

/// Schema of messages written in their memory layout, as JSON. Messages are little-endian and without
/// padding; bytes missing at the end are zero.
#[derive(Debug, Serialize)]
struct MemorySchema {
    /// Versioned type name of the element.
    type_name: String,
    /// Structure at the beginning of a message.
    message: String,
    /// Structure of the elements after it, up to the end of the message.
    #[serde(skip_serializing_if = "Option::is_none")]
    then: Option<String>,
    /// All structures.
    structures: Vec<Structure>,
}

impl Channel {
    /// All channels.
    pub const ALL: [Self; 12] = [
        Self::Setup,
        Self::Frames,
        Self::Runs,
        Self::Detections,
        Self::World,
        Self::Commands,
        Self::Truth,
        Self::Health,
        Self::Events,
        Self::Scene,
        Self::Robots,
        Self::Ball,
    ];

    /// Name in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Setup => "setup",
            Self::Frames => topics::FRAMES.name.base(),
            Self::Runs => topics::RUNS.name.base(),
            Self::Detections => topics::DETECTIONS.name.base(),
            Self::World => topics::WORLD.name.base(),
            Self::Commands => topics::COMMANDS.name.base(),
            Self::Truth => topics::TRUTH.name.base(),
            Self::Health => topics::HEALTH.name.base(),
            Self::Events => topics::EVENTS.name.base(),
            Self::Scene => "scene",
            Self::Robots => "robots",
            Self::Ball => "ball",
        }
    }

    /// The channel with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|channel| channel.name() == name)
    }

    /// Whether the channel is derived from `world`, for viewers only.
    pub fn is_derived(self) -> bool {
        matches!(self, Self::Scene | Self::Robots | Self::Ball)
    }

    /// Encoding and schema of its messages.
    pub fn description(self) -> Description {
        match self {
            Self::Setup => json::<Setup>("touchline.Setup"),
            Self::Frames => Description {
                message_encoding: "protobuf",
                schema_name: image::SCHEMA_NAME.into(),
                schema_encoding: "protobuf",
                schema: image::schema(),
            },
            Self::Runs => {
                let mut structures = structures_of::<RunsHeader>();
                structures.extend(structures_of::<Run>());
                let names = topics::RUNS.type_names();
                memory(names.header, "RunsHeader", Some("Run"), structures)
            }
            Self::Detections => single::<DetectionFrame>(topics::DETECTIONS.type_names().element),
            Self::World => single::<WorldFrame>(topics::WORLD.type_names().element),
            Self::Commands => single::<Commands>(topics::COMMANDS.type_names().element),
            Self::Truth => single::<TruthFrame>(topics::TRUTH.type_names().element),
            Self::Health => single::<Heartbeat>(topics::HEALTH.type_names().element),
            Self::Events => single::<GroupEvent>(topics::EVENTS.type_names().element),
            Self::Scene => json::<SceneUpdate>("foxglove.SceneUpdate"),
            Self::Robots => json::<PosesInFrame>("foxglove.PosesInFrame"),
            Self::Ball => json::<PoseInFrame>("foxglove.PoseInFrame"),
        }
    }
}

fn json<T: JsonSchema>(name: &str) -> Description {
    Description {
        message_encoding: "json",
        schema_name: name.into(),
        schema_encoding: "jsonschema",
        schema: serde_json::to_vec(&schema_for!(T)).unwrap_or_default(),
    }
}

fn single<T: JsonSchema>(type_name: &str) -> Description {
    memory(type_name, &T::schema_name(), None, structures_of::<T>())
}

fn memory(
    type_name: &str,
    message: &str,
    then: Option<&str>,
    structures: Vec<Structure>,
) -> Description {
    let schema = MemorySchema {
        type_name: type_name.into(),
        message: message.into(),
        then: then.map(Into::into),
        structures,
    };
    Description {
        message_encoding: MEMORY,
        schema_name: type_name.into(),
        schema_encoding: MEMORY,
        schema: serde_json::to_vec(&schema).unwrap_or_default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unambiguous_and_descriptions_complete() {
        for channel in Channel::ALL {
            assert_eq!(Channel::from_name(channel.name()), Some(channel));
            let description = channel.description();
            assert!(!description.schema.is_empty(), "{channel:?}");
        }
        let world = Channel::World.description();
        assert_eq!(world.schema_name, "touchline/WorldFrame/5");
        assert!(String::from_utf8(world.schema).unwrap().contains("prior_world_seq"));
    }
}
