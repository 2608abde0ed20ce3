//! The report about a run, finished or in progress. The same document is written by `run --report`,
//! printed by `touchline status --json` and drawn by terminal and console.

mod accuracy;
mod latency;
mod members;
mod pictures;
mod published;

use crate::{Configured, Event};
pub use accuracy::{Accuracy, Errors, StandingErrors, UnknownErrors};
pub use latency::{Breakdown, Latency, Percentiles};
pub use members::{AttendantState, Commander, Gateway, Process, Stage, Stranger};
pub use pictures::{Found, Light, Tops};
pub use published::{Published, PublishedProtocol};
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
