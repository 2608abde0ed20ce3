//! How well robots and ball are known: synthetic matches through the cores of all stages, offline,
//! scored against the truth.

use bytemuck::Zeroable;
use classifier::Classifier;
use common::config::Config;
use common::geometry::wrap_angle;
use common::messages::{
    DetectionFrame, FrameHeader, MAX_RUNS, RobotHypothesis, Run, RunsHeader, TruthRobot, WorldFrame,
};
use filter::Filter;
use grabber::synthetic::SyntheticMatch;
use nalgebra::{Matrix3, Vector3};
use std::collections::VecDeque;
use tracker::Tracker;

const START_NS: u64 = 5_000_000_000;
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
    let camera = &config.camera;
    let period_ns = (1e9 / camera.fps).round() as u64;
    let mut game = SyntheticMatch::new(config).unwrap();
    let mut classifier = Classifier::new(config).unwrap();
    let mut tracker = Tracker::new(config).unwrap();
    let mut filter = Filter::new(config).unwrap();
    let mut pixels = vec![0; (camera.width * camera.height) as usize];
    let mut runs = vec![Run::zeroed(); MAX_RUNS];
    let mut runs_header = RunsHeader::default();
    let mut seen = Box::new(DetectionFrame::zeroed());
    let mut world = Box::new(WorldFrame::zeroed());
    // What was predicted for frames to come.
    let mut predicted: VecDeque<(u64, Box<WorldFrame>)> = VecDeque::new();
    for seq in 0..frames {
        let header =
            FrameHeader { seq, t_capture_ns: START_NS + seq * period_ns, ..camera.frame_header() };
        game.render(&mut pixels, camera.width as usize);
        classifier.step(&header, &pixels, &mut runs_header, &mut runs).unwrap();
        let prior = (seq > 0).then_some(&*world);
        tracker.step(&runs_header, runs_header.valid(&runs), Some(&pixels), prior, &mut seen);
        // Predictions are for a command that leaves at once.
        seen.t_sent_ns = header.t_capture_ns;
        filter.step(&seen, &mut world);
        let mut commands = *game.commands();
        commands.seq = seq;
        commands.t_sent_ns = header.t_capture_ns;
        filter.command(&commands);
        if seq >= 40 {
            score(&game, &seen, &world, outcome);
            while predicted.front().is_some_and(|(for_seq, _)| *for_seq < seq) {
                predicted.pop_front();
            }
            if let Some((for_seq, before)) = predicted.front()
                && *for_seq == seq
            {
                score_predictions(&game, before, outcome);
            }
            let ahead_ns = world.t_predicted_ns - header.t_capture_ns;
            if ahead_ns.is_multiple_of(period_ns) {
                predicted.push_back((seq + ahead_ns / period_ns, world.clone()));
            }
        }
        game.advance();
    }
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

/// Innovations of the filter: how far detections are from what it predicted, in units of what it
/// said of its prediction and the tracker of the detection. A spare that sees nothing says what was
/// predicted.
fn innovations(config: &Config, frames: u64) -> Vec<f64> {
    let camera = &config.camera;
    let period_ns = (1e9 / camera.fps).round() as u64;
    let mut game = SyntheticMatch::new(config).unwrap();
    let mut classifier = Classifier::new(config).unwrap();
    let mut tracker = Tracker::new(config).unwrap();
    let mut filter = Filter::new(config).unwrap();
    let mut spare = Filter::new(config).unwrap();
    let mut pixels = vec![0; camera.frame_bytes()];
    let mut runs = vec![Run::zeroed(); MAX_RUNS];
    let mut runs_header = RunsHeader::default();
    let mut seen = Box::new(DetectionFrame::zeroed());
    let mut nothing = Box::new(DetectionFrame::zeroed());
    let mut world = Box::new(WorldFrame::zeroed());
    let mut predicted = Box::new(WorldFrame::zeroed());
    let mut innovations = Vec::new();
    let mut commands = None;
    for seq in 0..frames {
        let header =
            FrameHeader { seq, t_capture_ns: START_NS + seq * period_ns, ..camera.frame_header() };
        game.render(&mut pixels, camera.width as usize);
        classifier.step(&header, &pixels, &mut runs_header, &mut runs).unwrap();
        tracker.step(&runs_header, runs_header.valid(&runs), Some(&pixels), None, &mut seen);
        if seq > 0 {
            spare.resume(&world);
            commands.iter().for_each(|commands| spare.command(commands));
            nothing.frame = header;
            spare.step(&nothing, &mut predicted);
        }
        filter.step(&seen, &mut world);
        let mut sent = *game.commands();
        (sent.seq, sent.t_sent_ns) = (seq, header.t_capture_ns);
        filter.command(&sent);
        commands = Some(sent);
        for robot in seen.robots().iter().filter(|_| seq >= 80) {
            let name = (robot.team, robot.robot_id);
            let mut states = predicted.robots().iter().zip(&predicted.robot_memories);
            let before = states.find(|(state, _)| (state.team, state.robot_id) == name);
            let Some((_, memory)) = before else { continue };
            // The likeliest of the filter's hypotheses: their blend is no normal distribution.
            let by_probability = |a: &&RobotHypothesis, b: &&RobotHypothesis| {
                a.probability.total_cmp(&b.probability)
            };
            let likeliest = memory.hypotheses.iter().max_by(by_probability).unwrap();
            let [x_mm, y_mm, orientation, ..] = likeliest.mean;
            let off = Vector3::new(
                f64::from(robot.x_mm) - x_mm,
                f64::from(robot.y_mm) - y_mm,
                wrap_angle(f64::from(robot.orientation) - orientation),
            );
            let symmetric = |[xx, xy, xt, yy, yt, tt]: [f64; 6]| {
                Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt)
            };
            let noise = symmetric(robot.covariance.map(f64::from));
            // Rows of an upper triangle of five.
            let known = symmetric([0, 1, 2, 5, 6, 9].map(|index| likeliest.covariance[index]));
            let inverse = (noise + known).try_inverse().unwrap();
            innovations.push(off.dot(&(inverse * off)));
        }
        game.advance();
    }
    innovations
}

/// Of three numbers: they should be distributed as chi-square with three degrees of freedom, but for
/// collisions. They are smaller: a part of each error is the same in the next frame, and patches are
/// taken to be cut less exactly than painted ones are. What must not be is that more is claimed than
/// is known.
#[test]
fn innovations_are_within_what_is_claimed() {
    const CHI_SQUARE_95: f64 = 7.81;
    const CHI_SQUARE_99: f64 = 11.34;
    for speed in [1500.0, 2400.0] {
        let mut config = Config::default();
        config.synthetic.max_speed_mm_s = speed;
        let mut all = innovations(&config, 800);
        all.sort_by(f64::total_cmp);
        let at = |share: f64| all[(share * all.len() as f64) as usize];
        let [half, most, nearly_all] = [0.5, 0.95, 0.99].map(at);
        println!(
            "{speed} mm/s: innovations: median {half:.2}, 95 % {most:.2}, 99 % {nearly_all:.2}"
        );
        assert!(all.len() > 5000);
        assert!(most < CHI_SQUARE_95 && nearly_all < CHI_SQUARE_99, "{most} {nearly_all}");
        // Nor so much less that all weighing is for nothing: a fiftieth of what should be.
        assert!(half > 2.37 / 50.0, "{half}");
    }
}
