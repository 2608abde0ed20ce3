//! Faint robots: robots whose patches no colour class finds, because they are out of focus, moving or in
//! dim light.
//!
//! The remains of a team patch (the seed) tell the place of a robot to within the patch's size. Around the
//! seed, pose p and blur q are searched that minimise the cost of the [`mixture`](mixture) model,
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
//! colour that belong to no robot while robots of that team are missing, and the number of trials is bounded:
//! in a match frames take turns with the seeds ([`turns`]). Seeds that a frame has no time for are reported
//! ([`FaintRobots::has_skipped`]).

pub(crate) mod mixture;
mod search;
pub(crate) mod turns;

use crate::pairing::{Pairing, Scene};
use crate::pattern::{Pattern, Top};
use crate::pose::image_pose;
use crate::raw::{CHANNELS, RawFrame};
use crate::regions::measure::distance_mm;
use config::{ColorConfig, Config};
use geometry::{FieldPoint, ImagePoint, Pose, wrap_angle};
use messages::{DetectedRobot, DetectionFrame, MAX_PATCHES, MAX_REGIONS, MAX_ROBOTS, Team};
use mixture::{Blur, Colors, Look, Match, Mixture, Samples, Unmixed, has_hue};
use search::{Effort, PROMISING, Search, Trial};
use turns::Extent;

/// Area of a seed as a fraction of the team patch; blur may make it larger than the patch.
const MIN_AREA_RATIO: f64 = 0.06;
const MAX_AREA_RATIO: f64 = 3.0;
/// Most seeds of a frame, for each team.
const MAX_SEEDS: usize = 16;
/// Explained fraction that suffices without a wide search if all other conditions hold, in noisier pictures.
const SUFFICIENT: f64 = 0.75;
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
    /// Regions of seeds that were not searched, or not as widely as they deserve, for lack of trials.
    skipped: Vec<u32>,
    /// Robots that have been found, within reach of the seed that is being searched.
    others: Vec<FieldPoint>,
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
    look: Look,
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

/// A robot that was found.
#[derive(Debug, Clone, Copy)]
struct Found {
    identity: usize,
    region: u32,
    pose: Pose,
    confidence: f64,
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
            groups[known].wearers.push(Wearer { identity: index, look: Look::new(colors) });
        }
        Self {
            groups,
            samples: Box::default(),
            seeds: Vec::new(),
            found: Vec::new(),
            skipped: Vec::with_capacity(MAX_REGIONS),
            others: Vec::with_capacity(MAX_ROBOTS),
            best: Vec::new(),
        }
    }

    /// Forgets the robots of the last frame.
    pub fn clear(&mut self) {
        self.found.clear();
        self.skipped.clear();
    }

    /// Whether a region was a seed that there was no time to search.
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
        extent: Extent,
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
        let mut blur = extent.first_blur(scene.pattern.size_mm);
        for (index, effort) in extent.searches(self.seeds.len()) {
            let Seed { group, region, position, is_promising, .. } = self.seeds[index];
            if !is_promising
                || self.covers(scene.pattern, position)
                || self.is_complete(pairing, group)
            {
                continue;
            }
            // A search that was cut short would compare robots that were not tried equally.
            if trials + effort.most_trials() > extent.most_trials() {
                self.skipped.push(region);
                continue;
            }
            trials += self.search_around(scene, pairing, frame, index, effort, &mut blur);
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
        let others = pairing.robots().map(|robot| robot.pose.position);
        let others = others.chain(self.found.iter().map(|found| found.pose.position));
        let reach_mm = mixture.sample_reach_mm(top) + 0.5 * pattern.size_mm;
        self.others.clear();
        self.others.extend(others.filter(|&it| distance_mm(it, seed.position) <= reach_mm));
        let others = &self.others;
        let is_other = |place: FieldPoint| {
            others.iter().any(|&other| distance_mm(other, place) < 0.5 * pattern.size_mm)
        };
        self.samples.take(mixture, top, scene.camera, frame, seed.position, is_other);
        let patches = ..top.patches.len();
        if wearers.iter().all(|wearer| wearer.look.colors[patches].iter().all(has_hue)) {
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
        let own = unmixed.distance(&wearer.look).max(LEAST_DISTANCE);
        let is_far = |other: &Wearer| {
            other.identity == wearer.identity || unmixed.distance(&other.look) >= FARTHER * own
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
        let level = unmixed.level(&wearer.look, brightness, patch);
        let expected = wearer.look.colors[patch].map(|color| brightness * color);
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
