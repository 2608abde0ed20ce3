//! `touchline record`.

use super::{size_text, time_text};
use crate::cli::RecordArgs;
use crate::commands::CommandError;
use client::instance::Instance;
use recording::Channel;
use runtime::memory_rank::MemoryRank;
use serde_json::{Value, json};
use signal_hook::consts::{SIGINT, SIGTERM};
use std::collections::BTreeMap;
use std::io::{IsTerminal, Write};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};
use touchline::recorder::{self, End, Options, Progress};

/// Time between two lines of progress if they do not overwrite each other.
const LINE_PERIOD: Duration = Duration::from_secs(10);

/// Records a group.
pub fn record(args: RecordArgs) -> Result<ExitCode, CommandError> {
    // If memory runs out, the recorder is killed before the stages. Recording works without a rank too.
    let _ = runtime::memory_rank::set(MemoryRank::Recorder);
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        // The first signal ends the recording in order, which may take long on a slow disk; the second
        // ends it at once, and `recover` completes what is left.
        signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop))?;
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    for said in recorder::recover_family(&args.file) {
        runtime::tell!("touchline: {said}");
    }
    let mut channels = args.topics;
    if channels.contains(&Channel::Scene) {
        channels.extend([Channel::Robots, Channel::Ball]);
    }
    channels.sort_unstable();
    channels.dedup();
    let options = Options {
        instance: Instance::new(&args.instance.instance)?,
        path: args.file,
        channels,
        duration: args.seconds.map(Duration::from_secs_f64),
        file_bytes: args.max_size,
        keep_files: args.keep,
        keep_free_bytes: args.keep_free,
    };
    let mut display = Display::new(args.quiet);
    let outcome = recorder::record(&options, &stop, |progress| {
        display.show(progress);
        if args.progress {
            // A reader that is gone does not end the recording.
            let _ = runtime::say_line!("{}", progress_json(progress));
        }
    });
    display.clear();
    let (end, progress) = outcome?;
    runtime::say!("{}", summary(&progress))?;
    if end == End::DiskNearlyFull {
        return Err(format!(
            "stopped: less than {} are free on the disk (--keep-free); what was recorded is complete",
            size_text(options.keep_free_bytes)
        )
        .into());
    }
    Ok(ExitCode::SUCCESS)
}

/// Progress for a program.
fn progress_json(progress: &Progress) -> Value {
    json!({
        "path": progress.path, "bytes": progress.bytes, "dropped": total(&progress.dropped),
        // Results of a frame that never came are missed for the same reason.
        "missed": progress.missed.get(&Channel::Frames).copied().unwrap_or_default(),
    })
}

fn total(counts: &BTreeMap<Channel, u64>) -> u64 {
    counts.values().sum()
}

fn list(counts: &BTreeMap<Channel, u64>) -> String {
    let items: Vec<String> =
        counts.iter().map(|(channel, count)| format!("{} {count}", channel.name())).collect();
    if items.is_empty() { "none".into() } else { items.join(", ") }
}

/// Summary of the progress.
fn summary(progress: &Progress) -> String {
    let mut text = String::new();
    if progress.files.is_empty() {
        return "nothing was recorded\n".into();
    }
    for path in &progress.files {
        text += &format!("{}\n", path.display());
    }
    text += &format!(
        "  {} in {}\n  written      {}\n  dropped      {}\n  missed       {}\n",
        size_text(progress.bytes),
        time_text(progress.elapsed.as_secs_f64()),
        list(&progress.written),
        list(&progress.dropped),
        list(&progress.missed),
    );
    text
}

/// A line of progress, updated in place.
struct Display {
    quiet: bool,
    is_terminal: bool,
    shown: Option<Instant>,
    bytes: Option<(Instant, u64)>,
    bytes_per_s: f64,
}

impl Display {
    fn new(quiet: bool) -> Self {
        let is_terminal = std::io::stderr().is_terminal();
        Self { quiet, is_terminal, shown: None, bytes: None, bytes_per_s: 0.0 }
    }

    fn show(&mut self, progress: &Progress) {
        let period = if self.is_terminal { Duration::from_millis(250) } else { LINE_PERIOD };
        if self.quiet || self.shown.is_some_and(|shown| shown.elapsed() < period) {
            return;
        }
        self.shown = Some(Instant::now());
        self.measure(progress);
        let line = self.line(progress);
        if self.is_terminal {
            runtime::tell_part!("\r\x1b[K{line}");
            let _ = std::io::stderr().flush();
        } else {
            runtime::tell!("{line}");
        }
    }

    fn measure(&mut self, progress: &Progress) {
        let (since, bytes) = *self.bytes.get_or_insert((Instant::now(), progress.bytes));
        let seconds = since.elapsed().as_secs_f64();
        if seconds > 2.0 {
            self.bytes_per_s = progress.bytes.saturating_sub(bytes) as f64 / seconds;
            self.bytes = Some((Instant::now(), progress.bytes));
        }
    }

    fn line(&self, progress: &Progress) -> String {
        let Progress { path, elapsed, bytes, written, dropped, free_bytes, .. } = progress;
        if progress.is_waiting {
            return "waiting for the group to start (Ctrl-C to end)".into();
        }
        let mut line = format!(
            "{}  {}  {}  {} frames  {} dropped  {} free",
            path.display(),
            time_text(elapsed.as_secs_f64()),
            size_text(*bytes),
            written.get(&Channel::Frames).or(written.get(&Channel::World)).unwrap_or(&0),
            total(dropped),
            size_text(*free_bytes),
        );
        if self.bytes_per_s > 0.0 {
            line += &format!(
                " ({} at {}/s)",
                time_text(*free_bytes as f64 / self.bytes_per_s),
                size_text(self.bytes_per_s as u64)
            );
        }
        line
    }

    fn clear(&self) {
        if self.is_terminal && self.shown.is_some() {
            runtime::tell_part!("\r\x1b[K");
        }
    }
}
