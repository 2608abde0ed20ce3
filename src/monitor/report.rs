//! The report about a run, finished or in progress. The same document is written by `--report`,
//! printed by `touchline status --json` and drawn by the console.

use super::publisher::Published;
use super::view::{Configured, Event};
use crate::top_scale::Scale;
use hdrhistogram::Histogram;
use messages::LightCorrection;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The report. Counters cover the whole run.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Report {
    /// Version of the program.
    pub version: String,
    /// Name of the group.
    pub instance: String,
    /// Source of the frames.
    pub source: String,
    /// Picture size and rate, as configured.
    pub camera: Camera,
    /// Time the group has been running.
    pub elapsed_s: f64,
    /// Process id of the supervisor.
    pub supervisor_pid: u32,
    /// Whether every stage is working.
    pub complete: bool,
    /// Parts that the group lacks at the moment, one line each: stages that fail again and again, and
    /// calls that the system refuses. All are retried.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub degraded: Vec<String>,
    /// The configuration, with the changes so far.
    #[serde(default)]
    pub configuration: Configured,
    /// Frames, end to end.
    pub frames: Frames,
    /// Frames a second over the last second, captured and arrived in `world`.
    pub rate: Rate,
    /// From the middle of the exposure until a stage's output is published, in microseconds.
    pub latency_us: Latency,
    /// Resources that the whole group uses.
    pub resources: Resources,
    /// The stages, by name.
    pub stages: BTreeMap<String, Stage>,
    /// Objects found in the newest frame.
    pub found: Found,
    /// Light correction by the classifier; absent before its first report.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light: Option<Light>,
    /// What is wrong with the pictures by their looks, while no robot is identified in them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pictures: Option<String>,
    /// Measured size of the robots' tops relative to the configured layout; absent until some have
    /// been measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tops: Option<Tops>,
    /// Rejected candidates, by reason.
    pub rejected: BTreeMap<String, u64>,
    /// Errors against the truth; absent without a synthetic match.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accuracy: Option<Accuracy>,
    /// Attendants of the group, by name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub attendants: BTreeMap<String, AttendantState>,
    /// The gateway; absent if only the owner may attach.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gateway: Option<Gateway>,
    /// The publisher; absent if nothing is to be published.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub publisher: Option<Published>,
    /// Senders of commands, with the robots that they command at the moment.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub commanders: Vec<Commander>,
    /// Foreign programs that have published on protected topics.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub strangers: Vec<Stranger>,
    /// The last hundred observations and actions of the supervisor, oldest first.
    pub events: Vec<Event>,
}

/// The camera as configured, and its state.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Camera {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Frames a second.
    pub fps: f64,
    /// State of a real camera; absent with other sources.
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
    /// Model, format and transfer method.
    pub description: String,
    /// The problem and its remedy; empty if there is none.
    pub problem: String,
    /// Frames a second promised by the camera or its driver; 0 when unknown.
    pub promised_fps: f64,
    /// Frames a second received; 0 when not measured yet.
    pub delivered_fps: f64,
    /// Frames dropped because parts of them were missing or damaged.
    pub incomplete: u64,
    /// Frames that were captured but never received.
    pub lost: u64,
    /// Number of starts; more than one means that it was away.
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
    /// Frame numbers missing between the first and the last frame: while there was no grabber, and
    /// those it dropped.
    pub never_captured: u64,
    /// Frame numbers missed while the monitor was away: frozen, overtaken, or unable to connect to
    /// a new grabber.
    pub not_seen: u64,
    /// Arrived in `world`.
    pub world: u64,
    /// Captured, but not in `world`.
    pub missing_in_world: u64,
    /// Captured, but possibly in a `world` missed while the monitor was away.
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

/// Resources that the whole group uses.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Resources {
    /// Processor time that supervisor and monitor have used.
    pub supervisor_cpu_seconds: f64,
    /// Their share of one processor over the last second.
    pub supervisor_cpu_percent: f64,
    /// Share of one processor over the last second, for all processes except the grabber.
    pub pipeline_cpu_percent: f64,
    /// Memory of all processes together, shared memory counted once; measured every thirty seconds.
    pub memory_bytes: u64,
}

/// Latency from the middle of the exposure to a stage's output.
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
    /// Time of each step, along the way of a frame.
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
    /// Median.
    pub p50: f64,
    /// 90th percentile.
    pub p90: f64,
    /// 99th percentile.
    pub p99: f64,
    /// The largest.
    pub max: f64,
}

impl Percentiles {
    /// Percentiles in microseconds of a histogram in nanoseconds.
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
    /// Inputs dropped, by reason.
    pub dropped: BTreeMap<String, u64>,
    /// Number of its processes that have ended and were replaced.
    pub restarts: u64,
    /// Processor time used, by all its processes.
    pub cpu_seconds: f64,
    /// Share of one processor over the last second.
    pub cpu_percent: f64,
    /// Memory in use now (at the end of a run: at the last measurement), shared memory included.
    pub rss_bytes: u64,
    /// Its processes.
    pub processes: Vec<Process>,
}

/// One process.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Process {
    /// Its process id.
    pub pid: u32,
    /// `starting`, `spare`, `active`, `waiting` (for its camera) or `finished`.
    pub state: String,
}

/// An attendant: a process that serves people or programs, and that no stage needs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct AttendantState {
    /// Its process id; absent while it does not run.
    pub pid: Option<u32>,
    /// Number of restarts.
    pub restarts: u64,
}

/// The gateway, through which other users attach. Counters start with its process.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Gateway {
    /// Group of users that may attach.
    pub group: String,
    /// Path of its socket.
    pub socket: String,
    /// Its process id; absent while it does not run.
    pub pid: Option<u32>,
    /// Number of restarts.
    pub restarts: u64,
    /// Programs that are attached.
    pub clients: u32,
    /// Messages delivered to them.
    pub given: u64,
    /// Messages that a client lost because it was too slow.
    pub lost: u64,
    /// Client messages that were invalid, impossible or not permitted.
    pub refused: u64,
    /// Client messages with commands for a team that the user may not command.
    pub not_permitted: u64,
}

/// A sender of commands. If several command a robot, it obeys the command sent last.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Commander {
    /// Process id of the publisher.
    pub pid: u32,
    /// Its name in the group; `grabber` plays both teams of the synthetic match.
    pub name: String,
    /// User id of the sender behind the gateway.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub user: Option<u32>,
    /// Robots that obey it: team and number.
    pub robots: Vec<String>,
    /// Robots that it commands too, but that obey a later command of another sender.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub overruled: Vec<String>,
    /// Its messages so far.
    pub messages: u64,
    /// It publishes faster than its commands can be used; the rest is dropped.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub floods: bool,
}

/// A foreign program that publishes on a protected topic.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Stranger {
    /// Its process id.
    pub pid: u32,
    /// Its name in the group; empty when unknown.
    pub name: String,
    /// Name of its executable; empty when it is gone.
    pub program: String,
    /// The topic.
    pub topic: String,
    /// Its messages, all ignored.
    pub messages: u64,
}

impl Stranger {
    /// Its known names, in parentheses.
    pub fn full_name(&self) -> String {
        match (self.name.as_str(), self.program.as_str()) {
            ("", "") => "(gone)".into(),
            (name, "") => format!("({name})"),
            ("", program) => format!("(program {program})"),
            (name, program) => format!("({name}, program {program})"),
        }
    }
}

/// Objects found in the newest frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Found {
    /// Identified robots in the newest detections.
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

/// Measured size of the robots' tops.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Tops {
    /// Measured size relative to the configured size.
    pub scale: f64,
    /// Pairs of patches measured, each in every frame.
    pub votes: u64,
    /// The problem and its remedy; empty when the size is right.
    pub problem: String,
}

impl From<Scale> for Tops {
    fn from(measured: Scale) -> Self {
        let problem = if measured.is_off() { measured.advice() } else { String::new() };
        let scale = (measured.scale * 1000.0).round() / 1000.0;
        Self { scale, votes: measured.votes, problem }
    }
}

/// Light correction in the newest frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Light {
    /// Whether it is active: `light.follow` is on, and there is a `light.pitch_rgb`.
    pub followed: bool,
    /// Gains of red, green and blue; 1 is as the colours were set.
    pub gains: [f64; 3],
    /// Smallest and largest local gain on the pitch, common to all three.
    pub zones: [f64; 2],
    /// Whether a gain is at its limit: more may be needed.
    pub at_bound: bool,
    /// Whether enough of the pitch is seen to measure the light; otherwise nothing is corrected.
    pub pitch_seen: bool,
    /// Whether glare is removed.
    pub glare: bool,
    /// Changes of the gains since this classifier started.
    pub changes: u64,
}

impl From<&LightCorrection> for Light {
    fn from(light: &LightCorrection) -> Self {
        // JSON has no non-finite numbers.
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
    /// Errors of the tracker's detections.
    pub detections: Errors,
    /// Errors of the filter's world, at capture time.
    pub world: Errors,
    /// Errors in it of robots of which only the team is known; absent if there was none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unknown: Option<UnknownErrors>,
}

/// Errors of robots of which only the team is known.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct UnknownErrors {
    /// Share of the visible ones that were tracked.
    pub followed_ratio: f64,
    /// Tracks without a robot, counted in each frame.
    pub ghosts: u64,
    /// Number of times a robot's track number changed.
    pub switches: u64,
    /// RMS distance of the team patch, which defines the position.
    pub patch_rms_mm: f64,
    /// 99th percentile of the distance.
    pub patch_p99_mm: f64,
}

/// Errors of poses.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Errors {
    /// Share of the visible robots that were found under their right identity.
    pub found_ratio: f64,
    /// Robots reported in place of another one, or of none.
    pub wrong_identity: u64,
    /// RMS distance.
    pub position_rms_mm: f64,
    /// 99th percentile of the distance.
    pub position_p99_mm: f64,
    /// RMS difference in heading.
    pub heading_rms_deg: f64,
    /// 99th percentile of the difference.
    pub heading_p99_deg: f64,
    /// Errors of robots that have been standing still for half a second.
    pub standing: StandingErrors,
    /// Share of the frames with a visible ball in which it was found.
    pub ball_found_ratio: f64,
    /// RMS distance.
    pub ball_rms_mm: f64,
}

/// Errors of robots standing still.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct StandingErrors {
    /// Number of poses.
    pub samples: u64,
    /// RMS distance.
    pub position_rms_mm: f64,
    /// 99th percentile of the distance.
    pub position_p99_mm: f64,
    /// Largest distance.
    pub position_max_mm: f64,
    /// RMS difference in heading.
    pub heading_rms_deg: f64,
    /// 99th percentile of the difference.
    pub heading_p99_deg: f64,
    /// Largest difference in heading.
    pub heading_max_deg: f64,
}
