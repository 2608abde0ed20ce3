//! What dead groups have left: in the runtime directory, and in shared memory.
//!
//! Nothing is touched that a living process could need. Whether somebody has a piece of shared memory
//! open is not guessed from process lists, which end at the border of a container: the kernel
//! grants a lease on a file only when nobody else has it open or mapped.

use super::{Finding, bytes};
use common::bus::participants;
use common::instance::{Instance, InstanceError, lock};
use common::memory::SHARED_MEMORY;
use rustix::process::getuid;
use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

const ABOUT: &str = "leftovers";

/// What is left of one dead group.
#[derive(Debug, Default)]
pub struct Leftover {
    /// Its instance, while its runtime directory still exists.
    instance: Option<Instance>,
    /// Its pieces of shared memory.
    memory: Vec<PathBuf>,
    /// How much memory they take.
    bytes: u64,
}

impl Leftover {
    fn name(&self) -> String {
        let memory = match self.memory.first() {
            Some(first) => {
                let prefix = first.file_name().unwrap_or_default().to_string_lossy();
                format!(
                    "{} pieces of shared memory ({}, {SHARED_MEMORY}/{}*)",
                    self.memory.len(),
                    bytes(self.bytes),
                    &prefix[..PREFIX_LENGTH.min(prefix.len())]
                )
            }
            None => "no shared memory".into(),
        };
        match &self.instance {
            Some(instance) => {
                format!("dead group in {}, {memory}", instance.directory().display())
            }
            None => format!("dead group, its directory gone or elsewhere: {memory}"),
        }
    }

    /// Nobody can have come to life in it since it was found, or it stays.
    fn remove(&self) -> Result<(), String> {
        let Some(instance) = &self.instance else {
            return self.remove_memory();
        };
        let text = |error: InstanceError| error.to_string();
        // Held until the end: nobody starts meanwhile.
        let Some(_lock) = instance.lock().map_err(text)? else {
            return Err("it has just been started".into());
        };
        if has_processes(instance) {
            return Err("one of its processes has just been started".into());
        }
        self.remove_memory()?;
        instance.wipe().map_err(text)?;
        instance.remove_gateway_directory().map_err(text)?;
        instance.remove_directory().map_err(text)
    }

    fn remove_memory(&self) -> Result<(), String> {
        // The lock may be held by ourselves.
        let is_lock = |path: &Path| path.to_string_lossy().ends_with(lock::NAME);
        if self.memory.iter().any(|path| !is_lock(path) && is_in_use(path)) {
            return Err("somebody has just opened it".into());
        }
        for path in &self.memory {
            let removed =
                if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
            removed.map_err(|error| format!("{}: {error}", path.display()))?;
        }
        Ok(())
    }
}

/// `tl_`, eight digits, `_`: how all shared memory of ours begins.
const PREFIX_LENGTH: usize = 12;

/// Looks for leftovers of this user below `base` and in shared memory; in second place what cannot
/// be decided about.
pub fn find(base: &Path) -> Result<(Vec<Leftover>, Vec<Finding>), std::io::Error> {
    let mut memory = shared_memory()?;
    let mut found = Vec::new();
    let mut undecided = Vec::new();
    for instance in Instance::all_below(base) {
        if !instance.has_files() {
            continue;
        }
        let pieces = memory.remove(&instance.shared_memory_prefix()).unwrap_or_default();
        if instance.check_directory().is_err() {
            let what = format!("{} is not ours alone", instance.directory().display());
            undecided.push(Finding::warning(ABOUT, what, "look who has made it, and remove it"));
        } else if !is_alive(&instance) && !pieces.iter().any(|path| is_in_use(path)) {
            found.push(Leftover::new(Some(instance), pieces));
        }
    }
    for pieces in memory.into_values() {
        if !pieces.iter().any(|path| is_in_use(path)) {
            found.push(Leftover::new(None, pieces));
        }
    }
    Ok((found, undecided))
}

impl Leftover {
    fn new(instance: Option<Instance>, memory: Vec<PathBuf>) -> Self {
        let data = memory.iter().filter_map(|path| fs::symlink_metadata(path).ok());
        let bytes = data.map(|data| data.blocks() * 512).sum();
        Self { instance, memory, bytes }
    }
}

/// Says what there is.
pub fn list(left: &[Leftover]) -> Vec<Finding> {
    let finding = |left: &Leftover| {
        Finding::warning(ABOUT, left.name(), "touchline doctor --clean removes it")
    };
    or_nothing(left.iter().map(finding).collect())
}

/// Removes it, and says so.
pub fn remove(left: Vec<Leftover>) -> Vec<Finding> {
    let finding = |left: Leftover| match left.remove() {
        Ok(()) => Finding::ok(ABOUT, format!("removed: {}", left.name())),
        Err(why) => Finding::warning(
            ABOUT,
            format!("{}; it stays: {why}", left.name()),
            "run touchline doctor again",
        ),
    };
    or_nothing(left.into_iter().map(finding).collect())
}

fn or_nothing(findings: Vec<Finding>) -> Vec<Finding> {
    if findings.is_empty() { vec![Finding::ok(ABOUT, "none")] } else { findings }
}

/// Pieces of shared memory of this user that have our names, by the group they belong to.
fn shared_memory() -> Result<BTreeMap<String, Vec<PathBuf>>, std::io::Error> {
    let mut groups: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for entry in fs::read_dir(SHARED_MEMORY)?.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let Some(prefix) = prefix(&name) else { continue };
        let is_ours = fs::symlink_metadata(entry.path())
            .is_ok_and(|data| !data.is_symlink() && data.uid() == getuid().as_raw());
        if is_ours {
            groups.entry(prefix.into()).or_default().push(entry.path());
        }
    }
    Ok(groups)
}

fn prefix(name: &str) -> Option<&str> {
    let prefix = name.get(..PREFIX_LENGTH)?;
    let digits = prefix.strip_prefix("tl_")?.strip_suffix('_')?;
    let is_digit = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
    digits.bytes().all(is_digit).then_some(prefix)
}

/// Whether a supervisor or any other process of the group lives.
fn is_alive(instance: &Instance) -> bool {
    instance.is_supervised() || has_processes(instance)
}

/// Whether any process of the group lives. When that cannot be found out, one does.
fn has_processes(instance: &Instance) -> bool {
    participants::living(instance).map_or(true, |living| !living.is_empty())
}

/// Whether any process, of whatever container, has the file open or mapped; also when that cannot
/// be found out. A directory, in which iceoryx2 keeps files, is when one of those is.
fn is_in_use(path: &Path) -> bool {
    if fs::symlink_metadata(path).is_ok_and(|data| data.is_dir()) {
        let entries = fs::read_dir(path).into_iter().flatten().flatten();
        // What can be opened; sockets cannot, and do not last without the files beside them.
        let is_kept = |kind: fs::FileType| kind.is_dir() || kind.is_file();
        return entries
            .into_iter()
            .filter(|entry| entry.file_type().is_ok_and(is_kept))
            .any(|entry| is_in_use(&entry.path()));
    }
    match OpenOptions::new().read(true).custom_flags(libc::O_NOFOLLOW).open(path) {
        Ok(file) => !can_lease(&file),
        Err(error) => error.kind() != std::io::ErrorKind::NotFound,
    }
}

/// A write lease is granted only to the one who alone has the file open; it is given back at once.
#[allow(unsafe_code)] // `fcntl` for leases has no safe wrapper
fn can_lease(file: &File) -> bool {
    let lease = |kind: i32| {
        // SAFETY: the descriptor is open for the whole call, and this command takes an integer and
        // touches no memory of ours.
        unsafe { libc::fcntl(file.as_raw_fd(), libc::F_SETLEASE, kind) == 0 }
    };
    lease(libc::F_WRLCK) && lease(libc::F_UNLCK)
}

#[cfg(test)]
mod tests {
    use super::*;
    use common::bus::Bus;
    use common::topics;

    #[test]
    fn only_names_of_ours_count() {
        assert_eq!(prefix("tl_0123abcd_x"), Some("tl_0123abcd_"));
        for name in ["tl_0123abcd", "tl_0123ABCD_x", "xx_0123abcd_x", "tl_0123abcdex", "tl_", "ä"]
        {
            assert_eq!(prefix(name), None, "{name}");
        }
    }

    #[test]
    fn a_file_is_in_use_while_somebody_has_it_open() {
        let path = std::env::temp_dir().join(format!("tl-lease-{}", std::process::id()));
        let file = File::create(&path).unwrap();
        assert!(is_in_use(&path));
        drop(file);
        assert!(!is_in_use(&path));
        fs::remove_file(&path).unwrap();
        assert!(!is_in_use(&path));
    }

    #[test]
    fn the_living_are_left_alone_and_the_dead_removed() {
        let base = std::env::temp_dir().join(format!("tl-doctor-{}", std::process::id()));
        let instance = |name| Instance::below(&base, name).unwrap();
        let memory = |instance: &Instance| {
            shared_memory().unwrap().remove(&instance.shared_memory_prefix()).unwrap_or_default()
        };
        // A process that has joined, and shared memory of one that nobody has any more.
        let living = instance("living");
        living.create_directory().unwrap();
        let bus = Bus::join(&living, "somebody").unwrap();
        let _world = bus.publisher(&topics::WORLD, 1).unwrap();
        let dead = instance("dead");
        dead.create_directory().unwrap();
        let piece = Path::new(SHARED_MEMORY).join(dead.shared_memory_prefix() + "piece");
        fs::write(&piece, [1; 5000]).unwrap();
        // And of a group whose directory is gone.
        let gone = instance("gone");
        let lost = Path::new(SHARED_MEMORY).join(gone.shared_memory_prefix() + "piece");
        fs::write(&lost, [1; 5000]).unwrap();

        let (left, undecided) = find(&base).unwrap();
        assert!(undecided.is_empty());
        let names: Vec<String> = left.iter().map(Leftover::name).collect();
        let contains = |part: &str| names.iter().any(|name| name.contains(part));
        assert!(contains(dead.directory().to_str().unwrap()), "{names:?}");
        assert!(contains(&gone.shared_memory_prefix()), "{names:?}");
        assert!(!contains(living.directory().to_str().unwrap()), "{names:?}");
        assert!(!contains(&living.shared_memory_prefix()), "{names:?}");

        // Other tests of this machine may have leftovers too; they are none of our business here.
        let is_mine =
            |left: &Leftover| left.memory == [piece.clone()] || left.memory == [lost.clone()];
        for left in left.into_iter().filter(is_mine) {
            left.remove().unwrap();
        }
        assert!(!piece.exists() && !lost.exists() && !dead.directory().exists());
        assert!(living.directory().exists() && !memory(&living).is_empty());
        drop((_world, bus));
        living.wipe().unwrap();
        living.remove_directory().unwrap();
    }

    #[test]
    fn what_comes_to_life_meanwhile_stays() {
        let base = std::env::temp_dir().join(format!("tl-doctor-late-{}", std::process::id()));
        let late = Instance::below(&base, "late").unwrap();
        late.create_directory().unwrap();
        let left = Leftover::new(Some(late.clone()), Vec::new());
        let lock = late.lock().unwrap().unwrap();
        assert!(left.remove().is_err() && late.directory().exists());
        drop(lock);
        left.remove().unwrap();
        assert!(!base.exists());
    }
}
