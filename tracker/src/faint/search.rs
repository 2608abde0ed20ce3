//! The search for the pose and blur with which a robot explains the picture around a seed.

use super::Wearer;
use super::mixture::{Blur, Match, Mixture, Samples};
use crate::pattern::Top;
use crate::regions::measure::distance_mm;
use geometry::{FieldPoint, Pose, wrap_angle};

/// Headings of the first scan.
const HEADINGS: usize = 24;
/// Headings that a wide search descends from, and the least angle between them.
const BEGINNINGS: usize = 3;
const APART_DEG: f64 = 30.0;
/// First steps of the descent (the length as a multiple of a robot's size), and how often they are halved.
const STEP_SIZES: f64 = 0.06;
const STEP_DEG: f64 = 8.0;
const HALVINGS: u32 = 4;
/// Most poses tried in one descent.
const TRIALS_EACH: u32 = 80;
/// Directions of motion in the first scan of a wide search, and half of its length as a multiple of a
/// robot's size.
pub(super) const DIRECTIONS: usize = 4;
const FIRST_WAY_SIZES: f64 = 0.2;
/// Longest motion blur, as a multiple of a robot's size.
const LONGEST_WAY_SIZES: f64 = 0.8;
/// Explained fraction of the variation that ends a search.
const WELL_EXPLAINED: f64 = 0.95;
/// Explained fraction of the best heading below which there is no robot: specks of a team's colour reach 0.35
/// to 0.6, the darkest robots that are told apart 0.62.
pub(super) const PROMISING: f64 = 0.45;

/// How widely a seed is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Effort {
    /// With the blur of the last robot that was found, from one heading.
    Once,
    /// With other blurs too, from several headings.
    Widely,
}

/// Changes of a pose that a descent tries in a round. Each length of the steps has at least one round, also
/// after [`TRIALS_EACH`].
const CHANGES: u32 = 12;
const MOST_OF_A_DESCENT: u32 = TRIALS_EACH + CHANGES * (HALVINGS + 1);

impl Effort {
    /// Most poses that a search tries.
    pub const fn most_trials(self) -> u32 {
        let headings = HEADINGS as u32;
        let once = headings + MOST_OF_A_DESCENT;
        match self {
            Self::Once => once,
            Self::Widely => {
                let blurs = 1 + DIRECTIONS as u32;
                once + headings * blurs + BEGINNINGS as u32 * MOST_OF_A_DESCENT
            }
        }
    }
}

/// Blurs that searches begin with: out of focus, and moving in each direction.
pub(super) fn beginnings(size_mm: f64) -> [Blur; 1 + DIRECTIONS] {
    let mut blurs = [Blur { sigma: Mixture::SIGMA_COUNT / 2, ..Blur::default() }; 1 + DIRECTIONS];
    let way_mm = FIRST_WAY_SIZES * size_mm;
    for (direction, blur) in blurs[1..].iter_mut().enumerate() {
        let (sin, cos) = (direction as f64 / DIRECTIONS as f64 * std::f64::consts::PI).sin_cos();
        *blur = Blur { sigma: 1, way_mm: [way_mm * cos, way_mm * sin] };
    }
    blurs
}

/// A pose and blur, and how well a robot explains the picture there.
#[derive(Debug, Clone, Copy)]
pub(super) struct Trial {
    pub pose: Pose,
    pub blur: Blur,
    pub matched: Match,
}

/// A heading with its best blur: cost, heading, blur.
type Scanned = (f64, f64, Blur);

/// A search for pose and blur, for all robots of a group at once.
pub(super) struct Search<'a> {
    pub mixture: &'a Mixture,
    pub samples: &'a mut Samples,
    pub top: &'a Top,
    pub size_mm: f64,
    pub wearers: &'a [Wearer],
    pub seed: FieldPoint,
    pub best: &'a mut Vec<Trial>,
    pub trials: u32,
}

impl Search<'_> {
    /// The wearer that explains the picture best, and its trial; `best` has the trials of all wearers.
    pub fn run(&mut self, blur: Blur, effort: Effort) -> Option<(usize, Trial)> {
        let nothing = Match { cost: f64::INFINITY, explained: 0.0, brightness: 0.0 };
        self.best.clear();
        let trial = Trial { pose: Pose::default(), blur, matched: nothing };
        self.best.resize(self.wearers.len(), trial);
        // Robots of one picture mostly have the same blur.
        let scanned = self.scan(&[blur]);
        let is_promising = |trial: &Trial| trial.matched.explained >= PROMISING;
        if effort == Effort::Once && !self.best().is_some_and(|(_, trial)| is_promising(&trial)) {
            return self.best();
        }
        self.descend_from_best(scanned, 1);
        let is_explained = |trial: &Trial| trial.matched.explained >= WELL_EXPLAINED;
        let is_over =
            effort == Effort::Once || self.best().is_some_and(|(_, trial)| is_explained(&trial));
        if !is_over {
            let blurs = beginnings(self.size_mm);
            let scanned = self.scan(&blurs);
            self.descend_from_best(scanned, BEGINNINGS);
        }
        self.best()
    }

    /// The wearer that explains the picture best so far.
    fn best(&self) -> Option<(usize, Trial)> {
        let trials = self.best.iter().copied().enumerate();
        let tried = trials.filter(|(_, trial)| trial.matched.cost.is_finite());
        tried.min_by(|a, b| a.1.matched.cost.total_cmp(&b.1.matched.cost))
    }

    /// Tries all headings with these blurs. Returns each heading with its best blur, the least cost first.
    fn scan(&mut self, blurs: &[Blur]) -> [Scanned; HEADINGS] {
        let mut scanned = [(f64::INFINITY, 0.0, Blur::default()); HEADINGS];
        for (index, scanned) in scanned.iter_mut().enumerate() {
            let heading = index as f64 / HEADINGS as f64 * std::f64::consts::TAU;
            for &blur in blurs {
                let cost = self.try_at(self.pose(heading), blur);
                if cost < scanned.0 {
                    *scanned = (cost, heading, blur);
                }
            }
        }
        scanned.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        scanned
    }

    /// Descends from the best `beginnings` headings.
    fn descend_from_best(&mut self, scanned: [Scanned; HEADINGS], beginnings: usize) {
        let mut begun = [f64::NAN; BEGINNINGS];
        let mut count = 0;
        for (cost, heading, blur) in scanned {
            let is_apart =
                |other: &f64| wrap_angle(heading - other).abs().to_degrees() >= APART_DEG;
            if count < beginnings && cost.is_finite() && begun[..count].iter().all(is_apart) {
                begun[count] = heading;
                count += 1;
                self.descend(self.pose(heading), blur, cost);
            }
        }
    }

    /// The pose with this heading that puts the team patch on the seed.
    fn pose(&self, heading: f64) -> Pose {
        let turned = Pose { position: FieldPoint::default(), orientation: heading };
        let patch = &self.top.patches[self.top.team_patch];
        let offset = turned.field_from_robot(patch.centroid_mm);
        let position = FieldPoint::new(self.seed.x_mm - offset.x_mm, self.seed.y_mm - offset.y_mm);
        Pose { position, ..turned }
    }

    /// Coordinate descent of the cost over place, heading and blur, with steps that are halved.
    fn descend(&mut self, pose: Pose, blur: Blur, cost: f64) {
        let (mut pose, mut blur, mut cost) = (pose, blur, cost);
        let end = self.trials + TRIALS_EACH;
        for halving in 0..=HALVINGS {
            let part = 0.5f64.powi(halving as i32);
            let step_mm = STEP_SIZES * self.size_mm * part;
            let turn = STEP_DEG.to_radians() * part;
            loop {
                let before = cost;
                for change in 0..CHANGES {
                    let sign = if change % 2 == 0 { 1.0 } else { -1.0 };
                    let (mut tried, mut other) = (pose, blur);
                    match change / 2 {
                        0 => tried.position.x_mm += sign * step_mm,
                        1 => tried.position.y_mm += sign * step_mm,
                        2 => {
                            // Turns around the team patch, whose place is known best.
                            let patch = self.top.patches[self.top.team_patch].centroid_mm;
                            let fixed = tried.field_from_robot(patch);
                            tried.orientation += sign * turn;
                            let moved = tried.field_from_robot(patch);
                            tried.position.x_mm += fixed.x_mm - moved.x_mm;
                            tried.position.y_mm += fixed.y_mm - moved.y_mm;
                        }
                        3 if halving < 2 => match blur.sigma.checked_add_signed(sign as isize) {
                            Some(sigma) if sigma < Mixture::SIGMA_COUNT => other.sigma = sigma,
                            _ => continue,
                        },
                        4 => other.way_mm[0] += sign * step_mm,
                        5 => other.way_mm[1] += sign * step_mm,
                        _ => continue,
                    }
                    let [x, y] = other.way_mm;
                    if 2.0 * x.hypot(y) > LONGEST_WAY_SIZES * self.size_mm {
                        continue;
                    }
                    let tried_cost = self.try_at(tried, other);
                    if tried_cost < cost {
                        (pose, blur, cost) = (tried, other, tried_cost);
                    }
                }
                if cost >= before || self.trials >= end {
                    break;
                }
            }
        }
    }

    /// Least cost over the wearers at a pose and blur; updates the best trial of each.
    fn try_at(&mut self, pose: Pose, blur: Blur) -> f64 {
        let patch = &self.top.patches[self.top.team_patch];
        let place = pose.field_from_robot(patch.centroid_mm);
        // The seed lies on the team patch.
        if distance_mm(place, self.seed) > 0.6 * self.top.team_patch_size_mm() {
            return f64::INFINITY;
        }
        self.trials += 1;
        let Some(unmixed) = self.mixture.unmix(self.samples, &pose, &blur) else {
            return f64::INFINITY;
        };
        let mut least = f64::INFINITY;
        for (wearer, best) in self.wearers.iter().zip(self.best.iter_mut()) {
            let matched = unmixed.compare(&wearer.look);
            least = least.min(matched.cost);
            if matched.cost < best.matched.cost {
                *best = Trial { pose, blur, matched };
            }
        }
        least
    }
}
