//! Checks the places that a match uses: shared memory, runtime directory, disk.

use super::{Finding, bytes};
use crate::commands::group::strange_versions;
use client::instance::Instance;
use client::instance::namespace::IPC_VERSION;
use client::memory::{GroupMemory, SHARED_MEMORY, check_place, free_bytes};
use config::Config;
use grabber::source::Source;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use touchline::gateway::place;
use touchline::supervisor::evidence_directory;

/// Shortest recording for which the free disk space should last.
const DISK_MINUTES: u64 = 10;

/// Whether the configured group, with frames of that source, fits into shared memory.
pub fn shared_memory(instance: &Instance, config: &Config, source: &Source) -> Finding {
    if let Err(error) = check_place() {
        return Finding::problem(
            "shared memory",
            error.to_string(),
            "no match can be run without it",
        );
    }
    let most_bytes = source.frame_capacity(&config.camera);
    match free_bytes() {
        Ok(free) => fits(
            &GroupMemory::with_larger_frames(config.camera.frame_bytes(), most_bytes),
            free + used_by(instance),
        ),
        Err(error) => Finding::problem(
            "shared memory",
            format!("{SHARED_MEMORY}: {error}"),
            format!("mount -t tmpfs tmpfs {SHARED_MEMORY}"),
        ),
    }
}

fn fits(group: &GroupMemory, free: u64) -> Finding {
    let (least, ample) = (group.least_bytes(), group.ample_bytes());
    let what = format!(
        "{} free in {SHARED_MEMORY}; a match takes about {}, and with pictures full of noise and \
         processes replaced up to {}",
        bytes(free),
        bytes(least),
        bytes(ample)
    );
    let advice = client::memory::advice(ample);
    if free < least {
        Finding::problem("shared memory", what, advice)
    } else if free < ample {
        Finding::warning("shared memory", what, advice)
    } else {
        Finding::ok("shared memory", what)
    }
}

/// Shared memory that the group itself uses already, if it runs.
fn used_by(instance: &Instance) -> u64 {
    let Ok(Some(namespace)) = instance.namespace() else { return 0 };
    let segments = namespace.segments().map(|(own, _)| own).unwrap_or_default();
    let files = fs::read_dir(namespace.directory()).into_iter().flatten().flatten();
    segments
        .into_iter()
        .chain(files.map(|entry| entry.path()))
        .filter_map(|path| fs::symlink_metadata(path).ok())
        .map(|data| data.blocks() * 512)
        .sum()
}

/// Whether all attached programs have the running group's version of iceoryx2.
pub fn ipc_versions(instance: &Instance) -> Vec<Finding> {
    const ABOUT: &str = "iceoryx2";
    let Ok(Some(namespace)) = instance.namespace() else { return Vec::new() };
    if let Err(error) = namespace.check_version() {
        return vec![Finding::problem(ABOUT, error.to_string(), "see docs/attaching.md")];
    }
    let strange = strange_versions(instance);
    if strange.is_empty() {
        return vec![Finding::ok(ABOUT, IPC_VERSION)];
    }
    let advice = format!("for Python: pip install iceoryx2=={IPC_VERSION}; see docs/attaching.md");
    strange.into_iter().map(|what| Finding::warning(ABOUT, what, advice.as_str())).collect()
}

/// Whether the runtime directory is accessible only to this user, or can be created so.
pub fn runtime_directory(instance: &Instance) -> Finding {
    const ABOUT: &str = "runtime directory";
    let path = instance.directory();
    let there = existing(path);
    if let Err(error) = instance.check_directory() {
        return Finding::problem(ABOUT, error.to_string(), "see docs/deployment.md");
    }
    if rustix::fs::access(&there, rustix::fs::Access::WRITE_OK).is_err() {
        return Finding::problem(
            ABOUT,
            format!("{} cannot be made: no rights to write in {}", path.display(), there.display()),
            "set TOUCHLINE_RUNTIME_DIR to a directory of yours, or log in so that \
             XDG_RUNTIME_DIR is set",
        );
    }
    let state = if there == path { "" } else { " (made when needed)" };
    Finding::ok(ABOUT, format!("{}{state}", path.display()))
}

/// Whether the users in the configuration can be given access.
pub fn other_users(instance: &Instance, config: &Config) -> Finding {
    const ABOUT: &str = "other users";
    let Some(name) = config.access.group() else {
        return Finding::ok(ABOUT, "only the owner of a group may attach (access.group is empty)");
    };
    let group = match place::group_number(name) {
        Ok(group) => group,
        Err(error) => return Finding::problem(ABOUT, error.to_string(), "see docs/deployment.md"),
    };
    // The directory of all groups is opened for others when needed.
    let directory = instance.gateway_directory();
    let around = directory.parent().and_then(Path::parent).unwrap_or(Path::new("/"));
    match place::closed(&existing(around), group) {
        Some(closed) => Finding::warning(
            ABOUT,
            format!("users of the group {name:?} cannot get to the gateway's socket"),
            place::advice(&closed, name),
        ),
        None => Finding::ok(
            ABOUT,
            format!(
                "users of the group {name:?} may attach: {}",
                instance.gateway_path().display()
            ),
        ),
    }
}

/// Whether the disk has room for evidence and recordings.
pub fn disk(config: &Config) -> Finding {
    const ABOUT: &str = "disk";
    let directory = evidence_directory();
    let there = existing(&directory);
    let free = match rustix::fs::statvfs(&there) {
        Ok(data) => data.f_bavail.saturating_mul(data.f_frsize),
        Err(error) => {
            return Finding::warning(
                ABOUT,
                format!("{}: {error}", there.display()),
                "frames that kill a stage cannot be kept for the bug report",
            );
        }
    };
    let frame = u64::from(config.camera.width) * u64::from(config.camera.height);
    let minutes = free / ((frame as f64 * config.camera.fps * 60.0) as u64).max(1);
    let what =
        format!("{} free in {}: {minutes} minutes of raw frames", bytes(free), there.display());
    if minutes < DISK_MINUTES {
        Finding::warning(ABOUT, what, "make room before recording")
    } else {
        Finding::ok(ABOUT, what)
    }
}

/// The directory itself, or its nearest existing ancestor.
fn existing(path: &Path) -> PathBuf {
    let found = path.ancestors().find(|path| path.exists());
    found.unwrap_or(Path::new("/")).to_path_buf()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::doctor::Level;

    #[test]
    fn too_little_shared_memory_is_a_problem_with_figures() {
        let group = GroupMemory::new(Config::default().camera.frame_bytes());
        let (least, ample) = (group.least_bytes(), group.ample_bytes());
        assert_eq!(fits(&group, ample).level, Level::Ok);
        assert_eq!(fits(&group, ample - 1).level, Level::Warning);
        assert_eq!(fits(&group, least).level, Level::Warning);
        let problem = fits(&group, least - 1);
        assert_eq!(problem.level, Level::Problem);
        assert!(problem.what.contains(&bytes(ample)), "{problem}");
    }

    #[test]
    fn the_nearest_directory_that_exists_is_found() {
        assert_eq!(existing(Path::new("/nonexistent/a/b")), Path::new("/"));
        assert_eq!(existing(Path::new("/tmp")), Path::new("/tmp"));
    }
}
