//! The JSON schema of the configuration, and the checks that follow from it alone: unknown and missing
//! keys, wrong types, values and list lengths out of bounds.
//!
//! The schema is generated from the structures in `mod.rs`, so a new key with its bounds is checked
//! without a line here.

use super::Config;
use super::problem::{Problem, element_path, key_path, listed, nearest, quoted};
use serde_json::Value as Json;

/// The schema of the whole configuration.
pub(super) struct Schema {
    root: Json,
}

impl Schema {
    pub(super) fn new() -> Self {
        let schema = schemars::schema_for!(Config);
        let mut root = serde_json::to_value(schema).expect("a schema is plain JSON");
        root["title"] = Json::from("Touchline configuration");
        tidy(&mut root);
        Self { root }
    }

    /// All violations of the schema in `value`.
    pub(super) fn problems(&self, value: &toml::Value) -> Vec<Problem> {
        let mut problems = Vec::new();
        self.check(self.root(), value, "", &mut problems);
        problems
    }

    /// The schema of the top level.
    pub(super) fn root(&self) -> Node<'_> {
        Node { schema: self, property: &self.root, target: &self.root }
    }

    /// The schema as a document.
    pub(super) fn document(&self) -> &Json {
        &self.root
    }

    fn check(&self, node: Node, value: &toml::Value, path: &str, problems: &mut Vec<Problem>) {
        if let Some(names) = node.names() {
            problems.extend(check_name(&names, value, path));
            return;
        }
        match (node.kind(), value) {
            ("object", toml::Value::Table(table)) => self.check_table(node, table, path, problems),
            ("array", toml::Value::Array(array)) => {
                problems.extend(check_length(node, array.len(), path));
                if let Some(element) = node.element() {
                    for (index, value) in array.iter().enumerate() {
                        self.check(element, value, &element_path(path, index), problems);
                    }
                }
            }
            ("number", toml::Value::Integer(number)) => {
                problems.extend(check_range(node, *number as f64, path));
            }
            ("number", toml::Value::Float(number)) => {
                problems.extend(check_range(node, *number, path));
            }
            ("integer", toml::Value::Integer(number)) => {
                problems.extend(check_range(node, *number as f64, path));
            }
            ("string", toml::Value::String(text)) => {
                if (text.chars().count() as u64) < node.count("minLength").unwrap_or(0) {
                    problems.push(Problem::new(path, "must not be empty"));
                }
            }
            ("boolean", toml::Value::Boolean(_)) => {}
            // A key that accepts any simple type.
            ("", toml::Value::Float(number)) if number.is_finite() => {}
            ("", toml::Value::Boolean(_) | toml::Value::Integer(_) | toml::Value::String(_)) => {}
            (kind, value) => problems.push(wrong_kind(kind, value, path)),
        }
    }

    fn check_table(
        &self,
        node: Node,
        table: &toml::Table,
        path: &str,
        problems: &mut Vec<Problem>,
    ) {
        let mut meant_by_unknown = Vec::new();
        for (key, value) in table {
            if let Some(values) = node.values() {
                self.check(values, value, &key_path(path, key), problems);
            } else if node.property(key).is_none() {
                let (problem, meant) = self.unknown_key(node, key, path);
                problems.push(problem);
                meant_by_unknown.extend(meant);
            }
        }
        for (key, property) in node.properties() {
            match table.get(key) {
                Some(value) => self.check(property, value, &key_path(path, key), problems),
                // A misspelt key has been reported; reporting it as missing too would not help.
                None if node.requires(key) && !meant_by_unknown.contains(&key) => {
                    problems.push(Problem::new(path, format!("the key `{key}` is missing")));
                }
                None => {}
            }
        }
    }

    /// The problem, and the key that was probably meant.
    fn unknown_key<'a>(
        &'a self,
        node: Node<'a>,
        key: &str,
        path: &str,
    ) -> (Problem, Option<&'a str>) {
        let problem = Problem::new(key_path(path, key), "there is no such key").at_key();
        let keys = || node.properties().map(|(key, _)| key);
        if let Some(meant) = nearest(key, keys()) {
            return (problem.help(format!("did you mean `{meant}`?")), Some(meant));
        }
        let elsewhere = self
            .root()
            .properties()
            .find(|(_, section)| section.kind() == "object" && section.property(key).is_some());
        let help = match elsewhere {
            Some((section, _)) => format!("`{key}` belongs in [{section}]"),
            None => format!("the keys here are {}", listed(keys())),
        };
        (problem.help(help), None)
    }
}

/// A position in the schema: a property with the type it refers to.
#[derive(Clone, Copy)]
pub(super) struct Node<'a> {
    schema: &'a Schema,
    /// The property: its description and default here.
    property: &'a Json,
    /// Its type, with references resolved.
    target: &'a Json,
}

impl<'a> Node<'a> {
    fn at(schema: &'a Schema, property: &'a Json) -> Self {
        let target = property
            .get("$ref")
            .and_then(Json::as_str)
            .and_then(|reference| schema.root.pointer(reference.strip_prefix('#')?))
            .unwrap_or(property);
        Self { schema, property, target }
    }

    /// "object", "array", "number", "integer", "string" or "boolean"; empty when unknown. If several
    /// are allowed, the first: the others are short forms that [`super::load`] expands.
    pub(super) fn kind(self) -> &'a str {
        let kind = self.target.get("type");
        let first = kind.and_then(Json::as_array).and_then(|kinds| kinds.first());
        first.or(kind).and_then(Json::as_str).unwrap_or("")
    }

    /// Description of the key.
    pub(super) fn description(self) -> &'a str {
        let own = self.property.get("description").or_else(|| self.target.get("description"));
        own.and_then(Json::as_str).unwrap_or("")
    }

    /// Example value of an optional key.
    pub(super) fn example(self) -> Option<&'a Json> {
        self.property.get("examples")?.get(0)
    }

    /// The keys of a table, in the order of the structure.
    pub(super) fn properties(self) -> impl Iterator<Item = (&'a str, Node<'a>)> {
        let properties = self.target.get("properties").and_then(Json::as_object);
        properties
            .into_iter()
            .flatten()
            .map(move |(key, property)| (key.as_str(), Node::at(self.schema, property)))
    }

    fn property(self, key: &str) -> Option<Node<'a>> {
        let property = self.target.get("properties")?.get(key)?;
        Some(Node::at(self.schema, property))
    }

    /// Schema of the values in a table with free keys.
    pub(super) fn values(self) -> Option<Node<'a>> {
        let values = self.target.get("additionalProperties").filter(|values| values.is_object())?;
        Some(Node::at(self.schema, values))
    }

    /// Schema of an array's elements.
    pub(super) fn element(self) -> Option<Node<'a>> {
        Some(Node::at(self.schema, self.target.get("items")?))
    }

    fn requires(self, key: &str) -> bool {
        let required = self.target.get("required").and_then(Json::as_array);
        required.is_some_and(|required| required.iter().any(|name| name == key))
    }

    /// The values of an enumeration.
    fn names(self) -> Option<Vec<&'a str>> {
        if let Some(names) = self.target.get("enum").and_then(Json::as_array) {
            return Some(names.iter().filter_map(Json::as_str).collect());
        }
        let variants = self.target.get("oneOf").and_then(Json::as_array)?;
        let names = variants.iter().flat_map(|variant| {
            let listed = variant.get("enum").and_then(Json::as_array).into_iter().flatten();
            variant.get("const").into_iter().chain(listed)
        });
        Some(names.filter_map(Json::as_str).collect())
    }

    fn count(self, bound: &str) -> Option<u64> {
        self.target.get(bound)?.as_u64()
    }

    fn bound(self, bound: &str) -> Option<f64> {
        self.target.get(bound)?.as_f64()
    }
}

fn check_name(names: &[&str], value: &toml::Value, path: &str) -> Option<Problem> {
    let possible: Vec<String> = names.iter().map(|name| quoted(name)).collect();
    let possible = listed(possible.iter().map(String::as_str));
    let toml::Value::String(written) = value else {
        let message = format!("must be a name in quotes, not {}", kind_of(value));
        return Some(Problem::new(path, message).help(format!("possible are {possible}")));
    };
    if names.contains(&written.as_str()) {
        return None;
    }
    let help = match nearest(written, names.iter().copied()) {
        Some(meant) => format!("did you mean \"{meant}\"? Possible are {possible}"),
        None => format!("possible are {possible}"),
    };
    Some(Problem::new(path, format!("{} is unknown", quoted(written))).help(help))
}

fn check_length(node: Node, length: usize, path: &str) -> Option<Problem> {
    let length = length as u64;
    let (least, most) = (node.count("minItems").unwrap_or(0), node.count("maxItems"));
    let needed = match most {
        Some(most) if most == least => format!("needs {most} values"),
        Some(most) if length > most => format!("takes at most {most} elements"),
        _ if length < least => format!("needs at least {least} elements"),
        _ => return None,
    };
    (length < least || most.is_some_and(|most| length > most))
        .then(|| Problem::new(path, format!("{needed}, has {length}")))
}

fn check_range(node: Node, number: f64, path: &str) -> Option<Problem> {
    if !number.is_finite() {
        return Some(Problem::new(path, format!("must be a finite number, not {number}")));
    }
    let (low, high) = (node.bound("minimum"), node.bound("maximum"));
    if low.is_none_or(|low| number >= low) && high.is_none_or(|high| number <= high) {
        return None;
    }
    let allowed = match (low, high) {
        (Some(low), Some(high)) => format!("must lie between {low} and {high}"),
        (Some(low), None) => format!("must be at least {low}"),
        (_, high) => format!("must be at most {}", high.unwrap_or(f64::MAX)),
    };
    Some(Problem::new(path, format!("{allowed}, but is {number}")))
}

fn wrong_kind(kind: &str, value: &toml::Value, path: &str) -> Problem {
    let expected = match kind {
        "object" => "a table",
        "array" => "a list in [ ]",
        "number" => "a number",
        "integer" => "a whole number",
        "string" => "text in quotes",
        "boolean" => "true or false",
        "" => "a number, true or false, or text in quotes",
        other => other,
    };
    let problem = Problem::new(path, format!("must be {expected}, not {}", kind_of(value)));
    match value {
        toml::Value::String(text)
            if ["number", "integer"].contains(&kind) && text.trim().parse::<f64>().is_ok() =>
        {
            problem.help("write it without the quotes")
        }
        toml::Value::Float(number) if kind == "integer" && number.fract() == 0.0 => {
            problem.help(format!("write {number}"))
        }
        _ => problem,
    }
}

fn kind_of(value: &toml::Value) -> String {
    match value {
        toml::Value::String(text) => format!("the text {}", quoted(text)),
        toml::Value::Integer(number) => format!("{number}"),
        toml::Value::Float(number) => format!("{number:?}"),
        toml::Value::Boolean(value) => format!("{value}"),
        toml::Value::Datetime(date) => format!("a date ({date})"),
        toml::Value::Array(_) => "a list".into(),
        toml::Value::Table(_) => "a table".into(),
    }
}

/// Simplifies parts of the generated schema that a person would write differently.
fn tidy(schema: &mut Json) {
    match schema {
        Json::Object(object) => {
            // TOML has no null; an optional key is absent.
            if let Some(kind) = object.get_mut("type") {
                let named = kind.as_array_mut().and_then(|kinds| {
                    kinds.retain(|kind| kind != "null");
                    (kinds.len() == 1).then(|| kinds[0].take())
                });
                if let Some(named) = named {
                    *kind = named;
                }
            }
            object.retain(|key, value| !(key == "default" && value.is_null()));
            // Line breaks from the source are removed.
            if let Some(Json::String(text)) = object.get_mut("description") {
                *text = text.split_whitespace().collect::<Vec<_>>().join(" ");
            }
            object.values_mut().for_each(tidy);
        }
        Json::Array(array) => array.iter_mut().for_each(tidy),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Collects every numeric type in the schema.
    fn numbers<'a>(schema: &'a Json, path: &str, found: &mut Vec<(String, &'a Json)>) {
        match schema {
            Json::Object(object) => {
                if ["number", "integer"]
                    .iter()
                    .any(|kind| object.get("type") == Some(&(*kind).into()))
                {
                    found.push((path.to_string(), schema));
                }
                for (key, value) in object {
                    numbers(value, &format!("{path}/{key}"), found);
                }
            }
            Json::Array(array) => {
                for (index, value) in array.iter().enumerate() {
                    numbers(value, &format!("{path}/{index}"), found);
                }
            }
            _ => {}
        }
    }

    #[test]
    fn every_number_has_bounds() {
        let schema = Schema::new();
        let mut found = Vec::new();
        numbers(schema.document(), "", &mut found);
        assert!(found.len() > 50, "{} numbers", found.len());
        for (path, number) in found {
            let bounds = (number.get("minimum"), number.get("maximum"));
            assert!(
                bounds.0.is_some() && bounds.1.is_some(),
                "{path} has no bounds: add #[schemars(range(min = …, max = …))] to the key"
            );
        }
    }

    #[test]
    fn every_key_is_described() {
        fn check(node: Node, path: &str) {
            for (key, property) in node.properties() {
                let path = key_path(path, key);
                assert!(!property.description().is_empty(), "{path} has no doc comment");
                assert!(!property.kind().is_empty() || property.names().is_some(), "{path}");
                check(property, &path);
                if let Some(element) = property.element() {
                    check(element, &path);
                }
            }
        }
        check(Schema::new().root(), "");
    }
}
