//! Compares the detections of a picture with its labels.

use crate::learning::labels::{BallLabel, ImageLabels, Quality, RobotLabel};
use config::Config;
use geometry::{CameraModel, ImagePoint, wrap_angle};
use messages::{DetectedRobot, DetectionFrame, RejectReason, Rejected, Run, Team};
use serde::Serialize;
use std::collections::BTreeMap;

/// Tolerances of a correct detection.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Tolerances {
    /// Distance between a robot's centre and its label.
    pub robot_px: f64,
    /// Difference between a robot's heading and its label.
    pub robot_deg: f64,
    /// Distance between the ball's centre and its label.
    pub ball_px: f64,
}

/// The score of one picture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PictureScore {
    /// Name of the picture.
    pub image: String,
    /// Robots labelled clear; empty if robots are not labelled.
    pub robots: Vec<RobotVerdict>,
    /// Robots found where none is labelled.
    pub phantoms: Vec<FoundRobot>,
    /// `None` if the ball is not labelled, or labelled hard.
    pub ball: Option<BallVerdict>,
}

/// The result for a labelled robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RobotVerdict {
    /// Its team.
    pub team: Team,
    /// Its number in the team.
    pub id: u32,
    /// Centre by the label: column in the picture.
    pub x_px: f64,
    /// Centre by the label: row in the picture.
    pub y_px: f64,
    /// Whether it was found, and under which name.
    pub outcome: Outcome,
    /// Distance and turn of the robot found at the label.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub off: Option<Offset>,
    /// The wrong identity found at the label.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub taken_for: Option<Name>,
    /// Why the nearest candidate was rejected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// For a robot that is not right: pixels on its top by class.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub colors_seen: BTreeMap<String, u32>,
}

/// Outcome for a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Right identity, within the tolerances.
    Right,
    /// Right identity at its place, but beyond the tolerances.
    Inaccurate,
    /// A robot of another identity was found at its place.
    WrongIdentity,
    /// No robot was found at its place.
    Missed,
}

/// Distance of a detection from its label.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Offset {
    /// Distance in pixels.
    pub px: f64,
    /// Difference in heading, degrees.
    pub deg: f64,
}

/// A robot's identity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Name {
    /// Its team.
    pub team: Team,
    /// Its number in the team.
    pub id: u32,
}

/// A robot that was found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FoundRobot {
    /// Its team.
    pub team: Team,
    /// Its number in the team.
    pub id: u32,
    /// Centre in the picture: column.
    pub x_px: f64,
    /// Centre in the picture: row.
    pub y_px: f64,
}

/// The result for the ball.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BallVerdict {
    /// Whether it was found.
    pub outcome: BallOutcome,
    /// Distance of the detection from the label.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub off_px: Option<f64>,
    /// Why the nearest candidate was rejected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// Outcome for the ball.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum BallOutcome {
    /// Found within the tolerance.
    Right,
    /// Something else was found, or the ball too far off.
    Far,
    /// Not found.
    Missed,
    /// Found, although there is none.
    Phantom,
    /// Not found, and there is none.
    Absent,
}

/// Compares pictures with their labels.
pub struct Judge<'a> {
    /// The configuration of the stages that saw the pictures.
    pub config: &'a Config,
    /// The camera's geometry by that configuration.
    pub camera: &'a CameraModel,
    /// Largest errors of a right detection.
    pub tolerances: Tolerances,
}

impl Judge<'_> {
    /// `seen` and `runs` are the stages' outputs for the labelled picture.
    pub fn judge(&self, labels: &ImageLabels, seen: &DetectionFrame, runs: &[Run]) -> PictureScore {
        let all = labels.robots.as_deref().unwrap_or(&[]);
        let is_clear = |label: &&RobotLabel| label.quality == Quality::Clear;
        let robots =
            all.iter().filter(is_clear).map(|label| self.robot(label, all, seen, runs)).collect();
        let is_at_a_label = |found: &DetectedRobot| {
            all.iter().any(|label| {
                let reach_px = self.robot_size_px(label) / 2.0;
                distance_px(place(label), (found.x_px, found.y_px)) < reach_px
            })
        };
        let phantoms = seen
            .robots()
            .iter()
            .filter(|found| labels.robots.is_some() && !is_at_a_label(found))
            .filter_map(found_robot)
            .collect();
        PictureScore {
            image: labels.file.display().to_string(),
            robots,
            phantoms,
            ball: labels.ball.as_ref().and_then(|ball| self.ball(ball.as_ref(), seen)),
        }
    }

    fn robot(
        &self,
        label: &RobotLabel,
        all: &[RobotLabel],
        seen: &DetectionFrame,
        runs: &[Run],
    ) -> RobotVerdict {
        let size_px = self.robot_size_px(label);
        let near = |found: &&DetectedRobot| {
            distance_px(place(label), (found.x_px, found.y_px)) < size_px / 2.0
        };
        let is_named = |found: &DetectedRobot| {
            (found.team, found.robot_id) == (label.team as u32, label.id.into())
        };
        // A neighbour that touches the robot may be within reach; it belongs to its own label.
        let is_at_home = |found: &&DetectedRobot| {
            all.iter().any(|other| {
                (found.team, found.robot_id) == (other.team as u32, other.id.into())
                    && (other.team, other.id) != (label.team, label.id)
                    && distance_px(place(other), (found.x_px, found.y_px))
                        < distance_px(place(label), (found.x_px, found.y_px))
            })
        };
        // Unidentified detections are not identity errors.
        let here = seen.robots().iter().filter(|found| found.is_identified()).filter(near);
        let own = here.clone().find(|found| is_named(found));
        let other = || {
            here.filter(|found| !is_at_home(found)).min_by(|a, b| {
                let distance =
                    |found: &DetectedRobot| distance_px(place(label), (found.x_px, found.y_px));
                distance(a).total_cmp(&distance(b))
            })
        };
        let found = own.or_else(other);
        let off = found.map(|found| Offset {
            px: rounded(distance_px(place(label), (found.x_px, found.y_px))),
            deg: rounded({
                let turned = f64::from(found.orientation_image) - label.heading_deg.to_radians();
                wrap_angle(turned).abs().to_degrees()
            }),
        });
        let outcome = match (own, off) {
            (Some(_), Some(off))
                if off.px <= self.tolerances.robot_px && off.deg <= self.tolerances.robot_deg =>
            {
                Outcome::Right
            }
            (Some(_), _) => Outcome::Inaccurate,
            (None, Some(_)) => Outcome::WrongIdentity,
            (None, None) => Outcome::Missed,
        };
        let taken_for = match outcome {
            Outcome::WrongIdentity => {
                found.and_then(found_robot).map(|robot| Name { team: robot.team, id: robot.id })
            }
            _ => None,
        };
        let missed = outcome == Outcome::Missed;
        RobotVerdict {
            team: label.team,
            id: label.id,
            x_px: label.x_px,
            y_px: label.y_px,
            outcome,
            off,
            taken_for,
            reason: missed.then(|| {
                let is_patch = |rejected: &Rejected| rejected.team != Rejected::BALL;
                self.reason(place(label), size_px, seen, is_patch)
                    .unwrap_or_else(|| "no patch of a team's colour was seen there".into())
            }),
            colors_seen: match outcome {
                Outcome::Right => BTreeMap::new(),
                _ => self.colors_seen(place(label), size_px / 2.0, runs),
            },
        }
    }

    fn ball(&self, label: Option<&BallLabel>, seen: &DetectionFrame) -> Option<BallVerdict> {
        let found = seen.balls().first();
        let verdict = |outcome| BallVerdict { outcome, off_px: None, reason: None };
        let Some(label) = label else {
            return Some(verdict(match found {
                Some(_) => BallOutcome::Phantom,
                None => BallOutcome::Absent,
            }));
        };
        if label.quality != Quality::Clear {
            return None;
        }
        let here = ImagePoint::new(label.x_px, label.y_px);
        let off_px = found.map(|found| rounded(distance_px(here, (found.x_px, found.y_px))));
        let outcome = match off_px {
            Some(px) if px <= self.tolerances.ball_px => BallOutcome::Right,
            Some(_) => BallOutcome::Far,
            None => BallOutcome::Missed,
        };
        let reason = (outcome != BallOutcome::Right).then(|| {
            let size_px = self.config.ball.diameter_mm
                / self.camera.pixel_area_mm2(here, self.config.ball.diameter_mm / 2.0).sqrt();
            self.reason(here, size_px, seen, |rejected| rejected.team == Rejected::BALL)
                .unwrap_or_else(|| "nothing of its colour was seen there".into())
        });
        Some(BallVerdict { off_px, reason, ..verdict(outcome) })
    }

    /// Why the nearest candidate within reach was rejected.
    fn reason(
        &self,
        here: ImagePoint,
        reach_px: f64,
        seen: &DetectionFrame,
        counts: impl Fn(&Rejected) -> bool,
    ) -> Option<String> {
        let distance = |rejected: &Rejected| distance_px(here, (rejected.x_px, rejected.y_px));
        let nearest = seen
            .rejected()
            .iter()
            .filter(|rejected| counts(rejected) && distance(rejected) < reach_px)
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        let reason = RejectReason::from_number(nearest.reason)?.text();
        Some(match Team::from_number(nearest.team) {
            Some(team) => format!("{}: {reason}", team.name()),
            None => reason.to_string(),
        })
    }

    /// Number of pixels within a distance, by the name of their class.
    fn colors_seen(&self, here: ImagePoint, reach_px: f64, runs: &[Run]) -> BTreeMap<String, u32> {
        let mut seen = BTreeMap::new();
        for run in runs {
            let dy = f64::from(run.row) - here.y_px;
            let half = (reach_px * reach_px - dy * dy).max(0.0).sqrt();
            let begin = f64::from(run.begin).max((here.x_px - half).ceil());
            let end = f64::from(run.end).min((here.x_px + half).floor() + 1.0);
            let color = self.config.colors.get(usize::from(run.class));
            if let Some(color) = color.filter(|_| end > begin && half > 0.0) {
                *seen.entry(color.name.clone()).or_default() += (end - begin) as u32;
            }
        }
        seen
    }

    /// Side of a robot's top in the picture.
    fn robot_size_px(&self, label: &RobotLabel) -> f64 {
        let height_mm = self.config.top(label.team as u32, Some(label.id)).height_mm;
        self.config.robots.size_mm / self.camera.pixel_area_mm2(place(label), height_mm).sqrt()
    }
}

fn place(label: &RobotLabel) -> ImagePoint {
    ImagePoint::new(label.x_px, label.y_px)
}

fn distance_px(a: ImagePoint, (x_px, y_px): (f32, f32)) -> f64 {
    (a.x_px - f64::from(x_px)).hypot(a.y_px - f64::from(y_px))
}

fn found_robot(robot: &DetectedRobot) -> Option<FoundRobot> {
    Some(FoundRobot {
        team: Team::from_number(robot.team)?,
        id: robot.robot_id.number()?,
        x_px: rounded(robot.x_px.into()),
        y_px: rounded(robot.y_px.into()),
    })
}

/// Rounds to thousandths.
fn rounded(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use messages::DetectedBall;
    use std::path::Path;

    const TOLERANCES: Tolerances = Tolerances { robot_px: 3.0, robot_deg: 6.0, ball_px: 2.0 };

    fn found(team: Team, robot_id: u32, x_px: f32, y_px: f32, degrees: f32) -> DetectedRobot {
        DetectedRobot {
            team: team as u32,
            robot_id: robot_id.into(),
            x_px,
            y_px,
            orientation_image: degrees.to_radians(),
            ..DetectedRobot::default()
        }
    }

    /// The score of a picture with these labels and detections.
    fn score(labels: &str, fill: impl FnOnce(&mut DetectionFrame), runs: &[Run]) -> PictureScore {
        let config = Config::default();
        let camera = CameraModel::new(&config.geometry, 640, 480).unwrap();
        let text = format!(r#"{{"images": [{{"file": "a.png", {labels}}}]}}"#);
        let labels =
            crate::learning::labels::Labels::parse(&text, Path::new("labels.json")).unwrap();
        let mut seen = Box::new(DetectionFrame::zeroed());
        fill(&mut seen);
        let judge = Judge { config: &config, camera: &camera, tolerances: TOLERANCES };
        judge.judge(&labels.images[0], &seen, runs)
    }

    const TWO: &str = r#""robots": [
        {"team": "blue", "id": 0, "x_px": 300, "y_px": 200, "heading_deg": 359},
        {"team": "yellow", "id": 1, "x_px": 400, "y_px": 200, "heading_deg": 90}
    ]"#;

    fn outcomes(score: &PictureScore) -> Vec<Outcome> {
        score.robots.iter().map(|robot| robot.outcome).collect()
    }

    #[test]
    fn right_is_right_name_place_and_heading() {
        let here = |degrees: f32, x_px: f32| {
            let seen = score(
                TWO,
                |seen| {
                    seen.push_robot(found(Team::Blue, 0, x_px, 201.0, degrees));
                },
                &[],
            );
            outcomes(&seen)[0]
        };
        assert_eq!(here(1.0, 299.0), Outcome::Right);
        assert_eq!(here(6.0, 299.0), Outcome::Inaccurate);
        assert_eq!(here(1.0, 305.0), Outcome::Inaccurate);
        assert_eq!(here(1.0, 330.0), Outcome::Missed);
    }

    #[test]
    fn another_robot_in_its_place_is_a_wrong_identity() {
        let score = score(
            TWO,
            |seen| {
                seen.push_robot(found(Team::Yellow, 1, 300.0, 200.0, 0.0));
                seen.push_robot(found(Team::Blue, 4, 100.0, 100.0, 0.0));
            },
            &[],
        );
        assert_eq!(outcomes(&score), [Outcome::WrongIdentity, Outcome::Missed]);
        assert_eq!(score.robots[0].taken_for, Some(Name { team: Team::Yellow, id: 1 }));
        let [phantom] = score.phantoms[..] else { panic!("{score:?}") };
        assert_eq!((phantom.team, phantom.id), (Team::Blue, 4));
    }

    #[test]
    fn a_neighbour_is_not_taken_for_a_missed_robot() {
        let touching = TWO.replace("400", "307");
        let neighbour = |seen: &mut DetectionFrame| {
            seen.push_robot(found(Team::Yellow, 1, 306.5, 200.0, 90.0));
        };
        assert_eq!(outcomes(&score(&touching, neighbour, &[])), [Outcome::Missed, Outcome::Right]);
    }

    #[test]
    fn a_miss_has_a_reason_and_the_colours_seen() {
        let run = |row, begin, end, class| Run { row, begin, end, class, reserved: 0 };
        let score = score(
            TWO,
            |seen| {
                seen.push_rejected(Rejected {
                    team: Team::Blue as u32,
                    reason: RejectReason::NoIdentificationPatch as u32,
                    x_px: 303.0,
                    y_px: 203.0,
                });
            },
            &[run(200, 298, 302, 2), run(201, 300, 600, 1), run(300, 300, 310, 2)],
        );
        let missed = &score.robots[0];
        let reason = missed.reason.as_deref().unwrap();
        assert_eq!(reason, "blue: no identification patch in range");
        let colors = &missed.colors_seen;
        assert_eq!(colors.get("blue"), Some(&4));
        assert!(colors["yellow"] < 20, "{colors:?}");
        assert!(score.robots[1].reason.as_deref().unwrap().starts_with("no patch"));
    }

    #[test]
    fn hard_robots_are_neither_demanded_nor_phantoms() {
        let hard = TWO.replace(r#""heading_deg": 359"#, r#""heading_deg": 359, "quality": "hard""#);
        let score = score(
            &hard,
            |seen| {
                seen.push_robot(found(Team::Blue, 3, 300.0, 200.0, 0.0));
            },
            &[],
        );
        assert_eq!(outcomes(&score), [Outcome::Missed]);
        assert!(score.phantoms.is_empty());
    }

    #[test]
    fn the_ball_is_scored_if_it_is_labelled() {
        let ball = |labels: &str, x_px: Option<f32>| {
            let fill = |seen: &mut DetectionFrame| {
                if let Some(x_px) = x_px {
                    seen.push_ball(DetectedBall { x_px, y_px: 50.0, ..DetectedBall::default() });
                }
            };
            score(labels, fill, &[]).ball.map(|ball| ball.outcome)
        };
        let there = r#""ball": {"x_px": 100, "y_px": 50}"#;
        assert_eq!(ball(there, Some(101.0)), Some(BallOutcome::Right));
        assert_eq!(ball(there, Some(104.0)), Some(BallOutcome::Far));
        assert_eq!(ball(there, None), Some(BallOutcome::Missed));
        assert_eq!(ball(r#""ball": null"#, Some(1.0)), Some(BallOutcome::Phantom));
        assert_eq!(ball(r#""ball": null"#, None), Some(BallOutcome::Absent));
        assert_eq!(ball(r#""robots": []"#, Some(1.0)), None);
    }
}
