//! The random sequence of disturbances: what, to which stage and when; a seed repeats it exactly.

use clap::ValueEnum;
use messages::ProcessKind;
use serde::Serialize;
use std::time::Duration;

/// Ways to disturb a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Disturbance {
    /// Kill a stage's active process (SIGKILL)
    Kill,
    /// Freeze it for good (SIGSTOP); the watchdog has to notice
    Stop,
    /// Freeze it for 5 to 500 ms (SIGSTOP, then SIGCONT)
    Pause,
    /// Make it panic (SIGUSR2)
    Panic,
    /// Ask the supervisor to replace it, as `touchline restart` does
    Restart,
    /// Go over to another configuration, with other class numbers, as `touchline reload` does
    Reload,
    /// Kill a stage and its spare at once; frames may be lost, and are counted
    Double,
    /// Kill the supervisor and start a new one
    Supervisor,
    /// Tell the supervisor that its terminal is gone (SIGHUP)
    Hup,
    /// Leave the supervisor no descriptor to open for 20 ms to 2 s
    Emfile,
    /// Leave no byte of shared memory for 20 ms to 2 s, in a /dev/shm of the match's own
    Enospc,
    /// A program publishes rubbish on all topics of the stages, 80 times a second for 20 ms to 2 s
    Rubbish,
    /// Another user takes names in shared memory and tries to open, truncate and remove what is the match's,
    /// for 20 ms to 2 s; needs root, and a /dev/shm of the match's own
    Outsider,
}

impl Disturbance {
    /// The name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Kill => "kill",
            Self::Stop => "stop",
            Self::Pause => "pause",
            Self::Panic => "panic",
            Self::Restart => "restart",
            Self::Reload => "reload",
            Self::Double => "double",
            Self::Supervisor => "supervisor",
            Self::Hup => "hup",
            Self::Emfile => "emfile",
            Self::Enospc => "enospc",
            Self::Rubbish => "rubbish",
            Self::Outsider => "outsider",
        }
    }

    /// Whether its target is a process of a stage.
    pub fn concerns_a_stage(self) -> bool {
        !matches!(self, Self::Reload | Self::Supervisor | Self::Hup) && !self.is_long()
    }

    /// Whether it lasts so long that other disturbances are to happen meanwhile.
    fn is_long(self) -> bool {
        matches!(self, Self::Emfile | Self::Enospc | Self::Rubbish | Self::Outsider)
    }

    /// Whether it has a duration.
    pub fn lasts(self) -> bool {
        matches!(self, Self::Pause) || self.is_long()
    }
}

/// A planned disturbance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Step {
    /// Time since the start of the disturbances.
    pub at: Duration,
    /// The disturbance.
    pub what: Disturbance,
    /// Its stage; `None` if its target is not a stage.
    pub stage: Option<ProcessKind>,
    /// Its duration, if it has one.
    pub pause: Duration,
}

/// The sequence: endless, and the same for the same seed and settings.
#[derive(Debug, Clone)]
pub struct Plan {
    random: Random,
    every: Duration,
    kinds: Vec<Disturbance>,
    stages: Vec<ProcessKind>,
    count: u32,
}

/// Largest random delay of a disturbance, relative to the interval. Without it, 500 ms would be exactly
/// 40 frames at 80 a second, and every disturbance would happen at the same phase of a frame.
const JITTER: f64 = 0.25;
/// Duration of a pause: from unnoticeable to far beyond the stall deadline.
const PAUSE_MS: (f64, f64) = (5.0, 500.0);
/// Factor by which a shortage lasts longer than a pause, so that other disturbances happen meanwhile.
const SHORTAGE: u32 = 4;

impl Plan {
    /// Disturbances of these kinds to these stages, one per `every`. Neither list may be empty.
    pub fn new(
        seed: u64,
        every: Duration,
        kinds: Vec<Disturbance>,
        stages: Vec<ProcessKind>,
    ) -> Self {
        assert!(!kinds.is_empty() && !stages.is_empty(), "the command line requires both");
        Self { random: Random(seed), every, kinds, stages, count: 0 }
    }
}

impl Iterator for Plan {
    type Item = Step;

    fn next(&mut self) -> Option<Step> {
        // Always the same number of draws, so that adding a kind does not shift the rest of the
        // sequence.
        let (late, kind, stage, pause) =
            (self.random.unit(), self.random.unit(), self.random.unit(), self.random.unit());
        self.count = self.count.saturating_add(1);
        let what = pick(&self.kinds, kind);
        let (shortest, longest) = PAUSE_MS;
        let pause = Duration::from_secs_f64((shortest + (longest - shortest) * pause) / 1000.0);
        Some(Step {
            at: self.every.mul_f64(f64::from(self.count) + JITTER * late),
            what,
            stage: what.concerns_a_stage().then(|| pick(&self.stages, stage)),
            pause: if what.is_long() { pause * SHORTAGE } else { pause },
        })
    }
}

fn pick<T: Copy>(items: &[T], unit: f64) -> T {
    items[((unit * items.len() as f64) as usize).min(items.len() - 1)]
}

/// SplitMix64 (Steele, Lea and Flood 2014).
#[derive(Debug, Clone)]
struct Random(u64);

impl Random {
    /// Uniform in [0, 1).
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    const STAGES: [ProcessKind; 3] =
        [ProcessKind::Classifier, ProcessKind::Tracker, ProcessKind::Filter];

    fn steps(seed: u64, kinds: &[Disturbance]) -> Vec<Step> {
        let every = Duration::from_millis(500);
        Plan::new(seed, every, kinds.to_vec(), STAGES.to_vec()).take(200).collect()
    }

    #[test]
    fn a_seed_repeats_its_sequence_and_another_one_does_not() {
        let kinds = [Disturbance::Kill, Disturbance::Pause];
        assert_eq!(steps(1, &kinds), steps(1, &kinds));
        assert_ne!(steps(1, &kinds), steps(2, &kinds));
    }

    #[test]
    fn every_kind_comes_to_every_stage_in_time() {
        let kinds = [Disturbance::Kill, Disturbance::Stop, Disturbance::Pause];
        let steps = steps(7, &kinds);
        let met: BTreeSet<_> = steps.iter().map(|step| (step.what, step.stage)).collect();
        assert_eq!(met.len(), kinds.len() * STAGES.len());
        for (index, step) in steps.iter().enumerate() {
            let earliest = Duration::from_millis(500 * (index as u64 + 1));
            assert!((earliest..earliest + Duration::from_millis(125)).contains(&step.at));
            assert!((5..=500).contains(&step.pause.as_millis()));
        }
        let phases: BTreeSet<_> =
            steps.iter().map(|step| step.at.as_micros() % 12_500 / 1250).collect();
        assert_eq!(phases.len(), 10, "disturbances keep to one part of the frame period");
    }

    #[test]
    fn the_supervisor_is_no_stage() {
        let kinds = [Disturbance::Supervisor, Disturbance::Hup, Disturbance::Emfile];
        let steps = steps(1, &kinds);
        assert!(steps.iter().all(|step| step.stage.is_none()));
        let shortages = steps.iter().filter(|step| step.what == Disturbance::Emfile);
        assert!(
            shortages.map(|step| step.pause).all(|pause| (20..=2000).contains(&pause.as_millis()))
        );
    }
}
