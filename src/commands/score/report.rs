//! The scores of all pictures together: as JSON and as text.

use offline::scoring::{BallOutcome, Offset, Outcome, PictureScore, RobotVerdict, Tolerances};
use serde::Serialize;
use std::fmt::Write as _;
use touchline::top_scale::Scale;

/// The output of `--json`. The names are part of the program's interface.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Tolerances of a correct detection.
    pub tolerances: Tolerances,
    pub pictures: Vec<PictureScore>,
    pub total: Total,
    #[serde(skip)]
    pub tops: Option<Scale>,
}

/// All pictures together.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Total {
    /// Robots labelled clear; each is counted in one of the next four.
    pub robots: usize,
    pub right: usize,
    pub inaccurate: usize,
    pub wrong_identity: usize,
    pub missed: usize,
    /// Robots found where none is labelled.
    pub phantoms: usize,
    /// Over the robots found under their right identity.
    pub position_rms_px: Option<f64>,
    pub heading_rms_deg: Option<f64>,
    /// Balls labelled clear.
    pub balls: usize,
    pub balls_right: usize,
    /// Balls found in pictures without one.
    pub ball_phantoms: usize,
    /// Over the balls found within the tolerance.
    pub ball_rms_px: Option<f64>,
    /// Median ratio of the robots' tops to the configured layout.
    pub top_scale: Option<f64>,
}

impl Report {
    pub fn new(pictures: Vec<PictureScore>, tolerances: Tolerances, tops: Option<Scale>) -> Self {
        let top_scale = tops.map(|tops| (tops.scale * 1e3).round() / 1e3);
        let total = Total { top_scale, ..Total::of(&pictures) };
        Self { tolerances, pictures, total, tops }
    }

    /// The same as text.
    pub fn text(&self) -> String {
        let mut text = String::new();
        for picture in &self.pictures {
            picture_text(picture, &mut text);
        }
        let total = &self.total;
        let Tolerances { robot_px, robot_deg, ball_px } = self.tolerances;
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "all {} pictures: {} of {} robots right ({:.1} %, within {robot_px} px and {robot_deg}°), \
             {} inaccurate, {} taken for another, {} missed, {} phantoms",
            self.pictures.len(),
            total.right,
            total.robots,
            100.0 * total.right as f64 / total.robots.max(1) as f64,
            total.inaccurate,
            total.wrong_identity,
            total.missed,
            total.phantoms
        );
        if let (Some(px), Some(deg)) = (total.position_rms_px, total.heading_rms_deg) {
            let _ = writeln!(text, "  errors, rms: {px:.2} px, {deg:.2}°");
        }
        let _ = write!(text, "  balls: {} of {} right", total.balls_right, total.balls);
        let _ = match total.ball_rms_px {
            Some(px) => writeln!(text, " (within {ball_px} px; rms {px:.2} px)"),
            None => writeln!(text),
        };
        if let Some(measured) = self.tops.filter(Scale::is_off) {
            let _ = writeln!(text, "  {}", measured.advice());
        }
        text
    }
}

impl Total {
    fn of(pictures: &[PictureScore]) -> Self {
        let robots = || pictures.iter().flat_map(|picture| &picture.robots);
        let count = |outcome| robots().filter(|robot| robot.outcome == outcome).count();
        let own = robots().filter(|robot| {
            matches!(robot.outcome, Outcome::Right | Outcome::Inaccurate) && robot.off.is_some()
        });
        let offsets: Vec<Offset> = own.filter_map(|robot| robot.off).collect();
        let balls = || pictures.iter().filter_map(|picture| picture.ball.as_ref());
        let is = |outcome: BallOutcome| balls().filter(move |ball| ball.outcome == outcome);
        Self {
            robots: robots().count(),
            right: count(Outcome::Right),
            inaccurate: count(Outcome::Inaccurate),
            wrong_identity: count(Outcome::WrongIdentity),
            missed: count(Outcome::Missed),
            phantoms: pictures.iter().map(|picture| picture.phantoms.len()).sum(),
            position_rms_px: rms(offsets.iter().map(|off| off.px)),
            heading_rms_deg: rms(offsets.iter().map(|off| off.deg)),
            balls: is(BallOutcome::Right).count()
                + is(BallOutcome::Far).count()
                + is(BallOutcome::Missed).count(),
            balls_right: is(BallOutcome::Right).count(),
            ball_phantoms: is(BallOutcome::Phantom).count(),
            ball_rms_px: rms(is(BallOutcome::Right).filter_map(|ball| ball.off_px)),
            top_scale: None,
        }
    }
}

/// Root mean square; `None` without values.
fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, sum) = values.fold((0u32, 0.0), |(n, sum), value| (n + 1, sum + value * value));
    (count > 0).then(|| ((sum / f64::from(count)).sqrt() * 1000.0).round() / 1000.0)
}

fn picture_text(picture: &PictureScore, text: &mut String) {
    let right = picture.robots.iter().filter(|robot| robot.outcome == Outcome::Right).count();
    let _ = write!(text, "{}: {right} of {} robots right", picture.image, picture.robots.len());
    let ball = picture.ball.as_ref();
    let off = ball.and_then(|ball| ball.off_px).unwrap_or_default();
    let _ = match ball.map(|ball| ball.outcome) {
        None => writeln!(text),
        Some(BallOutcome::Right) => writeln!(text, ", ball {off:.1} px off"),
        Some(BallOutcome::Far) => writeln!(text, ", ball wrong: {off:.1} px off"),
        Some(BallOutcome::Missed) => writeln!(text, ", ball missed"),
        Some(BallOutcome::Phantom) => writeln!(text, ", a ball where there is none"),
        Some(BallOutcome::Absent) => writeln!(text, ", no ball, as it should be"),
    };
    for robot in picture.robots.iter().filter(|robot| robot.outcome != Outcome::Right) {
        robot_text(robot, text);
    }
    for phantom in &picture.phantoms {
        let _ = writeln!(
            text,
            "  {:<6} {:>2} at {:5.1}, {:5.1}: found, and nobody is there",
            phantom.team.name(),
            phantom.id,
            phantom.x_px,
            phantom.y_px
        );
    }
    if let Some(reason) = ball.and_then(|ball| ball.reason.as_ref()) {
        let _ = writeln!(text, "  ball: {reason}");
    }
}

fn robot_text(robot: &RobotVerdict, text: &mut String) {
    let off = robot.off.unwrap_or(Offset { px: 0.0, deg: 0.0 });
    let what = match (robot.outcome, robot.taken_for) {
        (Outcome::WrongIdentity, Some(name)) => {
            format!(
                "taken for {} {} ({:.1} px, {:.1}° off)",
                name.team.name(),
                name.id,
                off.px,
                off.deg
            )
        }
        (Outcome::Missed, _) => {
            format!("missed; {}", robot.reason.as_deref().unwrap_or("no reason known"))
        }
        _ => format!("{:.1} px, {:.1}° off", off.px, off.deg),
    };
    let colors: Vec<String> =
        robot.colors_seen.iter().map(|(color, pixels)| format!("{color} {pixels}")).collect();
    let colors = if colors.is_empty() { "none".into() } else { colors.join(", ") };
    let _ = writeln!(
        text,
        "  {:<6} {:>2} at {:5.1}, {:5.1}: {what}; colours seen: {colors}",
        robot.team.name(),
        robot.id,
        robot.x_px,
        robot.y_px
    );
}
