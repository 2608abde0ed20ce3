//! The promises, which of them were kept, and the report as text.

use super::leaks::STALE_DESCRIPTORS;
use super::plan::Disturbance;
use super::report::{ChaosReport, Settings, Times};
use super::vandal;
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt::Write as _;

/// A promise and its verdict.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Promise {
    /// The promise.
    pub promise: &'static str,
    /// Whether it was kept.
    pub kept: bool,
    /// The figures that decide it.
    pub figure: String,
}

/// Private memory may grow by this share …
const GROWTH: f64 = 0.10;
/// … and by this much in addition, before it counts as a leak.
const GROWTH_BYTES: u64 = 8 << 20;

/// Judges everything except times, which depend on the machine.
pub fn judge(report: &ChaosReport) -> Vec<Promise> {
    let mut promises = Vec::new();
    let mut promise = |promise, kept, figure: String| {
        promises.push(Promise { promise, kept, figure });
    };
    let frames = &report.frames;
    let besides = |count: u64, why: &str| match count {
        0 => String::new(),
        count => format!(" ({count} more {why})"),
    };
    promise(
        "every captured frame reaches world",
        frames.missing == 0 && frames.captured > 0,
        format!(
            "{} of {} missing{}",
            frames.missing,
            frames.captured,
            besides(frames.missing_unpromised, "where it is not promised")
        ),
    );
    promise(
        "the camera drops no frame",
        frames.never_captured == 0 && frames.captured_again == 0,
        format!(
            "{} never captured{}, {} numbers used again",
            frames.never_captured,
            besides(frames.never_captured_unpromised, "while the grabber was disturbed"),
            frames.captured_again
        ),
    );
    promise("no frame comes twice", frames.duplicates == 0, format!("{} twice", frames.duplicates));
    promise(
        "frames come in order",
        frames.out_of_order == 0,
        format!("{} out of order", frames.out_of_order),
    );
    let slow = &frames.slow_reader;
    promise(
        "the same for a reader that looks rarely",
        (slow.duplicates, slow.out_of_order, slow.lost) == (0, 0, 0),
        format!(
            "{} lost, {} twice, {} out of order, of {}",
            slow.lost, slow.duplicates, slow.out_of_order, slow.received
        ),
    );
    let never = report.disturbances.iter().filter(|done| done.fresh_world_ms.is_none()).count();
    promise(
        "every stage comes back",
        never == 0 && report.left_out == 0,
        format!(
            "{never} of {} never got over, {} left out because the stage was not back",
            report.disturbances.len(),
            report.left_out
        ),
    );
    promise(
        "the supervisor stays",
        report.supervisor_failure.is_none(),
        report.supervisor_failure.as_ref().map_or_else(
            || "it did not end by itself".into(),
            |failure| failure.lines().last().unwrap_or_default().into(),
        ),
    );
    promise(
        "no process ends without cause",
        report.ended_by_themselves.is_empty() && report.started_in_vain == 0,
        format!(
            "{} ended that nobody had touched, {} before they were ready",
            report.ended_by_themselves.len(),
            report.started_in_vain
        ),
    );
    // A new supervisor counts from zero.
    let counts_all = report.disturbances.iter().all(|done| {
        !matches!(done.what, Disturbance::Supervisor | Disturbance::Enospc | Disturbance::Emfile)
    });
    let has_rubbish = report.disturbances.iter().any(|done| done.what == Disturbance::Rubbish);
    if let Some(group) = report.group.as_ref().filter(|_| has_rubbish && counts_all) {
        let named = group.strangers.iter().filter(|stranger| stranger.name == vandal::NAME);
        let messages: u64 = named.clone().map(|stranger| stranger.messages).sum();
        let pids: BTreeSet<u32> = named.map(|stranger| stranger.pid).collect();
        promise(
            "who publishes rubbish is named",
            messages > 0,
            format!("{messages} messages of {} processes named", pids.len()),
        );
    }
    if let Some(deeds) = report.outsider {
        promise(
            "another user can touch nothing",
            deeds.succeeded == 0 && deeds.made > 0 && deeds.attempts > 0,
            format!(
                "{} of {} attempts to open, truncate, remove or address succeeded; {} names taken",
                deeds.succeeded, deeds.attempts, deeds.made
            ),
        );
    }
    // Without memory no program attaches.
    let has_memory = report.disturbances.iter().all(|done| done.what != Disturbance::Enospc);
    if let Some(fate) = report.bystanders {
        promise(
            "programs can attach at any time",
            (fate.failed == 0 || !has_memory) && fate.killed > 0,
            format!(
                "{} attached and were killed, {} could not attach or fell; one was frozen {} times",
                fate.killed, fate.failed, fate.frozen
            ),
        );
    }
    if let Some((agrees, figure)) = own_counts(report) {
        promise("the group counts its losses exactly", agrees, figure);
    }
    leaks(report, &mut promise);
    let left = &report.left;
    promise(
        "nothing is left at the end",
        left.ended_in_order
            && left.processes.is_empty()
            && left.shared_memory.is_empty()
            && !left.runtime_directory,
        format!(
            "{} processes, {} names in /dev/shm, {} runtime directory{}",
            left.processes.len(),
            left.shared_memory.len(),
            if left.runtime_directory { "a" } else { "no" },
            if left.ended_in_order { "" } else { "; it did not end when asked to" }
        ),
    );
    promises
}

fn leaks(report: &ChaosReport, promise: &mut impl FnMut(&'static str, bool, String)) {
    let (before, after) = (&report.usage_before, &report.usage_after);
    let stale = before.stale();
    let mut counted = |name, before, after, allowed| {
        promise(name, after <= before + allowed, format!("{before} before, {after} after"));
    };
    counted(
        "shared memory does not pile up",
        before.shared_memory_entries,
        after.shared_memory_entries,
        stale,
    );
    counted("files do not pile up", before.runtime_entries, after.runtime_entries, stale);
    counted("processes do not pile up", before.processes, after.processes, 0);
    let grown = after.descriptors_grown(before);
    let figure = match &grown[..] {
        [] => format!("{} before, {} after", sum(&before.descriptors), sum(&after.descriptors)),
        grown => {
            let words: Vec<String> = grown
                .iter()
                .map(|(role, before, after)| format!("{role} {before} before, {after} after"))
                .collect();
            words.join("; ")
        }
    };
    let kept = grown.iter().all(|(_, before, after)| *after <= before + STALE_DESCRIPTORS);
    promise("file descriptors do not pile up", kept, figure);
    let allowed =
        before.private_bytes + (before.private_bytes as f64 * GROWTH) as u64 + GROWTH_BYTES;
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    promise(
        "memory does not pile up",
        after.private_bytes <= allowed,
        format!(
            "private {:.1} MiB before, {:.1} after; resident {:.0} before, {:.0} after",
            mib(before.private_bytes),
            mib(after.private_bytes),
            mib(before.resident_bytes),
            mib(after.resident_bytes)
        ),
    );
}

fn sum(counts: &std::collections::BTreeMap<String, u64>) -> u64 {
    counts.values().sum()
}

/// The group's own counts compared with the observer's; `None` if they are not comparable, because a new
/// supervisor counts from zero or frames are lost all the time.
fn own_counts(report: &ChaosReport) -> Option<(bool, String)> {
    let anew = report.disturbances.iter().any(|done| done.what == Disturbance::Supervisor);
    if anew || report.lost_undisturbed > 0 || report.supervisor_failure.is_some() {
        return None;
    }
    let Some(group) = &report.group else {
        return Some((false, "the group does not say".into()));
    };
    let (ours, theirs) = (&report.frames, &group.frames);
    let pairs = [
        ("missing", ours.missing + ours.missing_unpromised, theirs.missing_in_world),
        (
            "never captured",
            ours.never_captured + ours.never_captured_unpromised,
            theirs.never_captured,
        ),
        ("twice or out of order", ours.duplicates + ours.out_of_order, theirs.duplicates_in_world),
    ];
    let words: Vec<String> = pairs
        .iter()
        .map(|(what, ours, theirs)| format!("{what} {theirs} (seen: {ours})"))
        .collect();
    // An observer that was too slow itself cannot contradict. A group that reports frames it has not
    // seen has not miscounted.
    let not_seen = theirs.not_seen + theirs.not_seen_in_world;
    let agrees =
        ours.overlooked > 0 || not_seen > 0 || pairs.iter().all(|(_, ours, theirs)| ours == theirs);
    let besides = if not_seen > 0 { format!(", {not_seen} not seen") } else { String::new() };
    Some((agrees, words.join(", ") + &besides))
}

/// The target for times, and whether it was met: median and 99th percentile or maximum in milliseconds,
/// until the `world` of a frame captured after the disturbance.
fn target(what: Disturbance, settings: &Settings, times: &Times) -> Option<(String, bool)> {
    let period_ms = 1000.0 / settings.fps;
    match what {
        Disturbance::Kill | Disturbance::Panic | Disturbance::Restart | Disturbance::Reload => {
            let median = period_ms.max(12.5);
            let met = times.median <= median && times.p99 <= 40.0;
            Some((format!("median ≤ {median:.1}, p99 ≤ 40"), met))
        }
        Disturbance::Stop => {
            let median = settings.stall_deadline_ms + 15.0;
            Some((format!("median ≤ {median:.1}"), times.median <= median))
        }
        Disturbance::Pause | Disturbance::Emfile | Disturbance::Enospc => None,
        // The lower bound is the time to the next frame.
        Disturbance::Hup | Disturbance::Rubbish | Disturbance::Outsider => {
            Some(("max ≤ 100".into(), times.max <= 100.0))
        }
        Disturbance::Double => Some(("max ≤ 500".into(), times.max <= 500.0)),
        Disturbance::Supervisor => Some(("max ≤ 1000".into(), times.max <= 1000.0)),
    }
}

/// The report as text.
pub fn text(report: &ChaosReport) -> String {
    let mut text = String::new();
    let mut line = |words: std::fmt::Arguments| {
        let _ = writeln!(text, "{words}");
    };
    line(format_args!("\nPromises"));
    for promise in &report.promises {
        let word = if promise.kept { "kept  " } else { "BROKEN" };
        line(format_args!("  {word}  {:<41}{}", promise.promise, promise.figure));
    }
    line(format_args!(
        "\nTimes in ms{:<34}{:>7} {:>8} {:>8} {:>8} {:>8}",
        "", "count", "median", "90 %", "99 %", "longest"
    ));
    let aims: Vec<(String, Disturbance)> =
        report.settings.signals.iter().map(|&what| (fresh_name(what.name()), what)).collect();
    for (name, times) in &report.times_ms {
        let aim = aims
            .iter()
            .find(|(aimed, _)| aimed == name)
            .and_then(|(_, what)| target(*what, &report.settings, times));
        let aim = match aim {
            None => String::new(),
            Some((aim, true)) => format!("   {aim}: met"),
            Some((aim, false)) => format!("   {aim}: MISSED"),
        };
        line(format_args!(
            "  {name:<43}{:>7} {:>8.1} {:>8.1} {:>8.1} {:>8.1}{aim}",
            times.count, times.median, times.p90, times.p99, times.max
        ));
    }
    if report.lost_undisturbed > 0 {
        line(format_args!("\n{}", too_slow(report.lost_undisturbed, report.settings.fps)));
    }
    if report.frames.overlooked > 0 {
        line(format_args!(
            "\nThis machine kept the observer itself from looking, once for {:.0} ms: nothing can be \
             said about {} frames.",
            report.observer_longest_absence_ms, report.frames.overlooked
        ));
    }
    if report.interrupted {
        line(format_args!("\nEnded before its time."));
    }
    let broken = report.promises.iter().filter(|promise| !promise.kept).count();
    match (report.disturbances.len(), broken) {
        (0, _) => line(format_args!("\nNothing was disturbed, so this proves nothing.")),
        (count, 0) => line(format_args!("\nEvery promise was kept through {count} disturbances.")),
        (count, broken) => line(format_args!(
            "\n{broken} of {} promises were BROKEN in {count} disturbances. The same sequence again: \
             --seed {}",
            report.promises.len(),
            report.settings.seed
        )),
    }
    text
}

/// The message when frames are lost before the first disturbance.
pub fn too_slow(lost: u64, fps: f64) -> String {
    format!(
        "{lost} frames were lost before anything was disturbed: this machine, as busy as it is, does \
         not keep up with {fps} frames a second."
    )
}

/// Key of the times until the `world` of a frame captured after a disturbance.
pub fn fresh_name(what: &str) -> String {
    format!("{what}: to a frame captured after it")
}

/// Key of the times until the next `world`.
pub fn next_name(what: &str) -> String {
    format!("{what}: to the next world")
}

#[cfg(test)]
mod tests {
    use super::super::bystanders::Fate;
    use super::super::leaks::{Leftovers, Usage};
    use super::super::report::{Ended, Frames, tests::done};
    use super::*;
    use control::Report;
    use messages::ProcessKind;

    fn good() -> ChaosReport {
        let usage = Usage {
            shared_memory_entries: 40,
            runtime_entries: 60,
            processes: 8,
            descriptors: [("supervisor".into(), 50), ("filter".into(), 20)].into(),
            private_bytes: 30 << 20,
            resident_bytes: 200 << 20,
        };
        ChaosReport {
            version: "1",
            kept: true,
            promises: vec![],
            settings: Settings {
                seconds: 10.0,
                every_ms: 500,
                signals: vec![Disturbance::Kill],
                stages: vec![ProcessKind::Filter],
                fps: 80.0,
                bystanders: false,
                seed: 1,
                stall_deadline_ms: 40.0,
                spares: vec![ProcessKind::Filter],
            },
            interrupted: false,
            frames: Frames { captured: 800, world: 800, ..Frames::default() },
            times_ms: Default::default(),
            disturbances: vec![done(1, Disturbance::Kill, Some(ProcessKind::Filter), true)],
            lost_undisturbed: 0,
            left_out: 0,
            supervisor_failure: None,
            ended_by_themselves: vec![],
            started_in_vain: 0,
            bystanders: Some(Fate { killed: 10, frozen: 1, failed: 0 }),
            outsider: None,
            observer_longest_absence_ms: 1.0,
            usage_before: usage.clone(),
            usage_after: usage,
            left: Leftovers { ended_in_order: true, ..Leftovers::default() },
            group: Some(Report::default()),
            group_log: vec![],
        }
    }

    fn broken(change: impl FnOnce(&mut ChaosReport)) -> Vec<&'static str> {
        let mut report = good();
        change(&mut report);
        let promises = judge(&report);
        promises
            .into_iter()
            .filter(|promise| !promise.kept)
            .map(|promise| promise.promise)
            .collect()
    }

    #[test]
    fn a_good_run_keeps_every_promise() {
        assert_eq!(broken(|_| {}), [""; 0]);
    }

    #[test]
    fn each_fault_breaks_its_own_promise() {
        let ended = Ended { stage: ProcessKind::Filter, pid: 1, t_s: 1.0 };
        let lost = ["every captured frame reaches world", "the group counts its losses exactly"];
        assert_eq!(broken(|r| r.frames.missing = 1), lost);
        assert_eq!(broken(|r| r.frames.captured = 0), lost[..1]);
        assert_eq!(broken(|r| r.frames.captured_again = 1), ["the camera drops no frame"]);
        assert_eq!(
            broken(|r| r.frames.slow_reader.out_of_order = 1),
            ["the same for a reader that looks rarely"]
        );
        assert_eq!(broken(|r| r.left_out = 1), ["every stage comes back"]);
        assert_eq!(broken(|r| r.disturbances[0].fresh_world_ms = None), ["every stage comes back"]);
        assert_eq!(
            broken(|r| r.ended_by_themselves.push(ended)),
            ["no process ends without cause"]
        );
        assert_eq!(
            broken(|r| r.supervisor_failure = Some("it failed".into())),
            ["the supervisor stays"]
        );
        assert_eq!(broken(|r| r.started_in_vain = 1), ["no process ends without cause"]);
        assert_eq!(
            broken(|r| r.bystanders = Some(Fate { killed: 9, frozen: 1, failed: 1 })),
            ["programs can attach at any time"]
        );
        assert_eq!(broken(|r| r.group = None), ["the group counts its losses exactly"]);
        assert_eq!(
            broken(|r| r.usage_after.shared_memory_entries += 25),
            ["shared memory does not pile up"]
        );
        assert_eq!(
            broken(|r| *r.usage_after.descriptors.get_mut("filter").unwrap() += 17),
            ["file descriptors do not pile up"]
        );
        assert_eq!(
            broken(|r| r.usage_after.private_bytes += 12 << 20),
            ["memory does not pile up"]
        );
        assert_eq!(broken(|r| r.left.runtime_directory = true), ["nothing is left at the end"]);
        assert_eq!(broken(|r| r.left.ended_in_order = false), ["nothing is left at the end"]);
    }

    #[test]
    fn unpromised_losses_must_still_be_counted_by_the_group() {
        let unpromised = |theirs: u64| {
            broken(|report| {
                report.frames.missing_unpromised = 7;
                report.group.as_mut().unwrap().frames.missing_in_world = theirs;
            })
        };
        assert_eq!(unpromised(7), [""; 0]);
        assert_eq!(unpromised(6), ["the group counts its losses exactly"]);
    }

    #[test]
    fn after_a_new_supervisor_counts_are_not_compared() {
        let found = broken(|report| {
            report.disturbances.push(done(2, Disturbance::Supervisor, None, true));
            report.group.as_mut().unwrap().frames.missing_in_world = 5;
        });
        assert_eq!(found, [""; 0]);
    }

    #[test]
    fn the_text_names_broken_promises_and_how_to_repeat_them() {
        let mut report = good();
        report.frames.duplicates = 3;
        report.promises = judge(&report);
        let times = Times { count: 1, median: 13.0, p90: 13.0, p99: 13.0, max: 13.0 };
        report.times_ms.insert(fresh_name("kill"), times);
        let text = text(&report);
        assert!(text.contains("BROKEN  no frame comes twice"), "{text}");
        assert!(text.contains("--seed 1"), "{text}");
        assert!(text.contains("median ≤ 12.5, p99 ≤ 40: MISSED"), "{text}");
    }
}
