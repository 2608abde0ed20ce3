//! Turns: which seeds are searched in a frame, in which order, and how.
//!
//! A picture is searched as a whole: every seed once, and then more widely. A frame of a match has at most a third
//! of the time between frames for that, which is enough at 80 frames a second, but not at 400. Where it is not, each
//! frame begins at another seed, and goes on until its trials are spent: every second frame begins with robots out of
//! focus, the others with robots that move in one direction after the other. All of this follows from the frame's
//! number and the configured rate alone, so a recording gives the same detections again.
//!
//! With φ the golden ratio, the nth frame of a blur begins at the fraction n·φ mod 1 of the list. These fractions
//! are spread evenly, however many of them are taken (Knuth, The Art of Computer Programming 3, 6.4), so no seed waits much
//! longer than another.

use super::mixture::Blur;
use super::search::{DIRECTIONS, Effort, beginnings};

/// How much of a picture is searched for faint robots.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Extent {
    /// A picture by itself: everything.
    Picture,
    /// A frame of a match: what it has time for.
    Frame {
        /// Its number.
        number: u64,
        /// Most poses tried, by [`Extent::frame_trials`].
        trials: u32,
    },
}

impl Extent {
    /// Poses tried in all but few pictures, if all are tried.
    const ENOUGH: u32 = 1600;
    /// Most poses tried in a picture by itself.
    const PICTURE_TRIALS: u32 = Self::ENOUGH + Effort::Widely.most_trials();
    /// Part of the time between two frames that the search may take, and the time of a trial: some 19,000
    /// instructions.
    const FRAME_SHARE: f64 = 1.0 / 3.0;
    const TRIAL_S: f64 = 2.5e-6;

    /// Most poses tried in a frame of a match at this rate: at least one search, and all of them up to about 80
    /// frames a second.
    pub(crate) fn frame_trials(fps: f64) -> u32 {
        let trials = (Self::FRAME_SHARE / fps / Self::TRIAL_S) as u32;
        trials.clamp(Effort::Once.most_trials(), Self::PICTURE_TRIALS)
    }

    /// Whether there may be too few trials for everything.
    fn is_short(self) -> bool {
        self.most_trials() < Self::ENOUGH
    }

    /// Most poses tried.
    pub(super) fn most_trials(self) -> u32 {
        match self {
            Self::Picture => Self::PICTURE_TRIALS,
            Self::Frame { trials, .. } => trials,
        }
    }

    /// The blur that the first search begins with, for robots of this size.
    pub(super) fn first_blur(self, size_mm: f64) -> Blur {
        let blurs = beginnings(size_mm);
        match self {
            Self::Frame { number, .. } if self.is_short() && number % 2 == 1 => {
                blurs[1 + (number / 2 % DIRECTIONS as u64) as usize]
            }
            _ => blurs[0],
        }
    }

    /// The searches of `count` seeds in their order: index of the seed, and effort.
    pub(super) fn searches(self, count: usize) -> impl Iterator<Item = (usize, Effort)> {
        let turn = match self {
            // Counts the frames with the same blur.
            Self::Frame { number, .. } if self.is_short() => match number % 2 {
                0 => number / 2,
                _ => number / (2 * DIRECTIONS as u64),
            },
            // Everything is searched, from the largest seed on.
            Self::Frame { .. } | Self::Picture => 0,
        };
        // 2⁶⁴·(φ − 1), so the product's lower 64 bits are a fraction.
        let fraction = turn.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let first = ((u128::from(fraction) * count as u128) >> 64) as usize;
        let seeds = move |&effort| (0..count).map(move |seed| ((first + seed) % count, effort));
        [Effort::Once, Effort::Widely].iter().flat_map(seeds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn a_picture_by_itself_is_searched_widely_from_the_largest_seed_on() {
        let searches: Vec<_> = Extent::Picture.searches(3).collect();
        let of = |effort| (0..3).map(move |seed| (seed, effort));
        assert!(searches.into_iter().eq(of(Effort::Once).chain(of(Effort::Widely))));
        assert_eq!(Extent::Picture.searches(0).count(), 0);
    }

    #[test]
    fn a_frame_has_time_for_a_search_and_at_usual_rates_for_nearly_all() {
        assert_eq!(Extent::frame_trials(10_000.0), Effort::Once.most_trials());
        assert!(!Extent::Frame { number: 1, trials: Extent::frame_trials(80.0) }.is_short());
        assert_eq!(Extent::frame_trials(30.0), Extent::PICTURE_TRIALS);
    }

    fn frame(number: u64) -> Extent {
        Extent::Frame { number, trials: 300 }
    }

    #[test]
    fn a_frame_lists_every_seed_once_before_any_is_searched_widely() {
        for (number, count) in [(0, 1), (7, 5), (u64::MAX, 32), (9, 0)] {
            let searches: Vec<_> = frame(number).searches(count).collect();
            let (once, widely) = searches.split_at(count);
            for (searches, effort) in [(once, Effort::Once), (widely, Effort::Widely)] {
                assert!(searches.iter().all(|&(_, it)| it == effort));
                let seeds: HashSet<usize> = searches.iter().map(|&(seed, _)| seed).collect();
                assert_eq!((searches.len(), seeds.len()), (count, count));
            }
        }
    }

    /// Each frame has time for the first three of its list: no seed waits for more than three times the
    /// frames that it would take if all took turns exactly.
    #[test]
    fn no_seed_waits_much_longer_than_another() {
        const TIME_FOR: usize = 3;
        // The frames that begin with one blur.
        for (first, step) in [(0, 2), (1, 8), (5, 8)] {
            for count in [4, 9, 16, 31] {
                let mut last_seen = vec![0; count];
                for (turn, number) in (1..4000).zip((first..).step_by(step)) {
                    for (seed, _) in frame(number).searches(count).take(TIME_FOR) {
                        last_seen[seed] = turn;
                    }
                    let longest = last_seen.iter().map(|seen| turn - seen).max().unwrap();
                    assert!(longest <= 3 * count.div_ceil(TIME_FOR), "{first} {count}: {longest}");
                }
            }
        }
    }
}
