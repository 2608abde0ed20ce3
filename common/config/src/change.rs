//! The difference of two configurations, key by key, and what has to be replaced for it to take effect.

use super::document::table;
use super::{Config, ConfigError};
use messages::ProcessKind;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use toml::Value;

use ProcessKind::{Classifier, Filter, Grabber, Tracker};

/// Whom a changed key concerns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effect {
    /// These stages read it.
    Stages(&'static [ProcessKind]),
    /// Only the supervisor reads it.
    Supervisor,
    /// Only a new group can have another value; the reason.
    NewGroup(&'static str),
}

/// The keys, and who reads them. The longest key that a changed key begins with counts.
///
/// The synthetic match paints with the configuration that its grabber was started with, as a real pitch
/// does not change with the configuration either: only `camera` and `synthetic` concern the grabber.
const EFFECTS: [(&str, Effect); 22] = [
    // A preset only says where defaults come from; what it changes appears in the other keys.
    ("preset", Effect::Stages(&[])),
    ("field", Effect::Stages(&[Classifier, Tracker])),
    ("camera.width", SIZE),
    ("camera.height", SIZE),
    ("camera.fps", Effect::Stages(&[Grabber, Classifier, Tracker, Filter])),
    ("camera.bayer_order", Effect::Stages(&[Grabber, Classifier, Tracker])),
    // Only the check of a configuration reads it.
    ("camera.mirrored", Effect::Stages(&[])),
    ("camera.exposure_us", Effect::Stages(&[Grabber])),
    ("camera.rolling_shutter_us", Effect::Stages(&[Grabber, Filter])),
    ("camera.v4l2", Effect::Stages(&[Grabber])),
    ("camera.genicam", Effect::Stages(&[Grabber])),
    ("geometry", Effect::Stages(&[Classifier, Tracker, Filter])),
    ("light", Effect::Stages(&[Classifier])),
    ("colors", Effect::Stages(&[Classifier, Tracker])),
    ("teams", Effect::Stages(&[Classifier, Tracker])),
    ("ball", Effect::Stages(&[Classifier, Tracker])),
    ("robots", Effect::Stages(&[Classifier, Tracker, Filter])),
    ("tracker", Effect::Stages(&[Tracker])),
    ("filter", Effect::Stages(&[Filter])),
    ("supervisor", Effect::Supervisor),
    ("scheduling", Effect::Stages(&[Grabber, Classifier, Tracker, Filter])),
    ("synthetic", Effect::Stages(&[Grabber])),
];

const SIZE: Effect =
    Effect::NewGroup("the shared memory of a group is made for pictures of one size");
const ATTENDANTS: Effect =
    Effect::NewGroup("who may attach, and what is published, is set up when a group starts");

/// Text for a value that is not set.
const NONE: &str = "(none)";

/// One changed key.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// The key, with elements of lists by name: `colors.orange.red`, `robots.identities.yellow 3.colors`.
    pub key: String,
    /// The value before; `None` for a new element or an optional key that was not set.
    pub old: Option<String>,
    /// The value after; `None` for a removed one.
    pub new: Option<String>,
}

impl Change {
    /// Whether the key is this one, or one of this section.
    pub fn is_below(&self, section: &str) -> bool {
        let rest = self.key.strip_prefix(section);
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
    }

    /// The value after, as text.
    pub fn new_text(&self) -> &str {
        self.new.as_deref().unwrap_or(NONE)
    }

    /// Whom the changed key concerns.
    pub fn effect(&self) -> Effect {
        let begins_with = |&&(prefix, _): &&(&str, Effect)| self.is_below(prefix);
        let longest = EFFECTS.iter().filter(begins_with).max_by_key(|(prefix, _)| prefix.len());
        // `access`, `publish` and `console`.
        longest.map_or(ATTENDANTS, |&(_, effect)| effect)
    }
}

/// `filter.actuation_delay_ms: 80.0 → 60.0`
impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let old = self.old.as_deref().unwrap_or(NONE);
        write!(f, "{}: {old} → {}", self.key, self.new_text())
    }
}

/// The keys in which two configurations differ, in alphabetical order.
pub fn changes(old: &Config, new: &Config) -> Vec<Change> {
    let [old, new] = [old, new].map(values);
    let mut keys: Vec<&String> = old.keys().chain(new.keys()).collect();
    keys.sort();
    keys.dedup();
    let change = |key: &String| {
        let (before, after) = (old.get(key), new.get(key));
        (before != after).then(|| Change {
            key: key.clone(),
            old: before.cloned(),
            new: after.cloned(),
        })
    };
    keys.into_iter().filter_map(change).collect()
}

/// Identifies the content of a configuration: 16 hexadecimal digits, equal for configurations with equal keys,
/// whatever their texts look like. FNV-1a over keys and values; nothing relies on it being hard to forge.
pub fn content_hash(config: &Config) -> String {
    const OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
    const PRIME: u64 = 0x0000_0100_0000_01b3;
    let text: String =
        values(config).iter().map(|(key, value)| format!("{key}={value}\n")).collect();
    let hash = text.bytes().fold(OFFSET, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(PRIME));
    format!("{hash:016x}")
}

/// `old` with those sections of `new` of which every change concerns only these stages, and the changes that
/// are left out.
pub fn only_for(
    old: &Config,
    new: &Config,
    stages: &[ProcessKind],
) -> Result<(Config, Vec<Change>), ConfigError> {
    let section = |change: &Change| change.key.split('.').next().unwrap_or_default().to_string();
    let is_theirs = |change: &Change| match change.effect() {
        Effect::Stages(kinds) => kinds.iter().all(|kind| stages.contains(kind)),
        Effect::Supervisor | Effect::NewGroup(_) => false,
    };
    let all = changes(old, new);
    let others: BTreeSet<String> =
        all.iter().filter(|change| !is_theirs(change)).map(section).collect();
    let (left, taken): (Vec<_>, Vec<_>) =
        all.into_iter().partition(|change| others.contains(&section(change)));
    let (mut merged, mut from) = (table(old), table(new));
    for name in taken.iter().map(section) {
        // A section with several changes is moved at the first of them.
        if let Some(value) = from.remove(&name) {
            merged.insert(name, value);
        }
    }
    let text = toml::to_string(&merged).expect("a table can be written");
    Ok((Config::parse(&text, "the sections for these stages")?, left))
}

/// Whether class numbers mean the same colours in both.
pub fn have_same_classes(old: &Config, new: &Config) -> bool {
    old.colors == new.colors
}

/// All keys with their values as TOML, in alphabetical order.
pub fn values(config: &Config) -> BTreeMap<String, String> {
    let mut keys = BTreeMap::new();
    flatten("", &Value::Table(table(config)), &mut keys);
    // The position of a colour is its class number, and the first of two that overlap wins.
    let order: Vec<&str> = config.colors.iter().map(|color| color.name.as_str()).collect();
    keys.insert("colors.order".into(), format!("{order:?}"));
    keys
}

fn flatten(path: &str, value: &Value, keys: &mut BTreeMap<String, String>) {
    let below = |name: &str| if path.is_empty() { name.into() } else { format!("{path}.{name}") };
    match value {
        Value::Table(table) => {
            table.iter().for_each(|(name, value)| flatten(&below(name), value, keys));
        }
        Value::Array(elements) => match elements.iter().map(name_of).collect::<Option<Vec<_>>>() {
            Some(names) if !names.is_empty() => {
                let named = names.iter().zip(elements);
                named.for_each(|(name, element)| flatten(&below(name), element, keys));
            }
            _ => drop(keys.insert(path.into(), value.to_string())),
        },
        value => drop(keys.insert(path.into(), value.to_string())),
    }
}

/// Name of an element of a list: a colour, or a robot.
pub(crate) fn name_of(element: &Value) -> Option<String> {
    let field = |name: &str| element.get(name);
    match (field("name"), field("team"), field("id")) {
        (Some(name), ..) => name.as_str().map(str::to_string),
        (None, Some(team), Some(id)) => Some(format!("{} {id}", team.as_str()?)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Preset;

    fn keys(changed: &Config) -> Vec<String> {
        changes(&Config::default(), changed).into_iter().map(|change| change.key).collect()
    }

    #[test]
    fn equal_configurations_have_no_changes() {
        for preset in Preset::ALL {
            assert_eq!(changes(&preset.config(), &preset.config()), []);
        }
    }

    #[test]
    fn every_key_has_an_effect_and_every_row_a_key() {
        let mut unused: Vec<&str> = EFFECTS.iter().map(|&(prefix, _)| prefix).collect();
        for config in Preset::ALL.map(Preset::config) {
            for key in values(&config).into_keys() {
                let change = Change { key: key.clone(), old: None, new: None };
                let prefix = |prefix: &&str| {
                    key.strip_prefix(*prefix)
                        .is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
                };
                let sections_of_attendants = ["access", "publish", "console"];
                let section = key.split('.').next().unwrap();
                assert!(
                    change.effect() != ATTENDANTS || sections_of_attendants.contains(&section),
                    "{key} has no row in the table of effects"
                );
                unused.retain(|row| !prefix(row));
            }
        }
        assert_eq!(unused, Vec::<&str>::new());
    }

    #[test]
    fn the_hash_is_of_the_content_not_of_the_text() {
        let config = Config::default();
        let hash = content_hash(&config);
        assert_eq!(hash.len(), 16);
        assert_eq!(content_hash(&Config::parse("# other text\n", "test").unwrap()), hash);
        let mut changed = config.clone();
        changed.filter.actuation_delay_ms += 1.0;
        assert_ne!(content_hash(&changed), hash);
        changed = config;
        changed.colors.swap(0, 1);
        assert_ne!(content_hash(&changed), hash);
    }

    #[test]
    fn only_sections_for_the_named_stages_are_taken_over() {
        let old = Config::default();
        let mut new = old.clone();
        new.filter.actuation_delay_ms += 1.0;
        new.colors.swap(0, 1);
        new.supervisor.stall_min_ms += 1.0;
        let keys = |left: Vec<Change>| left.into_iter().map(|it| it.key).collect::<Vec<_>>();
        let (config, left) = only_for(&old, &new, &[Filter]).unwrap();
        assert_eq!(config, Config { filter: new.filter.clone(), ..old.clone() });
        assert_eq!(keys(left), ["colors.order", "supervisor.stall_min_ms"]);
        let (config, _) = only_for(&old, &new, &[Classifier]).unwrap();
        assert_eq!(config, old, "the tracker reads the colours too");
        let (config, left) = only_for(&old, &new, &[Classifier, Tracker, Filter]).unwrap();
        assert_eq!((config.colors, config.filter), (new.colors, new.filter));
        assert_eq!(keys(left), ["supervisor.stall_min_ms"]);
    }

    #[test]
    fn elements_of_lists_are_found_by_name() {
        let mut config = Config::default();
        config.colors[1].red = [7, 9];
        let color = config.colors[1].name.clone();
        assert_eq!(keys(&config), [format!("colors.{color}.red")]);

        let mut config = Config::default();
        config.colors.swap(0, 1);
        assert_eq!(keys(&config), ["colors.order"]);
        assert!(!have_same_classes(&Config::default(), &config));

        let mut config = Config::default();
        config.robots.identities.remove(0);
        assert!(keys(&config).iter().all(|key| key.starts_with("robots.identities.")));
        assert!(have_same_classes(&Config::default(), &config));
    }

    #[test]
    fn the_nearest_row_counts() {
        let effect = |key: &str| Change { key: key.into(), old: None, new: None }.effect();
        assert_eq!(effect("camera.width"), SIZE);
        assert_eq!(effect("camera.v4l2.controls.gain"), Effect::Stages(&[Grabber]));
        assert_eq!(effect("filter.actuation_delay_ms"), Effect::Stages(&[Filter]));
        assert_eq!(effect("filters"), ATTENDANTS);
        assert_eq!(effect("supervisor.spares"), Effect::Supervisor);
    }
}
