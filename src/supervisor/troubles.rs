//! Failing operations that are retried: each is reported once, repeated seldom, and reported as over when
//! it succeeds.

use std::collections::BTreeMap;

/// Interval at which a lasting failure is reported again.
const REPEAT_NS: u64 = 60_000_000_000;

/// Current failures, by operation.
#[derive(Debug, Default)]
pub struct Troubles {
    current: BTreeMap<String, Trouble>,
}

#[derive(Debug)]
struct Trouble {
    reason: String,
    times: u64,
    told_ns: u64,
}

impl Troubles {
    /// Records an attempt; returns a message if one is due.
    pub fn note(&mut self, what: &str, outcome: Result<(), String>, now_ns: u64) -> Option<String> {
        let Err(reason) = outcome else {
            let trouble = self.current.remove(what)?;
            return Some(format!("{what}: works again, failed {}", times(trouble.times)));
        };
        if let Some(trouble) = self.current.get_mut(what) {
            trouble.times += 1;
            let is_known = trouble.reason == reason;
            if is_known && now_ns.saturating_sub(trouble.told_ns) < REPEAT_NS {
                return None;
            }
            (trouble.reason, trouble.told_ns) = (reason, now_ns);
            return Some(format!("{what}: {}, {}", trouble.reason, times(trouble.times)));
        }
        let text = format!("{what}: {reason}; the match goes on, and it is tried again");
        self.current.insert(what.into(), Trouble { reason, times: 1, told_ns: now_ns });
        Some(text)
    }

    /// All current failures, one line each.
    pub fn list(&self) -> Vec<String> {
        let line = |(what, trouble): (&String, &Trouble)| {
            format!("{what}: {} ({})", trouble.reason, times(trouble.times))
        };
        self.current.iter().map(line).collect()
    }
}

fn times(count: u64) -> String {
    if count == 1 { "once".into() } else { format!("{count} times") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_is_reported_when_it_begins_changes_lasts_and_ends() {
        let mut troubles = Troubles::default();
        assert_eq!(troubles.note("log", Ok(()), 0), None);
        let full = || Err("No space left".to_string());
        let said = troubles.note("log", full(), 0).unwrap();
        assert!(said.starts_with("log: No space left;"), "{said}");
        for second in 1..60 {
            assert_eq!(troubles.note("log", full(), second * 1_000_000_000), None);
        }
        assert_eq!(
            troubles.note("log", full(), REPEAT_NS).unwrap(),
            "log: No space left, 61 times"
        );
        assert!(troubles.note("log", Err("gone".into()), REPEAT_NS + 1).unwrap().contains("gone"));
        assert_eq!(troubles.list(), ["log: gone (62 times)"]);
        let over = troubles.note("log", Ok(()), REPEAT_NS + 2).unwrap();
        assert_eq!(over, "log: works again, failed 62 times");
        assert!(troubles.list().is_empty());
    }
}
