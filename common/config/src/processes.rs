//! Process configuration: supervisor, wake-up and scheduling.

use messages::ProcessKind;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A stage that can have a spare. The grabber cannot, since a camera can be opened by one process only.
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
    /// A stage that has input but gives no output for this many frame periods is replaced …
    #[schemars(range(min = 1, max = 10_000))]
    pub stall_frames: f64,
    /// … but not before this time has passed.
    #[schemars(range(min = 1, max = 600_000))]
    pub stall_min_ms: f64,
    /// Time from its start within which a process must report ready.
    #[schemars(range(min = 10, max = 600_000))]
    pub ready_timeout_ms: f64,
    /// Pause before the second start in a row that failed; doubles with each further failure.
    #[schemars(range(min = 0, max = 600_000))]
    pub backoff_ms: f64,
    /// Longest pause.
    #[schemars(range(min = 0, max = 600_000))]
    pub backoff_max_ms: f64,
    /// Stages with a spare: a second process, connected but idle, that takes over as soon as the first
    /// one is gone, without losing a frame. Any of "classifier", "tracker" and "filter".
    #[schemars(length(max = 3))]
    pub spares: Vec<SpareStage>,
    /// Time for which stages keep the match running when their supervisor is gone; then they end.
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

/// How stages wait for their input, and how the system schedules them. Options that the system does not
/// permit are left out with a warning.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SchedulingConfig {
    /// "event": a stage sleeps until it is woken. "predictive": it sleeps until shortly before the next
    /// input is expected, and then polls without sleeping. "spin": it never sleeps, and takes a
    /// processor per stage all the time.
    pub wake_up: WakeUpStrategy,
    /// Real-time priority of the stages (SCHED_FIFO), 1–98; 0 for none.
    #[schemars(range(max = 98))]
    pub realtime_priority: u8,
    /// Keep the stages' memory from being paged out, and allocate it before the first frame.
    pub lock_memory: bool,
    /// Keep idle processors from sleeping, since waking up takes time. Costs power and heat: for the
    /// match, not for the night.
    pub keep_awake: bool,
    /// Processors the stages may run on.
    pub cpus: StageCpus,
}

/// Processors the stages may run on, by number; an empty list for all.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct StageCpus {
    /// Processors of the grabber.
    #[schemars(length(max = 1024), inner(range(max = 1023)))]
    pub grabber: Vec<u16>,
    /// Processors of the classifier and its spare.
    #[schemars(length(max = 1024), inner(range(max = 1023)))]
    pub classifier: Vec<u16>,
    /// Processors of the tracker and its spare.
    #[schemars(length(max = 1024), inner(range(max = 1023)))]
    pub tracker: Vec<u16>,
    /// Processors of the filter and its spare.
    #[schemars(length(max = 1024), inner(range(max = 1023)))]
    pub filter: Vec<u16>,
}

impl StageCpus {
    /// Processors of a stage.
    pub fn of(&self, kind: ProcessKind) -> &[u16] {
        match kind {
            ProcessKind::Grabber => &self.grabber,
            ProcessKind::Classifier => &self.classifier,
            ProcessKind::Tracker => &self.tracker,
            ProcessKind::Filter => &self.filter,
        }
    }
}
