//! A possible patch, and the parts of regions that it is made of.

use crate::regions::measure::Measure;

/// Most regions that are merged into one candidate.
pub(crate) const MAX_PARTS: usize = 4;
/// Number of pieces of a part that was cut out by a footprint.
pub(super) const CUT_OUT: u16 = u16::MAX;

/// A region, a piece of one that was split, or the pixels of one within a footprint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Part {
    pub region: u32,
    /// Index of the piece, from 0; number of the footprint in the frame, from 1.
    pub piece: u16,
    /// Number of pieces; 1 for the whole region, [`CUT_OUT`] for a footprint.
    pub pieces: u16,
}

/// A possible patch.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Candidate {
    /// Largest first.
    parts: [Part; MAX_PARTS],
    part_count: usize,
    pub measure: Measure,
    /// Cost of its area: 0 to 1 at the limits.
    pub misfit: f64,
    /// For a footprint's pixels, the first part of the team patch that predicts them: they are a patch of
    /// that robot or of none.
    pub beside: Option<Part>,
}

impl Part {
    pub fn whole(region: u32) -> Self {
        Self { region, piece: 0, pieces: 1 }
    }

    /// Whether two parts share pixels.
    fn overlaps(&self, other: &Self) -> bool {
        self.region == other.region && (self.pieces != other.pieces || self.piece == other.piece)
    }
}

impl Candidate {
    /// A candidate made of `parts`; those beyond [`MAX_PARTS`] are left out.
    pub fn new(parts: &[Part], measure: Measure, misfit: f64) -> Self {
        let mut candidate = Self {
            parts: [Part::whole(u32::MAX); MAX_PARTS],
            part_count: parts.len().min(MAX_PARTS),
            measure,
            misfit,
            beside: None,
        };
        for (slot, part) in candidate.parts.iter_mut().zip(parts) {
            *slot = *part;
        }
        candidate
    }

    /// The parts, the largest first.
    pub fn parts(&self) -> &[Part] {
        &self.parts[..self.part_count]
    }

    /// The largest part.
    pub fn seed(&self) -> Part {
        self.parts[0]
    }

    /// Whether two candidates share pixels.
    pub fn overlaps(&self, other: &Self) -> bool {
        self.parts().iter().any(|part| other.parts().iter().any(|theirs| part.overlaps(theirs)))
    }

    pub fn uses_region(&self, region: u32) -> bool {
        self.parts().iter().any(|part| part.region == region)
    }
}
