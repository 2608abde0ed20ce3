//! The recordings that the page may open: `*.mcap` files in the console's own directory and in those that the
//! configuration names, and single files that the group plays or the page has recorded.

use super::answer::Failure;
use axum::http::StatusCode;
use serde_json::{Value, json};
use std::ffi::OsStr;
use std::fs::{self, Metadata};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Most recordings that are listed, the newest.
const MOST_LISTED: usize = 500;

/// A directory, or a single file of one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    directory: PathBuf,
    /// Only this file of it.
    only: Option<PathBuf>,
}

impl Place {
    /// All recordings of a directory.
    pub fn directory(path: &Path) -> Self {
        Self { directory: path.into(), only: None }
    }

    /// One recording; `None` if the path names no file.
    pub fn file(path: &Path) -> Option<Self> {
        let name = path.file_name()?;
        Some(Self { directory: path.parent()?.into(), only: Some(name.into()) })
    }

    /// A short name for addresses, which stays the same as long as the directory does.
    fn id(&self) -> String {
        let bytes = self.directory.as_os_str().as_encoded_bytes();
        let hash = bytes.iter().fold(0xcbf2_9ce4_8422_2325u64, |hash, &byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
        });
        format!("{:08x}", hash as u32)
    }

    fn admits(&self, name: &OsStr) -> bool {
        self.only.as_ref().is_none_or(|only| only.as_os_str() == name)
    }
}

/// A recording in a list.
struct Listed {
    place: String,
    name: String,
    directory: String,
    bytes: u64,
    modified_s: f64,
}

/// All recordings, the newest first. Directories that are not there have none.
pub fn list(places: &[Place]) -> Value {
    let mut all: Vec<Listed> = Vec::new();
    for place in places {
        let Ok(entries) = fs::read_dir(&place.directory) else { continue };
        for entry in entries.flatten() {
            let file_name = entry.file_name();
            // Names that no address can have are not shown.
            let Some(name) = file_name.to_str().filter(|name| is_recording(name)) else { continue };
            let Some(data) = regular(&entry.path()).filter(|_| place.admits(&file_name)) else {
                continue;
            };
            let modified = data.modified().ok().and_then(|it| it.duration_since(UNIX_EPOCH).ok());
            all.push(Listed {
                place: place.id(),
                name: name.into(),
                directory: place.directory.display().to_string(),
                bytes: data.len(),
                modified_s: modified.unwrap_or_default().as_secs_f64(),
            });
        }
    }
    all.sort_by(|a, b| b.modified_s.total_cmp(&a.modified_s).then(a.name.cmp(&b.name)));
    // A directory may be named twice.
    let mut seen = std::collections::HashSet::new();
    all.retain(|it| seen.insert((it.place.clone(), it.name.clone())));
    all.truncate(MOST_LISTED);
    let listed = all.into_iter().map(|it| {
        json!({
            "place": it.place, "name": it.name, "directory": it.directory, "bytes": it.bytes,
            "modified_s": it.modified_s,
        })
    });
    Value::Array(listed.collect())
}

/// The file of an address. Whatever the address says, it is a regular file right in one of the places.
pub fn find(places: &[Place], id: &str, name: &str) -> Result<PathBuf, Failure> {
    let nothing = || {
        Failure::new(StatusCode::NOT_FOUND, "there is no such recording")
            .help("it may have been moved or removed; look at the list again")
    };
    if !is_recording(name) {
        return Err(nothing());
    }
    let mut there = places.iter().filter(|it| it.id() == id && it.admits(OsStr::new(name)));
    let place = there.next().ok_or_else(nothing)?;
    let path = place.directory.join(name);
    regular(&path).map(|_| path).ok_or_else(nothing)
}

/// A plain name of a file that may be a recording.
fn is_recording(name: &str) -> bool {
    name.ends_with(".mcap") && !name.starts_with('.') && !name.contains(['/', '\0'])
}

/// A regular file; links may lead elsewhere, and devices and pipes may block.
fn regular(path: &Path) -> Option<Metadata> {
    fs::symlink_metadata(path).ok().filter(Metadata::is_file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_recordings_right_in_a_place_are_found() {
        let scratch = std::env::temp_dir().join(format!("touchline-shelf-{}", std::process::id()));
        let (shelf, other) = (scratch.join("shelf"), scratch.join("other"));
        fs::create_dir_all(shelf.join("folder.mcap")).unwrap();
        fs::create_dir_all(&other).unwrap();
        for file in [
            "shelf/a b.mcap",
            "shelf/ä.mcap",
            "shelf/.hidden.mcap",
            "shelf/a.toml",
            "other/c.mcap",
            "other/d.mcap",
        ] {
            fs::write(scratch.join(file), "x").unwrap();
        }
        std::os::unix::fs::symlink("/etc/passwd", shelf.join("link.mcap")).unwrap();
        let places = [
            Place::directory(&shelf),
            Place::directory(&shelf),
            Place::file(&other.join("c.mcap")).unwrap(),
            Place::directory(&scratch.join("nowhere")),
        ];
        let listed = list(&places);
        let mut names: Vec<&str> =
            listed.as_array().unwrap().iter().map(|it| it["name"].as_str().unwrap()).collect();
        names.sort_unstable();
        assert_eq!(names, ["a b.mcap", "c.mcap", "ä.mcap"]);
        let id = places[0].id();
        assert_eq!(find(&places, &id, "a b.mcap").unwrap(), shelf.join("a b.mcap"));
        let other_id = places[2].id();
        assert!(find(&places, &other_id, "c.mcap").is_ok());
        for (id, name) in [
            (&id, "../other/c.mcap"),
            (&id, "link.mcap"),
            (&id, "folder.mcap"),
            (&id, ".hidden.mcap"),
            (&id, "a.toml"),
            (&id, "c.mcap"),
            (&other_id, "d.mcap"),
            (&id, "a b.mcap\0"),
            (&id, ""),
            (&String::new(), "a b.mcap"),
        ] {
            assert!(find(&places, id, name).is_err(), "{name:?}");
        }
        fs::remove_dir_all(&scratch).unwrap();
    }
}
