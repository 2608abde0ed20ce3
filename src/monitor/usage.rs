//! Processor time and memory of processes, from `/proc`.

/// Resources used by a process.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Usage {
    /// Processor time since its start.
    pub cpu_seconds: f64,
    /// Memory in use, shared memory included.
    pub rss_bytes: u64,
}

/// Reads `/proc`; `None` when the process is gone.
pub fn usage_of(pid: u32) -> Option<Usage> {
    parse_stat(&std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?)
}

/// Proportional memory of a process: shared memory is divided among its users, so that the sum over
/// all processes counts everything once. The system walks the whole memory for this, which takes a
/// millisecond; `None` when the process is gone.
pub fn proportional_bytes(pid: u32) -> Option<u64> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/smaps_rollup")).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("Pss:"))?;
    let kilobytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kilobytes * 1024)
}

fn parse_stat(stat: &str) -> Option<Usage> {
    // The second field is the name in parentheses, which may contain anything; count from behind
    // it.
    let (_, fields) = stat.rsplit_once(')')?;
    let fields: Vec<&str> = fields.split_whitespace().collect();
    let number = |index: usize| fields.get(index)?.parse::<u64>().ok();
    let ticks = number(11)? + number(12)?;
    Some(Usage {
        cpu_seconds: ticks as f64 / rustix::param::clock_ticks_per_second() as f64,
        rss_bytes: number(21)? * rustix::param::page_size() as u64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn our_own_usage_is_plausible() {
        let usage = usage_of(std::process::id()).unwrap();
        assert!(usage.rss_bytes > 100_000, "{usage:?}");
        assert_eq!(usage_of(u32::MAX), None);
        let proportional = proportional_bytes(std::process::id()).unwrap();
        assert!((100_000..10_000_000_000).contains(&proportional), "{proportional}");
    }

    #[test]
    fn a_name_with_parentheses_does_not_shift_the_fields() {
        let rest =
            " S 1 1 1 0 -1 4194560 100 0 0 0 250 50 0 0 20 0 1 0 5 1000000 10 18446744073709551615";
        let plain = parse_stat(&format!("7 (a){rest}")).unwrap();
        assert_eq!(parse_stat(&format!("7 (a) (b){rest}")), Some(plain));
        assert!(plain.cpu_seconds > 0.0);
    }
}
