//! Names of a recording's files: FILE.mcap, FILE-2.mcap, FILE-3.mcap, … Existing files are never
//! overwritten.

use recording::RecordingError;
use recording::recover::{Recovery, is_finished, recover};
use std::path::{Path, PathBuf};

/// Generator of file names.
#[derive(Debug, Clone)]
pub struct Names {
    first: PathBuf,
    next: u32,
}

impl Names {
    /// Names derived from this one.
    pub fn new(first: &Path) -> Self {
        Self { first: first.into(), next: 1 }
    }

    /// The next name that is free.
    pub fn next_free(&mut self) -> PathBuf {
        loop {
            let path = numbered(&self.first, self.next);
            self.next += 1;
            if !path.exists() {
                return path;
            }
        }
    }
}

fn numbered(first: &Path, number: u32) -> PathBuf {
    if number <= 1 {
        return first.into();
    }
    let mut name = first.file_stem().unwrap_or_default().to_os_string();
    name.push(format!("-{number}"));
    if let Some(extension) = first.extension() {
        name.push(".");
        name.push(extension);
    }
    first.with_file_name(name)
}

/// Recovers unfinished files of an earlier recording of this name. Returns a message for each that
/// was recovered or could not be.
pub fn recover_family(first: &Path) -> Vec<String> {
    let mut said = Vec::new();
    for number in 1.. {
        let path = numbered(first, number);
        if !path.exists() {
            break;
        }
        // A finished file is left alone: scanning it would take long.
        let recovery = match is_finished(&path) {
            Ok(true) => Ok(Recovery::NotNeeded),
            Ok(false) => recover(&path, &mut |_, _| ()),
            Err(error) => Err(error),
        };
        match recovery {
            Ok(Recovery::Recovered { messages, .. }) => said.push(format!(
                "{} was never finished; recovered {messages} messages",
                path.display()
            )),
            Ok(Recovery::BeingWritten) => {
                said.push(format!("{} is being written by another recorder", path.display()));
            }
            Ok(Recovery::NotNeeded) => {}
            Err(RecordingError::Format { .. }) => {
                said.push(format!("{} is there, but is no recording", path.display()));
            }
            Err(error) => said.push(format!("not recovered: {error}")),
        }
    }
    said
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_before_the_extension() {
        assert_eq!(numbered(Path::new("a/match.mcap"), 1), Path::new("a/match.mcap"));
        assert_eq!(numbered(Path::new("a/match.mcap"), 12), Path::new("a/match-12.mcap"));
        assert_eq!(numbered(Path::new("match"), 2), Path::new("match-2"));
    }
}
