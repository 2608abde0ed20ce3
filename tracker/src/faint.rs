//! Faint robots: robots whose patches no colour class finds, because they are out of focus, moving or in
//! dim light.
//!
//! The remains of a team patch (the seed) tell the place of a robot to within the patch's size. Around the
//! seed, pose p and blur q are searched that minimise the cost of the [`mixture`](crate::mixture) model,
//!
//! cost(p, q, r) for every robot r of the team, from the same sums,
//!
//! first over [`HEADINGS`] headings with the team patch on the seed, then from the best of them by coordinate
//! descent with steps that are halved [`HALVINGS`] times. Robot r gets its name if
//!
//! * it explains enough of the picture's variation ([`MIN_EXPLAINED`]),
//! * each unmixed patch has the colour that r wears ([`LEVEL_TOLERANCE`]),
//! * the log likelihood ratio to the next robot, each at its own best pose, is decisive ([`DECISIVE`]):
//!   (cost₂ − cost₁) / 2σ², σ² estimated from the residuals of the best, and
//! * the colours of all other robots are [`FARTHER`] from the unmixed levels.
//!
//! Otherwise only its team is reported: a wrong name is worse than none.
//!
//! The search takes a hundred times as long as pairing patches. So it is done only for regions of a team's
//! colour that belong to no robot while robots of that team are missing, and [`MAX_TRIALS`] bounds it.
//! Within the bound every seed is searched once before any is searched widely, and teams take turns. Seeds
//! beyond the bound are reported ([`FaintRobots::has_skipped`]).

use crate::measure::distance_mm;
use crate::mixture::{Blur, Colors, Match, Mixture, Samples, Unmixed, has_hue};
use crate::pairing::{Pairing, Scene};
use crate::pattern::{Pattern, Top};
use crate::pose::image_pose;
use crate::raw::{CHANNELS, RawFrame};
use common::config::{ColorConfig, Config};
use common::geometry::{FieldPoint, ImagePoint, Pose, wrap_angle};
use common::messages::{DetectedRobot, DetectionFrame, MAX_PATCHES, Team};

/// Area of a seed as a fraction of the team patch; blur may make it larger than the patch.
const MIN_AREA_RATIO: f64 = 0.06;
const MAX_AREA_RATIO: f64 = 3.0;
/// Most seeds of a frame, for each team.
const MAX_SEEDS: usize = 16;
/// Most poses tried in a frame, at 2 to 5 µs each. A robot takes some 120.
const MAX_TRIALS: u32 = 1600;
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
const DIRECTIONS: usize = 4;
const FIRST_WAY_SIZES: f64 = 0.2;
/// Longest motion blur, as a multiple of a robot's size.
const LONGEST_WAY_SIZES: f64 = 0.8;
/// Explained fraction of the variation that ends a search.
const WELL_EXPLAINED: f64 = 0.95;
/// Explained fraction that suffices without a wide search if all other conditions hold, in noisier pictures.
const SUFFICIENT: f64 = 0.75;
/// Explained fraction of the best heading below which there is no robot: specks of a team's colour reach 0.35
/// to 0.6, the darkest robots that are told apart 0.62.
const PROMISING: f64 = 0.45;
/// Least explained fraction of a robot that is named.
const MIN_EXPLAINED: f64 = 0.6;
/// Largest deviation of an unmixed level from the expected colour: as a fraction of it, and in grey levels.
const LEVEL_TOLERANCE: f64 = 0.35;
const LEVEL_SLACK: f64 = 18.0;
/// Least log likelihood ratio between the best robot and the next one, each at its own best pose.
const DECISIVE: f64 = 4.0;
/// Least distance of every other robot's colours from the unmixed levels, as a multiple of the own distance.
const FARTHER: f64 = 2.5;
/// Accuracy of unmixed levels, in grey levels: no own distance counts as smaller.
const LEAST_DISTANCE: f64 = 20.0;
/// Least noise of a sample, 1σ in grey levels.
const LEAST_DEVIATION: f64 = 2.5;
/// Noise of the pose, 1σ; the heading's in pixels at a robot's edge.
const PLACE_NOISE_PX: f64 = 0.4;
const HEADING_NOISE_PX: f64 = 0.6;
/// Confidence of a robot that explains everything: names found this way are less certain than paired ones.
const CONFIDENCE: f64 = 0.5;

/// Finds faint robots, and keeps them until the next frame.
#[derive(Debug, Clone)]
pub(crate) struct FaintRobots {
    groups: Vec<Group>,
    samples: Box<Samples>,
    seeds: Vec<Seed>,
    found: Vec<Found>,
    /// Regions of seeds that were not searched, or not as widely as they deserve, because of [`MAX_TRIALS`].
    skipped: Vec<u32>,
    /// Best trial of each wearer of the group that is being searched.
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

/// A robot and the colours that it wears.
#[derive(Debug, Clone, Copy)]
struct Wearer {
    /// Index into the pattern's identities.
    identity: usize,
    colors: Colors,
}

/// A region that may be the remains of a team patch.
#[derive(Debug, Clone, Copy)]
struct Seed {
    /// Index into the groups.
    group: usize,
    /// Rank among the seeds of the group by area, the largest first.
    rank: usize,
    region: u32,
    position: FieldPoint,
    /// A wider search may find a robot.
    is_promising: bool,
}

/// How widely a seed is searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Effort {
    /// With the blur of the last robot that was found, from one heading.
    Once,
    /// With other blurs too, from several headings.
    Widely,
}

/// A robot that was found.
#[derive(Debug, Clone, Copy)]
struct Found {
    identity: usize,
    region: u32,
    pose: Pose,
    confidence: f64,
}

/// A pose and blur, and how well a robot explains the picture there.
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
                // The pattern lists identities in the configured order.
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

    /// Forgets the robots of the last frame.
    pub fn clear(&mut self) {
        self.found.clear();
        self.skipped.clear();
    }

    /// Whether a region was a seed that [`MAX_TRIALS`] kept from being searched.
    pub fn has_skipped(&self, region: u32) -> bool {
        self.skipped.contains(&region)
    }

    /// Whether a place is on the top of a faint robot.
    pub fn covers(&self, pattern: &Pattern, place: FieldPoint) -> bool {
        let is_on = |found: &Found| distance_mm(found.pose.position, place) < pattern.size_mm / 2.0;
        self.found.iter().any(is_on)
    }

    /// Adds the robots that `pairing` has not found to the frame, which stays sorted by team and number.
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
        // By rank, so that teams take turns.
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
                trials += self.search_around(scene, pairing, frame, index, effort, &mut blur);
            }
        }
        if !self.skipped.is_empty() {
            out.flags |= DetectionFrame::SEARCH_CUT;
        }
        self.write(scene, out);
    }

    /// Whether all robots of a group have been found.
    fn is_complete(&self, pairing: &Pairing, group: usize) -> bool {
        let wearers = &self.groups[group].wearers;
        wearers.iter().all(|wearer| self.is_named(pairing, wearer.identity))
    }

    fn is_named(&self, pairing: &Pairing, identity: usize) -> bool {
        pairing.robots().any(|robot| robot.identity == identity)
            || self.found.iter().any(|found| found.identity == identity)
    }

    /// Adds the regions that may be remains of the team patches of a group.
    fn find_seeds(&mut self, scene: &Scene, pairing: &Pairing, group: usize) {
        let pattern = scene.pattern;
        let Group { team, top, .. } = self.groups[group];
        let (class, top) = (pattern.team_class(team), &pattern.tops[top]);
        let whole_mm2 = top.patches[top.team_patch].area_mm2;
        let first = self.seeds.len();
        // Largest first.
        for measured in pairing.finder.measured_of(top, class) {
            let ratio = measured.measure.area_mm2 / whole_mm2;
            let place = measured.measure.position;
            if !measured.outside
                && (MIN_AREA_RATIO..MAX_AREA_RATIO).contains(&ratio)
                && scene.pitch.contains(place, 0.0)
                && !is_on_robot(pattern, pairing, place)
            {
                self.seeds.push(Seed {
                    group,
                    rank: self.seeds.len() - first,
                    region: measured.region,
                    position: place,
                    is_promising: true,
                });
            }
        }
        let end = self.seeds.len().min(first + MAX_SEEDS);
        self.skipped.extend(self.seeds.drain(end..).map(|seed| seed.region));
    }

    /// Searches for a robot around a seed, and keeps it if it is certain enough. `blur` is that of the last
    /// robot found. Returns the number of poses tried.
    fn search_around(
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

/// Whether a robot's colours explain the picture, and each unmixed patch has the robot's colour.
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

/// The configured look of a colour, or the middle of its box if the look lies outside the box.
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

/// A search for pose and blur, for all robots of a group at once.
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
    /// The wearer that explains the picture best, and its trial; `best` has the trials of all wearers.
    fn run(&mut self, blur: Blur, effort: Effort) -> Option<(usize, Trial)> {
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
            // Out of focus, and moving in each direction.
            let mut blurs =
                [Blur { sigma: Mixture::SIGMA_COUNT / 2, ..Blur::default() }; 1 + DIRECTIONS];
            let way_mm = FIRST_WAY_SIZES * self.size_mm;
            for (direction, blur) in blurs[1..].iter_mut().enumerate() {
                let (sin, cos) =
                    (direction as f64 / DIRECTIONS as f64 * std::f64::consts::PI).sin_cos();
                *blur = Blur { sigma: 1, way_mm: [way_mm * cos, way_mm * sin] };
            }
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
                for change in 0..12 {
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
            let matched = unmixed.compare(&wearer.colors);
            least = least.min(matched.cost);
            if matched.cost < best.matched.cost {
                *best = Trial { pose, blur, matched };
            }
        }
        least
    }
}
