//! Measures the resources that a group uses, and those left after its end.

use super::population::belongs_to;
use client::instance::{Instance, Namespace};
use client::memory::SHARED_MEMORY;
use control::KEPT_REVISIONS;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Connections to dead processes that a living process may still hold, on average: every process drops them
/// with its next heartbeat, so only those of the last death may be left.
const STALE_PER_PROCESS: u64 = 1;
/// Limit for the file descriptors that one process holds of dead ones.
pub const STALE_DESCRIPTORS: u64 = 4;

/// Resources that a group uses at one time.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Usage {
    /// Its entries in /dev/shm.
    pub shared_memory_entries: u64,
    /// Files, sockets and directories in its runtime directory.
    pub runtime_entries: u64,
    /// Its processes, the supervisor included.
    pub processes: u64,
    /// Open file descriptors: of the supervisor, and for each stage, of its process that has the most.
    pub descriptors: BTreeMap<String, u64>,
    /// Memory that no other process shares, of all processes together.
    pub private_bytes: u64,
    /// Resident memory of all processes together; shared memory counts once for each.
    pub resident_bytes: u64,
}

/// Resources left after the end of a group.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Leftovers {
    /// Whether the supervisor ended on request, and reported success.
    pub ended_in_order: bool,
    /// Processes still there.
    pub processes: Vec<u32>,
    /// Names in /dev/shm.
    pub shared_memory: Vec<String>,
    /// Whether the runtime directory is still there.
    pub runtime_directory: bool,
}

/// Resources that the group uses now.
pub fn usage(instance: &Instance) -> Usage {
    let processes = processes(instance.name());
    let namespace = instance.namespace().ok().flatten();
    let mut usage = Usage {
        shared_memory_entries: shared_memory(namespace.as_ref()).len() as u64,
        runtime_entries: runtime_entries(instance),
        processes: processes.len() as u64,
        ..Usage::default()
    };
    for pid in processes {
        let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
        usage.private_bytes += kilobytes(&status, "RssAnon:") * 1024;
        usage.resident_bytes += kilobytes(&status, "VmRSS:") * 1024;
        let descriptors = fs::read_dir(format!("/proc/{pid}/fd")).map_or(0, Iterator::count) as u64;
        let most = usage.descriptors.entry(role(pid)).or_default();
        *most = descriptors.max(*most);
    }
    usage
}

/// Resources left of the group that used this namespace.
pub fn leftovers(instance: &Instance, namespace: Option<&Namespace>) -> Leftovers {
    Leftovers {
        ended_in_order: false,
        processes: processes(instance.name()),
        shared_memory: shared_memory(namespace),
        runtime_directory: instance.directory().exists(),
    }
}

/// All processes whose command line names the group. A process not reaped yet has no command line.
pub fn processes(instance: &str) -> Vec<u32> {
    let Ok(entries) = fs::read_dir("/proc") else { return Vec::new() };
    let pids = entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    pids.filter(|&pid| belongs_to(pid, instance)).collect()
}

impl Usage {
    /// Entries of dead processes that may remain at any time, regardless of the number of deaths.
    pub fn stale(&self) -> u64 {
        STALE_PER_PROCESS * self.processes
    }

    /// Whether nothing has accumulated since `before`. Memory is not compared: how much an allocator
    /// keeps varies, and the verdict sets a limit.
    pub fn is_back_to(&self, before: &Usage) -> bool {
        self.shared_memory_entries <= before.shared_memory_entries + before.stale()
            && self.runtime_entries <= before.runtime_entries + before.stale()
            && self.processes <= before.processes
            && self
                .descriptors_grown(before)
                .iter()
                .all(|(_, before, now)| *now <= before + STALE_DESCRIPTORS)
    }

    /// Processes whose descriptors have increased, with the counts before and now.
    pub fn descriptors_grown(&self, before: &Usage) -> Vec<(String, u64, u64)> {
        let before = |role: &String| before.descriptors.get(role).copied().unwrap_or(0);
        self.descriptors
            .iter()
            .map(|(role, &now)| (role.clone(), before(role), now))
            .filter(|&(_, before, now)| now > before)
            .collect()
    }
}

/// The subcommand with which a process of the group was started.
fn role(pid: u32) -> String {
    let line = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
    let word = line.split(|&byte| byte == 0).nth(1).unwrap_or_default();
    match word {
        b"run" => "supervisor".into(),
        word => String::from_utf8_lossy(word).into(),
    }
}

fn kilobytes(status: &str, key: &str) -> u64 {
    let value = status.lines().find_map(|line| line.strip_prefix(key)).unwrap_or_default();
    value.split_whitespace().next().and_then(|number| number.parse().ok()).unwrap_or(0)
}

/// The group's names in shared memory: its segments, and everything in its directory.
fn shared_memory(namespace: Option<&Namespace>) -> Vec<String> {
    let Some(namespace) = namespace else { return Vec::new() };
    let mut paths = namespace.segments().map(|(own, _)| own).unwrap_or_default();
    let mut places = vec![namespace.directory().to_path_buf()];
    while let Some(place) = places.pop().filter(|place| place.is_dir()) {
        for entry in fs::read_dir(&place).into_iter().flatten().flatten() {
            if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                places.push(entry.path());
            }
            paths.push(entry.path());
        }
    }
    let below =
        |path: &PathBuf| path.strip_prefix(SHARED_MEMORY).unwrap_or(path).display().to_string();
    paths.iter().map(below).collect()
}

/// Entries of the runtime directory. The configurations that a supervisor keeps do not count, but more of
/// them do.
fn runtime_entries(instance: &Instance) -> u64 {
    // The last revisions, the configuration of the start, and the history.
    let kept = u64::from(KEPT_REVISIONS) + 2;
    let revisions = entries_below(&instance.revisions_directory());
    entries_below(instance.directory()) - revisions.min(kept)
}

fn entries_below(directory: &Path) -> u64 {
    let Ok(entries) = fs::read_dir(directory) else { return 0 };
    let count = |entry: fs::DirEntry| match entry.file_type() {
        Ok(kind) if kind.is_dir() => 1 + entries_below(&entry.path()),
        _ => 1,
    };
    entries.flatten().map(count).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_read_off_the_status_file() {
        let status = "Name:\tx\nVmRSS:\t   2048 kB\nRssAnon:\t     512 kB\n";
        assert_eq!((kilobytes(status, "VmRSS:"), kilobytes(status, "RssAnon:")), (2048, 512));
        assert_eq!(kilobytes("", "VmRSS:"), 0);
    }

    #[test]
    fn anything_more_than_before_is_noticed() {
        let before = Usage {
            shared_memory_entries: 5,
            processes: 8,
            descriptors: [("filter".into(), 20)].into(),
            ..Usage::default()
        };
        assert!(before.is_back_to(&before));
        let with = |change: fn(&mut Usage)| {
            let mut after = before.clone();
            change(&mut after);
            after.is_back_to(&before)
        };
        assert!(with(|usage| usage.shared_memory_entries += 8));
        assert!(!with(|usage| usage.shared_memory_entries += 9));
        assert!(!with(|usage| usage.runtime_entries += 9));
        assert!(!with(|usage| usage.processes += 1));
        assert!(with(|usage| *usage.descriptors.get_mut("filter").unwrap() += 4));
        assert!(!with(|usage| *usage.descriptors.get_mut("filter").unwrap() += 5));
        let leaky = Usage { descriptors: [("filter".into(), 21)].into(), ..before.clone() };
        assert_eq!(leaky.descriptors_grown(&before), [("filter".into(), 20, 21)]);
    }

    #[test]
    fn everything_below_a_directory_is_counted() {
        let place = std::env::temp_dir().join(format!("tl-entries-{}", std::process::id()));
        fs::create_dir_all(place.join("a/b")).unwrap();
        fs::write(place.join("a/file"), "").unwrap();
        assert_eq!(entries_below(&place), 3);
        fs::remove_dir_all(&place).unwrap();
        assert_eq!(entries_below(&place), 0);
    }
}
