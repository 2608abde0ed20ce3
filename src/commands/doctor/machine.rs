//! Checks processors, clock, and scheduling rights.

use super::Finding;
use config::Config;
use runtime::scheduling;
use rustix::process::{Resource, getrlimit};
use std::fs;
use std::path::Path;

/// Numbers of capabilities (linux/capability.h).
const CAP_IPC_LOCK: u32 = 14;
const CAP_SYS_NICE: u32 = 23;
/// Well above the memory of all processes of a group together, without shared memory.
const MEMLOCK_BYTES: u64 = 1 << 30;
const LIMITS: &str = "as a service: LimitRTPRIO= and LimitMEMLOCK= (scripts/touchline@.service); by \
                      hand: `NAME - rtprio 60` and `NAME - memlock unlimited` in \
                      /etc/security/limits.conf, then log in anew (docs/deployment.md)";

/// All findings about the machine itself.
pub fn findings(config: &Config) -> Vec<Finding> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let capabilities =
        effective_capabilities(&fs::read_to_string("/proc/self/status").unwrap_or_default());
    let has = |bit: u32| capabilities >> bit & 1 == 1;
    let mut findings = vec![
        processors(cores),
        instructions(),
        real_time(getrlimit(Resource::Rtprio).current, has(CAP_SYS_NICE)),
        memory_locking(getrlimit(Resource::Memlock).current, has(CAP_IPC_LOCK)),
        governor(&governors(Path::new("/sys/devices/system/cpu"))),
        clock_source(
            &fs::read_to_string("/sys/devices/system/clocksource/clocksource0/current_clocksource")
                .unwrap_or_default(),
        ),
    ];
    let denied = scheduling::unavailable(&config.scheduling);
    findings.extend(denied.into_iter().map(|complaint| {
        Finding::warning("scheduling", complaint, "allow it, or change the configuration")
    }));
    findings
}

fn processors(cores: usize) -> Finding {
    match cores {
        0 | 1 => Finding::warning(
            "processors",
            "1",
            "a match runs, but every stage waits for every other; use two or more",
        ),
        cores => Finding::ok("processors", format!("{cores}")),
    }
}

/// The best SIMD level that this processor has.
fn instructions() -> Finding {
    match best_instructions() {
        Some(name) => Finding::ok("instructions", name),
        None => Finding::warning(
            "instructions",
            "no wide ones that the classifier knows",
            "it works pixel by pixel: check its time in `touchline status` against the frame rate",
        ),
    }
}

#[cfg(target_arch = "x86_64")]
fn best_instructions() -> Option<&'static str> {
    let has_avx512 = is_x86_feature_detected!("avx512bw") && is_x86_feature_detected!("avx512vbmi");
    let levels = [
        (has_avx512, "AVX-512 (BW, VBMI)"),
        (is_x86_feature_detected!("avx2"), "AVX2"),
        (is_x86_feature_detected!("ssse3"), "SSSE3"),
    ];
    levels.into_iter().find_map(|(has, name)| has.then_some(name))
}

#[cfg(target_arch = "aarch64")]
fn best_instructions() -> Option<&'static str> {
    Some("NEON")
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
fn best_instructions() -> Option<&'static str> {
    None
}

fn real_time(limit: Option<u64>, has_capability: bool) -> Finding {
    match limit {
        _ if has_capability => Finding::ok("real time", "allowed (CAP_SYS_NICE)"),
        None => Finding::ok("real time", "allowed up to any priority"),
        Some(0) => Finding::warning(
            "real time",
            "not allowed: on a busy machine stages wait for other programs",
            LIMITS,
        ),
        Some(limit) => Finding::ok("real time", format!("allowed up to priority {limit}")),
    }
}

fn memory_locking(limit: Option<u64>, has_capability: bool) -> Finding {
    match limit {
        _ if has_capability => Finding::ok("memory locking", "allowed (CAP_IPC_LOCK)"),
        None => Finding::ok("memory locking", "allowed, any amount"),
        Some(limit) if limit < MEMLOCK_BYTES => Finding::warning(
            "memory locking",
            format!(
                "allowed up to {}: stages may have to wait for their pages",
                super::bytes(limit)
            ),
            LIMITS,
        ),
        Some(limit) => {
            Finding::ok("memory locking", format!("allowed up to {}", super::bytes(limit)))
        }
    }
}

/// The `CapEff` line of a process's status; 0 if there is none.
fn effective_capabilities(status: &str) -> u64 {
    let line = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    line.and_then(|digits| u64::from_str_radix(digits.trim(), 16).ok()).unwrap_or(0)
}

/// The frequency governor of each processor that has one.
fn governors(directory: &Path) -> Vec<String> {
    let processors = fs::read_dir(directory).into_iter().flatten().flatten();
    let texts = processors.filter_map(|processor| {
        fs::read_to_string(processor.path().join("cpufreq/scaling_governor")).ok()
    });
    texts.map(|text| text.trim().to_string()).collect()
}

fn governor(governors: &[String]) -> Finding {
    let slow: Vec<&String> = governors.iter().filter(|name| *name != "performance").collect();
    match slow.first() {
        Some(name) => Finding::warning(
            "frequency",
            format!(
                "{} of {} processors slow down between frames (governor {name})",
                slow.len(),
                governors.len()
            ),
            "cpupower frequency-set -g performance (Debian package linux-cpupower)",
        ),
        None if governors.is_empty() => {
            Finding::ok("frequency", "not for this system to decide (a virtual machine?)")
        }
        None => Finding::ok("frequency", "governor performance"),
    }
}

fn clock_source(name: &str) -> Finding {
    match name.trim() {
        "" => Finding::warning(
            "clock",
            "this system does not say which it uses",
            "check that stamps in reports make sense",
        ),
        slow @ ("hpet" | "acpi_pm" | "jiffies" | "refined-jiffies" | "pit") => Finding::warning(
            "clock",
            format!("{slow}: asking it for the time takes microseconds"),
            "if the firmware allows, boot with clocksource=tsc",
        ),
        fast => Finding::ok("clock", fast),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::doctor::Level;

    #[test]
    fn rights_come_from_a_limit_or_a_capability() {
        assert_eq!(real_time(Some(0), false).level, Level::Warning);
        assert_eq!(real_time(Some(0), true).level, Level::Ok);
        assert_eq!(real_time(Some(60), false).level, Level::Ok);
        assert_eq!(real_time(None, false).level, Level::Ok);
        assert_eq!(memory_locking(Some(8 << 20), false).level, Level::Warning);
        assert_eq!(memory_locking(Some(8 << 20), true).level, Level::Ok);
        assert_eq!(memory_locking(None, false).level, Level::Ok);
        let capabilities = effective_capabilities("Name:\tx\nCapEff:\t0000000000804000\n");
        assert_eq!(capabilities, 1 << CAP_IPC_LOCK | 1 << CAP_SYS_NICE);
        assert_eq!(effective_capabilities("rubbish"), 0);
    }

    #[test]
    fn slow_governors_and_clocks_are_named() {
        let names = |list: &[&str]| list.iter().map(|name| name.to_string()).collect::<Vec<_>>();
        assert_eq!(governor(&names(&[])).level, Level::Ok);
        assert_eq!(governor(&names(&["performance"; 2])).level, Level::Ok);
        let mixed = governor(&names(&["performance", "powersave"]));
        assert_eq!(mixed.level, Level::Warning);
        assert!(mixed.what.starts_with("1 of 2") && mixed.what.contains("powersave"));
        assert_eq!(clock_source("tsc\n").level, Level::Ok);
        assert_eq!(clock_source("hpet\n").level, Level::Warning);
        assert_eq!(clock_source("").level, Level::Warning);
    }

    #[test]
    fn too_few_processors_are_named() {
        assert_eq!(processors(1).level, Level::Warning);
        assert_eq!(processors(2).level, Level::Ok);
    }
}
