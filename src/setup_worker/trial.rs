//! What a changed configuration would find.

use super::SetupError;
use super::input::{assumed, frames};
use client::instance::Instance;
use config::Config;
use messages::{DetectionFrame, RejectReason, Rejected, Team};
use offline::chain::Chain;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::time::Duration;

/// Looks at frames of the group with a changed configuration.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Try {
    /// The changes.
    #[serde(default)]
    set: Map<String, Value>,
    /// Frames to look at.
    #[serde(default = "one")]
    frames: usize,
}

fn one() -> usize {
    1
}

/// What is found.
#[derive(Debug, Serialize)]
pub struct Tried {
    /// How often each robot is found in these frames.
    robots: Vec<Robot>,
    /// Frames with a ball, and frames in all.
    balls: usize,
    frames: usize,
    /// What is seen in the last of them.
    seen: Vec<Seen>,
    /// Team patches and balls rejected in the last of them.
    rejected: Vec<NotSeen>,
    /// Runs of the last frame: row, first column, column behind the last, class, and again.
    runs: Vec<u16>,
    /// Number of the last frame.
    seq: u64,
}

#[derive(Debug, Serialize)]
struct Robot {
    team: &'static str,
    identity: u32,
    found: usize,
}

#[derive(Debug, Serialize)]
struct Seen {
    team: &'static str,
    identity: Option<u32>,
    center_px: [f32; 2],
    pose_mm: [f32; 2],
    heading_deg: Option<f32>,
    confidence: f32,
}

#[derive(Debug, Serialize)]
struct NotSeen {
    team: &'static str,
    center_px: [f32; 2],
    reason: &'static str,
}

/// Looks.
pub fn attempt(request: &Try, instance: &Instance) -> Result<Tried, SetupError> {
    let config = assumed(instance, &request.set)?;
    let frames = frames(instance, &config, request.frames, Duration::ZERO)?;
    let mut chain = Chain::new(&config)?;
    let mut robots: Vec<Robot> = config
        .robots
        .identities
        .iter()
        .map(|robot| Robot { team: robot.team.name(), identity: robot.id, found: 0 })
        .collect();
    let mut tried = Tried {
        robots: Vec::new(),
        balls: 0,
        frames: frames.len(),
        seen: Vec::new(),
        rejected: Vec::new(),
        runs: Vec::new(),
        seq: 0,
    };
    for frame in &frames {
        // Every frame on its own: what `world` knows would hide what the colours do.
        chain.look_at(&frame.bayer(config.camera.bayer_order))?;
        let seen = chain.detections();
        tried.balls += usize::from(!seen.balls().is_empty());
        count(&mut robots, &config, seen);
        tried.seq = frame.header().seq;
    }
    let seen = chain.detections();
    tried.seen = seen.robots().iter().map(Seen::new).collect();
    tried.rejected = seen.rejected().iter().map(NotSeen::new).collect();
    let runs = chain.runs().iter();
    tried.runs = runs.flat_map(|run| [run.row, run.begin, run.end, run.class.into()]).collect();
    tried.robots = robots;
    Ok(tried)
}

fn count(robots: &mut [Robot], config: &Config, seen: &DetectionFrame) {
    for (robot, identity) in robots.iter_mut().zip(&config.robots.identities) {
        let is_it = |found: &&messages::DetectedRobot| {
            Team::from_number(found.team) == Some(identity.team)
                && found.robot_id.number() == Some(identity.id)
        };
        robot.found += usize::from(seen.robots().iter().any(|found| is_it(&found)));
    }
}

impl Seen {
    fn new(robot: &messages::DetectedRobot) -> Self {
        Self {
            team: Team::from_number(robot.team).map_or("unknown", Team::name),
            identity: robot.robot_id.number(),
            center_px: [robot.x_px, robot.y_px],
            pose_mm: [robot.x_mm, robot.y_mm],
            heading_deg: robot.is_identified().then(|| robot.orientation.to_degrees()),
            confidence: robot.confidence,
        }
    }
}

impl NotSeen {
    fn new(rejected: &Rejected) -> Self {
        Self {
            team: match rejected.team {
                Rejected::BALL => "ball",
                number => Team::from_number(number).map_or("unknown", Team::name),
            },
            center_px: [rejected.x_px, rejected.y_px],
            reason: RejectReason::from_number(rejected.reason)
                .map_or("unknown", RejectReason::text),
        }
    }
}
