//! Scores poses against the truth of a synthetic match.

use control::report::{Errors, StandingErrors};
use geometry::wrap_angle;
use hdrhistogram::Histogram;
use messages::{TruthFrame, TruthRobot};

/// A robot as reported by a message.
#[derive(Debug, Clone, Copy)]
pub struct ReportedRobot {
    /// Team number.
    pub team: u32,
    /// Number in the team.
    pub robot_id: u32,
    /// Position on the field.
    pub x_mm: f64,
    /// Position on the field.
    pub y_mm: f64,
    /// Heading, radians.
    pub orientation: f64,
}

/// Largest distance at which a report still belongs to a robot.
const SAME_ROBOT_MM: f64 = 40.0;
/// Largest distance at which a report still belongs to the ball.
const SAME_BALL_MM: f64 = 40.0;
/// Frames a robot must stand still before it counts as standing: half a second at 80 frames a
/// second, after which the filter has settled.
const STANDING_FRAMES: u32 = 40;

/// Collects errors over a run.
#[derive(Debug)]
pub struct Scorer {
    expected: u64,
    found: u64,
    wrong: u64,
    all: PoseErrors,
    standing: PoseErrors,
    ball_expected: u64,
    ball: Distribution,
}

impl Default for Scorer {
    /// Nothing scored yet.
    fn default() -> Self {
        Self {
            expected: 0,
            found: 0,
            wrong: 0,
            all: PoseErrors::new(),
            standing: PoseErrors::new(),
            ball_expected: 0,
            ball: Distribution::new(),
        }
    }
}

impl Scorer {
    /// Scores one frame.
    pub fn score(&mut self, truth: &TruthFrame, robots: &[ReportedRobot], ball: Option<[f64; 2]>) {
        self.expected += truth.robots().iter().filter(|robot| robot.visible != 0).count() as u64;
        for robot in robots {
            let same = |truth: &&TruthRobot| {
                (truth.team, truth.robot_id) == (robot.team, robot.robot_id)
                    && (truth.x_mm - robot.x_mm).hypot(truth.y_mm - robot.y_mm) < SAME_ROBOT_MM
            };
            let Some(truth) = truth.robots().iter().find(same) else {
                self.wrong += 1;
                continue;
            };
            self.found += u64::from(truth.visible != 0);
            self.all.add(truth, robot);
            if truth.frames_still >= STANDING_FRAMES {
                self.standing.add(truth, robot);
            }
        }
        if truth.ball_visible != 0 {
            self.ball_expected += 1;
            let distance = ball.map(|[x, y]| (truth.ball_x_mm - x).hypot(truth.ball_y_mm - y));
            if let Some(distance) = distance.filter(|&distance| distance < SAME_BALL_MM) {
                self.ball.add(distance);
            }
        }
    }

    /// The errors so far; `None` when nothing was scored.
    pub fn errors(&self) -> Option<Errors> {
        let ratio =
            |part: u64, whole: u64| if whole == 0 { 0.0 } else { part as f64 / whole as f64 };
        (self.expected > 0).then(|| Errors {
            found_ratio: ratio(self.found, self.expected),
            wrong_identity: self.wrong,
            position_rms_mm: self.all.position.rms(),
            position_p99_mm: self.all.position.p99(),
            heading_rms_deg: self.all.heading.rms(),
            heading_p99_deg: self.all.heading.p99(),
            standing: StandingErrors {
                samples: self.standing.position.count(),
                position_rms_mm: self.standing.position.rms(),
                position_p99_mm: self.standing.position.p99(),
                position_max_mm: self.standing.position.max(),
                heading_rms_deg: self.standing.heading.rms(),
                heading_p99_deg: self.standing.heading.p99(),
                heading_max_deg: self.standing.heading.max(),
            },
            ball_found_ratio: ratio(self.ball.count(), self.ball_expected),
            ball_rms_mm: self.ball.rms(),
        })
    }
}

#[derive(Debug)]
struct PoseErrors {
    position: Distribution,
    heading: Distribution,
}

impl PoseErrors {
    fn new() -> Self {
        Self { position: Distribution::new(), heading: Distribution::new() }
    }

    fn add(&mut self, truth: &TruthRobot, robot: &ReportedRobot) {
        self.position.add((truth.x_mm - robot.x_mm).hypot(truth.y_mm - robot.y_mm));
        self.heading.add(wrap_angle(truth.orientation - robot.orientation).abs().to_degrees());
    }
}

/// Statistics of non-negative errors, in millimetres or degrees.
#[derive(Debug)]
pub(super) struct Distribution {
    sum_of_squares: f64,
    /// Errors in thousandths of a unit.
    histogram: Histogram<u64>,
}

impl Distribution {
    pub fn new() -> Self {
        let histogram = Histogram::new_with_max(1_000_000, 3).expect("these bounds are allowed");
        Self { sum_of_squares: 0.0, histogram }
    }

    pub fn add(&mut self, error: f64) {
        self.sum_of_squares += error * error;
        self.histogram.saturating_record((error * 1000.0) as u64);
    }

    fn count(&self) -> u64 {
        self.histogram.len()
    }

    pub fn rms(&self) -> f64 {
        (self.sum_of_squares / self.count().max(1) as f64).sqrt()
    }

    pub fn p99(&self) -> f64 {
        self.histogram.value_at_quantile(0.99) as f64 / 1000.0
    }

    fn max(&self) -> f64 {
        self.histogram.max() as f64 / 1000.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn truth() -> TruthFrame {
        let mut truth = TruthFrame::zeroed();
        for (id, x_mm) in [(0, 0.0), (1, 100.0)] {
            truth.robots[id as usize] = TruthRobot {
                robot_id: id,
                x_mm,
                visible: 1,
                frames_still: 100,
                ..Default::default()
            };
        }
        truth.robot_count = 2;
        truth.ball_visible = 1;
        truth
    }

    fn robot(robot_id: u32, x_mm: f64) -> ReportedRobot {
        ReportedRobot { team: 0, robot_id, x_mm, y_mm: 0.0, orientation: 0.1 }
    }

    #[test]
    fn errors_are_measured_against_the_right_robot() {
        let mut scorer = Scorer::default();
        scorer.score(&truth(), &[robot(0, 3.0), robot(1, 104.0)], Some([0.0, 2.0]));
        let errors = scorer.errors().unwrap();
        assert_eq!((errors.found_ratio, errors.wrong_identity), (1.0, 0));
        assert!((errors.position_rms_mm - 12.5f64.sqrt()).abs() < 1e-9);
        assert!((errors.heading_rms_deg - 0.1f64.to_degrees()).abs() < 1e-9);
        assert_eq!((errors.standing.samples, errors.ball_found_ratio), (2, 1.0));
        assert!((errors.ball_rms_mm - 2.0).abs() < 1e-9);
    }

    #[test]
    fn swapped_identities_are_wrong_and_not_found() {
        let mut scorer = Scorer::default();
        scorer.score(&truth(), &[robot(1, 0.0), robot(0, 100.0)], None);
        let errors = scorer.errors().unwrap();
        assert_eq!((errors.found_ratio, errors.wrong_identity), (0.0, 2));
        assert_eq!(errors.ball_found_ratio, 0.0);
    }
}
