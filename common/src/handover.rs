//! What the supervisor tells the next process of a stage before it lets it work.
//!
//! The supervisor watches every stage's output and confirms a process dead before its successor
//! starts to work, so it knows exactly how far the stage has come. Only what a dead process has
//! published before this supervisor came it does not know; that is what [marks](crate::mark) are for.

use crate::instance::{Instance, create_private};
use crate::messages::ProcessKind;
use std::io::{self, Write};

/// How far a stage has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Handover {
    /// Number of its last output: everything up to it is done.
    pub resume_after: u64,
    /// The next input has killed two processes in a row and is to be skipped.
    pub skip_next: bool,
}

impl Handover {
    /// Leaves the note for the next process of a stage, in the place of the last one.
    pub fn write(&self, instance: &Instance, kind: ProcessKind) -> io::Result<()> {
        let skip = if self.skip_next { " skip" } else { "" };
        let mut file = create_private(&instance.handover_path(kind.name()))?;
        file.write_all(format!("{}{skip}\n", self.resume_after).as_bytes())
    }

    /// The note for a stage; `None` when it has not worked yet.
    pub fn read(instance: &Instance, kind: ProcessKind) -> Option<Self> {
        Self::parse(&std::fs::read_to_string(instance.handover_path(kind.name())).ok()?)
    }

    /// What a note says; `None` when it is none.
    pub fn parse(text: &str) -> Option<Self> {
        let mut words = text.split_whitespace();
        let resume_after = words.next()?.parse().ok()?;
        Some(Self { resume_after, skip_next: words.next() == Some("skip") })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_written_is_read() {
        let base = std::env::temp_dir().join(format!("tl-handover-{}", std::process::id()));
        let instance = Instance::below(&base, "test").unwrap();
        instance.create_directory().unwrap();
        let kind = ProcessKind::Tracker;
        assert_eq!(Handover::read(&instance, kind), None);
        for skip_next in [true, false] {
            let handover = Handover { resume_after: 149, skip_next };
            handover.write(&instance, kind).unwrap();
            assert_eq!(Handover::read(&instance, kind), Some(handover));
            assert_eq!(Handover::read(&instance, ProcessKind::Filter), None);
        }
        instance.remove_directory().unwrap();
    }
}
