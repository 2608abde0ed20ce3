//! Keys of the process group: what the supervisor does, and how stages wait and are scheduled.

use crate::messages::ProcessKind;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A stage that can have a spare. The grabber cannot: a camera belongs to one process at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum SpareStage {
    /// Frames to runs.
    Classifier,
    /// Runs to detections.
    Tracker,
    /// Detections to world.
    Filter,
}

impl From<SpareStage> for ProcessKind {
    fn from(stage: SpareStage) -> Self {
        match stage {
            SpareStage::Classifier => Self::Classifier,
            SpareStage::Tracker => Self::Tracker,
            SpareStage::Filter => Self::Filter,
        }
    }
}

/// The process group.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SupervisorConfig {
    /// A stage that has input and gives no output for so many frame periods is replaced …
    #[schemars(range(min = 1, max = 10_000))]
    pub stall_frames: f64,
    /// … but never sooner than this.
    #[schemars(range(min = 1, max = 600_000))]
    pub stall_min_ms: f64,
    /// A process must report ready within this time of its start.
    #[schemars(range(min = 10, max = 600_000))]
    pub ready_timeout_ms: f64,
    /// Pause before the second start in a row that failed; doubles with each further one.
    #[schemars(range(min = 0, max = 600_000))]
    pub backoff_ms: f64,
    /// Longest pause.
    #[schemars(range(min = 0, max = 600_000))]
    pub backoff_max_ms: f64,
    /// Stages that keep a spare: a second process, connected but idle, that takes over the moment
    /// the first is gone, without losing a frame. Any of "classifier", "tracker" and "filter".
    #[schemars(length(max = 3))]
    pub spares: Vec<SpareStage>,
    /// Stages whose supervisor is gone keep the match running for so long and then end themselves.
    #[schemars(range(min = 0, max = 604_800))]
    pub orphan_timeout_s: f64,
}

/// How a stage waits for its input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum WakeUpStrategy {
    /// Sleeps until it is woken.
    Event,
    /// Never sleeps.
    Spin,
    /// Sleeps until shortly before the next input is expected.
    Predictive,
}

/// How stages wait for their input, and what the system does for them. What the system does not
/// permit is done without, with a warning.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SchedulingConfig {
    /// "event": a stage sleeps until it is woken. "predictive": it sleeps until shortly before the
    /// next input is expected, and then looks for it without sleeping. "spin": it never sleeps;
    /// takes a processor for each stage, all the time.
    pub wake_up: WakeUpStrategy,
    /// Real-time priority of the stages (SCHED_FIFO), 1–98; 0 for none.
    #[schemars(range(max = 98))]
    pub realtime_priority: u8,
    /// Keep the stages' memory from being paged out, and have it at hand before the first frame.
    pub lock_memory: bool,
    /// Keep idle processors from falling asleep, from which they need their time to wake up. Takes
    /// power and makes warm; for the match, not for the night.
    pub keep_awake: bool,
    /// Processors the stages may run on.
    pub cpus: StageCpus,
}

/// Processors the stages may run on, by number; an empty list for all.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct StageCpus {
    /// Of the grabber.
    #[schemars(length(max = 1024), inner(range(max = 1023)))]
    pub grabber: Vec<u16>,
    /// Of the classifier and its spare.
    #[schemars(length(max = 1024), inner(range(max = 1023)))]
    pub classifier: Vec<u16>,
    /// Of the tracker and its spare.
    #[schemars(length(max = 1024), inner(range(max = 1023)))]
    pub tracker: Vec<u16>,
    /// Of the filter and its spare.
    #[schemars(length(max = 1024), inner(range(max = 1023)))]
    pub filter: Vec<u16>,
}

impl StageCpus {
    /// Those of a stage.
    pub fn of(&self, kind: ProcessKind) -> &[u16] {
        match kind {
            ProcessKind::Grabber => &self.grabber,
            ProcessKind::Classifier => &self.classifier,
            ProcessKind::Tracker => &self.tracker,
            ProcessKind::Filter => &self.filter,
        }
    }
}
