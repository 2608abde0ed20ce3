//! Colours without labels: robots on a pitch label themselves.
//!
//! Nothing is known but the layout, the geometry, and roughly what each colour looks like. That is
//! enough to find some robots, most of them rightly: it takes several patches in the right places to
//! make one. What is found is learned from as if somebody had labelled it; with those colours more is
//! found, and so on. Colours are as good as the robots that fit the layout with them, in number and in
//! how well they fit, less what they take of the floor: so of all rounds, from several beginnings, the
//! best one counts. The configured colours are one of the beginnings, and what they find one of the
//! rounds.

use super::floor;
use super::lessons::Lessons;
use super::{CommandError, learn_from};
use common::config::{ColorConfig, Config};
use common::messages::{DetectedRobot, DetectionFrame, RejectReason, Rejected, Team};
use learning::candidates::guess;
use learning::labels::{BallLabel, ImageLabels, Quality, RobotLabel};
use learning::palette::{LeastSaturation, by_tone};
use learning::picture::Picture;
use std::path::PathBuf;
use touchline::chain::Chain;

/// How saturated colours may be taken to be in the beginning.
const SATURATIONS: [LeastSaturation; 2] =
    [LeastSaturation { strong: 0.35, weak: 0.16 }, LeastSaturation { strong: 0.2, weak: 0.08 }];
const ROUNDS: u32 = 6;
/// So many rounds in a row may be hardly better than those before: by less than this part.
const PATIENCE: u32 = 2;
const HARDLY: f64 = 0.005;
/// What part of all that was found it costs if a colour takes as much of the floor as its patches
/// cover, and so much again for each e-fold of that.
const FLOOR_COST: f64 = 0.03;
/// A ball seen with less confidence may be anything.
const LEAST_BALL_CONFIDENCE: f32 = 0.5;

/// What was found with a set of colours.
pub struct Found {
    /// With colours, and the light that they are made for.
    pub config: Config,
    /// Detections, picture by picture.
    pub labels: Vec<ImageLabels>,
    robots: usize,
    balls: usize,
    score: f64,
}

/// Learns the colours that make most robots fit the layout. `configured` has the colours to begin with
/// and the light that they are made for, `config` the light that colours are learned for.
pub fn learn(
    configured: &Config,
    config: &Config,
    lessons: &Lessons,
) -> Result<Found, CommandError> {
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
    let climb = |(name, begin): (String, Config)| {
        climb(&name, begin, config, lessons, &lit, ROUNDS).map_err(|error| error.to_string())
    };
    let results: Vec<Result<Found, String>> = std::thread::scope(|scope| {
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
    best.filter(|best| best.robots > 0).ok_or_else(|| {
        "no robot was found with any colours: check geometry, layout (`robots.patches`) and \
         `looks`, or label some robots and use --samples"
            .into()
    })
}

/// Goes on from what was found, in another light.
pub fn improve(found: Found, config: &Config, lessons: &Lessons) -> Result<Found, CommandError> {
    let lit = lessons.under_light(config)?;
    let samples = lessons.gather(&found.config, &lit, &found.labels)?;
    let colors = learn_from(&found.config, &samples);
    let begin = Config { colors, ..config.clone() };
    let further = climb("in uneven light", begin, config, lessons, &lit, ROUNDS / 2)?;
    Ok(if further.score > found.score { further } else { found })
}

/// Finds robots and learns from them in turn, and returns the best of all rounds.
fn climb(
    name: &str,
    begin: Config,
    config: &Config,
    lessons: &Lessons,
    lit: &[Picture],
    rounds: u32,
) -> Result<Found, CommandError> {
    let mut best: Option<Found> = None;
    let mut worse = 0;
    let mut with = begin;
    for round in 1..=rounds {
        let found = find(&with, lessons)?;
        common::tell!(
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
    best.ok_or_else(|| "no round was played".into())
}

fn find(config: &Config, lessons: &Lessons) -> Result<Found, CommandError> {
    let mut chain = Chain::new(config)?;
    let mut taken = floor::Taken::none(config.colors.len());
    let mut confidence = 0.0;
    let mut found =
        Found { config: config.clone(), labels: Vec::new(), robots: 0, balls: 0, score: 0.0 };
    for lesson in &lessons.list {
        chain
            .look_at(&lesson.bayer)
            .map_err(|fault| format!("{}: {fault}", lesson.file.display()))?;
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

/// What was seen, as labels.
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
    // What might be a robot, whichever, is not learned from, and is no background either.
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
