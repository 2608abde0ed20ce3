//! How well robots and ball are known: synthetic matches through the cores of all stages, offline,
//! scored against the truth.

mod offline;

use bytemuck::Zeroable;
use common::config::Config;
use common::geometry::wrap_angle;
use common::messages::{
    BallHypothesis, DetectionFrame, RobotHypothesis, TruthFrame, TruthRobot, WorldFrame,
};
use filter::Filter;
use grabber::synthetic::SyntheticMatch;
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};
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
    /// Those of `world`.
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
    // What was predicted for frames to come.
    let mut predicted: VecDeque<(u64, Box<WorldFrame>)> = VecDeque::new();
    offline.play(frames, |offline| {
        let (seq, world) = (offline.header.seq, &offline.world);
        if seq < 40 {
            return;
        }
        score(&offline.game, &offline.seen, world, outcome);
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
            predicted.push_back((seq + ahead_ns / offline.period_ns, world.clone()));
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
            .find(|robot| (robot.team, robot.robot_id) == (truth.team, truth.robot_id));
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

/// As fast as such robots are driven.
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

/// Rows are captured over two thirds of a frame period. What was measured is at the time of its row; what is
/// known, at the time of the frame.
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

/// A ball that is slower takes its error from one frame to the next.
const ROLLING_MM_S: f64 = 150.0;

/// Normalised squared errors: each is what something is off by in units of the covariance claimed for
/// it, summed over its components.
#[derive(Default)]
struct Consistency {
    /// Detections of robots that move, against the truth.
    seen: Vec<f64>,
    /// Detections of robots that have just come to stand, against the truth: one each, for as long
    /// as a robot stands its error is the same.
    seen_still: Vec<f64>,
    /// Innovations of the filter: detections of robots that move, against its prediction.
    innovations: Vec<f64>,
    /// `world` for robots that move, against the truth.
    known: Vec<f64>,
    /// Likewise of the ball: detections, and innovations while it rolls.
    ball_seen: Vec<f64>,
    ball_innovations: Vec<f64>,
}

impl Consistency {
    fn print(&mut self, what: &str) {
        let all = [
            ("seen", &mut self.seen),
            ("seen still", &mut self.seen_still),
            ("innovations", &mut self.innovations),
            ("known", &mut self.known),
            ("ball seen", &mut self.ball_seen),
            ("ball innovations", &mut self.ball_innovations),
        ];
        println!("{what}:");
        for (name, values) in all {
            values.sort_by(f64::total_cmp);
            let [half, most, nearly_all] = [0.5, 0.95, 0.99].map(|share| quantile(values, share));
            println!(
                "  {name:16} {:6}: mean {:.2}, median {half:.2}, 95 % {most:.2}, 99 % {nearly_all:.2}",
                values.len(),
                mean(values),
            );
        }
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn quantile(sorted: &[f64], share: f64) -> f64 {
    sorted.get((share * sorted.len() as f64) as usize).copied().unwrap_or(f64::NAN)
}

fn normalised<const N: usize>(off: SVector<f64, N>, covariance: SMatrix<f64, N, N>) -> f64 {
    off.dot(&covariance.cholesky().unwrap().solve(&off))
}

fn consistency(config: &Config, frames: u64) -> Consistency {
    let mut offline = Offline::new(config);
    // A spare that sees nothing says what was predicted.
    let mut spare = Filter::new(config).unwrap();
    let mut nothing = Box::new(DetectionFrame::zeroed());
    let mut predicted = Box::new(WorldFrame::zeroed());
    let mut outcome = Consistency::default();
    for seq in 0..frames {
        offline.look(|_| ());
        if seq > 0 {
            spare.resume(&offline.world);
            spare.command(&offline.commands);
            nothing.frame = offline.header;
            spare.step(&nothing, &mut predicted);
        }
        offline.think();
        if seq >= 80 {
            let Offline { game, seen, world, .. } = &offline;
            for truth in game.truth().robots().iter().filter(|robot| robot.visible != 0) {
                compare_robot(truth, seen, &predicted, world, &mut outcome);
            }
            compare_ball(game.truth(), seen, &predicted, &mut outcome);
        }
        offline.advance();
    }
    outcome
}

fn compare_robot(
    truth: &TruthRobot,
    seen: &DetectionFrame,
    predicted: &WorldFrame,
    world: &WorldFrame,
    outcome: &mut Consistency,
) {
    let name = (truth.team, truth.robot_id);
    let place = |world: &WorldFrame| {
        world.robots().iter().position(|state| (state.team, state.robot_id) == name)
    };
    let Some(robot) = seen.robots().iter().find(|robot| (robot.team, robot.robot_id) == name)
    else {
        return;
    };
    let (Some(before), Some(after)) = (place(predicted), place(world)) else { return };
    let off = |[x_mm, y_mm, orientation]: [f64; 3], from: [f64; 3]| {
        Vector3::new(x_mm - from[0], y_mm - from[1], wrap_angle(orientation - from[2]))
    };
    let symmetric =
        |[xx, xy, xt, yy, yt, tt]: [f64; 6]| Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt);
    let measured = [robot.x_mm, robot.y_mm, robot.orientation].map(f64::from);
    let noise = symmetric(robot.covariance.map(f64::from));
    let really = [truth.x_mm, truth.y_mm, truth.orientation];
    if truth.frames_still == 5 {
        outcome.seen_still.push(normalised(off(measured, really), noise));
    }
    if truth.frames_still > 0 {
        return;
    }
    outcome.seen.push(normalised(off(measured, really), noise));
    // The likeliest of the filter's hypotheses: their blend is no normal distribution.
    let by_probability =
        |a: &&RobotHypothesis, b: &&RobotHypothesis| a.probability.total_cmp(&b.probability);
    let memory = &predicted.robot_memories[before];
    let likeliest = memory.hypotheses.iter().max_by(by_probability).unwrap();
    let [x_mm, y_mm, orientation, ..] = likeliest.mean;
    // Rows of an upper triangle of five.
    let known = symmetric([0, 1, 2, 5, 6, 9].map(|index| likeliest.covariance[index]));
    let innovation = off(measured, [x_mm, y_mm, orientation]);
    outcome.innovations.push(normalised(innovation, noise + known));
    let state = &world.robots()[after];
    let known = Matrix3::from_fn(|row, column| state.covariance[row * 5 + column]);
    let state = [state.x_mm, state.y_mm, state.orientation];
    outcome.known.push(normalised(off(state, really), known));
}

fn compare_ball(
    truth: &TruthFrame,
    seen: &DetectionFrame,
    predicted: &WorldFrame,
    outcome: &mut Consistency,
) {
    let Some(ball) = seen.balls().first() else { return };
    let measured = Vector2::new(f64::from(ball.x_mm), f64::from(ball.y_mm));
    let off = measured - Vector2::new(truth.ball_x_mm, truth.ball_y_mm);
    if truth.ball_visible == 0 || off.norm() > 20.0 || predicted.ball.status == 0 {
        return;
    }
    let [xx, xy, yy] = ball.covariance.map(f64::from);
    let noise = Matrix2::new(xx, xy, xy, yy);
    outcome.ball_seen.push(normalised(off, noise));
    if truth.ball_vx_mm_s.hypot(truth.ball_vy_mm_s) < ROLLING_MM_S {
        return;
    }
    let by_probability =
        |a: &&BallHypothesis, b: &&BallHypothesis| a.probability.total_cmp(&b.probability);
    let likeliest = predicted.ball_memory.hypotheses.iter().max_by(by_probability).unwrap();
    let [x_mm, y_mm, ..] = likeliest.mean;
    // Rows of an upper triangle of four.
    let [xx, xy, yy] = [0, 1, 4].map(|index| likeliest.covariance[index]);
    let known = Matrix2::new(xx, xy, xy, yy);
    outcome.ball_innovations.push(normalised(measured - Vector2::new(x_mm, y_mm), noise + known));
}

/// Normalised squared errors should be distributed as chi-square, on both sides. Detections claim a
/// little more error than they have, as patches of real robots are less exact than painted ones.
#[test]
fn detections_are_as_exact_as_they_claim() {
    let config = Config::default();
    let mut outcome = consistency(&config, 1200);
    outcome.print("as told");
    assert!(outcome.seen.len() > 5000 && outcome.seen_still.len() > 30);
    for seen in [&outcome.seen, &outcome.seen_still] {
        // 3, 7.81
        let (mean, most) = (mean(seen), quantile(seen, 0.95));
        assert!((1.4..3.5).contains(&mean), "{mean}");
        assert!((3.5..9.0).contains(&most), "{most}");
    }
    // 2, 5.99. A ball has few edges, and tells less of how well they fit together.
    let (mean, most) = (mean(&outcome.ball_seen), quantile(&outcome.ball_seen, 0.95));
    assert!((0.8..2.8).contains(&mean), "{mean}");
    assert!((3.0..10.0).contains(&most), "{most}");
    // The filter allows for slip, of which there is none here: innovations are small.
    assert!(quantile(&outcome.innovations, 0.95) < 3.0);
}

/// With robots that slip as the filter expects of real ones, innovations are chi-square too. Means are
/// no good test of that: in a collision a robot does for a frame what no command says, and one such
/// innovation is as large as a thousand others.
#[test]
fn innovations_are_as_large_as_the_filter_claims() {
    for (speed, seed) in [(1500.0, 1), (1500.0, 2), (2400.0, 3)] {
        let mut config = Config::default();
        config.synthetic.max_speed_mm_s = speed;
        config.synthetic.seed = seed;
        config.synthetic.slip = 1.0;
        let mut outcome = consistency(&config, 1000);
        outcome.print(&format!("{speed} mm/s, slip, seed {seed}"));
        assert!(outcome.innovations.len() > 3000);
        // 2.37, 7.81, 11.34
        let [half, most, nearly_all] =
            [0.5, 0.95, 0.99].map(|share| quantile(&outcome.innovations, share));
        assert!((1.6..2.8).contains(&half), "{half}");
        assert!((5.5..9.0).contains(&most), "{most}");
        assert!((8.0..16.0).contains(&nearly_all), "{nearly_all}");
        // 2.37: what goes out in `world`.
        let half = quantile(&outcome.known, 0.5);
        assert!((1.2..2.8).contains(&half), "{half}");
        // Of the ball only that it is not off by more than is claimed: a painted one rolls more evenly
        // than any real one. 5.99
        let most = quantile(&outcome.ball_innovations, 0.95);
        assert!(most < 5.99, "{most}");
    }
}
