//! Association of detections with tracks, for the whole frame at once.
//!
//! Each track either was seen as one of the detections in its gate, at cost −2·ln p with p the density of
//! that position under the track, or was not seen, at cost −2·ln λ with λ the density of unexpected
//! detections. Each detection belongs to one track at most. The association of minimal total cost is the most
//! likely one (global nearest neighbour), and is found by [`Assignment`]. A greedy choice, track by track,
//! would exchange two robots that pass each other closely.

use super::assignment::Assignment;

/// Clutter density, detections that belong to no track per mm²: at most one a minute anywhere on the pitch. The
/// densities of a struck track are small, too, and yet it is the better explanation.
const CLUTTER_PER_MM2: f64 = 1e-10;

/// A detection in the gate of a track, by indices.
#[derive(Debug, Clone, Copy)]
struct Pair {
    track: usize,
    seen: usize,
    /// Density of the detection under the track, per mm².
    density: f64,
}

/// Solver that reuses its tables.
#[derive(Debug, Clone, Default)]
pub(super) struct Association {
    /// Sorted by track.
    pairs: Vec<Pair>,
    /// Tracks that have a pair, ascending.
    tracks: Vec<usize>,
    assignment: Assignment,
    /// For each detection, the track it belongs to.
    owners: Vec<Option<usize>>,
}

impl Association {
    /// Clears everything; `seen` is the number of detections.
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

    /// Solves the association.
    pub fn solve(&mut self) {
        let Self { pairs, tracks, assignment, owners } = self;
        assignment.start(tracks.len(), owners.len());
        for &Pair { track, seen, density } in &*pairs {
            if let Ok(row) = tracks.binary_search(&track) {
                // Relative to not having been seen.
                let ratio = density.max(f64::MIN_POSITIVE) / CLUTTER_PER_MM2;
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

    /// The detection that belongs to a track.
    pub fn detection_of(&self, track: usize) -> Option<usize> {
        self.owners.iter().position(|owner| *owner == Some(track))
    }

    /// Whether the pair is the only explanation: no other detection was in the track's gate, and the
    /// detection in no other's.
    pub fn is_unambiguous(&self, track: usize, seen: usize) -> bool {
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
    fn association_is_globally_optimal() {
        // The first track fits detection 0 best, but the second fits no other.
        let (_, of) = owners(&[&[(0, 1e-2), (1, 5e-3)], &[(0, 2e-3)]], 2);
        assert_eq!(of, [Some(1), Some(0)]);
        // Limited by the cost: here a track was not seen.
        let (_, of) = owners(&[&[(0, 1e-2), (1, 1e-30)], &[(0, 1e-8)]], 2);
        assert_eq!(of, [Some(0), None]);
    }

    #[test]
    fn tracks_without_detections_have_none() {
        let (association, of) = owners(&[&[], &[(1, 1e-3)]], 2);
        assert_eq!(of, [None, Some(1)]);
        assert_eq!((association.detection_of(0), association.detection_of(1)), (None, Some(1)));
        assert!(!association.is_owned(0) && association.is_owned(1));
    }

    #[test]
    fn a_detection_in_two_gates_is_ambiguous() {
        let (association, _) = owners(&[&[(0, 1e-2)], &[(1, 1e-2), (2, 1e-4)], &[(3, 1e-2)]], 4);
        assert!(association.is_unambiguous(0, 0));
        assert!(!association.is_unambiguous(1, 1));
        let (association, _) = owners(&[&[(0, 1e-2)], &[(0, 1e-4)]], 1);
        assert!(!association.is_unambiguous(0, 0));
    }
}
