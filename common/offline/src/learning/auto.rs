//! Learns colours without labels: robots on a pitch label themselves.
//!
//! Only the layout, the geometry and an approximate appearance of each colour are known. That is enough
//! to find some robots, most of them correctly: a robot requires several patches in the right places.
//! The detections serve as labels for the next round of learning; the better colours find more robots,
//! and so on. The score of a set of colours is the number of robots that fit the layout and how well
//! they fit, less a cost for the floor that the colours take. The best of all rounds, from several
//! starts, is returned. The configured colours are one of the starts, and their own detections one of
//! the rounds.

use super::floor;
use super::lessons::Lessons;
use super::{LearnError, learn_from};
use crate::chain::Chain;
use crate::learning::candidates::guess;
use crate::learning::labels::{BallLabel, ImageLabels, Quality, RobotLabel};
use crate::learning::palette::{LeastSaturation, by_tone};
use crate::learning::picture::Picture;
use config::{ColorConfig, Config};
use messages::{DetectedRobot, DetectionFrame, RejectReason, Rejected, Team};
use std::path::PathBuf;

/// Least saturations to start with.
const SATURATIONS: [LeastSaturation; 2] =
    [LeastSaturation { strong: 0.35, weak: 0.16 }, LeastSaturation { strong: 0.2, weak: 0.08 }];
const ROUNDS: u32 = 6;
/// Ends after this many rounds in a row with a relative improvement below the given value.
const PATIENCE: u32 = 2;
const HARDLY: f64 = 0.005;
/// Weight of the floor in the score, which falls by this times the sum of ln(1 + s) over all colours.
/// s is the floor that a colour takes, relative to the pixels that its patches cover.
const FLOOR_COST: f64 = 0.03;
/// A ball of lower confidence is not used as a label.
const LEAST_BALL_CONFIDENCE: f32 = 0.5;

/// The detections with a set of colours.
pub struct Found {
    /// Contains the colours, and the light for which they are made.
    pub config: Config,
    /// Detections, picture by picture.
    pub labels: Vec<ImageLabels>,
    robots: usize,
    balls: usize,
    score: f64,
}

/// Learns the colours for which most robots fit the layout. `configured` has the colours to start with
/// and the light for which they are made, `config` the light for which colours are learned.
pub fn learn(configured: &Config, config: &Config, lessons: &Lessons) -> Result<Found, LearnError> {
    let worn: Vec<ColorConfig> =
        config.colors.iter().filter(|color| super::is_worn(config, &color.name)).cloned().collect();
    let is_strong = |color: &ColorConfig| {
        [&config.teams.yellow.color, &config.teams.blue.color, &config.ball.color]
            .contains(&&color.name)
    };
    let lit = lessons.under_light(config)?;
    let with = |colors| Config { colors, ..config.clone() };
    let guessed = learn_from(config, &guess(config, &lessons.scene, &lit));
    let mut beginnings = vec![
        ("colours as configured".to_string(), configured.clone()),
        ("blobs as large as patches".to_string(), with(guessed)),
    ];
    for least in SATURATIONS {
        let colors = by_tone(&worn, config.light.pitch_rgb, is_strong, least);
        let name = format!("saturation from {} %", (100.0 * least.weak).round());
        beginnings.push((name, with(colors)));
    }
    let climb =
        |(name, begin): (String, Config)| climb(&name, begin, config, lessons, &lit, ROUNDS);
    let results: Vec<Result<Found, LearnError>> = std::thread::scope(|scope| {
        let threads: Vec<_> =
            beginnings.into_iter().map(|beginning| scope.spawn(|| climb(beginning))).collect();
        let join = |thread: std::thread::ScopedJoinHandle<'_, _>| {
            thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        };
        threads.into_iter().map(join).collect()
    });
    let mut best: Option<Found> = None;
    for found in results {
        let found = found?;
        if best.as_ref().is_none_or(|best| found.score > best.score) {
            best = Some(found);
        }
    }
    best.filter(|best| best.robots > 0).ok_or(LearnError::NoRobot)
}

/// Continues from earlier detections, in another light.
pub fn improve(found: Found, config: &Config, lessons: &Lessons) -> Result<Found, LearnError> {
    let lit = lessons.under_light(config)?;
    let samples = lessons.gather(&found.config, &lit, &found.labels)?;
    let colors = learn_from(&found.config, &samples);
    let begin = Config { colors, ..config.clone() };
    let further = climb("in uneven light", begin, config, lessons, &lit, ROUNDS / 2)?;
    Ok(if further.score > found.score { further } else { found })
}

/// Alternates detection and learning, and returns the best of all rounds.
fn climb(
    name: &str,
    begin: Config,
    config: &Config,
    lessons: &Lessons,
    lit: &[Picture],
    rounds: u32,
) -> Result<Found, LearnError> {
    let mut best: Option<Found> = None;
    let mut worse = 0;
    let mut with = begin;
    for round in 1..=rounds {
        let found = find(&with, lessons)?;
        runtime::tell!(
            "{name}, round {round}: {} robots and {} balls in {} pictures (score {:.2})",
            found.robots,
            found.balls,
            lessons.list.len(),
            found.score
        );
        let samples = lessons.gather(&with, lit, &found.labels)?;
        let is_nothing = found.robots == 0;
        let colors = learn_from(&with, &samples);
        let before = best.as_ref().map_or(0.0, |best| best.score);
        worse = if found.score > before * (1.0 + HARDLY) { 0 } else { worse + 1 };
        if best.is_none() || found.score > before {
            best = Some(found);
        }
        if is_nothing || worse == PATIENCE {
            break;
        }
        with = Config { colors, ..config.clone() };
    }
    best.ok_or(LearnError::NoRobot)
}

fn find(config: &Config, lessons: &Lessons) -> Result<Found, LearnError> {
    let mut chain = Chain::new(config)?;
    let mut taken = floor::Taken::none(config.colors.len());
    let mut confidence = 0.0;
    let mut found =
        Found { config: config.clone(), labels: Vec::new(), robots: 0, balls: 0, score: 0.0 };
    for lesson in &lessons.list {
        chain
            .look_at(&lesson.bayer)
            .map_err(|fault| LearnError::Frame { file: lesson.file.clone(), fault })?;
        let seen = chain.detections();
        let file = lesson.file.clone();
        let labels = label(config, file, seen);
        let named = seen.robots().iter().filter(|robot| robot.is_identified());
        found.robots += named.clone().count();
        confidence += named.map(|robot| f64::from(robot.confidence)).sum::<f64>();
        if let Some(Some(_)) = labels.ball {
            found.balls += 1;
            confidence += seen.balls().first().map_or(0.0, |ball| f64::from(ball.confidence));
        }
        taken.add(config, &lessons.scene, chain.runs(), &labels);
        found.labels.push(labels);
    }
    let shares = taken.shares(config, &lessons.scene, lessons.list.len());
    let cost = FLOOR_COST * shares.iter().map(|share| share.ln_1p()).sum::<f64>();
    found.score = confidence * (1.0 - cost).max(0.0);
    Ok(found)
}

/// Detections as labels.
fn label(config: &Config, file: PathBuf, seen: &DetectionFrame) -> ImageLabels {
    let clear = |robot: &DetectedRobot| {
        Some(RobotLabel {
            team: Team::from_number(robot.team)?,
            id: robot.robot_id.number()?,
            x_px: robot.x_px.into(),
            y_px: robot.y_px.into(),
            heading_deg: f64::from(robot.orientation_image).to_degrees(),
            quality: Quality::Clear,
        })
    };
    // An uncertain robot is not learned from, and is no background either.
    let hard = |team: u32, x_px: f32, y_px: f32| {
        let team = Team::from_number(team)?;
        let any = config.robots.identities.iter().find(|other| other.team == team)?;
        Some(RobotLabel {
            team,
            id: any.id,
            x_px: x_px.into(),
            y_px: y_px.into(),
            heading_deg: 0.0,
            quality: Quality::Hard,
        })
    };
    let found = seen
        .robots()
        .iter()
        .filter_map(|robot| clear(robot).or_else(|| hard(robot.team, robot.x_px, robot.y_px)));
    let is_robot = |rejected: &&Rejected| {
        let reason = RejectReason::from_number(rejected.reason);
        rejected.team != Rejected::BALL
            && !matches!(reason, None | Some(RejectReason::TooSmall | RejectReason::OutsideField))
    };
    let rejected = seen.rejected().iter().filter(is_robot);
    let rejected =
        rejected.filter_map(|rejected| hard(rejected.team, rejected.x_px, rejected.y_px));
    let robots = found.chain(rejected).collect();
    let ball = seen.balls().first().filter(|ball| ball.confidence >= LEAST_BALL_CONFIDENCE);
    let ball = ball.map(|ball| BallLabel {
        x_px: ball.x_px.into(),
        y_px: ball.y_px.into(),
        quality: Quality::Clear,
    });
    ImageLabels { file, robots: Some(robots), ball: Some(ball), samples: Vec::new() }
}
