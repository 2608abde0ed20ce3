//! Robots whose patches have no colour of their own left: out of focus, moving, in dim light.
//!
//! What is left of a team patch says about where a robot must be. Around it, pose and blur are
//! searched at which the [`mixture`](crate::mixture) of the colours of some robot of the team explains
//! the pixels best: first all headings, then from the best of them by ever smaller steps. A robot
//! gets its name if it explains the picture, if its patches have its colours once they are unmixed, and if
//! every other robot of its team, each at its own best pose, explains the picture far worse. Otherwise it
//! stays one of which only the team is known: a wrong name is worse than none.
//!
//! It takes a hundred times as long as pairing patches. So it is done only where a team's colour has no
//! robot while robots of that team are missing, and a frame has a limit. Up to that, every place is searched
//! once before any is searched more widely, teams take turns, and what is not searched for lack of time is
//! said ([`FaintRobots::has_skipped`]).

use crate::measure::distance_mm;
use crate::mixture::{Blur, Colors, Match, Mixture, Samples, Unmixed, has_hue};
use crate::pairing::{Pairing, Scene};
use crate::pattern::{Pattern, Top};
use crate::pose::image_pose;
use crate::raw::{CHANNELS, RawFrame};
use common::config::{ColorConfig, Config};
use common::geometry::{FieldPoint, ImagePoint, Pose, wrap_angle};
use common::messages::{DetectedRobot, DetectionFrame, MAX_PATCHES, Team};

/// A region of less than this part of a team patch tells of none.
const MIN_AREA_RATIO: f64 = 0.06;
/// A blurred team patch may look larger than it is.
const MAX_AREA_RATIO: f64 = 3.0;
/// Most places looked at in a frame, for each team; and most poses that are tried, at 2 to 5 µs each. A robot
/// takes some 120.
const MAX_SEEDS: usize = 16;
const MAX_TRIALS: u32 = 1600;
/// Headings that are tried first.
const HEADINGS: usize = 24;
/// From so many of them the search goes on, …
const BEGINNINGS: usize = 3;
/// … which are so far apart.
const APART_DEG: f64 = 30.0;
/// First steps of the search, as multiples of a robot's size, and how often they are halved.
const STEP_SIZES: f64 = 0.06;
const STEP_DEG: f64 = 8.0;
const HALVINGS: u32 = 4;
/// Most poses tried from one beginning.
const TRIALS_EACH: u32 = 80;
/// Directions of motion that are tried first, and half of the way.
const DIRECTIONS: usize = 4;
const FIRST_WAY_SIZES: f64 = 0.2;
/// The longest way a robot is taken to move while the shutter is open, as a multiple of its size.
const LONGEST_WAY_SIZES: f64 = 0.8;
/// With so much explained of what varies around the robot, nothing else is tried, …
const WELL_EXPLAINED: f64 = 0.95;
/// … nor with so much, in noisier pictures, if all else speaks for the robot as well.
const SUFFICIENT: f64 = 0.75;
/// Where the best of the headings explains less than this, there is no robot: specks of a team's colour reach
/// 0.35 to 0.6, the darkest robots that are told apart 0.62.
const PROMISING: f64 = 0.45;
/// Share of the variation around a robot that must be explained.
const MIN_EXPLAINED: f64 = 0.6;
/// Levels may be off by this part of what they should be, and by so many grey levels.
const LEVEL_TOLERANCE: f64 = 0.35;
const LEVEL_SLACK: f64 = 18.0;
/// Least logarithm of the likelihood ratio between the best robot and the next one, each at its own best
/// pose. What a sample is off by is taken from what the best one leaves unexplained.
const DECISIVE: f64 = 4.0;
/// The colours of every other robot must be so many times as far from the levels as its own.
const FARTHER: f64 = 2.5;
/// Levels are never known better than to so many grey levels.
const LEAST_DISTANCE: f64 = 20.0;
/// A sample is off by at least so many grey levels.
const LEAST_DEVIATION: f64 = 2.5;
/// What place and heading are off by, 1σ: the heading by so many pixels at a robot's edge.
const PLACE_NOISE_PX: f64 = 0.4;
const HEADING_NOISE_PX: f64 = 0.6;
/// How sure a name is at best that was found this way.
const CONFIDENCE: f64 = 0.5;

/// Finds them, and keeps them until the next frame.
#[derive(Debug, Clone)]
pub(crate) struct FaintRobots {
    groups: Vec<Group>,
    samples: Box<Samples>,
    seeds: Vec<Seed>,
    found: Vec<Found>,
    /// Regions that were not searched, or not as widely as they deserve.
    skipped: Vec<u32>,
    /// Indexed by wearer.
    best: Vec<Trial>,
}

/// The robots of a team that have one top.
#[derive(Debug, Clone)]
struct Group {
    team: Team,
    /// Index into the pattern's tops.
    top: usize,
    mixture: Mixture,
    wearers: Vec<Wearer>,
}

#[derive(Debug, Clone, Copy)]
struct Wearer {
    identity: usize,
    colors: Colors,
}

/// A region that may be what is left of a team patch.
#[derive(Debug, Clone, Copy)]
struct Seed {
    /// Index into the groups.
    group: usize,
    /// Place among the seeds of the group, the largest first.
    rank: usize,
    region: u32,
    position: FieldPoint,
    /// A wider search may find a robot.
    is_promising: bool,
}

/// How widely a robot is searched for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Effort {
    /// With the blur of the robot before.
    Once,
    /// With other blurs, and from several headings, as well.
    Widely,
}

#[derive(Debug, Clone, Copy)]
struct Found {
    identity: usize,
    region: u32,
    pose: Pose,
    confidence: f64,
}

#[derive(Debug, Clone, Copy)]
struct Trial {
    pose: Pose,
    blur: Blur,
    matched: Match,
}

impl FaintRobots {
    pub fn new(config: &Config, pattern: &Pattern) -> Self {
        let mut groups: Vec<Group> = Vec::new();
        for (index, identity) in pattern.identities.iter().enumerate() {
            let mut colors = Colors::default();
            for (color, &kind) in colors.iter_mut().zip(&identity.kinds) {
                let class = pattern.kinds[kind].class as usize;
                *color = config.colors.get(class).map_or([0.0; CHANNELS], typical);
            }
            let (team, top) = (identity.team, identity.top);
            let is_its = |group: &Group| group.team == team && group.top == top;
            let known = groups.iter().position(is_its).unwrap_or_else(|| {
                // Identities are in the order in which they are configured.
                let patches = config.top_of(&config.robots.identities[index]).patches;
                let mixture = Mixture::new(patches, &pattern.tops[top], pattern.size_mm);
                groups.push(Group { team, top, mixture, wearers: Vec::new() });
                groups.len() - 1
            });
            groups[known].wearers.push(Wearer { identity: index, colors });
        }
        Self {
            groups,
            samples: Box::default(),
            seeds: Vec::new(),
            found: Vec::new(),
            skipped: Vec::new(),
            best: Vec::new(),
        }
    }

    /// Nothing was looked for.
    pub fn clear(&mut self) {
        self.found.clear();
        self.skipped.clear();
    }

    /// Whether a region that may be what is left of a team patch was not searched for lack of time.
    pub fn has_skipped(&self, region: u32) -> bool {
        self.skipped.contains(&region)
    }

    /// Whether a place is on the top of one of them.
    pub fn covers(&self, pattern: &Pattern, place: FieldPoint) -> bool {
        let is_on = |found: &Found| distance_mm(found.pose.position, place) < pattern.size_mm / 2.0;
        self.found.iter().any(is_on)
    }

    /// Appends to the frame, by team and number, what `pairing` has found no robot for.
    pub fn find(
        &mut self,
        scene: &Scene,
        pairing: &Pairing,
        frame: &RawFrame,
        out: &mut DetectionFrame,
    ) {
        self.clear();
        if frame.channels() != CHANNELS {
            return;
        }
        self.seeds.clear();
        for group in 0..self.groups.len() {
            if !self.is_complete(pairing, group) {
                self.find_seeds(scene, pairing, group);
            }
        }
        // Teams take turns.
        self.seeds.sort_unstable_by_key(|seed| (seed.rank, seed.group));
        let mut trials = 0;
        let mut blur = Blur { sigma: Mixture::SIGMA_COUNT / 2, ..Blur::default() };
        for effort in [Effort::Once, Effort::Widely] {
            for index in 0..self.seeds.len() {
                let Seed { group, region, position, is_promising, .. } = self.seeds[index];
                if !is_promising
                    || self.covers(scene.pattern, position)
                    || self.is_complete(pairing, group)
                {
                    continue;
                }
                if trials >= MAX_TRIALS {
                    self.skipped.push(region);
                    continue;
                }
                trials += self.look_at(scene, pairing, frame, index, effort, &mut blur);
            }
        }
        if !self.skipped.is_empty() {
            out.flags |= DetectionFrame::SEARCH_CUT;
        }
        self.write(scene, out);
    }

    /// Whether all robots of a group were found.
    fn is_complete(&self, pairing: &Pairing, group: usize) -> bool {
        let wearers = &self.groups[group].wearers;
        wearers.iter().all(|wearer| self.is_named(pairing, wearer.identity))
    }

    fn is_named(&self, pairing: &Pairing, identity: usize) -> bool {
        pairing.robots().any(|robot| robot.identity == identity)
            || self.found.iter().any(|found| found.identity == identity)
    }

    /// Adds what may be left of the team patches of a group.
    fn find_seeds(&mut self, scene: &Scene, pairing: &Pairing, group: usize) {
        let pattern = scene.pattern;
        let Group { team, top, .. } = self.groups[group];
        let (class, top) = (pattern.team_class(team), &pattern.tops[top]);
        let whole_mm2 = top.patches[top.team_patch].area_mm2;
        let first = self.seeds.len();
        // Largest first.
        for spot in pairing.finder.spots_of(top, class) {
            let ratio = spot.measure.area_mm2 / whole_mm2;
            let place = spot.measure.position;
            if !spot.outside
                && (MIN_AREA_RATIO..MAX_AREA_RATIO).contains(&ratio)
                && scene.pitch.contains(place, 0.0)
                && !is_on_robot(pattern, pairing, place)
            {
                self.seeds.push(Seed {
                    group,
                    rank: self.seeds.len() - first,
                    region: spot.region,
                    position: place,
                    is_promising: true,
                });
            }
        }
        let end = self.seeds.len().min(first + MAX_SEEDS);
        self.skipped.extend(self.seeds.drain(end..).map(|seed| seed.region));
    }

    /// Looks for a robot around a seed, blurred as the one before it or otherwise. Returns how many poses were
    /// tried.
    fn look_at(
        &mut self,
        scene: &Scene,
        pairing: &Pairing,
        frame: &RawFrame,
        index: usize,
        effort: Effort,
        blur: &mut Blur,
    ) -> u32 {
        let pattern = scene.pattern;
        let seed = self.seeds[index];
        self.seeds[index].is_promising = false;
        let Group { top, mixture, wearers, .. } = &self.groups[seed.group];
        let top = &pattern.tops[*top];
        let found = &self.found;
        let is_other = |place: FieldPoint| {
            is_on_robot(pattern, pairing, place)
                || found
                    .iter()
                    .any(|other| distance_mm(other.pose.position, place) < 0.5 * pattern.size_mm)
        };
        self.samples.take(mixture, top, scene.camera, frame, seed.position, is_other);
        let patches = ..top.patches.len();
        if wearers.iter().all(|wearer| wearer.colors[patches].iter().all(has_hue)) {
            self.samples.drop_lines();
        }
        let mut search = Search {
            mixture,
            samples: &mut self.samples,
            top,
            size_mm: pattern.size_mm,
            wearers,
            seed: seed.position,
            best: &mut self.best,
            trials: 0,
        };
        let best = search.run(*blur, effort);
        let trials = search.trials;
        let Some((winner, trial)) = best else { return trials };
        let Some(unmixed) = mixture.unmix(&mut self.samples, &trial.pose, &trial.blur) else {
            return trials;
        };
        self.seeds[index].is_promising =
            effort == Effort::Once && trial.matched.explained >= PROMISING;
        let wearer = &wearers[winner];
        let is_outside = !scene.pitch.contains(trial.pose.position, 0.0);
        if is_outside || !is_believable(top, wearer, &unmixed, &trial) {
            return trials;
        }
        // Noise of the samples, estimated from the best explanation.
        let count = (self.samples.count() * CHANNELS) as f64;
        let variance = (trial.matched.cost / count).max(LEAST_DEVIATION * LEAST_DEVIATION);
        let others = self.best.iter().enumerate().filter(|(other, _)| *other != winner);
        let next = others.map(|(_, other)| other.matched.cost).fold(f64::INFINITY, f64::min);
        let ratio = (next - trial.matched.cost) / (2.0 * variance);
        *blur = trial.blur;
        let own = unmixed.distance(&wearer.colors).max(LEAST_DISTANCE);
        let is_far = |other: &Wearer| {
            other.identity == wearer.identity || unmixed.distance(&other.colors) >= FARTHER * own
        };
        let is_doubtful = effort == Effort::Once && trial.matched.explained < SUFFICIENT;
        if ratio < DECISIVE
            || is_doubtful
            || !wearers.iter().all(is_far)
            || self.is_named(pairing, wearer.identity)
        {
            return trials;
        }
        self.found.push(Found {
            identity: wearer.identity,
            region: seed.region,
            pose: trial.pose,
            confidence: CONFIDENCE * trial.matched.explained.max(0.0),
        });
        trials
    }

    fn write(&self, scene: &Scene, out: &mut DetectionFrame) {
        let pattern = scene.pattern;
        for found in &self.found {
            let identity = &pattern.identities[found.identity];
            let top = pattern.top_of(found.identity);
            let (image, orientation_image) = image_pose(scene.camera, &found.pose, top.height_mm);
            let ImagePoint { x_px, y_px } = image;
            let mm_per_px = scene.camera.pixel_area_mm2(image, top.height_mm).sqrt();
            let place = (PLACE_NOISE_PX * mm_per_px).powi(2);
            let heading = (HEADING_NOISE_PX * mm_per_px / (pattern.size_mm / 2.0)).powi(2);
            let covariance = [place, 0.0, 0.0, place, 0.0, heading];
            let mut patch_regions = [u32::MAX; MAX_PATCHES];
            patch_regions[top.team_patch] = found.region;
            out.push_robot(DetectedRobot {
                team: identity.team as u32,
                robot_id: identity.id.into(),
                x_mm: found.pose.position.x_mm as f32,
                y_mm: found.pose.position.y_mm as f32,
                orientation: wrap_angle(found.pose.orientation) as f32,
                confidence: found.confidence as f32,
                x_px: x_px as f32,
                y_px: y_px as f32,
                orientation_image: orientation_image as f32,
                patch_count: top.patches.len() as u32,
                patch_regions,
                covariance: covariance.map(|term| term as f32),
                ..DetectedRobot::default()
            });
        }
        if !self.found.is_empty() {
            let count = (out.robot_count as usize).min(out.robots.len());
            out.robots[..count].sort_by_key(|robot| (robot.team, robot.robot_id));
        }
    }
}

/// Whether a robot's colours explain the picture, and each patch has its own.
fn is_believable(top: &Top, wearer: &Wearer, unmixed: &Unmixed, trial: &Trial) -> bool {
    let Match { explained, brightness, .. } = trial.matched;
    let fits = |patch: usize| {
        let level = unmixed.level(&wearer.colors, brightness, patch);
        let expected = wearer.colors[patch].map(|color| brightness * color);
        let norm = |values: [f64; CHANNELS]| values.iter().map(|v| v * v).sum::<f64>().sqrt();
        let off = std::array::from_fn(|channel| level[channel] - expected[channel]);
        norm(off) <= LEVEL_TOLERANCE * norm(expected) + LEVEL_SLACK
    };
    explained >= MIN_EXPLAINED && (0..top.patches.len()).all(fits)
}

/// Whether a place is on the top of a robot that was paired.
fn is_on_robot(pattern: &Pattern, pairing: &Pairing, place: FieldPoint) -> bool {
    pairing.robots().any(|robot| distance_mm(robot.pose.position, place) < 0.5 * pattern.size_mm)
}

/// What a colour looks like; the middle of its box if that is said to lie outside of it.
fn typical(color: &ColorConfig) -> [f64; CHANNELS] {
    let ranges = [color.red, color.green, color.blue];
    let inside =
        color.looks.iter().zip(ranges).all(|(&value, [low, high])| (low..=high).contains(&value));
    std::array::from_fn(|channel| {
        let [low, high] = ranges[channel].map(f64::from);
        if inside { f64::from(color.looks[channel]) } else { (low + high) / 2.0 }
    })
}

/// A heading with its best blur: cost, heading, blur.
type Scanned = (f64, f64, Blur);

/// Searches pose and blur, for all robots of a team at once.
struct Search<'a> {
    mixture: &'a Mixture,
    samples: &'a mut Samples,
    top: &'a Top,
    size_mm: f64,
    wearers: &'a [Wearer],
    seed: FieldPoint,
    best: &'a mut Vec<Trial>,
    trials: u32,
}

impl Search<'_> {
    /// The wearer that explains the picture best, and where; `best` has the same of all others.
    fn run(&mut self, blur: Blur, effort: Effort) -> Option<(usize, Trial)> {
        let nothing = Match { cost: f64::INFINITY, explained: 0.0, brightness: 0.0 };
        self.best.clear();
        let trial = Trial { pose: Pose::default(), blur, matched: nothing };
        self.best.resize(self.wearers.len(), trial);
        // Mostly it is blurred as the robot before.
        let scanned = self.scan(&[blur]);
        let is_promising = |trial: &Trial| trial.matched.explained >= PROMISING;
        if effort == Effort::Once && !self.best().is_some_and(|(_, trial)| is_promising(&trial)) {
            return self.best();
        }
        self.go_on(scanned, 1);
        let is_explained = |trial: &Trial| trial.matched.explained >= WELL_EXPLAINED;
        let is_over =
            effort == Effort::Once || self.best().is_some_and(|(_, trial)| is_explained(&trial));
        if !is_over {
            // Standing still, and moving in four directions.
            let mut blurs =
                [Blur { sigma: Mixture::SIGMA_COUNT / 2, ..Blur::default() }; 1 + DIRECTIONS];
            let way_mm = FIRST_WAY_SIZES * self.size_mm;
            for (direction, blur) in blurs[1..].iter_mut().enumerate() {
                let (sin, cos) =
                    (direction as f64 / DIRECTIONS as f64 * std::f64::consts::PI).sin_cos();
                *blur = Blur { sigma: 1, way_mm: [way_mm * cos, way_mm * sin] };
            }
            let scanned = self.scan(&blurs);
            self.go_on(scanned, BEGINNINGS);
        }
        self.best()
    }

    /// The wearer that explains the picture best so far.
    fn best(&self) -> Option<(usize, Trial)> {
        let trials = self.best.iter().copied().enumerate();
        let tried = trials.filter(|(_, trial)| trial.matched.cost.is_finite());
        tried.min_by(|a, b| a.1.matched.cost.total_cmp(&b.1.matched.cost))
    }

    /// Tries all headings with these blurs. Returns what the best blur of each costs, the least first.
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

    /// Goes on from the best `beginnings` headings.
    fn go_on(&mut self, scanned: [Scanned; HEADINGS], beginnings: usize) {
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

    /// A robot with this heading whose team patch lies where the seed does.
    fn pose(&self, heading: f64) -> Pose {
        let turned = Pose { position: FieldPoint::default(), orientation: heading };
        let patch = &self.top.patches[self.top.team_patch];
        let offset = turned.field_from_robot(patch.centroid_mm);
        let position = FieldPoint::new(self.seed.x_mm - offset.x_mm, self.seed.y_mm - offset.y_mm);
        Pose { position, ..turned }
    }

    /// Goes on to where it costs less, by ever smaller steps of place, heading and blur.
    fn descend(&mut self, pose: Pose, blur: Blur, cost: f64) {
        let (mut pose, mut blur, mut cost) = (pose, blur, cost);
        let end = self.trials + TRIALS_EACH;
        for halving in 0..=HALVINGS {
            let part = 0.5f64.powi(halving as i32);
            let step_mm = STEP_SIZES * self.size_mm * part;
            let turn = STEP_DEG.to_radians() * part;
            loop {
                let before = cost;
                for change in 0..12 {
                    let sign = if change % 2 == 0 { 1.0 } else { -1.0 };
                    let (mut tried, mut other) = (pose, blur);
                    match change / 2 {
                        0 => tried.position.x_mm += sign * step_mm,
                        1 => tried.position.y_mm += sign * step_mm,
                        2 => {
                            // Around the team patch, the place of which is known best.
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

    /// Cost of the cheapest explanation at a pose and a blur.
    fn try_at(&mut self, pose: Pose, blur: Blur) -> f64 {
        let patch = &self.top.patches[self.top.team_patch];
        let place = pose.field_from_robot(patch.centroid_mm);
        // The remains of a patch lie on it.
        if distance_mm(place, self.seed) > 0.6 * self.top.team_patch_size_mm() {
            return f64::INFINITY;
        }
        self.trials += 1;
        let Some(unmixed) = self.mixture.unmix(self.samples, &pose, &blur) else {
            return f64::INFINITY;
        };
        let mut least = f64::INFINITY;
        for (wearer, best) in self.wearers.iter().zip(self.best.iter_mut()) {
            let matched = unmixed.hold(&wearer.colors);
            least = least.min(matched.cost);
            if matched.cost < best.matched.cost {
                *best = Trial { pose, blur, matched };
            }
        }
        least
    }
}
