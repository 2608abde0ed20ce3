//! Colours without labels: robots on a pitch label themselves.
//!
//! Nothing is known but the layout, the geometry, and roughly what hue each colour has. That is enough
//! to find some robots, most of them rightly: it takes several patches in the right places to make
//! one. What is found is learned from as if somebody had labelled it; with those colours more is
//! found, and so on. Colours are as good as the robots that fit the layout with them, in number and in
//! how well they fit: so of all rounds, from several beginnings, the best one counts.

use super::{CommandError, Lesson, learn_from};
use crate::commands::pipeline::Pipeline;
use common::config::{ColorConfig, Config};
use common::messages::{DetectedRobot, DetectionFrame, RejectReason, Rejected, Team};
use learning::labels::{BallLabel, ImageLabels, Quality, RobotLabel};
use learning::palette::{LeastSaturation, by_hue};

/// How saturated colours may be taken to be in the beginning.
const BEGINNINGS: [LeastSaturation; 3] = [
    LeastSaturation { strong: 0.3, weak: 0.13 },
    LeastSaturation { strong: 0.4, weak: 0.2 },
    LeastSaturation { strong: 0.2, weak: 0.08 },
];
const ROUNDS: u32 = 6;
/// A ball seen with less confidence may be anything.
const LEAST_BALL_CONFIDENCE: f32 = 0.5;

/// What was found with a set of colours.
struct Found {
    colors: Vec<ColorConfig>,
    labels: Vec<ImageLabels>,
    robots: usize,
    balls: usize,
    /// Sum of the confidences of all that was found.
    score: f64,
}

/// Learns the colours that make most robots fit the layout, and labels the lessons with those robots.
pub fn learn(config: &Config, lessons: &mut [Lesson]) -> Result<Vec<ColorConfig>, CommandError> {
    let worn: Vec<ColorConfig> =
        config.colors.iter().filter(|color| super::is_worn(config, &color.name)).cloned().collect();
    let is_strong = |color: &ColorConfig| {
        [&config.teams.yellow.color, &config.teams.blue.color, &config.ball.color]
            .contains(&&color.name)
    };
    let mut best: Option<Found> = None;
    for (number, least) in (1..).zip(BEGINNINGS) {
        let mut colors = by_hue(&worn, is_strong, least);
        for color in &worn {
            if !colors.iter().any(|known| known.name == color.name) {
                return Err(format!(
                    "the colour \"{}\" looks grey ({:?}); `looks` must have its hue for --auto",
                    color.name, color.looks
                )
                .into());
            }
        }
        for round in 1..=ROUNDS {
            let found = find(config, colors, lessons)?;
            common::tell!(
                "beginning {number} of {}, round {round}: {} robots and {} balls in {} pictures",
                BEGINNINGS.len(),
                found.robots,
                found.balls,
                lessons.len()
            );
            for (lesson, labels) in lessons.iter_mut().zip(&found.labels) {
                lesson.labels = labels.clone();
            }
            let is_nothing = found.robots == 0;
            colors = found.colors.clone();
            if best.as_ref().is_none_or(|best| found.score > best.score) {
                best = Some(found);
            }
            if is_nothing || round == ROUNDS {
                break;
            }
            colors = learn_from(&Config { colors, ..config.clone() }, lessons, false)?;
        }
    }
    let best = best.filter(|best| best.robots > 0).ok_or(
        "no robot was found with any colours: check geometry, layout (`robots.patches`) and \
         `looks`, or label some robots and use --samples",
    )?;
    for (lesson, labels) in lessons.iter_mut().zip(best.labels) {
        lesson.labels = labels;
    }
    Ok(best.colors)
}

fn find(
    config: &Config,
    colors: Vec<ColorConfig>,
    lessons: &[Lesson],
) -> Result<Found, CommandError> {
    let config = Config { colors, ..config.clone() };
    let mut pipeline = Pipeline::new(&config)?;
    let mut found = Found {
        colors: config.colors.clone(),
        labels: Vec::new(),
        robots: 0,
        balls: 0,
        score: 0.0,
    };
    for lesson in lessons {
        let file = &lesson.labels.file;
        let seen =
            pipeline.step(&lesson.bayer).map_err(|fault| format!("{}: {fault}", file.display()))?;
        let labels =
            label(&config, ImageLabels { file: file.clone(), ..lesson.labels.clone() }, seen);
        found.robots += seen.robots().len();
        found.score += seen.robots().iter().map(|robot| f64::from(robot.confidence)).sum::<f64>();
        if let Some(Some(_)) = labels.ball {
            found.balls += 1;
            found.score += seen.balls().first().map_or(0.0, |ball| f64::from(ball.confidence));
        }
        found.labels.push(labels);
    }
    Ok(found)
}

/// What was seen, as labels.
fn label(config: &Config, labels: ImageLabels, seen: &DetectionFrame) -> ImageLabels {
    let mut robots: Vec<RobotLabel> = seen.robots().iter().filter_map(robot).collect();
    // What might have been a robot is not learned from, and is no background either.
    for rejected in seen.rejected() {
        let reason = RejectReason::from_number(rejected.reason);
        let may_be_robot =
            !matches!(reason, None | Some(RejectReason::TooSmall | RejectReason::OutsideField));
        if rejected.team != Rejected::BALL
            && may_be_robot
            && let Some(team) = Team::from_number(rejected.team)
            && let Some(any) = config.robots.identities.iter().find(|other| other.team == team)
        {
            robots.push(RobotLabel {
                team,
                id: any.id,
                x_px: rejected.x_px.into(),
                y_px: rejected.y_px.into(),
                heading_deg: 0.0,
                quality: Quality::Hard,
            });
        }
    }
    let ball = seen.balls().first().filter(|ball| ball.confidence >= LEAST_BALL_CONFIDENCE);
    let ball = ball.map(|ball| BallLabel {
        x_px: ball.x_px.into(),
        y_px: ball.y_px.into(),
        quality: Quality::Clear,
    });
    ImageLabels { robots: Some(robots), ball: Some(ball), ..labels }
}

fn robot(robot: &DetectedRobot) -> Option<RobotLabel> {
    Some(RobotLabel {
        team: Team::from_number(robot.team)?,
        id: robot.robot_id,
        x_px: robot.x_px.into(),
        y_px: robot.y_px.into(),
        heading_deg: f64::from(robot.orientation_image).to_degrees(),
        quality: Quality::Clear,
    })
}
