//! The note with which the supervisor tells a stage's next process where to continue.
//!
//! The supervisor watches every stage's output and confirms a process dead before its successor starts
//! to work, so it knows exactly how far the stage has come. The only gap is output that a dead process
//! published before this supervisor started; the stage itself notes that. Both notes are in the [stage
//! page](crate::stage_page), so a hand-over takes neither a file nor a disk.

/// How far a stage has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Handover {
    /// Number of its last output; everything up to it is done.
    pub resume_after: u64,
    /// The next input has killed two processes in a row and must be skipped.
    pub skip_next: bool,
}

impl Handover {
    /// Encodes the note as one number, which is read and written atomically; 0 means no note.
    pub(crate) fn to_bits(self) -> u64 {
        // A quarter of the range, at 80 frames a second, still outlasts any match.
        let resume_after = self.resume_after.min(u64::MAX >> 2);
        (resume_after + 1) << 1 | u64::from(self.skip_next)
    }

    /// Decodes a number; `None` if it is no note.
    pub(crate) fn from_bits(bits: u64) -> Option<Self> {
        let resume_after = (bits >> 1).checked_sub(1)?;
        Some(Self { resume_after, skip_next: bits & 1 == 1 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_note_goes_through_one_number() {
        assert_eq!(Handover::from_bits(0), None);
        for resume_after in [0, 1, 149, u64::MAX >> 2] {
            for skip_next in [false, true] {
                let note = Handover { resume_after, skip_next };
                assert_eq!(Handover::from_bits(note.to_bits()), Some(note));
            }
        }
        let note = Handover { resume_after: u64::MAX, skip_next: false };
        assert!(Handover::from_bits(note.to_bits()).is_some(), "rubbish is no reason to panic");
    }
}
