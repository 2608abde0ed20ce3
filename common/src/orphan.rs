//! The time that a process goes on without a supervisor.
//!
//! A match outlives a crash of its supervisor: the processes work on for `supervisor.orphan_timeout_s`, in which a
//! new supervisor can take them over. Then each of them ends by itself, so that nothing is left running for ever.

use crate::config::Config;
use crate::instance::Instance;

/// Measures how long a process has been without a supervisor.
#[derive(Debug)]
pub struct Orphanhood {
    instance: Instance,
    supervised: bool,
    timeout_ns: u64,
    since_ns: Option<u64>,
}

impl Orphanhood {
    /// For a process of that group. One that is not `supervised` was started by hand, and never ends for this
    /// reason.
    pub fn new(instance: &Instance, config: &Config, supervised: bool) -> Self {
        let timeout_ns = (config.supervisor.orphan_timeout_s * 1e9) as u64;
        Self { instance: instance.clone(), supervised, timeout_ns, since_ns: None }
    }

    /// Whether the process may go on.
    pub fn may_go_on(&mut self, now_ns: u64) -> bool {
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
        let mut orphanhood = Orphanhood::new(&instance, &config, true);
        let s = 1_000_000_000;
        assert!(orphanhood.judge(false, 10 * s) && orphanhood.judge(false, 12 * s - 1));
        assert!(orphanhood.judge(true, 12 * s), "a new supervisor");
        assert!(orphanhood.judge(false, 13 * s) && orphanhood.judge(false, 15 * s - 1));
        assert!(!orphanhood.judge(false, 15 * s));
        assert!(Orphanhood::new(&instance, &config, false).may_go_on(s), "started by hand");
    }
}
