//! The report: what a run was like, or is like so far. The same document is written by `--report`,
//! printed by `touchline status --json` and drawn by the console.

use super::view::Event;
use common::messages::LightCorrection;
use common::top_scale::Scale;
use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What a run was like. Counters cover the whole run.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Report {
    /// Version of the program.
    pub version: String,
    /// Name of the group.
    pub instance: String,
    /// Where frames come from.
    pub source: String,
    /// Picture size and rate, as configured.
    pub camera: Camera,
    /// How long the group has been running.
    pub elapsed_s: f64,
    /// Number of the supervisor's process.
    pub supervisor_pid: u32,
    /// Whether every stage is working.
    pub complete: bool,
    /// What the group does without at the moment, in a line each: stages that fail again and again, and
    /// what the system refuses. It is tried again all the time.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub degraded: Vec<String>,
    /// Frames, end to end.
    pub frames: Frames,
    /// Frames a second over the last second, captured and arrived in `world`.
    pub rate: Rate,
    /// From the middle of the exposure until a stage's output is published, in microseconds.
    pub latency_us: Latency,
    /// What the whole group takes of the machine.
    pub resources: Resources,
    /// Stage by stage.
    pub stages: BTreeMap<String, Stage>,
    /// What was found in the newest frame.
    pub found: Found,
    /// How the classifier corrects the light; absent before its first word.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light: Option<Light>,
    /// How large robots' tops are against the configured layout; absent until some have been measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tops: Option<Tops>,
    /// How often candidates were rejected, by reason.
    pub rejected: BTreeMap<String, u64>,
    /// Errors against the truth; absent where nobody knows it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accuracy: Option<Accuracy>,
    /// Processes that serve people and programs, by name: which of them the group has.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub attendants: BTreeMap<String, AttendantState>,
    /// The gateway; absent where nobody but the owner may attach.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gateway: Option<Gateway>,
    /// Senders of commands, with the robots that they command at the moment.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub commanders: Vec<Commander>,
    /// Programs that have published on topics on which only processes of the group are believed.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub strangers: Vec<Stranger>,
    /// What the supervisor noticed and did, oldest first; the last hundred.
    pub events: Vec<Event>,
}

/// The camera as configured, and as it is.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Camera {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Frames a second.
    pub fps: f64,
    /// How it is; absent with sources that are always there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<CameraDevice>,
}

/// A real camera, as the grabber sees it. Counters start with the grabber.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct CameraDevice {
    /// `opening`, `streaming`, `slow`, or what keeps it from streaming: `missing`, `no_rights`,
    /// `busy`, `wrong_format`, `wrong_setting`, `hung`, `no_library`, `failed`.
    pub state: String,
    /// Model, format and way of transfer.
    pub description: String,
    /// What is wrong, and what to do about it; empty when nothing is.
    pub problem: String,
    /// Frames a second as the camera or its driver promises; 0 when unknown.
    pub promised_fps: f64,
    /// Frames a second that have come; 0 when not measured yet.
    pub delivered_fps: f64,
    /// Frames dropped because parts of them were missing or damaged.
    pub incomplete: u64,
    /// Frames that were captured, but of which nothing has come.
    pub lost: u64,
    /// How often it was started; more than once means that it was away.
    pub starts: u64,
}

/// Frames, end to end, counted by an independent subscriber.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Frames {
    /// Published by the grabber.
    pub captured: u64,
    /// Skipped by the grabber because it was late or had no memory.
    pub dropped_by_grabber: u64,
    /// Numbers between the first and the last frame that nobody captured: while there was no
    /// grabber, and those it dropped.
    pub never_captured: u64,
    /// Numbers of which nothing is known, because the monitor itself was away: frozen, overtaken, or
    /// without the means to connect to a new grabber.
    pub not_seen: u64,
    /// Arrived in `world`.
    pub world: u64,
    /// Captured, but not in `world`.
    pub missing_in_world: u64,
    /// Captured, but whether they are in `world` is not known, because the monitor was away.
    pub not_seen_in_world: u64,
    /// In `world` more than once, or out of order.
    pub duplicates_in_world: u64,
}

/// Frames a second.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Rate {
    /// Published by the grabber.
    pub captured: f64,
    /// Arrived in `world`.
    pub world: f64,
}

/// What the whole group takes of the machine.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Resources {
    /// Processor time that supervisor and monitor have used.
    pub supervisor_cpu_seconds: f64,
    /// Their share of one processor over the last second.
    pub supervisor_cpu_percent: f64,
    /// Share of one processor over the last second, of all processes but the grabber.
    pub pipeline_cpu_percent: f64,
    /// Memory of all processes together, shared memory counted once; looked at every ten seconds.
    pub memory_bytes: u64,
}

/// From the middle of the exposure to a stage's output.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Latency {
    /// To the frame itself being published.
    pub capture_to_frame: Percentiles,
    /// To the runs.
    pub capture_to_runs: Percentiles,
    /// To the detections.
    pub capture_to_detections: Percentiles,
    /// To the world.
    pub capture_to_world: Percentiles,
    /// Where that time goes: each stage's share, along the way of a frame.
    pub breakdown: Breakdown,
}

/// The way of a frame from capture to `world`, cut into pieces.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Breakdown {
    /// From the middle of the exposure until the grabber hands the frame on.
    pub grabber: Percentiles,
    /// Until the classifier has it: publishing, waking up, taking over.
    pub way_to_classifier: Percentiles,
    /// Until the classifier hands the runs on.
    pub classifier: Percentiles,
    /// Until the tracker has them.
    pub way_to_tracker: Percentiles,
    /// Until the tracker hands the detections on.
    pub tracker: Percentiles,
    /// Until the filter has them.
    pub way_to_filter: Percentiles,
    /// Until the filter hands the world on.
    pub filter: Percentiles,
}

/// A distribution.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Percentiles {
    /// Half of all values are below.
    pub p50: f64,
    /// Nine of ten are below.
    pub p90: f64,
    /// Ninety-nine of a hundred are below.
    pub p99: f64,
    /// The largest.
    pub max: f64,
}

impl Percentiles {
    /// Of a histogram in nanoseconds, in microseconds.
    pub fn of_ns(histogram: &Histogram<u64>) -> Self {
        let at = |quantile| histogram.value_at_quantile(quantile) as f64 / 1000.0;
        if histogram.is_empty() {
            return Self::default();
        }
        Self { p50: at(0.5), p90: at(0.9), p99: at(0.99), max: histogram.max() as f64 / 1000.0 }
    }
}

/// One stage, all its processes taken together.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Stage {
    /// Inputs taken. Counters of a process that was killed may lack its last tenth of a second.
    pub frames_in: u64,
    /// Outputs given.
    pub frames_out: u64,
    /// Numbers missing in its input.
    pub frames_missed: u64,
    /// Inputs not worked on, by reason.
    pub dropped: BTreeMap<String, u64>,
    /// How often a process of the stage has ended and was replaced.
    pub restarts: u64,
    /// Processor time used, by all its processes.
    pub cpu_seconds: f64,
    /// Share of one processor over the last second.
    pub cpu_percent: f64,
    /// Memory in use now (at the end of a run: when last looked at), shared memory included.
    pub rss_bytes: u64,
    /// Its processes.
    pub processes: Vec<Process>,
}

/// One process.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Process {
    /// The system's number for it.
    pub pid: u32,
    /// `starting`, `spare`, `active`, `waiting` (for its camera) or `finished`.
    pub state: String,
}

/// A process that serves people or programs, and that no stage needs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct AttendantState {
    /// The system's number for its process; absent while there is none.
    pub pid: Option<u32>,
    /// How often it was started again.
    pub restarts: u64,
}

/// What lets other users attach. Counters start with its process.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Gateway {
    /// Whose users may attach.
    pub group: String,
    /// Where.
    pub socket: String,
    /// The system's number for its process; absent while there is none.
    pub pid: Option<u32>,
    /// How often it was started again.
    pub restarts: u64,
    /// Programs that are attached.
    pub clients: u32,
    /// Messages given to them.
    pub given: u64,
    /// Messages that one of them lost because it was too slow.
    pub lost: u64,
    /// Messages of theirs that were no commands, impossible ones, or not permitted.
    pub refused: u64,
    /// Messages of theirs with commands for a team that their user may not command.
    pub not_permitted: u64,
}

/// A sender of commands. Of several for a robot, the one whose command was sent last is obeyed.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Commander {
    /// The system's number for the process that has published them.
    pub pid: u32,
    /// The name under which that has joined the group; `grabber` plays both teams of the synthetic match.
    pub name: String,
    /// The system's number for the user that sent them through the gateway.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub user: Option<u32>,
    /// Robots that obey it: team and number.
    pub robots: Vec<String>,
    /// Robots that it commands too, but that obey a later command of another sender.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub overruled: Vec<String>,
    /// Its messages so far.
    pub messages: u64,
}

/// A program that is none of the group's, on a topic on which only those are believed.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Stranger {
    /// The system's number for it.
    pub pid: u32,
    /// The name under which it has joined the group; empty when that cannot be known any more.
    pub name: String,
    /// The program that the process runs, as the system calls it; empty when it is gone.
    pub program: String,
    /// The topic.
    pub topic: String,
    /// Its messages, none of which was believed.
    pub messages: u64,
}

impl Stranger {
    /// What is known of its names, in parentheses.
    pub fn full_name(&self) -> String {
        match (self.name.as_str(), self.program.as_str()) {
            ("", "") => "(gone)".into(),
            (name, "") => format!("({name})"),
            ("", program) => format!("(program {program})"),
            (name, program) => format!("({name}, program {program})"),
        }
    }
}

/// What was found in the newest frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Found {
    /// Robots in the newest detections of which it is known who they are.
    pub robots: u32,
    /// Robots configured.
    pub robots_configured: u32,
    /// Robots in the newest `world` of which only the team is known.
    pub unknown_robots: u32,
    /// Whether there was a ball.
    pub ball: bool,
    /// Regions.
    pub regions: u32,
}

/// How large robots' tops are.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Tops {
    /// How many times as large as configured.
    pub scale: f64,
    /// Pairs of patches that say so, each in every frame.
    pub votes: u64,
    /// What is wrong and what to do; empty when the size is right.
    pub problem: String,
}

impl From<Scale> for Tops {
    fn from(measured: Scale) -> Self {
        let problem = if measured.is_off() { measured.advice() } else { String::new() };
        let scale = (measured.scale * 1000.0).round() / 1000.0;
        Self { scale, votes: measured.votes, problem }
    }
}

/// How the classifier corrects the light of the newest frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Light {
    /// Whether it does: `light.follow` is on, and there is a `light.pitch_rgb`.
    pub followed: bool,
    /// What red, green and blue are multiplied with; 1 is as the colours were set.
    pub gains: [f64; 3],
    /// What all three are multiplied with besides, where on the pitch that is least and where it is most.
    pub zones: [f64; 2],
    /// Whether a gain is as far from 1 as it may be: more may be needed.
    pub at_bound: bool,
    /// Whether enough of the pitch is seen to tell the light; if not, nothing is corrected.
    pub pitch_seen: bool,
    /// Whether glare is taken off.
    pub glare: bool,
    /// How often the gains have changed since this classifier began.
    pub changes: u64,
}

impl From<&LightCorrection> for Light {
    fn from(light: &LightCorrection) -> Self {
        // JSON has no word for what is no number.
        let number = |factor: f32| match factor.is_finite() {
            true => (f64::from(factor) * 1000.0).round() / 1000.0,
            false => 0.0,
        };
        Self {
            followed: light.has(LightCorrection::FOLLOWED),
            gains: light.gains.map(number),
            zones: light.zones.map(number),
            at_bound: light.has(LightCorrection::AT_BOUND),
            pitch_seen: !light.has(LightCorrection::PITCH_UNSEEN),
            glare: light.has(LightCorrection::GLARE),
            changes: light.changes,
        }
    }
}

/// Errors against the truth, raw and filtered.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Accuracy {
    /// Of the tracker's detections.
    pub detections: Errors,
    /// Of the filter's world, at capture time.
    pub world: Errors,
    /// Of robots in it of which only the team is known; absent when there was none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unknown: Option<UnknownErrors>,
}

/// Errors of robots of which only the team is known.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct UnknownErrors {
    /// Share of those visible that were followed.
    pub followed_ratio: f64,
    /// Tracks where nobody is, counted in each frame.
    pub ghosts: u64,
    /// How often a robot was followed under another number than before.
    pub switches: u64,
    /// Root of the mean squared distance of the team patch, of which the position is.
    pub patch_rms_mm: f64,
    /// Ninety-nine of a hundred distances are below.
    pub patch_p99_mm: f64,
}

/// Errors of poses.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Errors {
    /// Share of the visible robots that were found under their right identity.
    pub found_ratio: f64,
    /// Robots reported where another one is, or none.
    pub wrong_identity: u64,
    /// Root of the mean squared distance.
    pub position_rms_mm: f64,
    /// Ninety-nine of a hundred distances are below.
    pub position_p99_mm: f64,
    /// Root of the mean squared difference in heading.
    pub heading_rms_deg: f64,
    /// Ninety-nine of a hundred differences are below.
    pub heading_p99_deg: f64,
    /// The same for robots that have been standing still for half a second.
    pub standing: StandingErrors,
    /// Share of the frames with a visible ball in which it was found.
    pub ball_found_ratio: f64,
    /// Root of the mean squared distance.
    pub ball_rms_mm: f64,
}

/// Errors of robots standing still.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct StandingErrors {
    /// How many poses this is about.
    pub samples: u64,
    /// Root of the mean squared distance.
    pub position_rms_mm: f64,
    /// Ninety-nine of a hundred distances are below.
    pub position_p99_mm: f64,
    /// Largest distance.
    pub position_max_mm: f64,
    /// Root of the mean squared difference in heading.
    pub heading_rms_deg: f64,
    /// Ninety-nine of a hundred differences are below.
    pub heading_p99_deg: f64,
    /// Largest difference in heading.
    pub heading_max_deg: f64,
}
