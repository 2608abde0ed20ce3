//! The iceoryx2 versions that created a group's topics, from iceoryx2's service descriptions.

use crate::private;
use std::fs;
use std::io::Read;
use std::path::Path;

/// Directory of the descriptions, below iceoryx2's root.
const PLACE: &str = "services";
/// Longest possible description.
const MAX_BYTES: u64 = 1 << 16;

/// An existing topic.
#[derive(Debug, PartialEq, Eq)]
pub struct Service {
    /// Name of the topic, or of its file if that cannot be read.
    pub name: String,
    /// Version of iceoryx2 that created it; "unknown" if it cannot be read.
    pub version: String,
}

/// All existing topics.
pub fn read(root: &Path) -> Vec<Service> {
    let entries = fs::read_dir(root.join(PLACE)).into_iter().flatten().flatten();
    entries.filter_map(|entry| read_one(&entry.path())).collect()
}

/// `None` if the description is just being created, or has been removed.
fn read_one(path: &Path) -> Option<Service> {
    let mut text = String::new();
    let read = private::read_file(path).ok()?.take(MAX_BYTES).read_to_string(&mut text);
    if read.is_ok_and(|bytes| bytes == 0) {
        return None;
    }
    let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let described = describe(&text);
    Some(described.unwrap_or(Service { name: file, version: "unknown".into() }))
}

/// Reads the two entries of interest. A description is a flat TOML file, one `key = value` a line below
/// its `[table]`; a whole TOML reader would be the largest part of a strategy's build.
fn describe(text: &str) -> Option<Service> {
    let mut table = "";
    let mut name = None;
    let mut version = [None; 3];
    if !text.ends_with('\n') {
        return None;
    }
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
        if let Some(header) = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            table = header;
            continue;
        }
        let (key, value) = line.split_once('=')?;
        let value = value.trim();
        match (table, key.trim()) {
            ("", "service_name") => name = value.strip_prefix('"')?.strip_suffix('"'),
            ("iceoryx2_version", "major") => version[0] = value.parse::<u16>().ok(),
            ("iceoryx2_version", "minor") => version[1] = value.parse().ok(),
            ("iceoryx2_version", "patch") => version[2] = value.parse().ok(),
            _ => {}
        }
    }
    let [major, minor, patch] = version;
    Some(Service { name: name?.to_string(), version: format!("{}.{}.{}", major?, minor?, patch?) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::Bus;
    use crate::instance::{Instance, namespace::IPC_VERSION};
    use messages::topics;

    #[test]
    fn descriptions_of_this_version_are_understood_and_damaged_ones_are_named() {
        let base = std::env::temp_dir().join(format!("tl-services-{}", std::process::id()));
        let instance = Instance::below(&base, "services").unwrap();
        instance.create_directory().unwrap();
        let bus = Bus::join(&instance, "writer").unwrap();
        let _health = bus.publisher(&topics::HEALTH, 1).unwrap();
        let namespace = bus.namespace().clone();
        let own = [Service { name: "health".into(), version: IPC_VERSION.into() }];
        assert_eq!(
            read(namespace.directory()),
            own,
            "iceoryx2 describes its services in another way"
        );
        assert_eq!(namespace.strange_versions().unwrap(), Vec::<String>::new());

        let path = fs::read_dir(namespace.directory().join(PLACE)).unwrap().next().unwrap();
        let path = path.unwrap().path();
        let text = fs::read_to_string(&path).unwrap();
        let mut refusals = Vec::new();
        for (changed, hint) in [
            (text.replace("minor = 10", "minor = 9"), "iceoryx2 0.9.0"),
            (text[..text.len() / 2].to_string(), "or is damaged"),
        ] {
            fs::remove_file(&path).unwrap();
            fs::write(&path, changed).unwrap();
            let mode = std::os::unix::fs::PermissionsExt::from_mode(0o400);
            fs::set_permissions(&path, mode).unwrap();
            let strange = namespace.strange_versions().unwrap();
            assert!(strange.len() == 1 && strange[0].contains(hint), "{strange:?}");
            let other = Bus::join(&instance, "reader").unwrap();
            refusals.push(other.subscriber(&topics::HEALTH).err().unwrap().to_string());
        }
        for refusal in refusals {
            assert!(
                refusal.contains("topic health: it was made by a program with another"),
                "{refusal}"
            );
        }
        drop((_health, bus));
        instance.remove_directory().unwrap();
    }
}
