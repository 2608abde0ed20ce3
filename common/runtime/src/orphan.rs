//! The time for which a process continues without a supervisor.
//!
//! A match outlives a crash of its supervisor: the processes continue for
//! `supervisor.orphan_timeout_s`, in which a new supervisor can take them over. Then each of them ends,
//! so that nothing is left running for ever.

use client::instance::Instance;
use config::Config;

/// Measures how long a process has been without a supervisor.
#[derive(Debug)]
pub struct OrphanTimer {
    instance: Instance,
    supervised: bool,
    timeout_ns: u64,
    since_ns: Option<u64>,
}

impl OrphanTimer {
    /// Creates the timer for a process of this group. A process that is not `supervised` was started by
    /// hand, and has no timeout.
    pub fn new(instance: &Instance, config: &Config, supervised: bool) -> Self {
        let timeout_ns = (config.supervisor.orphan_timeout_s * 1e9) as u64;
        Self { instance: instance.clone(), supervised, timeout_ns, since_ns: None }
    }

    /// Whether the process may continue.
    pub fn may_continue(&mut self, now_ns: u64) -> bool {
        let is_supervised = !self.supervised || self.instance.is_supervised();
        self.judge(is_supervised, now_ns)
    }

    fn judge(&mut self, is_supervised: bool, now_ns: u64) -> bool {
        if is_supervised {
            self.since_ns = None;
            return true;
        }
        let since_ns = *self.since_ns.get_or_insert(now_ns);
        now_ns.saturating_sub(since_ns) < self.timeout_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_absence_of_the_supervisor_is_timed_anew() {
        let instance = Instance::below(&std::env::temp_dir(), "orphan").unwrap();
        let mut config = Config::default();
        config.supervisor.orphan_timeout_s = 2.0;
        let mut orphan_timer = OrphanTimer::new(&instance, &config, true);
        let s = 1_000_000_000;
        assert!(orphan_timer.judge(false, 10 * s) && orphan_timer.judge(false, 12 * s - 1));
        assert!(orphan_timer.judge(true, 12 * s), "a new supervisor");
        assert!(orphan_timer.judge(false, 13 * s) && orphan_timer.judge(false, 15 * s - 1));
        assert!(!orphan_timer.judge(false, 15 * s));
        assert!(OrphanTimer::new(&instance, &config, false).may_continue(s), "started by hand");
    }
}
