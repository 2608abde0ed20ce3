//! Finds and removes what dead groups have left, in the runtime directory and in shared memory.
//!
//! Nothing that a living process could need is touched. Whether a process has a segment open is not
//! concluded from process lists, which end at the border of a container: the kernel grants a lease on a
//! file only if no other process has it open or mapped.

use super::{Finding, bytes};
use client::bus::participants;
use client::instance::{Instance, InstanceError, Namespace, lock, namespace};
use client::memory::SHARED_MEMORY;
use rustix::process::getuid;
use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

const ABOUT: &str = "leftovers";

/// The leftovers of one dead group.
#[derive(Debug, Default)]
pub struct Leftover {
    /// Its instance, if its runtime directory still exists.
    instance: Option<Instance>,
    /// Its entries in shared memory.
    memory: Memory,
}

/// Entries of shared memory that belong together.
#[derive(Debug, Default, PartialEq, Eq)]
struct Memory {
    /// Directories and segments.
    pieces: Vec<PathBuf>,
    /// The runtime directory of the group that created them, if they record it.
    runtime_directory: Option<PathBuf>,
}

impl Memory {
    /// Memory that they occupy.
    fn bytes(&self) -> u64 {
        let data = self.pieces.iter().filter_map(|path| fs::symlink_metadata(path).ok());
        data.map(|data| data.blocks() * 512).sum()
    }

    /// Whether any process has any of them open; `lock` says whether an open lock counts.
    fn is_in_use(&self, lock: Lock) -> bool {
        self.pieces.iter().any(|path| is_in_use(path, lock))
    }
}

/// Whether an open lock counts as use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Lock {
    /// It may be held by a supervisor.
    Counts,
    /// It is held by this process.
    IsOurs,
}

impl Leftover {
    fn name(&self) -> String {
        let memory = match self.memory.pieces.first() {
            Some(first) => {
                let count = self.memory.pieces.len();
                format!(
                    "{count} pieces of shared memory ({}, {}{})",
                    bytes(self.memory.bytes()),
                    first.display(),
                    if count == 1 { "" } else { " and others" }
                )
            }
            None => "no shared memory".into(),
        };
        match (&self.instance, &self.memory.runtime_directory) {
            (Some(instance), _) => {
                format!("dead group in {}, {memory}", instance.directory().display())
            }
            (None, Some(directory)) => {
                format!("dead group of {}, which is gone: {memory}", directory.display())
            }
            (None, None) => format!("dead group, its directory gone or elsewhere: {memory}"),
        }
    }

    /// Removes the leftovers, unless a process has started to use them since they were found.
    fn remove(&self) -> Result<(), String> {
        let Some(instance) = &self.instance else {
            return self.remove_memory(Lock::Counts);
        };
        let text = |error: InstanceError| error.to_string();
        // Held until the end, so that no supervisor starts meanwhile.
        let Some(_lock) = instance.lock().map_err(text)? else {
            return Err("it has just been started".into());
        };
        if has_processes(instance) {
            return Err("one of its processes has just been started".into());
        }
        self.remove_memory(Lock::IsOurs)?;
        instance.remove_gateway_directory().map_err(text)?;
        instance.remove_directory().map_err(text)
    }

    fn remove_memory(&self, lock: Lock) -> Result<(), String> {
        if self.memory.is_in_use(lock) {
            return Err("somebody has just opened it".into());
        }
        for path in &self.memory.pieces {
            let removed =
                if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
            removed.map_err(|error| format!("{}: {error}", path.display()))?;
        }
        Ok(())
    }
}

/// Length of the prefix of the program's segments: `tl_`, eight digits, `_`.
const PREFIX_LENGTH: usize = 12;

/// Finds this user's leftovers below `base` and in shared memory; the second part of the result lists
/// those that cannot be judged or removed.
pub fn find(base: &Path) -> Result<(Vec<Leftover>, Vec<Finding>), std::io::Error> {
    let mut segments = segments()?;
    let mut groups = Vec::new();
    let mut undecided = Vec::new();
    for namespace in Namespace::all()? {
        let mut pieces = vec![namespace.directory().to_path_buf()];
        pieces.extend(segments.remove(namespace.prefix()).unwrap_or_default());
        let runtime_directory = Some(namespace.runtime_directory().to_path_buf());
        groups.push(Memory { pieces, runtime_directory });
        let foreign = namespace.segments()?.1.into_iter().map(|file| {
            let advice = "nothing uses it; its owner or root can remove it";
            Finding::warning("other users", file.to_string(), advice)
        });
        undecided.extend(foreign);
    }
    // Directories whose note is gone, or not written yet.
    let is_known =
        |path: &PathBuf, groups: &[Memory]| groups.iter().any(|it| it.pieces.contains(path));
    for path in namespace::directories()?.into_iter().filter(|path| !is_known(path, &groups)) {
        segments.entry(path.to_string_lossy().into_owned()).or_default().push(path);
    }
    let mut found = Vec::new();
    for instance in Instance::all_below(base) {
        if !instance.has_files() {
            continue;
        }
        let is_its =
            |group: &Memory| group.runtime_directory.as_deref() == Some(instance.directory());
        let memory = groups.iter().position(is_its).map(|index| groups.remove(index));
        let memory = memory.unwrap_or_default();
        if instance.check_directory().is_err() {
            let what = format!("{} is not ours alone", instance.directory().display());
            undecided.push(Finding::warning(ABOUT, what, "look who has made it, and remove it"));
        } else if !is_alive(&instance) && !memory.is_in_use(Lock::Counts) {
            found.push(Leftover { instance: Some(instance), memory });
        }
    }
    groups.extend(segments.into_values().map(|pieces| Memory { pieces, runtime_directory: None }));
    let dead = groups.into_iter().filter(|memory| !memory.is_in_use(Lock::Counts));
    found.extend(dead.map(|memory| Leftover { instance: None, memory }));
    Ok((found, undecided))
}

/// A finding for each.
pub fn list(left: &[Leftover]) -> Vec<Finding> {
    let finding = |left: &Leftover| {
        Finding::warning(ABOUT, left.name(), "touchline doctor --clean removes it")
    };
    or_nothing(left.iter().map(finding).collect())
}

/// Removes them, and reports the results.
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

/// This user's segments with names of this program, by their prefix.
fn segments() -> Result<BTreeMap<String, Vec<PathBuf>>, std::io::Error> {
    let mut segments: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for entry in fs::read_dir(SHARED_MEMORY)?.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let Some(prefix) = prefix(&name) else { continue };
        let is_ours = fs::symlink_metadata(entry.path())
            .is_ok_and(|data| !data.is_symlink() && data.uid() == getuid().as_raw());
        if is_ours {
            segments.entry(prefix.into()).or_default().push(entry.path());
        }
    }
    Ok(segments)
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

/// Whether any process of the group lives; `true` if that cannot be determined.
fn has_processes(instance: &Instance) -> bool {
    participants::living(instance).map_or(true, |living| !living.is_empty())
}

/// Whether any process, in any container, has the file open or mapped; `true` if that cannot be
/// determined. A directory, in which iceoryx2 keeps files, is in use if one of its files is.
fn is_in_use(path: &Path, lock: Lock) -> bool {
    if fs::symlink_metadata(path).is_ok_and(|data| data.is_dir()) {
        let entries = fs::read_dir(path).into_iter().flatten().flatten();
        // Only files that can be opened count; sockets cannot, and do not outlast the files beside them.
        let is_kept = |kind: fs::FileType| kind.is_dir() || kind.is_file();
        return entries
            .into_iter()
            .filter(|entry| entry.file_type().is_ok_and(is_kept))
            .any(|entry| is_in_use(&entry.path(), lock));
    }
    if lock == Lock::IsOurs && path.file_name().is_some_and(|name| name == lock::NAME) {
        return false;
    }
    match OpenOptions::new().read(true).custom_flags(libc::O_NOFOLLOW).open(path) {
        Ok(file) => !can_lease(&file),
        Err(error) => error.kind() != std::io::ErrorKind::NotFound,
    }
}

/// A write lease is granted only if no other process has the file open; it is returned at once.
#[allow(unsafe_code)] // `fcntl` for leases has no safe wrapper
fn can_lease(file: &File) -> bool {
    let lease = |kind: i32| {
        // SAFETY: the descriptor is open for the whole call, and this command takes an integer and
        // accesses no memory of this process.
        unsafe { libc::fcntl(file.as_raw_fd(), libc::F_SETLEASE, kind) == 0 }
    };
    lease(libc::F_WRLCK) && lease(libc::F_UNLCK)
}

#[cfg(test)]
mod tests {
    use super::*;
    use client::bus::Bus;
    use messages::topics;

    #[test]
    fn only_names_of_ours_count() {
        assert_eq!(prefix("tl_0123abcd_x"), Some("tl_0123abcd_"));
        for name in ["tl_0123abcd", "tl_0123ABCD_x", "xx_0123abcd_x", "tl_0123abcdex", "tl_", "ä"]
        {
            assert_eq!(prefix(name), None, "{name}");
        }
    }

    #[test]
    fn a_file_is_in_use_while_a_process_has_it_open() {
        let path = std::env::temp_dir().join(format!("tl-lease-{}", std::process::id()));
        let file = File::create(&path).unwrap();
        assert!(is_in_use(&path, Lock::Counts));
        drop(file);
        assert!(!is_in_use(&path, Lock::Counts));
        fs::remove_file(&path).unwrap();
        assert!(!is_in_use(&path, Lock::Counts));
    }

    #[test]
    fn living_groups_stay_and_dead_ones_are_removed() {
        let base = std::env::temp_dir().join(format!("tl-doctor-{}", std::process::id()));
        let instance = |name| {
            let instance = Instance::below(&base, name).unwrap();
            instance.create_directory().unwrap();
            instance
        };
        // A process that has joined, and shared memory that no process uses.
        let living = instance("living");
        let bus = Bus::join(&living, "somebody").unwrap();
        let _world = bus.publisher(&topics::WORLD, 1).unwrap();
        let dead = instance("dead");
        let piece = |instance: &Instance| {
            let namespace = instance.create_namespace().unwrap();
            let path = Path::new(SHARED_MEMORY).join(namespace.prefix().to_owned() + "piece");
            fs::write(&path, [1; 5000]).unwrap();
            (path, namespace.directory().to_path_buf())
        };
        let (piece_of_dead, dead_place) = piece(&dead);
        // Also of groups without a runtime directory: one records it, the other has lost that note too.
        let [gone, lost] = ["gone", "lost"].map(instance);
        let [(piece_of_gone, gone_place), (piece_of_lost, lost_place)] =
            [piece(&gone), piece(&lost)];
        fs::remove_dir_all(gone.directory()).unwrap();
        fs::remove_dir_all(lost.directory()).unwrap();
        fs::remove_dir_all(&lost_place).unwrap();

        let (left, undecided) = find(&base).unwrap();
        assert!(undecided.is_empty(), "{undecided:?}");
        let names: Vec<String> = left.iter().map(Leftover::name).collect();
        let contains = |part: &str| names.iter().any(|name| name.contains(part));
        assert!(contains(&format!("dead group in {}", dead.directory().display())), "{names:?}");
        assert!(contains(&format!("dead group of {}", gone.directory().display())), "{names:?}");
        assert!(contains(piece_of_lost.to_str().unwrap()), "{names:?}");
        assert!(!contains(living.directory().to_str().unwrap()), "{names:?}");
        assert!(!contains(bus.namespace().prefix()), "{names:?}");

        // Other tests on this machine may have leftovers too.
        let mine = [&piece_of_dead, &piece_of_gone, &piece_of_lost];
        let is_mine = |left: &Leftover| left.memory.pieces.iter().any(|it| mine.contains(&it));
        for left in left.into_iter().filter(is_mine) {
            left.remove().unwrap();
        }
        for path in [&piece_of_dead, &piece_of_gone, &piece_of_lost, &dead_place, &gone_place] {
            assert!(!path.exists(), "{}", path.display());
        }
        assert!(!dead.directory().exists());
        assert!(living.directory().exists() && living.namespace().unwrap().is_some());
        drop((_world, bus));
        living.remove_directory().unwrap();
    }

    #[test]
    fn a_group_that_starts_meanwhile_stays() {
        let base = std::env::temp_dir().join(format!("tl-doctor-late-{}", std::process::id()));
        let late = Instance::below(&base, "late").unwrap();
        late.create_directory().unwrap();
        let left = Leftover { instance: Some(late.clone()), memory: Memory::default() };
        let lock = late.lock().unwrap().unwrap();
        assert!(left.remove().is_err() && late.directory().exists());
        drop(lock);
        left.remove().unwrap();
        assert!(!base.exists());
    }
}
