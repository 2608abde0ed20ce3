//! Which of a group's processes the system kills first when memory runs out: the ones that a match can do
//! without.
//!
//! The system adds a number (`oom_score_adj`, in thousandths of all memory) to what a process uses, and
//! kills the one with the most. A process may always make itself more likely to be killed, and go back to
//! what it was started with; so ranks begin at what the supervisor was given, by a service manager say, and
//! rise from there.

use std::fs;
use std::io;
use std::sync::OnceLock;

/// How well a match can do without a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum MemoryRank {
    /// Not at all: the supervisor, and the process of a stage that works.
    Needed = 0,
    /// Until the next one dies: a spare.
    Spare = 100,
    /// The match goes on without, for all but those who attach through it: the gateway.
    Attendant = 300,
    /// Nobody misses it before the match is over: the recorder.
    Recorder = 500,
}

const PATH: &str = "/proc/self/oom_score_adj";
const HIGHEST: i32 = 1000;

/// Gives this process a rank. That it cannot be given is no reason not to work.
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
