//! Messages as JSON: names instead of numbers, and lists without the stale elements behind their counts.
//!
//! A number that has no name here, of a newer program or of a damaged message, stays a number.

use super::{
    Attendant, BallState, BayerOrder, CameraReport, CameraState, Commands, CommandsName,
    DetectedBall, DetectedRobot, DetectionFrame, EventKind, FrameHeader, GroupEvent, PixelFormat,
    ProcessState, Region, RejectReason, Rejected, RobotId, RobotState, Team, TrackStatus,
    TruthFrame, TruthRobot, UnknownRobotState, WheelCommand, WorldFrame, read_text,
};
use crate::stages::StageId;
use serde::{Serialize, Serializer};

fn named<S: Serializer>(name: Option<&str>, number: u32, to: S) -> Result<S::Ok, S::Error> {
    match name {
        Some(name) => to.serialize_str(name),
        None => to.serialize_u32(number),
    }
}

/// A [`Team`].
pub fn team<S: Serializer>(number: &u32, to: S) -> Result<S::Ok, S::Error> {
    named(Team::from_number(*number).map(Team::name), *number, to)
}

/// A [`TrackStatus`].
pub fn track_status<S: Serializer>(number: &u32, to: S) -> Result<S::Ok, S::Error> {
    named(TrackStatus::from_number(*number).map(TrackStatus::name), *number, to)
}

/// The kind of a rejected candidate: a robot of a team, of either team, or the ball.
pub fn candidate<S: Serializer>(number: &u32, to: S) -> Result<S::Ok, S::Error> {
    let name = match *number {
        Rejected::BALL => Some("ball"),
        Rejected::UNKNOWN_TEAM => Some("robot"),
        team => Team::from_number(team).map(Team::name),
    };
    named(name, *number, to)
}

/// A [`RejectReason`], in words.
pub fn reject_reason<S: Serializer>(number: &u32, to: S) -> Result<S::Ok, S::Error> {
    named(RejectReason::from_number(*number).map(RejectReason::text), *number, to)
}

/// A [`PixelFormat`].
pub fn pixel_format<S: Serializer>(number: &u32, to: S) -> Result<S::Ok, S::Error> {
    named(PixelFormat::from_number(*number).map(PixelFormat::name), *number, to)
}

/// A [`BayerOrder`].
pub fn bayer_order<S: Serializer>(number: &u32, to: S) -> Result<S::Ok, S::Error> {
    match BayerOrder::from_number(*number) {
        Some(order) => order.serialize(to),
        None => to.serialize_u32(*number),
    }
}

/// The number of a process: a stage or an [`Attendant`].
pub fn process<S: Serializer>(number: &u32, to: S) -> Result<S::Ok, S::Error> {
    let attendant = Attendant::ALL.into_iter().find(|&attendant| attendant as u32 == *number);
    let stage = StageId::from_number(*number).map(|stage| stage.to_string());
    named(attendant.map(Attendant::name).or(stage.as_deref()), *number, to)
}

/// A [`ProcessState`].
pub fn process_state<S: Serializer>(number: &u32, to: S) -> Result<S::Ok, S::Error> {
    named(ProcessState::from_number(*number).map(ProcessState::name), *number, to)
}

impl Serialize for RobotId {
    /// `null` when unknown.
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        self.number().serialize(to)
    }
}

impl Serialize for DetectionFrame {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Valid<'a> {
            frame: FrameHeader,
            t_frame_taken_ns: u64,
            t_runs_ns: u64,
            t_runs_taken_ns: u64,
            t_sent_ns: u64,
            classifier_revision: u32,
            revision: u32,
            flags: u32,
            robots: &'a [DetectedRobot],
            balls: &'a [DetectedBall],
            rejected: &'a [Rejected],
            regions: &'a [Region],
        }
        let valid = Valid {
            frame: self.frame,
            t_frame_taken_ns: self.t_frame_taken_ns,
            t_runs_ns: self.t_runs_ns,
            t_runs_taken_ns: self.t_runs_taken_ns,
            t_sent_ns: self.t_sent_ns,
            classifier_revision: self.classifier_revision,
            revision: self.revision,
            flags: self.flags,
            robots: self.robots(),
            balls: self.balls(),
            rejected: self.rejected(),
            regions: self.regions(),
        };
        valid.serialize(to)
    }
}

/// Without the memories for the filter's successor.
impl Serialize for WorldFrame {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Valid<'a> {
            frame: FrameHeader,
            t_frame_taken_ns: u64,
            t_runs_ns: u64,
            t_runs_taken_ns: u64,
            t_detections_ns: u64,
            t_detections_taken_ns: u64,
            t_sent_ns: u64,
            t_predicted_ns: u64,
            classifier_revision: u32,
            tracker_revision: u32,
            revision: u32,
            robots: &'a [RobotState],
            unknown_robots: &'a [UnknownRobotState],
            /// `null` when there is none.
            ball: Option<BallState>,
            commands: &'a [CommandsName],
        }
        let is_there = self.ball.status != TrackStatus::Absent as u32;
        let valid = Valid {
            frame: self.frame,
            t_frame_taken_ns: self.t_frame_taken_ns,
            t_runs_ns: self.t_runs_ns,
            t_runs_taken_ns: self.t_runs_taken_ns,
            t_detections_ns: self.t_detections_ns,
            t_detections_taken_ns: self.t_detections_taken_ns,
            t_sent_ns: self.t_sent_ns,
            t_predicted_ns: self.t_predicted_ns,
            classifier_revision: self.classifier_revision,
            tracker_revision: self.tracker_revision,
            revision: self.revision,
            robots: self.robots(),
            unknown_robots: self.unknown_robots(),
            ball: is_there.then_some(self.ball),
            commands: self.commands(),
        };
        valid.serialize(to)
    }
}

impl Serialize for Commands {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Valid<'a> {
            seq: u64,
            t_sent_ns: u64,
            user: u32,
            wheels: &'a [WheelCommand],
        }
        let Self { seq, t_sent_ns, user, .. } = *self;
        Valid { seq, t_sent_ns, user, wheels: self.wheels() }.serialize(to)
    }
}

impl Serialize for TruthFrame {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Valid<'a> {
            seq: u64,
            t_capture_ns: u64,
            robots: &'a [TruthRobot],
            ball_visible: bool,
            ball_x_mm: f64,
            ball_y_mm: f64,
            ball_vx_mm_s: f64,
            ball_vy_mm_s: f64,
        }
        let valid = Valid {
            seq: self.seq,
            t_capture_ns: self.t_capture_ns,
            robots: self.robots(),
            ball_visible: self.ball_visible != 0,
            ball_x_mm: self.ball_x_mm,
            ball_y_mm: self.ball_y_mm,
            ball_vx_mm_s: self.ball_vx_mm_s,
            ball_vy_mm_s: self.ball_vy_mm_s,
        };
        valid.serialize(to)
    }
}

impl Serialize for GroupEvent {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Valid {
            t_wall_ns: u64,
            number: u64,
            pid: u32,
            #[serde(serialize_with = "process")]
            process: u32,
            kind: Option<EventKind>,
            what: String,
            evidence: String,
        }
        let Self { t_wall_ns, number, pid, process, .. } = *self;
        let kind = EventKind::from_number(self.kind);
        let (what, evidence) = (read_text(&self.what), read_text(&self.evidence));
        Valid { t_wall_ns, number, pid, process, kind, what, evidence }.serialize(to)
    }
}

impl Serialize for CameraReport {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Valid {
            state: Option<&'static str>,
            camera_id: u32,
            starts: u64,
            promised_fps: f32,
            delivered_fps: f32,
            device: String,
            description: String,
            problem: String,
        }
        let Self { camera_id, starts, promised_fps, delivered_fps, .. } = *self;
        let state = CameraState::from_number(self.state).map(CameraState::name);
        let [device, description, problem] =
            [&self.device[..], &self.description, &self.problem].map(read_text);
        let valid = Valid {
            state,
            camera_id,
            starts,
            promised_fps,
            delivered_fps,
            device,
            description,
            problem,
        };
        valid.serialize(to)
    }
}

#[cfg(all(test, feature = "schema"))]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use serde_json::json;

    #[test]
    fn a_world_shows_names_and_only_valid_elements() {
        let mut world = bytemuck::allocation::zeroed_box::<WorldFrame>();
        world.robot_count = 1;
        world.robots[0].status = TrackStatus::Measured as u32;
        world.robots[0].team = Team::Blue as u32;
        world.robots[1].team = 77;
        let text = serde_json::to_value(*world).unwrap();
        assert_eq!(text["robots"].as_array().unwrap().len(), 1, "{text}");
        assert_eq!(text["robots"][0]["team"], "blue");
        assert_eq!(text["robots"][0]["status"], "measured");
        assert_eq!(text["ball"], json!(null));
        assert!(text.get("robot_memories").is_none());
        world.ball.status = 99;
        assert_eq!(serde_json::to_value(*world).unwrap()["ball"]["status"], 99);
        // A count from outside never leads beyond the array.
        world.robot_count = u32::MAX;
        assert_eq!(serde_json::to_value(*world).unwrap()["robots"].as_array().unwrap().len(), 32);
    }

    #[test]
    fn rejected_candidates_and_processes_have_names() {
        let mut frame = bytemuck::allocation::zeroed_box::<DetectionFrame>();
        frame.push_rejected(Rejected {
            team: Rejected::BALL,
            reason: RejectReason::NotRound as u32,
            ..Rejected::default()
        });
        frame.push_robot(DetectedRobot { robot_id: RobotId::UNKNOWN, ..Default::default() });
        let text = serde_json::to_value(*frame).unwrap();
        assert_eq!(text["rejected"][0]["team"], "ball");
        assert_eq!(text["rejected"][0]["reason"], RejectReason::NotRound.text());
        assert_eq!(text["robots"][0]["robot_id"], json!(null));
        let beat = super::super::Heartbeat::new(Attendant::Gateway as u32, ProcessState::Active);
        let text = serde_json::to_value(beat).unwrap();
        assert_eq!((&text["process"], &text["state"]), (&json!("gateway"), &json!("active")));
        let event = GroupEvent { kind: 1, ..GroupEvent::zeroed() };
        assert!(serde_json::to_value(event).unwrap()["kind"].is_string());
    }
}
