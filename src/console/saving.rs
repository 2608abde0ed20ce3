//! Writing what a group runs with into its file: comments and order of the file stay as far as its entries do.

use config::change::{Change, changes};
use config::edit::with_value;
use config::{Config, commented_toml};
use grabber::source::Source;
use rustix::fs::{Mode, OFlags};
use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use toml_edit::{DocumentMut, Item};

use crate::supervisor::{Overrides, as_run};

/// Passes over the keys that differ.
const PASSES: usize = 2;

/// A text that says what a group runs with.
#[derive(Debug, Clone, PartialEq)]
pub struct Merged {
    /// The text.
    pub text: String,
    /// Sections that were written anew, without the comments that they had.
    pub rewritten: Vec<String>,
}

/// The text of a file with everything in it that differs from what the group runs with. What the group's command
/// line says is not written. `None` if the file is no valid configuration, or would not say the same as the group.
pub fn merge(text: &str, now: &Config, overrides: &Overrides, source: &Source) -> Option<Merged> {
    let as_group = |text: &str| Some(as_run(Config::parse(text, "file").ok()?, overrides, source));
    let differing = |text: &str| Some(changes(&as_group(text)?, now));
    let first = differing(text)?;
    let all: DocumentMut = commented_toml(now).parse().ok()?;
    let mut merged = Merged { text: text.into(), rewritten: Vec::new() };
    // Another preset changes what is not in the file, so that further keys may be needed.
    for _ in 0..PASSES {
        for Change { key, new, .. } in differing(&merged.text).unwrap_or_default() {
            let is_there = merged.has_place_for(&key, &all);
            let value = new.filter(|_| is_there);
            // A key alone may contradict others until those are set too.
            match value.and_then(|value| with_value(&merged.text, &key, &value).ok()) {
                Some(text) => merged.text = text,
                None => merged.rewrite(&key, &all)?,
            }
        }
    }
    for Change { key, .. } in differing(&merged.text).unwrap_or(first) {
        merged.rewrite(&key, &all)?;
    }
    differing(&merged.text)?.is_empty().then_some(merged)
}

impl Merged {
    /// Whether a key can be set by itself: lists on the way to it are in the file.
    fn has_place_for(&self, key: &str, all: &DocumentMut) -> bool {
        let Ok(document) = self.text.parse::<DocumentMut>() else { return false };
        let (mut here, mut there) = (Some(document.as_item()), Some(all.as_item()));
        for part in key.split('.') {
            if there.is_some_and(Item::is_array_of_tables) {
                // The order of a list is no key of it.
                return here.is_some_and(Item::is_array_of_tables) && key != "colors.order";
            }
            here = here.and_then(|item| item.get(part));
            there = there.and_then(|item| item.get(part));
        }
        // A key that is not set in `all` has its default.
        there.is_some_and(Item::is_value)
    }

    /// Writes the section of a key anew.
    fn rewrite(&mut self, key: &str, all: &DocumentMut) -> Option<()> {
        let section = key.split('.').next().unwrap_or(key);
        if self.rewritten.iter().any(|it| it == section) {
            return Some(());
        }
        let mut document: DocumentMut = self.text.parse().ok()?;
        document.insert(section, all.get(section)?.clone());
        self.text = document.to_string();
        self.rewritten.push(section.into());
        Some(())
    }
}

/// Identifies a text: FNV-1a, since nobody gains anything from two texts of the same hash.
pub fn hash(text: &str) -> String {
    let mix = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
    format!("{:016x}", text.bytes().fold(0xcbf2_9ce4_8422_2325, mix))
}

/// Replaces a file as a whole, or creates it; a reader finds the old text or the new one. Its mode stays.
pub fn replace(path: &Path, text: &str) -> io::Result<()> {
    // A link keeps leading there.
    let path = path.canonicalize().unwrap_or_else(|_| path.into());
    let mode = fs::metadata(&path).map(|data| data.permissions().mode()).unwrap_or(0o644);
    let new = path.with_extension(format!("new-{}", std::process::id()));
    let flags = OFlags::WRONLY | OFlags::CREATE | OFlags::EXCL | OFlags::CLOEXEC;
    let write = || {
        let mut file = File::from(rustix::fs::open(&new, flags, Mode::from_bits_truncate(mode))?);
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(&new, &path)
    };
    write().inspect_err(|_| drop(fs::remove_file(&new)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::Preset;

    const FILE: &str = "# our pitch\n[filter] # tuned\nactuation_delay_ms = 50 # measured\n\n[field]\n# by hand\n\
                        length_mm = 2200\n";

    fn merged(text: &str, change: impl FnOnce(&mut Config)) -> Merged {
        let mut now = Config::parse(text, "test").unwrap();
        change(&mut now);
        let merged = merge(text, &now, &Overrides::default(), &Source::External).unwrap();
        assert_eq!(Config::parse(&merged.text, "test").unwrap(), now);
        merged
    }

    #[test]
    fn comments_stay_where_keys_stay() {
        let it = merged(FILE, |config| config.filter.actuation_delay_ms = 61.5);
        assert_eq!(it.text, FILE.replace("50 #", "61.5 #"));
        assert_eq!(it.rewritten, Vec::<String>::new());
        let unchanged = merged(FILE, |_| ());
        assert_eq!(unchanged.text, FILE);
    }

    #[test]
    fn lists_are_written_anew_and_everything_else_stays() {
        let it = merged(FILE, |config| {
            config.colors[1].red = [7, 9];
            config.robots.identities.remove(3);
            config.filter.actuation_delay_ms = 61.5;
        });
        assert!(it.text.contains("# our pitch") && it.text.contains("61.5 # measured"));
        assert!(it.rewritten.contains(&"colors".to_string()), "{:?}", it.rewritten);
        // Once they are in the file, their comments stay.
        let text = format!("{}\n# the end\n", it.text);
        let it = merged(&text, |config| config.colors[1].red = [8, 9]);
        assert_eq!(it.rewritten, Vec::<String>::new());
        assert_eq!(it.text.lines().count(), text.lines().count());
    }

    #[test]
    fn every_preset_can_be_saved_over_every_file() {
        for preset in Preset::ALL {
            let now = preset.config();
            let text = format!("preset = \"{}\"\n", Preset::Vsss3v3.name());
            for text in [FILE, "", &text] {
                let merged = merge(text, &now, &Overrides::default(), &Source::External);
                let merged = merged.unwrap_or_else(|| panic!("{} over {text}", preset.name()));
                assert_eq!(Config::parse(&merged.text, "test").unwrap(), now);
            }
        }
    }

    #[test]
    fn what_the_command_line_says_is_not_written() {
        let overrides = Overrides { fps: Some(33.0), no_console: true, ..Overrides::default() };
        let mut now = as_run(Config::parse(FILE, "test").unwrap(), &overrides, &Source::External);
        now.filter.actuation_delay_ms = 61.5;
        let merged = merge(FILE, &now, &overrides, &Source::External).unwrap();
        assert_eq!(merged.text, FILE.replace("50 #", "61.5 #"));
        assert_eq!(merge("[filter\n", &now, &overrides, &Source::External), None);
    }

    #[test]
    fn a_file_is_replaced_as_a_whole() {
        let path = std::env::temp_dir().join(format!("tl-saving-{}.toml", std::process::id()));
        replace(&path, "one").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        replace(&path, "two").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "two");
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        fs::remove_file(&path).unwrap();
        assert_ne!(hash("one"), hash("two"));
    }
}
