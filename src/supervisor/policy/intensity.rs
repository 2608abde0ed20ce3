//! How often a stage's processes die: the restart intensity of Erlang/OTP's supervisors. There a
//! supervisor that is over its limit ends itself; a match is worth more than that, so here it becomes
//! slower.

use std::collections::VecDeque;

/// Deaths are counted over so long.
const WINDOW_NS: u64 = 5_000_000_000;
/// More of them are too many. A kill twice a second, which a match takes without losing a frame, is
/// half of this; a process that dies of every frame reaches it.
const MOST: usize = 20;

/// The latest deaths.
#[derive(Debug, Default)]
pub struct Intensity {
    /// When, oldest first.
    deaths_ns: VecDeque<u64>,
}

impl Intensity {
    /// Takes note of a death.
    pub fn note(&mut self, now_ns: u64) {
        self.deaths_ns.push_back(now_ns);
        // One more than is asked for.
        if self.deaths_ns.len() > MOST + 1 {
            self.deaths_ns.pop_front();
        }
    }

    /// Deaths in the window before now, up to one more than are too many.
    pub fn count(&self, now_ns: u64) -> u32 {
        let is_recent = |&&at_ns: &&u64| now_ns.saturating_sub(at_ns) < WINDOW_NS;
        self.deaths_ns.iter().filter(is_recent).count() as u32
    }

    /// Whether there are too many.
    pub fn is_too_high(&self, now_ns: u64) -> bool {
        self.count(now_ns) as usize > MOST
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_storm_is_told_from_a_disturbed_match() {
        let mut deaths = Intensity::default();
        let ms = |ms: u64| ms * 1_000_000;
        for death in 0..100 {
            deaths.note(ms(500 * death));
            assert!(!deaths.is_too_high(ms(500 * death)));
        }
        for death in 0..100 {
            deaths.note(ms(50_000 + 150 * death));
            assert_eq!(deaths.is_too_high(ms(50_000 + 150 * death)), death > 14, "{death}");
        }
        assert!(!deaths.is_too_high(ms(70_000)));
    }
}
