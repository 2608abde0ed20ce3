//! Restart intensity: how often a stage's processes die. Erlang/OTP's supervisors use it too, and end
//! themselves above the limit; here a stage above the limit is only restarted more slowly, so that the
//! match goes on.

use std::collections::VecDeque;

/// Window over which deaths are counted.
const WINDOW_NS: u64 = 5_000_000_000;
/// Largest permitted number of deaths in a window. A kill twice a second, which a match survives
/// without losing a frame, causes half as many; a process that dies of every frame exceeds it.
const MOST: usize = 20;

/// The latest deaths.
#[derive(Debug, Default)]
pub struct Intensity {
    /// Times of death, oldest first.
    deaths_ns: VecDeque<u64>,
}

impl Intensity {
    /// Records a death.
    pub fn note(&mut self, now_ns: u64) {
        self.deaths_ns.push_back(now_ns);
        // One more than the limit is enough to exceed it.
        if self.deaths_ns.len() > MOST + 1 {
            self.deaths_ns.pop_front();
        }
    }

    /// Deaths in the window before now; counts up to one above the limit.
    pub fn count(&self, now_ns: u64) -> u32 {
        let is_recent = |&&at_ns: &&u64| now_ns.saturating_sub(at_ns) < WINDOW_NS;
        self.deaths_ns.iter().filter(is_recent).count() as u32
    }

    /// Whether the deaths exceed the limit.
    pub fn is_too_high(&self, now_ns: u64) -> bool {
        self.count(now_ns) as usize > MOST
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frequent_deaths_exceed_the_limit_and_disturbances_do_not() {
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
