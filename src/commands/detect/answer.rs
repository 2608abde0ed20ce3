//! The output of `detect` for a picture: the objects of the JSON lines, and the same as text.
//!
//! Pixels: the centre of the top-left pixel is (0, 0). Angles are in degrees from 0 to 360; in the
//! picture 0 is right and 90 up on the screen, on the field 0 is along x and 90 along y.

use messages::{DetectedBall, DetectedRobot, DetectionFrame, RejectReason, Rejected, Team};
use serde::Serialize;
use std::fmt::Write as _;

/// The detections of one picture. The names are part of the program's interface.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Answer {
    pub image: String,
    pub robots: Vec<RobotAnswer>,
    pub ball: Option<BallAnswer>,
    pub rejected: Vec<RejectedAnswer>,
}

/// A robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RobotAnswer {
    pub team: &'static str,
    /// `null` for a robot of which only the team is known; its headings are `null` too.
    pub id: Option<u32>,
    pub x_px: f64,
    pub y_px: f64,
    pub heading_image_deg: Option<f64>,
    pub x_mm: f64,
    pub y_mm: f64,
    pub heading_field_deg: Option<f64>,
    pub confidence: f64,
}

/// The ball.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BallAnswer {
    pub x_px: f64,
    pub y_px: f64,
    pub x_mm: f64,
    pub y_mm: f64,
}

/// A rejected candidate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RejectedAnswer {
    /// "yellow", "blue", or "ball" for a candidate of the ball.
    pub team: &'static str,
    pub x_px: f64,
    pub y_px: f64,
    pub reason: &'static str,
}

impl Answer {
    /// Collects the detections of a picture.
    pub fn new(image: String, seen: &DetectionFrame) -> Self {
        Self {
            image,
            robots: seen.robots().iter().map(RobotAnswer::new).collect(),
            ball: seen.balls().first().map(BallAnswer::new),
            rejected: seen.rejected().iter().map(RejectedAnswer::new).collect(),
        }
    }

    /// The same as text.
    pub fn text(&self) -> String {
        let plural = if self.robots.len() == 1 { "" } else { "s" };
        let ball = if self.ball.is_some() { "the ball" } else { "no ball" };
        let mut text = format!(
            "{}: {} robot{plural}, {ball}, {} rejected\n",
            self.image,
            self.robots.len(),
            self.rejected.len()
        );
        let number = |id: Option<u32>| id.map_or("?".to_string(), |id| id.to_string());
        let degrees = |angle: Option<f64>| angle.map_or("?".to_string(), |deg| format!("{deg:.1}"));
        for robot in &self.robots {
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "  {:<6} {:>2}  {:6.1}, {:5.1} px {:>5}°   {:7.1}, {:7.1} mm {:>5}°   confidence {:.2}",
                robot.team,
                number(robot.id),
                robot.x_px,
                robot.y_px,
                degrees(robot.heading_image_deg),
                robot.x_mm,
                robot.y_mm,
                degrees(robot.heading_field_deg),
                robot.confidence
            );
        }
        if let Some(ball) = &self.ball {
            let _ = writeln!(
                text,
                "  ball       {:6.1}, {:5.1} px          {:7.1}, {:7.1} mm",
                ball.x_px, ball.y_px, ball.x_mm, ball.y_mm
            );
        }
        for rejected in &self.rejected {
            let _ = writeln!(
                text,
                "  rejected   {:6.1}, {:5.1} px  {}: {}",
                rejected.x_px, rejected.y_px, rejected.team, rejected.reason
            );
        }
        text
    }
}

impl RobotAnswer {
    fn new(robot: &DetectedRobot) -> Self {
        Self {
            team: Team::from_number(robot.team).map_or("unknown", Team::name),
            id: robot.robot_id.number(),
            x_px: rounded(robot.x_px, 3),
            y_px: rounded(robot.y_px, 3),
            heading_image_deg: robot.is_identified().then(|| degrees(robot.orientation_image)),
            x_mm: rounded(robot.x_mm, 2),
            y_mm: rounded(robot.y_mm, 2),
            heading_field_deg: robot.is_identified().then(|| degrees(robot.orientation)),
            confidence: rounded(robot.confidence, 3),
        }
    }
}

impl BallAnswer {
    fn new(ball: &DetectedBall) -> Self {
        Self {
            x_px: rounded(ball.x_px, 3),
            y_px: rounded(ball.y_px, 3),
            x_mm: rounded(ball.x_mm, 2),
            y_mm: rounded(ball.y_mm, 2),
        }
    }
}

impl RejectedAnswer {
    fn new(rejected: &Rejected) -> Self {
        Self {
            team: match Team::from_number(rejected.team) {
                Some(team) => team.name(),
                None if rejected.team == Rejected::BALL => "ball",
                None => "unknown",
            },
            x_px: rounded(rejected.x_px, 3),
            y_px: rounded(rejected.y_px, 3),
            reason: RejectReason::from_number(rejected.reason)
                .map_or("unknown reason", RejectReason::text),
        }
    }
}

/// Messages carry 32-bit numbers; as 64-bit numbers with all digits they would show meaningless ones.
fn rounded(value: f32, decimals: i32) -> f64 {
    round(f64::from(value), decimals)
}

fn round(value: f64, decimals: i32) -> f64 {
    let factor = 10f64.powi(decimals);
    (value * factor).round() / factor
}

/// Degrees from 0 up to, but not including, 360.
fn degrees(radians: f32) -> f64 {
    let degrees = round(f64::from(radians).to_degrees().rem_euclid(360.0), 2);
    // A value that rounds to a full turn becomes 0.
    if degrees >= 360.0 { 0.0 } else { degrees }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use serde_json::json;

    fn seen() -> Box<DetectionFrame> {
        let mut seen = Box::new(DetectionFrame::zeroed());
        seen.push_robot(DetectedRobot {
            team: 1,
            robot_id: 3.into(),
            x_mm: -1.25,
            y_mm: 2.0,
            orientation: -0.5 * std::f32::consts::PI,
            confidence: 0.87654,
            x_px: 12.34567,
            y_px: 45.0,
            orientation_image: 1e-9,
            ..DetectedRobot::default()
        });
        seen.push_rejected(Rejected { team: 0, reason: 5, x_px: 1.0, y_px: 2.0 });
        seen.push_rejected(Rejected { team: Rejected::BALL, reason: 8, x_px: 3.0, y_px: 4.0 });
        seen
    }

    #[test]
    fn json_has_the_documented_keys() {
        let mut seen = seen();
        let answer = |seen: &DetectionFrame| {
            serde_json::to_value(Answer::new("a.png".into(), seen)).unwrap()
        };
        let rejected = json!([
            {"team": "yellow", "x_px": 1.0, "y_px": 2.0,
             "reason": "identification patches do not fit the layout"},
            {"team": "ball", "x_px": 3.0, "y_px": 4.0, "reason": "not round enough for a ball"}
        ]);
        let robots = json!([
            {"team": "blue", "id": 3, "x_px": 12.346, "y_px": 45.0, "heading_image_deg": 0.0,
             "x_mm": -1.25, "y_mm": 2.0, "heading_field_deg": 270.0, "confidence": 0.877}
        ]);
        assert_eq!(
            answer(&seen),
            json!({"image": "a.png", "robots": robots, "ball": null, "rejected": rejected})
        );
        let ball =
            DetectedBall { x_mm: 1.0, y_mm: 2.0, x_px: 3.5, y_px: 4.5, ..DetectedBall::default() };
        seen.push_ball(ball);
        seen.push_ball(DetectedBall::default());
        assert_eq!(
            answer(&seen)["ball"],
            json!({"x_px": 3.5, "y_px": 4.5, "x_mm": 1.0, "y_mm": 2.0})
        );
    }

    #[test]
    fn text_has_a_line_for_everything() {
        let text = Answer::new("a.png".into(), &seen()).text();
        assert_eq!(text.lines().count(), 4);
        for part in ["a.png: 1 robot, no ball, 2 rejected", "blue    3", "270.0°", "fit the layout"]
        {
            assert!(text.contains(part), "{part:?} is missing in\n{text}");
        }
    }

    #[test]
    fn angles_are_in_one_turn() {
        for (radians, expected) in [(0.0, 0.0), (-1e-9, 0.0), (-3.1, 182.38), (6.3, 0.96)] {
            assert_eq!(degrees(radians), expected);
        }
    }
}
