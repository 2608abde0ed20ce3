//! Messages in the terms of a page.

use super::{Scene, name, round};
use geometry::{FieldPoint, Pose};
use messages::{
    DetectedRobot, DetectionFrame, FrameHeader, RejectReason, Rejected, RobotState, Run, Team,
    TrackStatus, WorldFrame,
};
use serde_json::{Value, json};
use std::fmt::Write as _;

/// Seconds in a nanosecond.
const NANOSECOND_S: f64 = 1e-9;

impl Scene {
    /// What the tracker found.
    pub fn detections(&self, seen: &DetectionFrame) -> Value {
        let regions = seen.regions().iter().map(|it| {
            json!({
                "class": it.class, "pixels": it.pixel_count,
                "center_px": [round(f64::from(it.x_px), 2), round(f64::from(it.y_px), 2)],
                "box_px": [it.left, it.top, it.right, it.bottom],
            })
        });
        let balls = seen.balls().iter().map(|it| {
            let at = [f64::from(it.x_mm), f64::from(it.y_mm)];
            json!({
                "position_mm": at.map(|value| round(value, 1)),
                "center_px": [round(f64::from(it.x_px), 2), round(f64::from(it.y_px), 2)],
                "radius_px": self.ball_radius_px(at),
                "confidence": round(f64::from(it.confidence), 3),
            })
        });
        json!({
            "seq": seen.frame.seq,
            "revision": seen.revision,
            "time_s": time_s(&seen.frame),
            "regions": regions.collect::<Vec<_>>(),
            "robots": seen.robots().iter().map(|it| self.detected(it)).collect::<Vec<_>>(),
            "balls": balls.collect::<Vec<_>>(),
            "rejected": seen.rejected().iter().map(|it| self.rejected(it)).collect::<Vec<_>>(),
        })
    }

    fn detected(&self, it: &DetectedRobot) -> Value {
        let id = it.robot_id.number();
        let (x_mm, y_mm) = (f64::from(it.x_mm), f64::from(it.y_mm));
        let orientation = f64::from(it.orientation);
        let pose = Pose { position: FieldPoint::new(x_mm, y_mm), orientation };
        let (outline, heading) = self.robot_px(it.team, id, pose);
        json!({
            "team": team(it.team), "identity": id, "name": name(it.team, id),
            "pose_mm": [round(x_mm, 1), round(y_mm, 1)],
            "heading_deg": id.map(|_| round(orientation.to_degrees(), 1)),
            "center_px": [round(f64::from(it.x_px), 2), round(f64::from(it.y_px), 2)],
            "outline_px": outline,
            "heading_px": id.map(|_| heading),
            "confidence": round(f64::from(it.confidence), 3),
        })
    }

    fn rejected(&self, it: &Rejected) -> Value {
        let (team_name, color) = match it.team {
            Rejected::BALL => ("ball", Some(self.config.ball.color.as_str())),
            number => match Team::from_number(number) {
                Some(team) => (team.name(), Some(self.config.teams.color(team))),
                None => ("unknown", None),
            },
        };
        let reason = RejectReason::from_number(it.reason).map_or("unknown", RejectReason::text);
        json!({
            "center_px": [round(f64::from(it.x_px), 1), round(f64::from(it.y_px), 1)],
            "team": team_name, "color": color, "reason": reason,
        })
    }

    /// The filtered state.
    pub fn world(&self, world: &WorldFrame) -> Value {
        let robots = world.robots().iter().map(|it| self.tracked(it));
        let unknown = world.unknown_robots().iter().map(|it| {
            json!({
                "team": team(it.team), "track": it.track_id,
                "position_mm": [round(it.x_mm, 1), round(it.y_mm, 1)],
                "velocity_mm_s": [round(it.vx_mm_s, 0), round(it.vy_mm_s, 0)],
                "center_px": self.px([it.x_mm, it.y_mm], self.config.robots.height_mm),
            })
        });
        let ball = &world.ball;
        let exists = ball.status != TrackStatus::Absent as u32;
        let captured_ns = world.frame.t_capture_ns;
        let after_us = |t_ns: u64| round(t_ns.saturating_sub(captured_ns) as f64 * 1e-3, 0);
        json!({
            "seq": world.frame.seq,
            "revision": world.revision,
            "time_s": time_s(&world.frame),
            "latency_us": {
                "grabber": after_us(world.frame.t_sent_ns), "classifier": after_us(world.t_runs_ns),
                "tracker": after_us(world.t_detections_ns), "filter": after_us(world.t_sent_ns),
            },
            "robots": robots.collect::<Vec<_>>(),
            "unknown_robots": unknown.collect::<Vec<_>>(),
            "ball": exists.then(|| json!({
                "position_mm": [round(ball.x_mm, 1), round(ball.y_mm, 1)],
                "velocity_mm_s": [round(ball.vx_mm_s, 0), round(ball.vy_mm_s, 0)],
                "center_px": self.px([ball.x_mm, ball.y_mm], self.config.ball.diameter_mm / 2.0),
                "radius_px": self.ball_radius_px([ball.x_mm, ball.y_mm]),
                "predicted_mm": [round(ball.predicted_x_mm, 1), round(ball.predicted_y_mm, 1)],
                "visible": ball.frames_unseen == 0,
            })),
        })
    }

    fn tracked(&self, it: &RobotState) -> Value {
        let at = |x, y, orientation| Pose { position: FieldPoint::new(x, y), orientation };
        let id = Some(it.robot_id);
        let (outline, heading) = self.robot_px(it.team, id, at(it.x_mm, it.y_mm, it.orientation));
        let frame_ms = 1000.0 / self.config.camera.fps;
        let [xx, xy, yy] = [0, 1, 6].map(|index| round(it.covariance[index], 4));
        json!({
            "name": name(it.team, id), "team": team(it.team), "identity": it.robot_id,
            "status": TrackStatus::from_number(it.status).map_or("absent", TrackStatus::name),
            "pose_mm": [round(it.x_mm, 2), round(it.y_mm, 2)],
            "heading_deg": round(it.orientation.to_degrees(), 2),
            "velocity_mm_s": [round(it.vx_mm_s, 0), round(it.vy_mm_s, 0)],
            "turning_deg_s": round(it.omega.to_degrees(), 0),
            "covariance_mm2": [xx, xy, yy],
            "seen_ms": round(f64::from(it.frames_unseen) * frame_ms, 0),
            "visibility": round(f64::from(it.visibility), 3),
            "outline_px": outline,
            "heading_px": heading,
            "predicted": {
                "pose_mm": [round(it.predicted_x_mm, 1), round(it.predicted_y_mm, 1)],
                "heading_deg": round(it.predicted_orientation.to_degrees(), 1),
            },
        })
    }

    fn ball_radius_px(&self, [x, y]: [f64; 2]) -> f64 {
        let radius = self.config.ball.diameter_mm / 2.0;
        let [a, b] = [self.px([x, y], radius), self.px([x + radius, y], radius)];
        round((a[0] - b[0]).hypot(a[1] - b[1]), 2)
    }
}

/// Runs as one list of numbers: row, first and last column, class, and so on.
pub fn runs_list<'a>(runs: impl Iterator<Item = &'a Run>) -> Vec<u16> {
    runs.flat_map(|run| [run.row, run.begin, run.end.saturating_sub(1), run.class.into()]).collect()
}

/// The same with the number of the frame, as text.
pub fn runs(seq: u64, revision: u32, runs: &[Run]) -> String {
    let mut text = String::with_capacity(64 + 20 * runs.len());
    let _ = write!(text, "{{\"seq\":{seq},\"revision\":{revision},\"runs\":[");
    for (index, run) in runs.iter().enumerate() {
        let comma = if index == 0 { "" } else { "," };
        let last = run.end.saturating_sub(1);
        let _ = write!(text, "{comma}{},{},{last},{}", run.row, run.begin, run.class);
    }
    text.push_str("]}");
    text
}

fn team(number: u32) -> &'static str {
    Team::from_number(number).map_or("unknown", Team::name)
}

/// The middle of the exposure, Unix time.
fn time_s(frame: &FrameHeader) -> f64 {
    frame.t_capture_wall_ns as f64 * NANOSECOND_S
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use config::Preset;
    use config::snapshot::Snapshot;

    fn scene() -> Scene {
        Scene::new(&Snapshot::first(Preset::Mirosot5v5.config())).unwrap()
    }

    #[test]
    fn detections_are_placed_in_the_picture_with_reasons_in_words() {
        let mut seen: Box<DetectionFrame> = bytemuck::allocation::zeroed_box();
        let robot = DetectedRobot { robot_id: 3.into(), x_mm: 100.0, ..Default::default() };
        assert!(seen.push_robot(robot));
        let unknown = DetectedRobot { robot_id: messages::RobotId::UNKNOWN, ..robot };
        assert!(seen.push_robot(unknown));
        let rejected = Rejected { team: Rejected::BALL, reason: 8, x_px: 4.0, y_px: 5.0 };
        assert!(seen.push_rejected(rejected));
        let json = scene().detections(&seen);
        assert_eq!(json["robots"][0]["name"], "yellow 3");
        assert_eq!(json["robots"][0]["outline_px"].as_array().unwrap().len(), 4);
        let heading = &json["robots"][0]["heading_px"];
        let lengthens = heading[1][0].as_f64().unwrap() > heading[0][0].as_f64().unwrap();
        assert!(lengthens, "0 degrees is to the right: {heading}");
        assert_eq!(json["robots"][1]["name"], "yellow");
        assert!(json["robots"][1]["heading_deg"].is_null());
        assert_eq!(json["rejected"][0]["reason"], "not round enough for a ball");
        assert_eq!(json["rejected"][0]["color"], "orange");
    }

    #[test]
    fn garbage_makes_valid_json() {
        let mut world = WorldFrame::zeroed();
        world.robot_count = u32::MAX;
        world.unknown_robot_count = u32::MAX;
        world.robots[0].x_mm = f64::NAN;
        world.robots[1].orientation = f64::INFINITY;
        world.robots[2].team = 77;
        world.ball.status = 9;
        world.ball.x_mm = f64::MAX;
        let text = scene().world(&world).to_string();
        assert!(serde_json::from_str::<Value>(&text).is_ok());
    }

    #[test]
    fn runs_are_one_list() {
        let run = Run { row: 4, begin: 10, end: 12, class: 3, reserved: 0 };
        let text = runs(7, 2, &[run, Run { row: 5, ..run }]);
        assert_eq!(text, r#"{"seq":7,"revision":2,"runs":[4,10,11,3,5,10,11,3]}"#);
        assert!(serde_json::from_str::<Value>(&runs(1, 1, &[])).is_ok());
    }
}
