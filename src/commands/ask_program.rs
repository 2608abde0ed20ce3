//! Asks another program a question, as `upgrade` does. The program may be any executable, so its time
//! and its output are limited.

use super::CommandError;
use std::ffi::OsStr;
use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// Longest time for an answer.
const PATIENCE: Duration = Duration::from_secs(10);
/// Largest answer.
const MOST_BYTES: u64 = 1 << 20;
/// Time between two checks whether the program has ended.
const LOOK: Duration = Duration::from_millis(5);

/// The answer of a program.
pub struct Answer {
    pub status: ExitStatus,
    pub stdout: Vec<u8>,
    pub stderr: Vec<u8>,
}

/// Runs a program to its end. A program that takes too long or writes too much is killed.
pub fn ask(program: &Path, arguments: &[&OsStr]) -> Result<Answer, CommandError> {
    ask_for(program, arguments, PATIENCE)
}

fn ask_for(
    program: &Path,
    arguments: &[&OsStr],
    patience: Duration,
) -> Result<Answer, CommandError> {
    let shown = program.display();
    let mut child = Command::new(program)
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|error| format!("{shown}: {error}"))?;
    let outputs = [child.stdout.take().map(listen), child.stderr.take().map(listen)];
    let outcome = wait(&mut child, outputs, Instant::now() + patience);
    // Has no effect on a program that has ended by itself.
    let _ = child.kill();
    let _ = child.wait();
    outcome.map_err(|problem| {
        let arguments: Vec<_> = arguments.iter().map(|part| part.to_string_lossy()).collect();
        format!("{shown} {}: {problem}; it was ended, and nothing was changed", arguments.join(" "))
            .into()
    })
}

/// Reads on a separate thread, up to one byte more than the largest answer. The thread may outlive the
/// program if that has passed its output on to another process.
fn listen(mut output: impl Read + Send + 'static) -> Receiver<Vec<u8>> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        let mut text = Vec::new();
        // An output that cannot be read counts as empty.
        let _ = output.by_ref().take(MOST_BYTES + 1).read_to_end(&mut text);
        let _ = sender.send(text);
    });
    receiver
}

fn wait(
    child: &mut Child,
    outputs: [Option<Receiver<Vec<u8>>>; 2],
    deadline: Instant,
) -> Result<Answer, String> {
    let mut texts = [Vec::new(), Vec::new()];
    for (text, output) in texts.iter_mut().zip(outputs) {
        let Some(output) = output else { continue };
        let left = deadline.saturating_duration_since(Instant::now());
        *text = output.recv_timeout(left).map_err(|_| too_late())?;
        if text.len() as u64 > MOST_BYTES {
            return Err(format!("it says more than {} kB", MOST_BYTES >> 10));
        }
    }
    let [stdout, stderr] = texts;
    loop {
        match child.try_wait().map_err(|error| error.to_string())? {
            Some(status) => return Ok(Answer { status, stdout, stderr }),
            None if Instant::now() > deadline => return Err(too_late()),
            None => std::thread::sleep(LOOK),
        }
    }
}

fn too_late() -> String {
    format!("it does not answer within {} s", PATIENCE.as_secs())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str, patience: Duration) -> Result<Answer, String> {
        let arguments = ["-c".as_ref(), script.as_ref()];
        ask_for(Path::new("/bin/sh"), &arguments, patience).map_err(|error| error.to_string())
    }

    #[test]
    fn an_answer_contains_the_whole_output() {
        let answer = shell("echo yes; echo no >&2; exit 3", PATIENCE).unwrap();
        assert_eq!((&*answer.stdout, &*answer.stderr), (&b"yes\n"[..], &b"no\n"[..]));
        assert_eq!(answer.status.code(), Some(3));
    }

    #[test]
    fn a_program_that_talks_or_hangs_is_ended() {
        for script in ["yes", "yes >&2", "exec cat /dev/zero"] {
            let problem = shell(script, PATIENCE).err().unwrap();
            assert!(problem.contains("says more than 1024 kB"), "{script}: {problem}");
        }
        for script in ["exec sleep 1000", "exec >&- 2>&-; exec sleep 1000"] {
            let problem = shell(script, Duration::from_millis(300)).err().unwrap();
            assert!(problem.contains("does not answer"), "{script}: {problem}");
        }
    }
}
