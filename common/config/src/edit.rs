//! Single keys of a configuration by their path: `filter.actuation_delay_ms`, `colors.orange.red`,
//! `robots.identities.yellow 3.height_mm`.

use super::document::table;
use super::{Config, ConfigError};
use toml::{Table, Value};

/// Reason why a key could not be set.
#[derive(Debug, thiserror::Error)]
pub enum EditError {
    /// Not of the form `KEY=VALUE`.
    #[error(
        "{0:?}: write KEY=VALUE, for example filter.actuation_delay_ms=60 or colors.orange.red=[200,255]"
    )]
    Form(String),
    /// An element of a list as a whole.
    #[error("{0}: set one of its keys, for example colors.orange.red=[200,255]")]
    Element(String),
    /// There is no such key or element.
    #[error("{key}: there is no {part:?} in it; `touchline config init` lists all keys")]
    Key {
        /// The whole key.
        key: String,
        /// The part that is not there.
        part: String,
    },
    /// The changed configuration is not valid.
    #[error(transparent)]
    Config(#[from] ConfigError),
}

/// The configuration with these keys set, each `KEY=VALUE` with a value as in a TOML file; quotes around
/// a text may be left out.
pub fn with_values(config: &Config, assignments: &[String]) -> Result<Config, EditError> {
    let assignment = |assignment: &String| {
        let form = || EditError::Form(assignment.clone());
        let (key, value) = assignment.split_once('=').ok_or_else(form)?;
        let (key, value) = (key.trim(), value.trim());
        if key.is_empty() || value.is_empty() {
            return Err(form());
        }
        let parsed = toml::from_str::<Table>(&format!("value = {value}")).ok();
        let parsed = parsed.and_then(|mut table| table.remove("value"));
        Ok((key.to_string(), parsed.unwrap_or_else(|| Value::String(value.into()))))
    };
    let pairs = assignments.iter().map(assignment).collect::<Result<Vec<_>, EditError>>()?;
    with_pairs(config, pairs)
}

/// The configuration with these keys set to these values.
pub fn with_pairs(config: &Config, pairs: Vec<(String, Value)>) -> Result<Config, EditError> {
    if pairs.is_empty() {
        return Ok(config.clone());
    }
    let mut table = table(config);
    for (key, value) in pairs {
        set(&mut table, &key, value)?;
    }
    let text = toml::to_string(&table).expect("a table can be written");
    Ok(Config::parse(&text, "the configuration with --set")?)
}

/// A file's text with a key set; comments and order stay. Whether the key exists, and takes the value, is
/// for the caller to check with the whole text.
pub fn with_value(text: &str, key: &str, value: &str) -> Result<String, EditError> {
    use toml_edit::{DocumentMut, Item, Value};
    let missing = |part: &str| EditError::Key { key: key.into(), part: part.into() };
    let mut document: DocumentMut =
        text.parse().map_err(|_| EditError::Form(format!("{key}={value}")))?;
    let value = value.parse().unwrap_or_else(|_| Value::from(value));
    let (path, last) = key.rsplit_once('.').unwrap_or(("", key));
    let mut place: &mut Item = document.as_item_mut();
    for part in path.split('.').filter(|part| !part.is_empty()) {
        place = match place {
            Item::ArrayOfTables(elements) => {
                let is_it = |table: &toml_edit::Table| element_name(table).as_deref() == Some(part);
                let index = elements.iter().position(is_it).ok_or_else(|| missing(part))?;
                &mut place[index]
            }
            // A section that the file does not have yet.
            place => place
                .as_table_like_mut()
                .ok_or_else(|| missing(part))?
                .entry(part)
                .or_insert_with(|| Item::Table(toml_edit::Table::new())),
        };
    }
    if let Item::ArrayOfTables(_) = place {
        return Err(EditError::Element(key.into()));
    }
    let table = place.as_table_like_mut().ok_or_else(|| missing(last))?;
    match table.get_mut(last) {
        // A comment behind the value stays.
        Some(Item::Value(old)) => {
            let decor = old.decor().clone();
            *old = value;
            *old.decor_mut() = decor;
        }
        _ => drop(table.insert(last, Item::Value(value))),
    }
    Ok(document.to_string())
}

/// Name of an element of a list in a file: a colour, or a robot.
fn element_name(table: &toml_edit::Table) -> Option<String> {
    let text = |name: &str| table.get(name)?.as_str().map(str::to_string);
    text("name").or_else(|| Some(format!("{} {}", text("team")?, table.get("id")?.as_integer()?)))
}

fn set(table: &mut Table, key: &str, value: Value) -> Result<(), EditError> {
    let missing = |part: &str| EditError::Key { key: key.into(), part: part.into() };
    let (path, last) = key.rsplit_once('.').unwrap_or(("", key));
    let mut place = table;
    for part in path.split('.').filter(|part| !part.is_empty()) {
        place = match place.get_mut(part) {
            Some(Value::Table(table)) => table,
            Some(Value::Array(elements)) => return set_in_list(elements, key, part, value),
            _ => return Err(missing(part)),
        };
    }
    // Whether the key exists, and takes this value, is checked with the whole configuration.
    place.insert(last.into(), value);
    Ok(())
}

/// Sets `…LIST.ELEMENT.KEY`, with an element given by its name.
fn set_in_list(
    elements: &mut [Value],
    key: &str,
    list: &str,
    value: Value,
) -> Result<(), EditError> {
    let missing = |part: &str| EditError::Key { key: key.into(), part: part.into() };
    let below = key.split_once(&format!("{list}.")).map_or("", |(_, below)| below);
    let (name, field) = below.rsplit_once('.').ok_or_else(|| EditError::Element(key.into()))?;
    let is_it = |element: &&mut Value| crate::change::name_of(element).as_deref() == Some(name);
    let element = elements.iter_mut().find(is_it).and_then(Value::as_table_mut);
    element.ok_or_else(|| missing(name))?.insert(field.into(), value);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commented_toml;

    fn set_one(assignment: &str) -> Result<Config, String> {
        with_values(&Config::default(), &[assignment.into()]).map_err(|error| error.to_string())
    }

    #[test]
    fn keys_and_elements_of_lists_are_set() {
        assert_eq!(
            set_one("filter.actuation_delay_ms=61.5").unwrap().filter.actuation_delay_ms,
            61.5
        );
        let config = set_one("colors.orange.red = [201, 250]").unwrap();
        let orange = config.colors.iter().find(|color| color.name == "orange").unwrap();
        assert_eq!(orange.red, [201, 250]);
        assert_eq!(set_one("camera.v4l2.format=MJPG").unwrap().camera.v4l2.format, "MJPG");
        let config = set_one("robots.identities.yellow 1.height_mm=120").unwrap();
        assert!(config.robots.identities.iter().any(|robot| robot.height_mm == Some(120.0)));
        assert_eq!(with_values(&Config::default(), &[]).unwrap(), Config::default());
    }

    #[test]
    fn a_file_keeps_its_comments() {
        let text = "# mine\n[filter] # tuned\nactuation_delay_ms = 50 # ms\n";
        let set = with_value(text, "filter.actuation_delay_ms", "61.5").unwrap();
        assert_eq!(set, "# mine\n[filter] # tuned\nactuation_delay_ms = 61.5 # ms\n");
        let set = with_value(text, "camera.v4l2.format", "MJPG").unwrap();
        assert!(set.starts_with(text), "{set}");
        let config = Config::parse(&set, "test").unwrap();
        assert_eq!(config.camera.v4l2.format, "MJPG");
        // Elements of lists by name, in a file with every key.
        let all = commented_toml(&Config::default());
        let set = with_value(&all, "colors.orange.red", "[201, 250]").unwrap();
        let config = Config::parse(&set, "test").unwrap();
        assert_eq!(config.colors.iter().find(|it| it.name == "orange").unwrap().red, [201, 250]);
        assert_eq!(set.lines().count(), all.lines().count());
        assert!(with_value(&all, "colors.mauve.red", "[1, 2]").is_err());
        assert!(with_value(text, "filter.actuation_delay_ms.x", "1").is_err());
    }

    #[test]
    fn mistakes_are_named() {
        for (assignment, said) in [
            ("filter", "KEY=VALUE"),
            ("=1", "KEY=VALUE"),
            ("filter.x=", "KEY=VALUE"),
            ("filters.x=1", "\"filters\""),
            ("colors.mauve.red=[1,2]", "\"mauve\""),
            ("colors.orange=3", "set one of its keys"),
            ("filter.actuation_dealy_ms=1", "actuation_delay_ms"),
            ("filter.actuation_delay_ms=-1", "actuation_delay_ms"),
            ("filter.actuation_delay_ms=fast", "actuation_delay_ms"),
        ] {
            let error = set_one(assignment).unwrap_err();
            assert!(error.contains(said), "{assignment}: {error}");
        }
    }
}
