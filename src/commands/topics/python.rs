//! The messages as a Python module.

use super::{Types, enumerations, field_name, upper_case};
use std::fmt::Write;

const HEAD: &str = r#""""The messages of Touchline, as they lie in shared memory.

Made by `touchline topics --format python`; a test compares. Do not edit.
"""

import ctypes
import enum
from typing import NamedTuple

"#;

const TAIL: &str = r#"
class Topic(NamedTuple):
    """A topic: a message is a slice of elements with a header beside it."""

    name: str
    element: type
    header: type | None
    history: int
    notifies: bool


def unpack(structure: type, data: bytes):
    """A message of a recording; bytes missing at its end are zeros."""
    return structure.from_buffer_copy(data.ljust(ctypes.sizeof(structure), b"\0"))

"#;

/// The text of the module.
pub fn module(types: &Types) -> String {
    let mut text = String::from(HEAD);
    // Writing to a string cannot fail.
    let _ = write_module(types, &mut text);
    text
}

fn write_module(types: &Types, text: &mut String) -> std::fmt::Result {
    for (name, items) in enumerations() {
        writeln!(text, "\nclass {name}(enum.IntEnum):")?;
        for (item, number) in items {
            writeln!(text, "    {} = {number}", upper_case(&item))?;
        }
        writeln!(text)?;
    }
    writeln!(text, "\nNONE = {} # a number that stands for none\n", u64::MAX)?;
    for structure in &types.structures {
        writeln!(text, "\nclass {}(ctypes.Structure):", structure.name)?;
        writeln!(text, "    \"\"\"{}\"\"\"\n", structure.doc)?;
        writeln!(text, "    _fields_ = [")?;
        for field in &structure.fields {
            let count = field.count.map(|count| format!(" * {count}")).unwrap_or_default();
            writeln!(
                text,
                "        (\"{}\", {}{count}),",
                field_name(&field.name),
                kind(&field.kind)
            )?;
        }
        writeln!(text, "    ]\n")?;
        if let Some(type_name) = types.type_name(structure) {
            writeln!(
                text,
                "    @staticmethod\n    def type_name():\n        return \"{type_name}\"\n"
            )?;
        }
        writeln!(text, "\nassert ctypes.sizeof({}) == {}\n", structure.name, structure.size)?;
    }
    text.push_str(TAIL);
    writeln!(text, "\nTOPICS = {{")?;
    for row in &types.topics {
        let class = |type_name: &'static str| match type_name {
            "()" => "None".to_string(),
            "u8" => "ctypes.c_uint8".to_string(),
            other => super::structure_name(other).to_string(),
        };
        writeln!(
            text,
            "    \"{0}\": Topic(\"{0}\", {1}, {2}, {3}, {4}),",
            row.name,
            class(row.element),
            class(row.header),
            row.history,
            if row.notifies { "True" } else { "False" },
        )?;
    }
    writeln!(text, "}}")
}

fn kind(kind: &str) -> String {
    match kind {
        "u8" => "ctypes.c_uint8".into(),
        "u16" => "ctypes.c_uint16".into(),
        "u32" => "ctypes.c_uint32".into(),
        "u64" => "ctypes.c_uint64".into(),
        "f32" => "ctypes.c_float".into(),
        "f64" => "ctypes.c_double".into(),
        structure => structure.into(),
    }
}
