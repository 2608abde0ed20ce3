//! The report: what was done, what was seen, and how long it was felt.

use super::bystanders::Fate;
use super::leaks::{Leftovers, Usage};
use super::observer::Sight;
use super::outsider::Deeds;
use super::plan::Disturbance;
use super::tally::Missing;
use super::verdict::Promise;
use common::messages::ProcessKind;
use serde::{Serialize, Serializer};
use std::collections::BTreeMap;

/// The whole document, as `--report` writes it.
#[derive(Debug, Serialize)]
pub struct ChaosReport {
    /// Version of the program.
    pub version: &'static str,
    /// Whether every promise was kept.
    pub kept: bool,
    /// The promises, one by one.
    pub promises: Vec<Promise>,
    /// What was asked for.
    pub settings: Settings,
    /// Whether it was ended before its time.
    pub interrupted: bool,
    /// Frames, as the observer counted them.
    pub frames: Frames,
    /// Times by what they are of, in milliseconds.
    pub times_ms: BTreeMap<String, Times>,
    /// What was done, in order.
    pub disturbances: Vec<Done>,
    /// Frames lost before anything was disturbed: the machine does not keep up.
    pub lost_undisturbed: u64,
    /// Disturbances left out because the stage was not back in time to be disturbed again.
    pub left_out: u64,
    /// Why the supervisor ended although nobody had asked it to, if it did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub supervisor_failure: Option<String>,
    /// Processes that ended although nobody had touched them.
    pub ended_by_themselves: Vec<Ended>,
    /// Processes that ended before they were ready, as the group counts them; 0 when a new
    /// supervisor began to count anew.
    pub started_in_vain: u64,
    /// What the programs that attach and behave badly have been through, if there were any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bystanders: Option<Fate>,
    /// What another user has done, where one was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outsider: Option<Deeds>,
    /// Longest time for which the observer itself was kept from looking.
    pub observer_longest_absence_ms: f64,
    /// What the group used before the first disturbance.
    pub usage_before: Usage,
    /// What it used when it had settled after the last one.
    pub usage_after: Usage,
    /// What was left when it had ended.
    pub left: Leftovers,
    /// What the group said of itself at the end.
    pub group: Option<touchline::monitor::Report>,
    /// What its supervisor wrote: every event, with its evidence.
    pub group_log: Vec<String>,
}

/// What was asked for.
#[derive(Debug, Clone, Serialize)]
pub struct Settings {
    /// For how long.
    pub seconds: f64,
    /// Time between two disturbances.
    pub every_ms: u64,
    /// Kinds of disturbance.
    pub signals: Vec<Disturbance>,
    /// Stages disturbed.
    #[serde(serialize_with = "names")]
    pub stages: Vec<ProcessKind>,
    /// Frames a second.
    pub fps: f64,
    /// Whether programs attach meanwhile and behave badly.
    pub bystanders: bool,
    /// What makes the sequence.
    pub seed: u64,
    /// Input without output for so long counts as a stall.
    pub stall_deadline_ms: f64,
    /// Stages that keep a spare.
    #[serde(serialize_with = "names")]
    pub spares: Vec<ProcessKind>,
}

/// A disturbance that happened.
#[derive(Debug, Clone, Serialize)]
pub struct Done {
    /// Monotonic clock.
    #[serde(skip)]
    pub t_ns: u64,
    /// Seconds since disturbances began.
    pub t_s: f64,
    /// What was done.
    pub what: Disturbance,
    /// To which stage; absent for the supervisor and the machine.
    #[serde(serialize_with = "name", skip_serializing_if = "Option::is_none")]
    pub stage: Option<ProcessKind>,
    /// To which process.
    pub pid: u32,
    /// For what lasts: how long.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pause_ms: Option<f64>,
    /// How long it came late because the stage had no spare yet.
    pub waited_ms: f64,
    /// Whether the group promises to lose nothing by it.
    pub lossless: bool,
    /// Until the next `world`, of whatever frame.
    pub next_world_ms: Option<f64>,
    /// Until the `world` of a frame captured after it.
    pub fresh_world_ms: Option<f64>,
    /// Until the stage had a spare again.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub protected_ms: Option<f64>,
}

impl Done {
    /// What its times are grouped by.
    pub fn label(&self) -> String {
        match self.what {
            Disturbance::Double => "double".into(),
            what if self.lossless => what.name().into(),
            what => format!("{} without a spare", what.name()),
        }
    }
}

/// A process that ended although nobody had touched it.
#[derive(Debug, Clone, Serialize)]
pub struct Ended {
    /// Its stage.
    #[serde(serialize_with = "one_name")]
    pub stage: ProcessKind,
    /// The system's number for it.
    pub pid: u32,
    /// Seconds since disturbances began.
    pub t_s: f64,
}

/// Frames, as the observer counted them.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Frames {
    /// On `frames`.
    pub captured: u64,
    /// On `frames` with a number that had been there before.
    pub captured_again: u64,
    /// In `world`.
    pub world: u64,
    /// Captured, but not in `world`, although that is promised.
    pub missing: u64,
    /// Captured, but not in `world`, around double faults and the like, where it is not promised.
    pub missing_unpromised: u64,
    /// Numbers nobody captured, although somebody should have.
    pub never_captured: u64,
    /// Numbers nobody captured because the grabber itself was disturbed.
    pub never_captured_unpromised: u64,
    /// More than once in `world`.
    pub duplicates: u64,
    /// In `world` after a later frame.
    pub out_of_order: u64,
    /// Frames about which nothing can be said: the observer itself was too slow.
    pub overlooked: u64,
    /// Another reader of `world`, which looks only now and then.
    pub slow_reader: SlowReader,
    /// Which frames are `missing`; the first hundred.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub missing_numbers: Vec<u64>,
    /// Which are `duplicates`; the first hundred.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub duplicate_numbers: Vec<u64>,
    /// Which are `out_of_order`; the first hundred.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub out_of_order_numbers: Vec<u64>,
}

/// What a reader of `world` met that looks only now and then.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct SlowReader {
    /// Messages.
    pub received: u64,
    /// Numbers that came again.
    pub duplicates: u64,
    /// Numbers that came after a higher one.
    pub out_of_order: u64,
    /// Numbers that the other reader got, and this one did not.
    pub lost: u64,
}

/// A distribution, in milliseconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Times {
    /// How many.
    pub count: usize,
    /// Half are below.
    pub median: f64,
    /// Nine of ten are below.
    pub p90: f64,
    /// Ninety-nine of a hundred are below.
    pub p99: f64,
    /// The longest.
    pub max: f64,
}

/// Frames in flight before a disturbance may be lost by it.
const IN_FLIGHT_NS: u64 = 1_000_000_000;

/// So many frame numbers are listed, for looking at what happened.
const NUMBERS: usize = 100;

impl Frames {
    /// What was seen, with losses told apart by whether they are promised not to happen.
    pub fn new(sight: &Sight, missing: &[Missing], done: &[Done]) -> Self {
        let tally = &sight.tally;
        let order = tally.order();
        let first = |numbers: &[u64]| numbers[..numbers.len().min(NUMBERS)].to_vec();
        let excused = |t_ns: u64, by: &dyn Fn(&Done) -> bool| {
            done.iter().filter(|done| by(done)).any(|done| {
                let felt_ns = done.fresh_world_ms.map(|ms| (ms * 1e6) as u64);
                let until_ns = felt_ns.map_or(u64::MAX, |ns| done.t_ns + ns + IN_FLIGHT_NS);
                (done.t_ns.saturating_sub(IN_FLIGHT_NS)..=until_ns).contains(&t_ns)
            })
        };
        let mut frames = Self {
            captured: tally.frames_captured(),
            captured_again: tally.frames_captured_again(),
            world: order.received(),
            duplicates: order.duplicates().len() as u64,
            duplicate_numbers: first(order.duplicates()),
            out_of_order: order.out_of_order().len() as u64,
            out_of_order_numbers: first(order.out_of_order()),
            overlooked: tally.overlooked(),
            slow_reader: SlowReader {
                received: sight.napper.received(),
                duplicates: sight.napper.duplicates().len() as u64,
                out_of_order: sight.napper.out_of_order().len() as u64,
                lost: sight.napper.skipped().saturating_sub(order.skipped()),
            },
            ..Self::default()
        };
        for missing in missing {
            if excused(missing.t_capture_ns, &|done| !done.lossless) {
                frames.missing_unpromised += 1;
            } else {
                frames.missing += 1;
                if frames.missing_numbers.len() < NUMBERS {
                    frames.missing_numbers.push(missing.seq);
                }
            }
        }
        for gap in tally.gaps() {
            if excused(gap.until_ns, &|done| done.stage == Some(ProcessKind::Grabber)) {
                frames.never_captured_unpromised += gap.frames;
            } else {
                frames.never_captured += gap.frames;
            }
        }
        frames
    }
}

impl Times {
    /// Of times in milliseconds; `None` when there are none.
    pub fn of(times_ms: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut times: Vec<f64> = times_ms.into_iter().collect();
        times.sort_by(f64::total_cmp);
        let max = *times.last()?;
        // The smallest time that so many are not above.
        let at = |share: f64| {
            let rank = (share * times.len() as f64).ceil() as usize;
            times[rank.clamp(1, times.len()) - 1]
        };
        Some(Self { count: times.len(), median: at(0.5), p90: at(0.9), p99: at(0.99), max })
    }
}

/// Nanoseconds to milliseconds, to the microsecond.
pub fn ms(ns: u64) -> f64 {
    (ns as f64 / 1000.0).round() / 1000.0
}

fn one_name<S: Serializer>(kind: &ProcessKind, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(kind.name())
}

fn name<S: Serializer>(kind: &Option<ProcessKind>, serializer: S) -> Result<S::Ok, S::Error> {
    kind.map(ProcessKind::name).serialize(serializer)
}

fn names<S: Serializer>(kinds: &[ProcessKind], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(kinds.iter().map(|kind| kind.name()))
}

#[cfg(test)]
pub mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    /// A disturbance at `t_s` seconds that was felt for 100 ms.
    pub fn done(t_s: u64, what: Disturbance, stage: Option<ProcessKind>, lossless: bool) -> Done {
        Done {
            t_ns: t_s * S,
            t_s: t_s as f64,
            what,
            stage,
            pid: 1,
            pause_ms: None,
            waited_ms: 0.0,
            lossless,
            next_world_ms: Some(50.0),
            fresh_world_ms: Some(100.0),
            protected_ms: None,
        }
    }

    fn missing(t_s: &[u64]) -> Vec<Missing> {
        t_s.iter().map(|&t_s| Missing { seq: t_s, t_capture_ns: t_s * S }).collect()
    }

    #[test]
    fn losses_are_excused_only_around_what_promises_nothing() {
        let history = [
            done(10, Disturbance::Kill, Some(ProcessKind::Filter), true),
            done(20, Disturbance::Double, Some(ProcessKind::Tracker), false),
        ];
        let frames = Frames::new(&Sight::default(), &missing(&[10, 20, 21, 25]), &history);
        assert_eq!((frames.missing, frames.missing_unpromised), (2, 2));
        assert_eq!(frames.missing_numbers, [10, 25]);
    }

    #[test]
    fn an_outage_that_never_ended_excuses_everything_after_it() {
        let mut history = [done(20, Disturbance::Double, Some(ProcessKind::Tracker), false)];
        history[0].fresh_world_ms = None;
        let frames = Frames::new(&Sight::default(), &missing(&[10, 500]), &history);
        assert_eq!((frames.missing, frames.missing_unpromised), (1, 1));
    }

    #[test]
    fn gaps_are_excused_only_by_the_grabber() {
        let mut sight = Sight::default();
        for (seq, t_s) in [(0, 9), (5, 10), (8, 20)] {
            sight.tally.captured(seq, t_s * S);
        }
        let history = [
            done(10, Disturbance::Kill, Some(ProcessKind::Grabber), false),
            done(20, Disturbance::Double, Some(ProcessKind::Tracker), false),
        ];
        let frames = Frames::new(&sight, &[], &history);
        assert_eq!((frames.never_captured, frames.never_captured_unpromised), (2, 4));
    }

    #[test]
    fn percentiles_are_times_that_happened() {
        let times = Times::of((1..=200).rev().map(f64::from)).unwrap();
        assert_eq!((times.count, times.median, times.p90), (200, 100.0, 180.0));
        assert_eq!((times.p99, times.max), (198.0, 200.0));
        let one = Times::of([3.0]).unwrap();
        assert_eq!((one.median, one.p99, one.max), (3.0, 3.0, 3.0));
        assert_eq!(Times::of([]), None);
    }
}
