//! Who has joined an instance: the living, and the dead whose places are still taken.

use super::{BusError, failed};
use crate::instance::Instance;
use crate::roster::NodeKey;
use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::node::NodeView;
use iceoryx2::prelude::*;
use std::time::{Duration, SystemTime};

/// A process that has joined an instance.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LivingProcess {
    /// The system's number for it.
    pub pid: u32,
    /// The name under which it joined.
    pub name: String,
}

/// When a process has last joined the instance or left it in order; `None` before the first. Much
/// cheaper to ask than who they are. By the wall clock, which may be set: good for noticing that
/// something has changed, and for nothing else.
pub fn changed_at(instance: &Instance) -> Option<SystemTime> {
    let config = instance.namespace().ok()??.ipc_config().ok()?;
    let nodes = config.global.node_dir().to_string();
    std::fs::metadata(nodes).ok()?.modified().ok()
}

/// Removes what dead processes have left: slots of publishers and subscribers, and their
/// shared memory. Takes milliseconds for each; returns how many were found. After an error it is
/// worth trying again.
pub fn remove_dead(instance: &Instance) -> Result<usize, BusError> {
    remove_dead_named(instance, |_| true)
}

/// As [`remove_dead`], for processes that had joined under certain names.
/// The name of one that died while it joined is empty.
pub fn remove_dead_named(
    instance: &Instance,
    concerns: impl Fn(&str) -> bool,
) -> Result<usize, BusError> {
    let Some(namespace) = instance.namespace()? else { return Ok(0) };
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
        // One that cannot be cleared now, since somebody died while clearing it, say, is no reason
        // to leave the others.
        if let Err(error) = view.blocking_remove_stale_resources(Duration::from_secs(1)) {
            outcome = Err(failed("node", "remove what a dead process left")(error));
        }
    }
    outcome
}

/// The living processes in the instance.
pub fn living(instance: &Instance) -> Result<Vec<LivingProcess>, BusError> {
    let mut living = Vec::new();
    let Some(namespace) = instance.namespace()? else { return Ok(living) };
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

/// The name under which a node has joined, also when its process has died and is not yet cleared.
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
        instance.wipe().unwrap();
        instance.remove_directory().unwrap();
        let _ = std::fs::remove_dir(base);
    }
}
