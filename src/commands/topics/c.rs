//! The messages as a header file for C and C++.

use super::{Types, enumerations, field_name, upper_case};
use std::fmt::Write;

const HEAD: &str = "\
/* The messages of Touchline, as they lie in shared memory.
 *
 * Made by `touchline topics --format c`; a test compares. Do not edit.
 */
#ifndef TOUCHLINE_H
#define TOUCHLINE_H

#include <stdint.h>

#ifdef __cplusplus
#define TOUCHLINE_CHECK(condition) static_assert(condition, #condition)
#else
#define TOUCHLINE_CHECK(condition) _Static_assert(condition, #condition)
#endif

/* A number that stands for none. */
#define TOUCHLINE_NONE UINT64_MAX

";

/// The text of the header.
pub fn header(types: &Types) -> String {
    let mut text = String::from(HEAD);
    // Writing to a string cannot fail.
    let _ = write_header(types, &mut text);
    text
}

fn write_header(types: &Types, text: &mut String) -> std::fmt::Result {
    for (name, items) in enumerations() {
        writeln!(text, "enum Touchline{name} {{")?;
        for (item, number) in items {
            let prefix = upper_case(name);
            writeln!(text, "    TOUCHLINE_{prefix}_{} = {number},", upper_case(&item))?;
        }
        writeln!(text, "}};\n")?;
    }
    for structure in &types.structures {
        writeln!(text, "/* {} */", structure.doc)?;
        writeln!(text, "typedef struct Touchline{} {{", structure.name)?;
        for field in &structure.fields {
            let count = field.count.map(|count| format!("[{count}]")).unwrap_or_default();
            writeln!(text, "    /* {} */", field.doc)?;
            writeln!(text, "    {} {}{count};", kind(&field.kind), field_name(&field.name))?;
        }
        writeln!(text, "}} Touchline{};\n", structure.name)?;
        writeln!(
            text,
            "TOUCHLINE_CHECK(sizeof(Touchline{}) == {});",
            structure.name, structure.size
        )?;
        if let Some(type_name) = types.type_name(structure) {
            let name = upper_case(&structure.name);
            writeln!(text, "#define TOUCHLINE_{name}_TYPE_NAME \"{type_name}\"")?;
        }
        writeln!(text)?;
    }
    writeln!(text, "/* Topics: name, element, header. A message is a slice of elements.")?;
    for row in &types.topics {
        writeln!(text, " * {:<12} {:<28} {}", row.name, row.element, row.header)?;
    }
    writeln!(text, " */\n\n#endif")
}

fn kind(kind: &str) -> String {
    match kind {
        "u8" => "uint8_t".into(),
        "u16" => "uint16_t".into(),
        "u32" => "uint32_t".into(),
        "u64" => "uint64_t".into(),
        "f32" => "float".into(),
        "f64" => "double".into(),
        structure => format!("Touchline{structure}"),
    }
}
