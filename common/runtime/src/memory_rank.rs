//! The order in which the system kills a group's processes when memory runs out: dispensable ones
//! first.
//!
//! The system adds `oom_score_adj` (in thousandths of all memory) to the memory use of a process, and
//! kills the process with the highest sum. A process may always raise its own value, and lower it again
//! to the value it was started with. So the ranks are added to the value that the supervisor inherited,
//! for example from a service manager.

use std::fs;
use std::io;
use std::sync::OnceLock;

/// Importance of a process for a match.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum MemoryRank {
    /// Indispensable: the supervisor, and the active process of a stage.
    Needed = 0,
    /// Needed when the active process dies: a spare.
    Spare = 100,
    /// The match continues for everything but its clients: gateway and publisher.
    Attendant = 300,
    /// Needed only after the match: the recorder.
    Recorder = 500,
}

const PATH: &str = "/proc/self/oom_score_adj";
const HIGHEST: i32 = 1000;

/// Gives this process a rank. Callers may ignore the error.
pub fn set(rank: MemoryRank) -> io::Result<()> {
    static INHERITED: OnceLock<i32> = OnceLock::new();
    let inherited = match INHERITED.get() {
        Some(&inherited) => inherited,
        None => {
            let text = fs::read_to_string(PATH)?;
            let inherited = text.trim().parse().map_err(|_| io::ErrorKind::InvalidData)?;
            *INHERITED.get_or_init(|| inherited)
        }
    };
    fs::write(PATH, (inherited + rank as i32).min(HIGHEST).to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_are_above_what_was_inherited_and_can_be_left() {
        let now = || fs::read_to_string(PATH).unwrap().trim().parse::<i32>().unwrap();
        let inherited = now();
        for rank in [MemoryRank::Recorder, MemoryRank::Spare, MemoryRank::Needed] {
            set(rank).unwrap();
            assert_eq!(now(), (inherited + rank as i32).min(HIGHEST));
        }
    }
}
