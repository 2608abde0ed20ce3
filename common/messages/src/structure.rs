//! Memory layout of messages, for programs in other languages: derived from the Rust definitions, so
//! that no description can drift from them.
//!
//! Messages have no padding, so the offset of a field is the sum of the sizes before it.

use crate::RobotId;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::Serialize;
use serde_json::Value;
use std::borrow::Cow;
use std::marker::PhantomData;

/// A message or a part of one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Structure {
    /// Name here and in the generated files.
    pub name: String,
    /// Documentation text.
    #[serde(skip)]
    pub doc: String,
    /// Size in bytes.
    pub size: usize,
    /// Fields in memory order, without gaps.
    pub fields: Vec<Field>,
}

/// A field of a structure.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Field {
    /// Field name.
    pub name: String,
    /// Documentation text.
    #[serde(skip)]
    pub doc: String,
    /// Type: a name in [`PRIMITIVES`], or the name of another structure.
    #[serde(rename = "type")]
    pub kind: String,
    /// Number of elements of an array; `None` for a single one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub count: Option<usize>,
    /// Bytes from the start of the structure.
    pub offset: usize,
}

/// The number types of messages, and their sizes in bytes.
pub const PRIMITIVES: [(&str, usize); 6] =
    [("u8", 1), ("u16", 2), ("u32", 4), ("u64", 8), ("f32", 4), ("f64", 8)];

/// Described in messages as a plain `u32`.
impl JsonSchema for RobotId {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        u32::schema_name()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        u32::json_schema(generator)
    }
}

/// Stands for `[T; N]` in schemas when `N` is larger than schemars supports.
#[derive(Debug)]
pub struct List<T, const N: usize>(PhantomData<T>);

impl<T: JsonSchema, const N: usize> JsonSchema for List<T, N> {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        format!("List_of_{N}_{}", T::schema_name()).into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "type": "array",
            "items": Value::from(generator.subschema_for::<T>()),
            "minItems": N,
            "maxItems": N,
        })
    }
}

/// Describes a message and all structures in it: parts first, the message itself last.
///
/// # Panics
///
/// If the message contains a type that cannot be described here, or its size differs from the sum of
/// its parts. Either is a mistake in its definition, found by the tests.
pub fn structures_of<T: JsonSchema>() -> Vec<Structure> {
    let schema = Value::from(SchemaGenerator::default().into_root_schema_for::<T>());
    let mut found = Vec::new();
    describe(&T::schema_name(), &schema, &schema["$defs"], &mut found);
    let size = found.last().map(|structure| structure.size);
    assert_eq!(size, Some(size_of::<T>()), "the parts of {} do not add up", T::schema_name());
    found
}

/// The name of the field at an offset in the last of these structures, such as `robots[3].x_mm`.
pub fn name_at(structures: &[Structure], offset: usize) -> String {
    let mut structure = structures.last();
    let (mut name, mut rest) = (String::new(), offset);
    while let Some(here) = structure
        && let Some(field) = here.fields.iter().rev().find(|field| field.offset <= rest)
    {
        if !name.is_empty() {
            name.push('.');
        }
        name.push_str(&field.name);
        rest -= field.offset;
        structure = structures.iter().find(|structure| structure.name == field.kind);
        if field.count.is_some() {
            let primitive = PRIMITIVES.iter().find(|(name, _)| *name == field.kind);
            let size = structure.map_or(primitive.map_or(1, |p| p.1), |s| s.size).max(1);
            name.push_str(&format!("[{}]", rest / size));
            rest %= size;
        }
    }
    name
}

fn describe(name: &str, schema: &Value, definitions: &Value, found: &mut Vec<Structure>) {
    if found.iter().any(|structure| structure.name == name) {
        return;
    }
    let mut fields = Vec::new();
    let mut offset = 0;
    for (field, schema) in schema["properties"].as_object().into_iter().flatten() {
        let count = schema["minItems"].as_u64().map(|count| count as usize);
        let item = if count.is_some() { &schema["items"] } else { schema };
        let kind = kind_of(item)
            .unwrap_or_else(|| panic!("{name}.{field} is nothing that a message can hold: {item}"));
        let size = size_of_kind(&kind, definitions, found);
        let doc = text(schema);
        fields.push(Field { name: field.clone(), doc, kind, count, offset });
        offset += size * count.unwrap_or(1);
    }
    found.push(Structure { name: name.into(), doc: text(schema), size: offset, fields });
}

fn kind_of(schema: &Value) -> Option<String> {
    if let Some(reference) = schema["$ref"].as_str() {
        return Some(reference.strip_prefix("#/$defs/")?.to_string());
    }
    let kind = match schema["format"].as_str()? {
        "uint8" => "u8",
        "uint16" => "u16",
        "uint32" => "u32",
        "uint64" => "u64",
        "float" => "f32",
        "double" => "f64",
        _ => return None,
    };
    Some(kind.to_string())
}

fn size_of_kind(kind: &str, definitions: &Value, found: &mut Vec<Structure>) -> usize {
    if let Some((_, size)) = PRIMITIVES.iter().find(|(name, _)| *name == kind) {
        return *size;
    }
    describe(kind, &definitions[kind], definitions, found);
    let structure = found.iter().find(|structure| structure.name == kind);
    structure.map_or(0, |structure| structure.size)
}

/// The description without Rust's documentation markup.
fn text(schema: &Value) -> String {
    let text = schema["description"].as_str().unwrap_or("");
    let mut plain = String::with_capacity(text.len());
    let mut rest = text;
    // [`name`](path) and [`name`] become name.
    while let Some(start) = rest.find("[`") {
        let Some(end) = rest[start..].find("`]") else { break };
        plain.push_str(&rest[..start]);
        plain.push_str(&rest[start + 2..start + end]);
        rest = &rest[start + end + 2..];
        if let Some(after) = rest.strip_prefix('(') {
            rest = after.split_once(')').map_or(after, |(_, after)| after);
        }
    }
    plain.push_str(rest);
    plain.replace('`', "").split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::super::*;
    use super::*;
    use std::mem::offset_of;

    #[test]
    fn offsets_are_those_of_the_compiler() {
        let structures = structures_of::<DetectionFrame>();
        let names: Vec<&str> = structures.iter().map(|s| s.name.as_str()).collect();
        let expected = [
            "FrameHeader",
            "DetectedRobot",
            "DetectedBall",
            "Rejected",
            "Region",
            "Run",
            "DetectionFrame",
        ];
        assert_eq!(names, expected);
        let detections = structures.last().unwrap();
        let offset = |name: &str| detections.fields.iter().find(|f| f.name == name).unwrap().offset;
        assert_eq!(offset("prior_world_seq"), offset_of!(DetectionFrame, prior_world_seq));
        assert_eq!(offset("regions"), offset_of!(DetectionFrame, regions));
        assert_eq!(offset("runs"), offset_of!(DetectionFrame, runs));
        let runs = detections.fields.last().unwrap();
        assert_eq!((runs.kind.as_str(), runs.count), ("Run", Some(MAX_RUNS)));
        let second_end = offset_of!(DetectionFrame, runs) + size_of::<Run>() + offset_of!(Run, end);
        assert_eq!(name_at(&structures, second_end), "runs[1].end");
        assert_eq!(name_at(&structures, 1), "frame.seq");
        assert_eq!(runs.doc, "The pixels of the regions, region by region.");
    }

    #[test]
    fn every_message_can_be_described() {
        structures_of::<RunsHeader>();
        structures_of::<WorldFrame>();
        structures_of::<Commands>();
        structures_of::<TruthFrame>();
        structures_of::<Heartbeat>();
        structures_of::<StatusHeader>();
    }

    #[test]
    fn comments_lose_their_marks() {
        let schema = json_schema!({ "description": "A [`Team`](super::Team) number,\nor `0`." });
        assert_eq!(text(schema.as_value()), "A Team number, or 0.");
    }
}
