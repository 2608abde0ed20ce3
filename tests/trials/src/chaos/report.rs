//! The report: disturbances, observations, and durations of outages.

use super::bystanders::Fate;
use super::leaks::{Leftovers, Usage};
use super::observer::Sight;
use super::outsider::Deeds;
use super::plan::Disturbance;
use super::tally::Missing;
use super::verdict::Promise;
use messages::ProcessKind;
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
    /// Settings of the run.
    pub settings: Settings,
    /// Whether it was interrupted.
    pub interrupted: bool,
    /// Frames, as the observer counted them.
    pub frames: Frames,
    /// Distributions of times by name, in milliseconds.
    pub times_ms: BTreeMap<String, Times>,
    /// The disturbances, in order.
    pub disturbances: Vec<Done>,
    /// Frames lost before the first disturbance: the machine does not keep up.
    pub lost_undisturbed: u64,
    /// Disturbances skipped because the stage had not recovered in time.
    pub left_out: u64,
    /// Reason for which the supervisor ended without a request, if it did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub supervisor_failure: Option<String>,
    /// Processes that ended without a disturbance.
    pub ended_by_themselves: Vec<Ended>,
    /// Processes that ended before they were ready, as the group counts them; 0 if a new supervisor has
    /// restarted the count.
    pub started_in_vain: u64,
    /// Counts of the bystanders, if there were any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bystanders: Option<Fate>,
    /// Counts of the outsiders, if there were any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outsider: Option<Deeds>,
    /// Longest time for which the observer did not poll.
    pub observer_longest_absence_ms: f64,
    /// Resources used before the first disturbance.
    pub usage_before: Usage,
    /// Resources used after the group had settled.
    pub usage_after: Usage,
    /// Resources left after its end.
    pub left: Leftovers,
    /// The group's own last report.
    pub group: Option<control::Report>,
    /// The supervisor's log: every event, with its evidence.
    pub group_log: Vec<String>,
}

/// Settings of the run.
#[derive(Debug, Clone, Serialize)]
pub struct Settings {
    /// Duration of the disturbances.
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
    /// Whether bystanders attach meanwhile.
    pub bystanders: bool,
    /// Seed of the sequence.
    pub seed: u64,
    /// Time with input and without output that counts as a stall.
    pub stall_deadline_ms: f64,
    /// Stages that keep a spare.
    #[serde(serialize_with = "names")]
    pub spares: Vec<ProcessKind>,
}

/// A disturbance that was carried out.
#[derive(Debug, Clone, Serialize)]
pub struct Done {
    /// On the monotonic clock.
    #[serde(skip)]
    pub t_ns: u64,
    /// Seconds since the start of the disturbances.
    pub t_s: f64,
    /// The disturbance.
    pub what: Disturbance,
    /// Its stage; absent if the target is the supervisor or the machine.
    #[serde(serialize_with = "name", skip_serializing_if = "Option::is_none")]
    pub stage: Option<ProcessKind>,
    /// The process id of its target.
    pub pid: u32,
    /// Its duration, if it has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pause_ms: Option<f64>,
    /// Delay because the stage had no spare yet.
    pub waited_ms: f64,
    /// Whether the group promises to lose no frame by it.
    pub lossless: bool,
    /// Time to the next `world`, of any frame.
    pub next_world_ms: Option<f64>,
    /// Time to the `world` of a frame captured after the disturbance.
    pub fresh_world_ms: Option<f64>,
    /// Time until the stage had a spare again.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub protected_ms: Option<f64>,
}

impl Done {
    /// The group of disturbances to whose times it belongs.
    pub fn label(&self) -> String {
        match self.what {
            Disturbance::Double => "double".into(),
            what if self.lossless => what.name().into(),
            what => format!("{} without a spare", what.name()),
        }
    }
}

/// A process that ended without a disturbance.
#[derive(Debug, Clone, Serialize)]
pub struct Ended {
    /// Its stage.
    #[serde(serialize_with = "one_name")]
    pub stage: ProcessKind,
    /// Its process id.
    pub pid: u32,
    /// Seconds since the start of the disturbances.
    pub t_s: f64,
}

/// Frames, as the observer counted them.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Frames {
    /// Frames on `frames`.
    pub captured: u64,
    /// Frames on `frames` whose number had come before.
    pub captured_again: u64,
    /// Frames in `world`.
    pub world: u64,
    /// Captured, but missing in `world` in spite of the promise.
    pub missing: u64,
    /// Captured, but missing in `world` around double faults and the like, where nothing is promised.
    pub missing_unpromised: u64,
    /// Numbers that were not captured although the grabber was undisturbed.
    pub never_captured: u64,
    /// Numbers that were not captured because the grabber itself was disturbed.
    pub never_captured_unpromised: u64,
    /// Frames that came more than once in `world`.
    pub duplicates: u64,
    /// Frames that came in `world` after a later one.
    pub out_of_order: u64,
    /// Frames that the observer may have overlooked because it was too slow.
    pub overlooked: u64,
    /// Another reader of `world`, which reads only at long intervals.
    pub slow_reader: SlowReader,
    /// Numbers of the `missing` frames; the first hundred.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub missing_numbers: Vec<u64>,
    /// Numbers of the `duplicates`; the first hundred.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub duplicate_numbers: Vec<u64>,
    /// Numbers of the `out_of_order` frames; the first hundred.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub out_of_order_numbers: Vec<u64>,
}

/// Counts of a reader of `world` that reads only at long intervals.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct SlowReader {
    /// Messages received.
    pub received: u64,
    /// Numbers that came again.
    pub duplicates: u64,
    /// Numbers that came after a higher one.
    pub out_of_order: u64,
    /// Numbers that the other reader received, and this one did not.
    pub lost: u64,
}

/// A distribution, in milliseconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Times {
    /// Number of values.
    pub count: usize,
    /// Half are below.
    pub median: f64,
    /// 90th percentile.
    pub p90: f64,
    /// 99th percentile.
    pub p99: f64,
    /// The longest.
    pub max: f64,
}

/// Window around an outage in which the loss of frames in flight is excused.
const IN_FLIGHT_NS: u64 = 1_000_000_000;

/// Most frame numbers listed.
const NUMBERS: usize = 100;

impl Frames {
    /// Counts of frames, with losses divided into promised and unpromised ones.
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
    /// The distribution of times in milliseconds; `None` without values.
    pub fn of(times_ms: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut times: Vec<f64> = times_ms.into_iter().collect();
        times.sort_by(f64::total_cmp);
        let max = *times.last()?;
        // The nearest-rank percentile.
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
    fn losses_are_excused_only_around_disturbances_without_a_promise() {
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
    fn percentiles_are_measured_values() {
        let times = Times::of((1..=200).rev().map(f64::from)).unwrap();
        assert_eq!((times.count, times.median, times.p90), (200, 100.0, 180.0));
        assert_eq!((times.p99, times.max), (198.0, 200.0));
        let one = Times::of([3.0]).unwrap();
        assert_eq!((one.median, one.p99, one.max), (3.0, 3.0, 3.0));
        assert_eq!(Times::of([]), None);
    }
}
