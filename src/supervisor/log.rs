//! Standard error of a process of the group, kept in anonymous memory: it takes no disk, no directory can
//! be removed from under it, and it leaves no file. While the process lives it can be read as
//! `/proc/PID/fd/2`.

use super::sys::{self, Call};
use rustix::fs::{MemfdFlags, memfd_create};
use std::fs::{self, File};
use std::os::unix::fs::FileExt;
use std::process::Stdio;

/// Kept part of a dead process's last output: enough for a panic with its place.
const LAST_WORDS_BYTES: u64 = 2000;
/// Prefix of the logs' names in `/proc`.
const NAME: &str = "touchline-log-";

/// A log; keeps nothing if there was no memory or descriptor for it.
#[derive(Debug)]
pub struct Log(Option<File>);

impl Log {
    /// An empty log.
    pub fn new(name: &str) -> Self {
        let make = || Ok(memfd_create(format!("{NAME}{name}"), MemfdFlags::CLOEXEC)?);
        Self(sys::ask(Call::MakeLog, make).ok().map(File::from))
    }

    /// The log of a process that another supervisor has started.
    pub fn of_process(pid: u32) -> Self {
        let path = format!("/proc/{pid}/fd/2");
        // Only a log: its standard error may be anything, and opening a fifo would block for ever.
        let is_log = fs::read_link(&path)
            .is_ok_and(|target| target.to_string_lossy().starts_with(&format!("/memfd:{NAME}")));
        Self(is_log.then(|| sys::ask(Call::MakeLog, || File::open(&path)).ok()).flatten())
    }

    /// The handle the process writes to.
    pub fn for_writing(&self) -> Stdio {
        let copy =
            self.0.as_ref().and_then(|file| sys::ask(Call::MakeLog, || file.try_clone()).ok());
        copy.map_or_else(Stdio::null, Stdio::from)
    }

    /// Its last lines.
    pub fn last_words(&self) -> String {
        let Some(file) = &self.0 else { return String::new() };
        let read = || {
            let length = file.metadata()?.len();
            let begin = length.saturating_sub(LAST_WORDS_BYTES);
            let mut text = vec![0; (length - begin) as usize];
            let read = file.read_at(&mut text, begin)?;
            text.truncate(read);
            Ok(text)
        };
        let text = sys::ask(Call::ReadLog, read).unwrap_or_default();
        String::from_utf8_lossy(&text).trim().to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    #[test]
    fn the_end_of_what_a_process_wrote_is_kept() {
        let log = Log::new("test");
        let script =
            "i=0; while [ $i -lt 1000 ]; do echo line $i >&2; i=$((i+1)); done; echo done >&2";
        let mut child =
            Command::new("sh").args(["-c", script]).stderr(log.for_writing()).spawn().unwrap();
        child.wait().unwrap();
        let words = log.last_words();
        assert!(words.ends_with("line 999\ndone") && words.len() > 1900, "{words}");
        assert!(Log(None).last_words().is_empty());
    }

    #[test]
    fn the_log_of_a_living_process_is_found_and_nothing_else() {
        let log = Log::new("other");
        let mut child = Command::new("sh")
            .args(["-c", "echo hello >&2; read line"])
            .stdin(Stdio::piped())
            .stderr(log.for_writing())
            .spawn()
            .unwrap();
        while log.last_words().is_empty() {
            std::thread::yield_now();
        }
        assert_eq!(Log::of_process(child.id()).last_words(), "hello");
        child.kill().unwrap();
        child.wait().unwrap();
        let mut quiet = Command::new("sleep").arg("60").stderr(Stdio::null()).spawn().unwrap();
        assert!(Log::of_process(quiet.id()).0.is_none());
        quiet.kill().unwrap();
        quiet.wait().unwrap();
    }
}
