//! The configuration as a document: commented TOML, and the JSON schema.
//!
//! Both are generated from the structures in `mod.rs` through the schema, so new keys appear
//! automatically.

use super::Config;
use super::problem::key_path;
use super::schema::{Node, Schema};
use serde_json::Value as Json;
use toml::Value;

/// The configuration as a commented TOML file: every key with its description above it, in the order of
/// the structures. Parsing it gives the same configuration.
pub fn commented_toml(config: &Config) -> String {
    let values = table(config);
    let schema = Schema::new();
    let mut out = String::from(HEADER);
    write_table(&mut out, schema.root(), &values, "", Comments::Full);
    out
}

/// The configuration as a TOML table.
///
/// TOML's integers end at 2⁶³ − 1. A larger seed, which no file can contain, becomes that number.
pub(crate) fn table(config: &Config) -> toml::Table {
    let mut config = config.clone();
    config.synthetic.seed = config.synthetic.seed.min(i64::MAX as u64);
    toml::Table::try_from(&config).expect("a configuration is plain TOML")
}

/// The JSON schema of the configuration: types, bounds, descriptions and defaults.
pub fn schema_json() -> String {
    format!("{:#}\n", Schema::new().document())
}

const HEADER: &str = "\
# Touchline configuration.
#
# All keys are listed. A deleted key has the preset's value; a list replaces the preset's list as a
# whole. So a change of `preset` affects only keys that are deleted here.
# `touchline config init --preset NAME` writes another preset's file.
# `touchline config check FILE` checks a file.
";

/// Longest line of comments and lists.
const WIDTH: usize = 96;
/// Tables in a list with at most this many keys are written in one line each, others as [[tables]].
const MAX_INLINE_KEYS: usize = 3;

/// Amount of comments.
#[derive(Clone, Copy, PartialEq)]
enum Comments {
    /// Every key, with blank lines between.
    Full,
    /// Every key, without blank lines: the first table of a list.
    Close,
    /// No comments: the other tables of a list.
    None,
}

/// Writes the keys of a table, then the tables in it.
fn write_table(out: &mut String, node: Node, table: &toml::Table, path: &str, comments: Comments) {
    let mut first = !path.is_empty();
    for (key, property) in node.properties() {
        let value = table.get(key);
        if value.is_some_and(is_section) {
            continue;
        }
        // No blank line between a heading and its first key.
        if comments == Comments::Full && !first {
            out.push('\n');
        }
        first = false;
        if comments != Comments::None {
            write_comment(out, "", property.description());
            write_legend(out, property);
        }
        match (value, property.example()) {
            (Some(value), _) => {
                out.push_str(&format!("{key} = {}\n", list_or_scalar(property, value, key)))
            }
            (None, Some(example)) if comments != Comments::None => {
                let example = Value::try_from(example).expect("examples are plain values");
                out.push_str(&format!("#{key} = {}\n", inline(Some(property), &example)));
            }
            (None, _) => {}
        }
    }
    if node.values().is_some() {
        for (key, value) in table {
            out.push_str(&format!("{} = {}\n", written_key(key), inline(None, value)));
        }
    }
    for (key, property) in node.properties() {
        match table.get(key) {
            Some(Value::Table(section)) => {
                write_gap(out, path);
                let path = key_path(path, key);
                write_comment(out, "", property.description());
                out.push_str(&format!("[{path}]\n"));
                write_table(out, property, section, &path, comments);
            }
            Some(value @ Value::Array(elements)) if is_section(value) => {
                write_gap(out, path);
                let path = key_path(path, key);
                write_comment(out, "", property.description());
                for (index, element) in elements.iter().enumerate() {
                    let (Value::Table(element), Some(node)) = (element, property.element()) else {
                        continue;
                    };
                    out.push_str(if index == 0 { "" } else { "\n" });
                    out.push_str(&format!("[[{path}]]\n"));
                    let comments = if index == 0 { Comments::Close } else { Comments::None };
                    write_table(out, node, element, &path, comments);
                }
            }
            _ => {}
        }
    }
}

/// The key, quoted if TOML requires it.
fn written_key(key: &str) -> String {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "_-".contains(letter);
    if !key.is_empty() && key.chars().all(is_plain) {
        key.to_string()
    } else {
        // Quoted as in JSON: TOML's multi-line strings, which its writer prefers, cannot be keys.
        Json::from(key).to_string().replace('\u{7f}', "\\u007f")
    }
}

/// Top-level sections are separated by two blank lines.
fn write_gap(out: &mut String, parent: &str) {
    out.push_str(if parent.is_empty() { "\n\n" } else { "\n" });
}

/// Whether a key gets its own heading, and so must follow the simple keys.
fn is_section(value: &Value) -> bool {
    match value {
        Value::Table(_) => true,
        Value::Array(elements) => {
            let keys = |element: &Value| element.as_table().map_or(0, toml::Table::len);
            elements.iter().any(|element| keys(element) > MAX_INLINE_KEYS)
        }
        _ => false,
    }
}

/// Describes the keys of a list's elements when these are written in one line each.
fn write_legend(out: &mut String, property: Node) {
    let Some(element) = property.element() else { return };
    let width = element.properties().map(|(key, _)| key.len()).max().unwrap_or(0);
    for (key, property) in element.properties() {
        write_comment(out, &format!("  {key:width$}  "), property.description());
    }
}

/// Writes a comment with wrapped lines; continuation lines are indented by the length of `head`.
fn write_comment(out: &mut String, head: &str, text: &str) {
    let indent = head.chars().count();
    let mut line = format!("# {head}");
    let mut empty = true;
    for word in text.split_whitespace() {
        if !empty && line.chars().count() + 1 + word.chars().count() > WIDTH {
            out.push_str(line.trim_end());
            out.push('\n');
            line = format!("# {:indent$}", "");
            empty = true;
        }
        if !empty {
            line.push(' ');
        }
        line.push_str(word);
        empty = false;
    }
    if !text.is_empty() {
        out.push_str(line.trim_end());
        out.push('\n');
    }
}

/// The value for `key =`. A list that does not fit into the line, or a list of tables, gets one line
/// per element.
fn list_or_scalar(node: Node, value: &Value, key: &str) -> String {
    let one_line = inline(Some(node), value);
    match value {
        Value::Array(elements)
            if elements.first().is_some_and(Value::is_table)
                || key.len() + 3 + one_line.chars().count() > WIDTH =>
        {
            let line = |element| format!("    {},\n", inline(node.element(), element));
            format!("[\n{}]", elements.iter().map(line).collect::<String>())
        }
        _ => one_line,
    }
}

/// A value in one line; the schema gives the order of a table's keys.
fn inline(node: Option<Node>, value: &Value) -> String {
    match value {
        // 2200 instead of 2200.0. Both are read as the same number up to the largest TOML integer.
        Value::Float(number) if number.fract() == 0.0 && number.abs() < 1e15 => {
            format!("{number}")
        }
        Value::Array(elements) => {
            let element = node.and_then(Node::element);
            let elements: Vec<String> =
                elements.iter().map(|value| inline(element, value)).collect();
            format!("[{}]", elements.join(", "))
        }
        Value::Table(table) => {
            let entry = |(key, property)| {
                Some(format!("{key} = {}", inline(Some(property), table.get(key)?)))
            };
            let properties = node.into_iter().flat_map(Node::properties);
            let entries: Vec<String> = properties.filter_map(entry).collect();
            format!("{{ {} }}", entries.join(", "))
        }
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ColorConfig, Preset, SettingValue};
    use proptest::prelude::*;

    #[test]
    fn reading_what_was_written_gives_the_same_configuration() {
        for preset in Preset::ALL {
            let config = preset.config();
            let text = commented_toml(&config);
            assert_eq!(Config::parse(&text, preset.name()).unwrap(), config);
        }
    }

    #[test]
    fn every_key_is_there_and_explained() {
        let text = commented_toml(&Config::default());
        let lines: Vec<&str> = text.lines().collect();
        let values = toml::Table::try_from(Config::default()).unwrap();
        for (section, keys) in
            values.iter().filter_map(|(key, value)| Some((key, value.as_table()?)))
        {
            let heading = lines.iter().position(|line| *line == format!("[{section}]")).unwrap();
            assert!(lines[heading - 1].starts_with("# "), "[{section}] is not explained");
            for (key, _) in keys.iter().filter(|(_, value)| !value.is_table()) {
                let line =
                    lines[heading..].iter().position(|l| l.starts_with(&format!("{key} = ")));
                let line = heading + line.unwrap_or_else(|| panic!("{section}.{key} is missing"));
                assert!(lines[line - 1].starts_with("# "), "{section}.{key} is not explained");
            }
        }
        for optional in ["#hue_deg = [350, 20]", "#saturation = [0.4, 1]"] {
            assert_eq!(lines.iter().filter(|line| **line == optional).count(), 1, "{optional}");
        }
        assert!(lines.iter().all(|line| line.chars().count() <= 100));
    }

    #[test]
    fn it_looks_like_a_file_that_a_person_wrote() {
        let text = commented_toml(&Config::default());
        assert!(text.contains(
            "\n\n\
             # The camera's picture.\n\
             [camera]\n\
             # Pixels in a row.\n\
             width = 640\n\
             \n\
             # Rows.\n\
             height = 480\n"
        ));
        assert!(text.contains(
            "\n\
             #   team       \"yellow\" or \"blue\".\n\
             #   id         Number in the team.\n\
             #   colors     One colour for each identification patch, in the order of the patches.\n\
             #   patches    Patches of this robot, if they differ from `robots.patches`: robots may be\n\
             #              distinguished by shapes.\n\
             #   height_mm  Height of its top above the floor, if it differs from its team's.\n\
             identities = [\n    \
                 { team = \"yellow\", id = 0, colors = [\"green\"] },\n"
        ));
        assert!(text.contains(
            "\n\n\
             [[colors]]\n\
             name = \"yellow\"\n\
             red = [115, 255]\n\
             green = [113, 255]\n\
             blue = [0, 75]\n\
             looks = [225, 205, 40]\n\
             \n\
             [[colors]]\n"
        ));
    }

    #[test]
    fn empty_lists_survive() {
        let mut config = Config::default();
        config.colors.clear();
        config.robots.identities.clear();
        assert_eq!(toml::from_str::<Config>(&commented_toml(&config)).unwrap(), config);
    }

    #[test]
    fn the_schema_describes_the_configuration() {
        let schema: serde_json::Value = serde_json::from_str(&schema_json()).unwrap();
        assert_eq!(schema["properties"]["preset"]["default"], "mirosot-5v5");
        let fps = &schema["$defs"]["CameraConfig"]["properties"]["fps"];
        assert_eq!(fps["description"], "Frames a second.");
        assert_eq!((&fps["default"], &fps["maximum"]), (&80.0.into(), &10_000.into()));
        assert_eq!(schema["$defs"]["CameraConfig"]["additionalProperties"], false);
        let hue = &schema["$defs"]["ColorConfig"]["properties"]["hue_deg"];
        assert_eq!(hue["type"], "array");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn any_names_and_numbers_survive(
            name in any::<String>(),
            numbers in prop::collection::vec(any::<f64>().prop_filter("finite", |n| n.is_finite()), 4),
            hue_deg in any::<Option<[f32; 2]>>(),
            seed in 0..=i64::MAX as u64,
        ) {
            let mut config = Config::default();
            let hue_deg = hue_deg.map(|hue| hue.map(|h| if h.is_finite() { h.into() } else { 0.0 }));
            config.colors[2] = ColorConfig { name: name.clone(), hue_deg, ..config.colors[2].clone() };
            config.robots.identities[0].colors = vec![name.clone(); 20];
            config.teams.blue = name.as_str().into();
            config.field.length_mm = numbers[0];
            config.geometry.points[0].field_mm = [numbers[1], numbers[2]];
            config.robots.patches[0].outline_mm = vec![[numbers[3], 0.5]; 30];
            config.synthetic.seed = seed;
            config.camera.v4l2.controls = [
                (name.clone(), SettingValue::Number(numbers[0])),
                ("gain".into(), SettingValue::Text(name)),
                ("white_balance".into(), SettingValue::Switch(seed % 2 == 0)),
            ].into();
            let text = commented_toml(&config);
            prop_assert_eq!(toml::from_str::<Config>(&text).unwrap(), config);
        }
    }
}
