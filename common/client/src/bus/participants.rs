//! The processes that have joined an instance: living ones, and dead ones whose slots are still taken.

use super::{BusError, failed};
use crate::instance::Instance;
use crate::roster::NodeKey;
use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::node::NodeView;
use iceoryx2::prelude::*;
use rustix::io::Errno;
use rustix::process::{Pid, test_kill_process};
use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;
use std::time::{Duration, SystemTime};

/// A process that has joined an instance.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LivingProcess {
    /// Process id.
    pub pid: u32,
    /// The name under which it joined.
    pub name: String,
}

/// Time at which a process last joined the instance or left it in order; `None` before the first. Much
/// cheaper than listing the processes. It is wall-clock time, which may be set, so it can only show
/// that something has changed.
pub fn changed_at(instance: &Instance) -> Option<SystemTime> {
    let config = instance.namespace().ok()??.ipc_config().ok()?;
    let nodes = config.global.node_dir().to_string();
    std::fs::metadata(nodes).ok()?.modified().ok()
}

/// Removes what dead processes have left: publisher and subscriber slots, and shared memory. Takes
/// milliseconds for each; returns how many were found. It can be retried after an error.
pub fn remove_dead(instance: &Instance) -> Result<usize, BusError> {
    remove_dead_named(instance, |_| true)
}

/// Like [`remove_dead`], for processes that joined under certain names. A process that died while it
/// joined has an empty name.
pub fn remove_dead_named(
    instance: &Instance,
    concerns: impl Fn(&str) -> bool,
) -> Result<usize, BusError> {
    let Some(namespace) = instance.namespace()? else { return Ok(0) };
    namespace.check_version()?;
    let mut dead = Vec::new();
    Node::<ipc::Service>::list(&namespace.ipc_config()?, |state| {
        if let NodeState::Dead(view) = state {
            let name = view.details().as_ref().map(|details| details.name().to_string());
            if concerns(&name.unwrap_or_default()) {
                dead.push(view);
            }
        }
        CallbackProgression::Continue
    })
    .map_err(failed("node", "list the processes"))?;
    let found = dead.len();
    let mut outcome = Ok(found);
    for view in dead {
        // One that cannot be cleared now, for example because a process died while clearing it, must
        // not keep the others.
        if let Err(error) = view.blocking_remove_stale_resources(Duration::from_secs(1)) {
            outcome = Err(failed("node", "remove what a dead process left")(error));
        }
    }
    outcome
}

/// Finds the leftovers of processes that died while they joined.
///
/// A joining process makes a directory, and then the files by which iceoryx2 sees that it lives. One
/// that dies between the two, or cannot make the files because memory has run out, is on no list, and
/// iceoryx2 would keep its directory for ever.
#[derive(Debug, Default)]
pub struct HalfJoined {
    /// Directories without files at the last check.
    found: BTreeSet<u128>,
}

impl HalfJoined {
    /// Removes directories that were already half made at the last check and belong to no living
    /// process; a process that is joining right now is not disturbed. Returns how many were removed.
    pub fn remove(&mut self, instance: &Instance) -> Result<usize, BusError> {
        let Some(namespace) = instance.namespace()? else { return Ok(0) };
        let nodes = PathBuf::from(namespace.ipc_config()?.global.node_dir().to_string());
        let mut directories = BTreeSet::new();
        let mut has_files = BTreeSet::new();
        for entry in fs::read_dir(&nodes).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            match name.parse() {
                Ok(id) => _ = directories.insert(id),
                // Such a file is named PREFIX_ID.KIND.
                Err(_) => has_files.extend(id_of_file(&name)),
            }
        }
        let half: BTreeSet<u128> = directories.difference(&has_files).copied().collect();
        let mut removed = 0;
        for id in half.intersection(&self.found).filter(|&&id| !lives(pid_of(id))) {
            fs::remove_dir_all(nodes.join(id.to_string()))
                .map_err(failed("node", "remove what a process left that had only half joined"))?;
            removed += 1;
        }
        self.found = half;
        Ok(removed)
    }
}

fn id_of_file(name: &str) -> Option<u128> {
    let (stem, _) = name.split_once('.')?;
    stem.rsplit('_').next()?.parse().ok()
}

/// The process id is the third of the four parts of an iceoryx2 node id.
fn pid_of(id: u128) -> u32 {
    (id >> PID_SHIFT) as u32
}

const PID_SHIFT: u32 = 64;

fn lives(pid: u32) -> bool {
    let pid = i32::try_from(pid).ok().and_then(Pid::from_raw);
    // EPERM means that the process exists and belongs to another user.
    pid.is_some_and(|pid| test_kill_process(pid) != Err(Errno::SRCH))
}

/// The living processes in the instance.
pub fn living(instance: &Instance) -> Result<Vec<LivingProcess>, BusError> {
    let mut living = Vec::new();
    let Some(namespace) = instance.namespace()? else { return Ok(living) };
    namespace.check_version()?;
    Node::<ipc::Service>::list(&namespace.ipc_config()?, |state| {
        if let NodeState::Alive(view) = state
            && let Ok(pid) = view.id().pid::<ipc::Service>()
        {
            let name = view.details().as_ref().map(|details| details.name().to_string());
            living.push(LivingProcess { pid: pid.value() as u32, name: name.unwrap_or_default() });
        }
        CallbackProgression::Continue
    })
    .map_err(failed("node", "list the processes"))?;
    Ok(living)
}

/// The name under which a node joined, also when its process has died and is not cleaned up yet.
pub fn name_of(instance: &Instance, key: NodeKey) -> Option<String> {
    let mut name = None;
    let named = |id: &UniqueNodeId, details: Option<String>, name: &mut Option<String>| {
        if NodeKey::of(id) == key {
            *name = details;
        }
        CallbackProgression::Continue
    };
    let config = instance.namespace().ok()??.ipc_config().ok()?;
    Node::<ipc::Service>::list(&config, |state| match state {
        NodeState::Alive(view) => {
            let details = view.details().as_ref().map(|details| details.name().to_string());
            named(view.id(), details, &mut name)
        }
        NodeState::Dead(view) => {
            let details = view.details().as_ref().map(|details| details.name().to_string());
            named(view.id(), details, &mut name)
        }
        _ => CallbackProgression::Continue,
    })
    .ok()?;
    name
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::Bus;

    #[test]
    fn coming_and_going_is_noticed() {
        let base = std::env::temp_dir().join(format!("tl-participants-{}", std::process::id()));
        let instance = Instance::below(&base, "changes").unwrap();
        instance.create_directory().unwrap();
        assert_eq!(changed_at(&instance), None);
        let first = Bus::join(&instance, "first").unwrap();
        let names: Vec<_> = living(&instance).unwrap().into_iter().map(|it| it.name).collect();
        assert_eq!(names, ["first"]);
        let mut before = changed_at(&instance);
        assert!(before.is_some());
        // File systems count time in steps of some milliseconds.
        let is_noticed = |change: &dyn Fn(), before: &mut Option<SystemTime>| {
            let noticed = (0..10_000).any(|_| {
                change();
                changed_at(&instance) != *before
            });
            *before = changed_at(&instance);
            noticed
        };
        assert!(is_noticed(&|| drop(Bus::join(&instance, "second")), &mut before));
        assert_eq!(changed_at(&instance), before, "nobody has come");
        drop(first);
        instance.remove_directory().unwrap();
        let _ = std::fs::remove_dir(base);
    }

    #[test]
    fn leftovers_of_half_a_join_are_removed_and_a_living_process_stays() {
        let base = std::env::temp_dir().join(format!("tl-half-{}", std::process::id()));
        let instance = Instance::below(&base, "half").unwrap();
        instance.create_directory().unwrap();
        let bus = Bus::join(&instance, "whole").unwrap();
        let config = bus.namespace().ipc_config().unwrap();
        let nodes = PathBuf::from(config.global.node_dir().to_string());
        let ids = || -> Vec<u128> {
            let names = fs::read_dir(&nodes).unwrap().flatten().map(|entry| entry.file_name());
            names.filter_map(|name| name.to_string_lossy().parse().ok()).collect()
        };
        let own = ids()[0];
        assert_eq!(pid_of(own), std::process::id(), "iceoryx2 makes its numbers in another way");

        // One directory of a dead process, and one of a living process that may be about to go on.
        let mut child = std::process::Command::new("true").spawn().unwrap();
        child.wait().unwrap();
        let dead = own & !(u128::from(u32::MAX) << PID_SHIFT);
        let dead = dead | u128::from(child.id()) << PID_SHIFT;
        let joining = own + 1;
        for id in [dead, joining] {
            fs::create_dir(nodes.join(id.to_string())).unwrap();
            fs::write(nodes.join(id.to_string()).join("details"), "").unwrap();
        }
        let mut half_joined = HalfJoined::default();
        assert_eq!(half_joined.remove(&instance).unwrap(), 0, "it may be joining");
        assert_eq!(half_joined.remove(&instance).unwrap(), 1);
        assert_eq!(half_joined.remove(&instance).unwrap(), 0);
        assert!(ids().contains(&own) && ids().contains(&joining) && !ids().contains(&dead));
        drop(bus);
        instance.remove_directory().unwrap();
    }
}
