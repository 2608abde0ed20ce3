//! `touchline replay`: computes a recording again.

use super::{tell_damages, time_text};
use crate::cli::ReplayArgs;
use crate::commands::CommandError;
use recording::Reader;
use std::io::{IsTerminal, Write};
use std::process::ExitCode;
use std::time::{Duration, Instant};
use touchline::replay::{Findings, Verifier};

/// Time between two updates of the progress on a terminal.
const TELL_PERIOD: Duration = Duration::from_millis(250);

/// Checks that every recorded output follows from the recorded inputs.
pub fn replay(args: ReplayArgs) -> Result<ExitCode, CommandError> {
    if !args.verify {
        return Err(format!(
            "say what to do: `--verify` computes everything again and compares; to play the recording, \
             `touchline run --source recording:{}`",
            args.file.display()
        )
        .into());
    }
    let mut reader = Reader::open(&args.file)?;
    let mut verifier = Verifier::default();
    let is_terminal = std::io::stderr().is_terminal();
    let (began, mut told, mut first_ns) = (Instant::now(), Instant::now(), None);
    for entry in reader.by_ref() {
        let entry = entry?;
        verifier.take(&entry)?;
        let first_ns = *first_ns.get_or_insert(entry.t_sent_ns);
        if is_terminal && told.elapsed() > TELL_PERIOD {
            told = Instant::now();
            let seconds = entry.t_sent_ns.saturating_sub(first_ns) as f64 / 1e9;
            runtime::tell_part!("\r\x1b[K{} of the recording checked", time_text(seconds));
            let _ = std::io::stderr().flush();
        }
    }
    if is_terminal {
        runtime::tell_part!("\r\x1b[K");
    }
    let findings = verifier.finish();
    runtime::say!("{}", text(&findings, began.elapsed()))?;
    tell_damages(&args.file, reader.damages());
    let equal: u64 = findings.outputs.values().map(|tally| tally.equal).sum();
    let different: u64 = findings.outputs.values().map(|tally| tally.different).sum();
    if equal == 0 {
        return Err(
            "nothing could be checked: record frames, detections, world and commands".into()
        );
    }
    Ok(if different == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn text(findings: &Findings, took: Duration) -> String {
    let mut text = format!("  {:<12}{:>10}{:>12}{:>14}\n", "", "equal", "different", "not checked");
    for (channel, tally) in &findings.outputs {
        let without: u64 = tally.without.values().sum();
        text += &format!(
            "  {:<12}{:>10}{:>12}{without:>14}",
            channel.name(),
            tally.equal,
            tally.different
        );
        for (what, count) in &tally.without {
            text += &format!("  {count} without {what}");
        }
        text += "\n";
    }
    for difference in &findings.differences {
        text += &format!("  different    {difference}\n");
    }
    if findings.rubbish > 0 {
        text += &format!("  {} messages make no sense\n", findings.rubbish);
    }
    text += &format!(
        "  the filter began from nothing {} times; checked in {}\n",
        findings.filter_starts,
        time_text(took.as_secs_f64())
    );
    text
}
