//! Accuracy of robots and ball: synthetic matches through the cores of all stages, offline, scored
//! against the truth.

mod offline;

use config::Config;
use geometry::wrap_angle;
use grabber::synthetic::SyntheticMatch;
use messages::{DetectionFrame, TruthRobot, WorldFrame};
use offline::Offline;
use std::collections::VecDeque;

/// Half a second, as in the report.
const STANDING_FRAMES: u32 = 40;

/// Errors of poses.
#[derive(Default)]
struct Errors {
    position_mm: Vec<f64>,
    heading_deg: Vec<f64>,
}

impl Errors {
    fn add(&mut self, truth: &TruthRobot, x_mm: f64, y_mm: f64, orientation: f64) {
        self.position_mm.push((x_mm - truth.x_mm).hypot(y_mm - truth.y_mm));
        self.heading_deg.push(wrap_angle(orientation - truth.orientation).abs().to_degrees());
    }

    fn rms(&self) -> [f64; 2] {
        [&self.position_mm, &self.heading_deg].map(|values| {
            let squares: f64 = values.iter().map(|value| value * value).sum();
            (squares / values.len().max(1) as f64).sqrt()
        })
    }

    fn greatest(&self) -> [f64; 2] {
        [&self.position_mm, &self.heading_deg]
            .map(|values| values.iter().copied().fold(0.0, f64::max))
    }

    fn text(&self) -> String {
        let ([mm, deg], [most_mm, most_deg]) = (self.rms(), self.greatest());
        format!("rms {mm:.3} mm {deg:.3}° max {most_mm:.2} {most_deg:.2}")
    }
}

#[derive(Default)]
struct Outcome {
    expected: u64,
    found: u64,
    seen: Errors,
    seen_still: Errors,
    known: Errors,
    known_still: Errors,
    predicted: Errors,
    ball_mm: Vec<f64>,
    /// Squared errors of detections in units of their covariance, one dimension at a time.
    normalised: [f64; 3],
    /// The same for `world`.
    known_normalised: f64,
}

impl Outcome {
    fn print(&self, what: &str) {
        let count = self.seen.position_mm.len().max(1) as f64;
        let normalised = self.normalised.map(|sum| (sum / count * 100.0).round() / 100.0);
        let ball: f64 = self.ball_mm.iter().map(|mm| mm * mm).sum::<f64>();
        println!(
            "{what}: found {}/{}\n  seen        {}\n  seen still  {}\n  known       {}\n  \
             known still {}\n  predicted   {}\n  normalised {normalised:?}, known {:.2}, ball rms {:.3} mm",
            self.found,
            self.expected,
            self.seen.text(),
            self.seen_still.text(),
            self.known.text(),
            self.known_still.text(),
            self.predicted.text(),
            self.known_normalised / count,
            (ball / self.ball_mm.len().max(1) as f64).sqrt()
        );
    }
}

fn play(config: &Config, seeds: std::ops::Range<u64>, frames: u64) -> Outcome {
    let mut outcome = Outcome::default();
    for seed in seeds {
        let mut config = config.clone();
        config.synthetic.seed = seed;
        play_one(&config, frames, &mut outcome);
    }
    outcome
}

fn play_one(config: &Config, frames: u64, outcome: &mut Outcome) {
    let mut offline = Offline::new(config);
    // Predictions for later frames.
    let mut predicted: VecDeque<(u64, Box<WorldFrame>)> = VecDeque::new();
    offline.play(frames, |offline| {
        let (seq, world) = (offline.header.seq, offline.world());
        if seq < 40 {
            return;
        }
        score(&offline.game, offline.seen(), world, outcome);
        while predicted.front().is_some_and(|(for_seq, _)| *for_seq < seq) {
            predicted.pop_front();
        }
        if let Some((for_seq, before)) = predicted.front()
            && *for_seq == seq
        {
            score_predictions(&offline.game, before, outcome);
        }
        let ahead_ns = world.t_predicted_ns - offline.header.t_capture_ns;
        if ahead_ns.is_multiple_of(offline.period_ns) {
            predicted.push_back((seq + ahead_ns / offline.period_ns, Box::new(*world)));
        }
    });
}

fn score(game: &SyntheticMatch, seen: &DetectionFrame, world: &WorldFrame, outcome: &mut Outcome) {
    for truth in game.truth().robots().iter().filter(|robot| robot.visible != 0) {
        let is_still = truth.frames_still >= STANDING_FRAMES;
        outcome.expected += 1;
        let robot = seen
            .robots()
            .iter()
            .find(|robot| (robot.team, robot.robot_id) == (truth.team, truth.robot_id.into()));
        if let Some(robot) = robot {
            outcome.found += 1;
            let pose = [robot.x_mm, robot.y_mm, robot.orientation].map(f64::from);
            outcome.seen.add(truth, pose[0], pose[1], pose[2]);
            if is_still {
                outcome.seen_still.add(truth, pose[0], pose[1], pose[2]);
            }
            let off = [
                pose[0] - truth.x_mm,
                pose[1] - truth.y_mm,
                wrap_angle(pose[2] - truth.orientation),
            ];
            for (axis, term) in [0, 3, 5].into_iter().enumerate() {
                outcome.normalised[axis] += off[axis].powi(2) / f64::from(robot.covariance[term]);
            }
        }
        let state = world
            .robots()
            .iter()
            .find(|robot| (robot.team, robot.robot_id) == (truth.team, truth.robot_id));
        if let Some(state) = state {
            outcome.known.add(truth, state.x_mm, state.y_mm, state.orientation);
            if is_still {
                outcome.known_still.add(truth, state.x_mm, state.y_mm, state.orientation);
            }
            let off = [
                state.x_mm - truth.x_mm,
                state.y_mm - truth.y_mm,
                wrap_angle(state.orientation - truth.orientation),
            ];
            outcome.known_normalised +=
                (0..3).map(|axis| off[axis].powi(2) / state.covariance[6 * axis]).sum::<f64>();
        }
    }
    if game.truth().ball_visible != 0
        && let Some(ball) = seen.balls().first()
    {
        let (x, y) = (f64::from(ball.x_mm), f64::from(ball.y_mm));
        let off = (x - game.truth().ball_x_mm).hypot(y - game.truth().ball_y_mm);
        if off < 20.0 {
            outcome.ball_mm.push(off);
        }
    }
}

fn score_predictions(game: &SyntheticMatch, before: &WorldFrame, outcome: &mut Outcome) {
    for truth in game.truth().robots() {
        let state = before
            .robots()
            .iter()
            .find(|robot| (robot.team, robot.robot_id) == (truth.team, truth.robot_id));
        if let Some(state) = state {
            outcome.predicted.add(
                truth,
                state.predicted_x_mm,
                state.predicted_y_mm,
                state.predicted_orientation,
            );
        }
    }
}

#[test]
fn robots_are_known_to_a_fraction_of_a_millimetre() {
    let outcome = play(&Config::default(), 1..4, 400);
    outcome.print("5v5");
    assert_eq!(outcome.found, outcome.expected);
    assert!(outcome.seen_still.position_mm.len() > 500);
    let ([mm, deg], [most_mm, most_deg]) =
        (outcome.seen_still.rms(), outcome.seen_still.greatest());
    assert!(mm < 0.15 && deg < 0.2, "{mm} mm {deg}°");
    assert!(most_mm < 0.5 && most_deg < 0.6, "{most_mm} mm {most_deg}°");
    let [mm, deg] = outcome.known_still.rms();
    assert!(mm < 0.1 && deg < 0.15, "{mm} mm {deg}°");
    let [mm, deg] = outcome.known.rms();
    assert!(mm < 0.5 && deg < 0.4, "{mm} mm {deg}°");
    let [mm, deg] = outcome.predicted.rms();
    assert!(mm < 5.0 && deg < 3.0, "{mm} mm {deg}°");
}

/// At the highest speed of such robots.
#[test]
fn fast_robots_are_known_and_predicted() {
    let mut config = Config::default();
    config.synthetic.max_speed_mm_s = 2400.0;
    let outcome = play(&config, 1..4, 800);
    outcome.print("2.4 m/s");
    assert!(outcome.found as f64 >= 0.999 * outcome.expected as f64);
    let [mm, deg] = outcome.known.rms();
    assert!(mm < 1.5 && deg < 1.0, "{mm} mm {deg}°");
    let [mm, deg] = outcome.predicted.rms();
    assert!(mm < 5.0 && deg < 3.0, "{mm} mm {deg}°");
}

/// The rows are captured over two thirds of a frame period. Measurements are at the time of their row;
/// `world` is at the time of the frame.
#[test]
fn a_rolling_shutter_costs_nothing() {
    let mut config = Config::default();
    config.synthetic.max_speed_mm_s = 2400.0;
    config.camera.rolling_shutter_us = 8000;
    let outcome = play(&config, 1..3, 400);
    outcome.print("rolling shutter");
    assert!(outcome.found as f64 >= 0.999 * outcome.expected as f64);
    let ([mm, _], [known_mm, known_deg]) = (outcome.seen.rms(), outcome.known.rms());
    assert!(mm > 0.5, "{mm} mm");
    assert!(known_mm < 0.3 && known_deg < 0.3, "{known_mm} mm {known_deg}°");
}
