//! Scheduling options of the system for a stage: processor affinity, real-time priority, locked memory,
//! processors that stay awake.
//!
//! All of it is optional, and much of it needs rights. A stage runs without whatever is not permitted,
//! and each function returns one line about it.

use client::wake_up::Strategy;
use config::{SchedulingConfig, WakeUpStrategy};
use messages::ProcessKind;
use rustix::io::Errno;
use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, getrlimit};
use rustix::thread::{CpuSet, sched_setaffinity, set_current_timer_slack};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::num::NonZeroU64;
use std::os::fd::IntoRawFd;
use std::path::Path;

/// Stages that would spin at the same time.
const SPINNING_STAGES: usize = 3;

/// Sets up the calling thread for a stage. Returns one line for each option that failed.
pub fn set_up(config: &SchedulingConfig, kind: ProcessKind) -> Vec<String> {
    // By default the system may lengthen a sleep by 50 µs to save energy. Cannot fail.
    let _ = set_current_timer_slack(NonZeroU64::new(1));
    let mut unavailable: Vec<String> =
        [restrict_to(config.cpus.of(kind), kind), set_priority(config.realtime_priority)]
            .into_iter()
            .flatten()
            .collect();
    if config.keep_awake {
        match keep_awake(Path::new(LATENCY_DEVICE)) {
            // The file stays open, and with it the demand in force, until the process ends.
            Ok(device) => _ = device.into_raw_fd(),
            Err(refusal) => unavailable.push(refusal),
        }
    }
    unavailable
}

/// The options that this machine does not permit, one line each, for a group that is to start. They are
/// tried on a separate thread.
pub fn unavailable(config: &SchedulingConfig) -> Vec<String> {
    let tried = || {
        let mut unavailable: Vec<String> = ProcessKind::ALL
            .iter()
            .filter_map(|&kind| restrict_to(config.cpus.of(kind), kind))
            .collect();
        unavailable.extend(set_priority(config.realtime_priority));
        if config.lock_memory && !may_lock_memory() {
            unavailable.push(LOCK_REFUSED.into());
        }
        if config.keep_awake {
            unavailable.extend(keep_awake(Path::new(LATENCY_DEVICE)).err());
        }
        if config.wake_up == WakeUpStrategy::Spin {
            unavailable.extend(too_few_to_spin(processors()));
        }
        unavailable
    };
    std::thread::scope(|scope| scope.spawn(tried).join().unwrap_or_default())
}

/// The strategy for this machine: spinning is replaced where it would take the processors from the
/// processes that are waited for.
pub fn wake_up_strategy(config: &SchedulingConfig) -> Strategy {
    match config.wake_up {
        WakeUpStrategy::Spin if too_few_to_spin(processors()).is_some() => Strategy::Event,
        WakeUpStrategy::Spin => Strategy::Spin,
        WakeUpStrategy::Event => Strategy::Event,
        WakeUpStrategy::Predictive => Strategy::Predictive,
    }
}

fn processors() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

fn too_few_to_spin(processors: usize) -> Option<String> {
    (processors <= SPINNING_STAGES).then(|| {
        format!(
            "scheduling.wake_up = \"spin\" takes {SPINNING_STAGES} processors and leaves none of {processors}: \
             \"event\" is used instead; \"predictive\" needs fewer"
        )
    })
}

fn restrict_to(cpus: &[u16], kind: ProcessKind) -> Option<String> {
    if cpus.is_empty() {
        return None;
    }
    let mut set = CpuSet::new();
    for &cpu in cpus {
        if usize::from(cpu) < CpuSet::MAX_CPU {
            set.set(cpu.into());
        }
    }
    let error = sched_setaffinity(None, &set).err()?;
    Some(format!(
        "scheduling.cpus.{} = {cpus:?} is not possible ({error}): there is none of these processors, \
         or this program may not use them; the stage runs on any",
        kind.name()
    ))
}

#[allow(unsafe_code)]
fn set_priority(priority: u8) -> Option<String> {
    if priority == 0 {
        return None;
    }
    let parameter = libc::sched_param { sched_priority: priority.into() };
    // SAFETY: `parameter` is what the call expects, and it only reads it. 0 is the calling thread.
    let result = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &parameter) };
    (result != 0).then(|| {
        format!(
            "scheduling.realtime_priority = {priority} is not permitted ({}): the stages run without; \
             allow it with a line `USER - rtprio {priority}` in /etc/security/limits.conf, or \
             LimitRTPRIO={priority} in a systemd unit",
            std::io::Error::last_os_error()
        )
    })
}

const LOCK_REFUSED: &str = "scheduling.lock_memory = true is not permitted: the stages run without; allow it \
     with a line `USER - memlock unlimited` in /etc/security/limits.conf, or LimitMEMLOCK=infinity in a \
     systemd unit";

fn may_lock_memory() -> bool {
    // With a limit, locking succeeds until the limit is reached, which may be in the middle of a match.
    getrlimit(Resource::Memlock).current.is_none() || may_exceed_limits()
}

/// Whether the process has the capability CAP_IPC_LOCK.
fn may_exceed_limits() -> bool {
    const IPC_LOCK: u32 = 14;
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let effective = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    effective
        .and_then(|text| u64::from_str_radix(text.trim(), 16).ok())
        .is_some_and(|capabilities| capabilities & (1 << IPC_LOCK) != 0)
}

/// Locks all memory of the process once it is touched, now or later; most of a topic's slots never are.
/// Returns a line if that failed.
pub fn lock_memory() -> Option<String> {
    if !may_lock_memory() {
        return Some(LOCK_REFUSED.into());
    }
    let flags = MlockAllFlags::CURRENT | MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT;
    match mlockall(flags) {
        Ok(()) => None,
        Err(Errno::PERM | Errno::NOMEM | Errno::AGAIN) => Some(LOCK_REFUSED.into()),
        Err(error) => Some(format!("scheduling.lock_memory: {error}")),
    }
}

/// Linux's interface for demands on processor wake-up latency (Documentation/power/pm_qos_interface of
/// the kernel). A demand holds while the file is open.
const LATENCY_DEVICE: &str = "/dev/cpu_dma_latency";

/// Demands zero wake-up latency: idle processors then wait instead of falling asleep.
fn keep_awake(device: &Path) -> Result<File, String> {
    let no_time_us = 0i32.to_ne_bytes();
    let demand = || {
        let mut file = OpenOptions::new().write(true).open(device)?;
        file.write_all(&no_time_us)?;
        Ok(file)
    };
    demand().map_err(|error: std::io::Error| {
        format!(
            "scheduling.keep_awake = true is not possible ({}: {error}): processors fall asleep between \
             frames; allow it with a udev rule `KERNEL==\"cpu_dma_latency\", GROUP=\"touchline\", \
             MODE=\"0660\"`",
            device.display()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processors_are_asked_to_wake_up_in_no_time() {
        let path = std::env::temp_dir().join(format!("tl-latency-{}", std::process::id()));
        let refusal = keep_awake(&path).unwrap_err();
        assert!(refusal.contains("scheduling.keep_awake") && !refusal.contains('\n'));
        std::fs::write(&path, "----").unwrap();
        let demanded = keep_awake(&path).map(|_| std::fs::read(&path).unwrap());
        std::fs::remove_file(&path).unwrap();
        assert_eq!(demanded.unwrap(), 0i32.to_ne_bytes());
    }

    #[test]
    fn impossible_options_are_reported_in_a_line_and_no_others() {
        assert!(unavailable(&SchedulingConfig::default()).is_empty());
        let mut config = SchedulingConfig::default();
        config.cpus.tracker = vec![1023];
        let unavailable = unavailable(&config);
        let [refusal] = unavailable.as_slice() else { panic!("{unavailable:?}") };
        assert!(refusal.contains("scheduling.cpus.tracker = [1023]"), "{refusal}");
        assert!(!refusal.contains('\n'));
    }

    #[test]
    fn a_stage_keeps_to_its_processors() {
        let mut config = SchedulingConfig::default();
        config.cpus.filter = vec![0];
        std::thread::scope(|scope| {
            scope.spawn(|| {
                // If processor 0 is forbidden, a refusal is returned.
                if set_up(&config, ProcessKind::Filter).is_empty() {
                    let set = rustix::thread::sched_getaffinity(None).unwrap();
                    assert_eq!((set.count(), set.is_set(0)), (1, true));
                }
            });
        });
    }

    #[test]
    fn spinning_needs_more_processors_than_spin() {
        assert!(too_few_to_spin(2).is_some() && too_few_to_spin(3).is_some());
        assert!(too_few_to_spin(4).is_none());
    }
}
