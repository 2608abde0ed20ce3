//! Which track what was seen belongs to: decided over the whole frame at once.
//!
//! Every track either has been seen as one of the detections in its gate, which costs −2·ln of the
//! density of that place under the track, or has not been seen, which costs −2·ln of the density of
//! things that nobody expects. Each detection belongs to one track at most. The cheapest choice is the
//! likeliest. Nearest first, track by track, would give two that pass each other close by each other's
//! places.

use super::assignment::Assignment;

/// Detections per mm² that belong to no track: one a minute, anywhere on the pitch, or fewer. Where a
/// track is struck by something its densities are small too, and yet it is the better explanation.
const UNEXPECTED_PER_MM2: f64 = 1e-10;

/// A detection in the gate of a track, by indices.
#[derive(Debug, Clone, Copy)]
struct Pair {
    track: usize,
    seen: usize,
    /// Of the detection under the track, per mm².
    density: f64,
}

/// Decides, reusing its tables.
#[derive(Debug, Clone, Default)]
pub(super) struct Association {
    /// By track.
    pairs: Vec<Pair>,
    /// Tracks that have a pair, ascending.
    tracks: Vec<usize>,
    assignment: Assignment,
    /// By detection: the track it belongs to.
    owners: Vec<Option<usize>>,
}

impl Association {
    /// Forgets everything; `seen` detections are to be given to tracks.
    pub fn start(&mut self, seen: usize) {
        self.pairs.clear();
        self.tracks.clear();
        self.owners.clear();
        self.owners.resize(seen, None);
    }

    /// Adds a track (in ascending order) with the density, per mm², of each detection in its gate.
    pub fn add(&mut self, track: usize, densities: impl Iterator<Item = (usize, f64)>) {
        let before = self.pairs.len();
        self.pairs.extend(densities.map(|(seen, density)| Pair { track, seen, density }));
        if self.pairs.len() > before {
            self.tracks.push(track);
        }
    }

    /// Gives detections to tracks.
    pub fn solve(&mut self) {
        let Self { pairs, tracks, assignment, owners } = self;
        assignment.start(tracks.len(), owners.len());
        for &Pair { track, seen, density } in &*pairs {
            if let Ok(row) = tracks.binary_search(&track) {
                // Against not having been seen.
                let ratio = density.max(f64::MIN_POSITIVE) / UNEXPECTED_PER_MM2;
                assignment.set(row, seen, -2.0 * ratio.ln());
            }
        }
        assignment.solve();
        for (seen, owner) in owners.iter_mut().enumerate() {
            *owner = assignment.owner(seen).map(|row| tracks[row]);
        }
    }

    /// Whether a detection belongs to a track.
    pub fn is_owned(&self, seen: usize) -> bool {
        self.owners[seen].is_some()
    }

    /// The detection that a track has been seen as.
    pub fn seen_as(&self, track: usize) -> Option<usize> {
        self.owners.iter().position(|owner| *owner == Some(track))
    }

    /// Whether nothing else could be believed of a track and a detection: no other detection was in the
    /// track's gate, and the detection in no other's.
    pub fn is_only_one(&self, track: usize, seen: usize) -> bool {
        self.pairs.iter().all(|pair| (pair.track == track) == (pair.seen == seen))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn owners(tracks: &[&[(usize, f64)]], seen: usize) -> (Association, Vec<Option<usize>>) {
        let mut association = Association::default();
        association.start(seen);
        for (track, densities) in tracks.iter().enumerate() {
            association.add(track, densities.iter().copied());
        }
        association.solve();
        let owners = association.owners.clone();
        (association, owners)
    }

    #[test]
    fn the_whole_frame_decides() {
        // The first track likes detection 0 best, but the second can be nothing else.
        let (_, of) = owners(&[&[(0, 1e-2), (1, 5e-3)], &[(0, 2e-3)]], 2);
        assert_eq!(of, [Some(1), Some(0)]);
        // Not at any price: then somebody has not been seen.
        let (_, of) = owners(&[&[(0, 1e-2), (1, 1e-30)], &[(0, 1e-8)]], 2);
        assert_eq!(of, [Some(0), None]);
    }

    #[test]
    fn tracks_without_detections_have_none() {
        let (association, of) = owners(&[&[], &[(1, 1e-3)]], 2);
        assert_eq!(of, [None, Some(1)]);
        assert_eq!((association.seen_as(0), association.seen_as(1)), (None, Some(1)));
        assert!(!association.is_owned(0) && association.is_owned(1));
    }

    #[test]
    fn what_is_in_two_gates_is_not_the_only_one() {
        let (association, _) = owners(&[&[(0, 1e-2)], &[(1, 1e-2), (2, 1e-4)], &[(3, 1e-2)]], 4);
        assert!(association.is_only_one(0, 0));
        assert!(!association.is_only_one(1, 1));
        let (association, _) = owners(&[&[(0, 1e-2)], &[(0, 1e-4)]], 1);
        assert!(!association.is_only_one(0, 0));
    }
}
