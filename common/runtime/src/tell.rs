//! Messages on the standard error output and results on the standard output, without the risk to panic
//! or block.
//!
//! `eprintln!` panics if the output cannot be written: the terminal is gone, the reader of a pipe has
//! ended, a log has filled its disk. None of that is a reason to end a match.
//!
//! A reader that stops reading, such as a terminal after Ctrl-S or a pager, blocks the writer for as
//! long as that lasts. A process that must not be held up writes from a separate thread
//! ([`never_block`]); texts that do not fit into its queue are left out and counted.

use std::fmt::Arguments;
use std::io::{self, Write};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

/// Texts that may wait to be written: some seconds of a lively match.
const WAITING: usize = 256;

/// Like `eprintln!`, but ignores errors.
#[macro_export]
macro_rules! tell {
    ($($text:tt)*) => { $crate::tell_part!("{}\n", format_args!($($text)*)) };
}

/// Like `eprint!`, but ignores errors.
#[macro_export]
macro_rules! tell_part {
    ($($text:tt)*) => { $crate::tell::tell(format_args!($($text)*)) };
}

/// A message to the writing thread.
enum Task {
    Error(String),
    Output(String),
    /// Answered when everything before it has been written.
    Finish(SyncSender<()>),
}

static WRITER: OnceLock<SyncSender<Task>> = OnceLock::new();
/// Texts left out since the last one written.
static LEFT_OUT: AtomicU64 = AtomicU64::new(0);

/// From now on this process's output never blocks it.
pub fn never_block() -> io::Result<()> {
    let (sender, tasks) = sync_channel(WAITING);
    std::thread::Builder::new().name("tell".into()).spawn(move || write_all(&tasks))?;
    // If there is a writer already, the new thread ends at once.
    let _ = WRITER.set(sender);
    Ok(())
}

/// See [`tell!`](crate::tell!).
pub fn tell(text: Arguments) {
    match WRITER.get() {
        None => drop(io::stderr().lock().write_fmt(text)),
        Some(writer) => give(writer, Task::Error(text.to_string())),
    }
}

/// Writes to the standard output and ignores errors.
pub fn show(text: String) {
    match WRITER.get() {
        None => write_output(&text),
        Some(writer) => give(writer, Task::Output(text)),
    }
}

/// Waits until everything said so far has been written, but no longer than `patience`; returns whether
/// it was.
pub fn finish(patience: Duration) -> bool {
    let Some(writer) = WRITER.get() else { return true };
    let (done, is_done) = sync_channel(1);
    let begun = std::time::Instant::now();
    // The queue may be full at the moment.
    while writer.try_send(Task::Finish(done.clone())).is_err() {
        if begun.elapsed() >= patience {
            return false;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    is_done.recv_timeout(patience.saturating_sub(begun.elapsed())).is_ok()
}

fn give(writer: &SyncSender<Task>, task: Task) {
    if writer.try_send(task).is_err() {
        LEFT_OUT.fetch_add(1, Ordering::Relaxed);
    }
}

fn write_all(tasks: &Receiver<Task>) {
    for task in tasks {
        match task {
            Task::Error(text) => drop(io::stderr().lock().write_all(text.as_bytes())),
            Task::Output(text) => write_output(&text),
            Task::Finish(done) => drop(done.try_send(())),
        }
        let left_out = LEFT_OUT.swap(0, Ordering::Relaxed);
        if left_out > 0 {
            let what = format!(
                "touchline: {left_out} texts were left out, because the output was not read in time\n"
            );
            let _ = io::stderr().lock().write_all(what.as_bytes());
        }
    }
}

fn write_output(text: &str) {
    let mut out = io::stdout().lock();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}
