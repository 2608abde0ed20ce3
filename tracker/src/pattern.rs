//! What to look for: the patches of a robot as they show, and which robot wears which colours.
//!
//! Everything that can be computed from the configuration alone is computed here, once, and
//! everything that is wrong with it is refused here.

use crate::agreement::Shares;
use crate::error::TrackerError;
use crate::footprint::Footprints;
use common::config::{Config, Pair, PatchRole, RobotsConfig};
use common::geometry::Pose;
use common::layout::{Layout, body_turn, topmost_patch};
use common::messages::{MAX_PATCHES, Team};

/// The robots to look for.
#[derive(Debug, Clone)]
pub(crate) struct Pattern {
    /// The patches of a robot's top, in the configured order.
    pub patches: Vec<ExpectedPatch>,
    /// Between the visible centroids of any two patches.
    distances_mm: [[f64; MAX_PATCHES]; MAX_PATCHES],
    /// Which of them is the team patch.
    pub team_patch: usize,
    /// Every combination of colour and patch that some robot wears.
    pub kinds: Vec<Kind>,
    /// The robots that may be on the pitch.
    pub identities: Vec<Identity>,
    /// For each team, its identities, those that begin with the same kinds side by side.
    wearers: [Vec<usize>; 2],
    /// Side of a robot.
    pub size_mm: f64,
    /// How the body is turned against the frame of the layout.
    body_turn: f64,
    /// Height of the robots' tops.
    pub height_mm: f64,
    /// What of a robot's top may belong to which patch.
    pub footprints: Footprints,
    /// How much of each patch there is at every point of a top.
    pub shares: Shares,
    /// Tolerances.
    pub limits: Limits,
}

/// One patch as it should show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ExpectedPatch {
    pub area_mm2: f64,
    /// In the robot's frame.
    pub centroid_mm: Pair,
    /// Covariance [xx, xy, yy] of its points, in the robot's frame.
    pub covariance: [f64; 3],
    /// Standard deviation of the patch's points along its longer principal axis.
    pub major_mm: f64,
    /// The same along the shorter one; a square of side s has s/√12.
    pub minor_mm: f64,
    /// From its centroid to its farthest point.
    pub reach_mm: f64,
}

/// A patch in a colour: what candidates are candidates for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Kind {
    /// Colour class.
    pub class: u32,
    /// Index into the patches of the layout.
    pub patch: usize,
    /// For the team patch, the team that wears the colour.
    pub team: Option<Team>,
}

/// A robot by name, and what it wears.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Identity {
    pub team: Team,
    pub id: u32,
    /// For each patch of the layout, the index of its kind.
    pub kinds: Vec<usize>,
}

/// The configured tolerances.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Limits {
    pub min_area_ratio: f64,
    pub max_area_ratio: f64,
    pub patch_tolerance_mm: f64,
}

impl Pattern {
    pub fn new(config: &Config) -> Result<Self, TrackerError> {
        let robots = &config.robots;
        let limits = Limits::new(config)?;
        positive("robots.size_mm", robots.size_mm)?;
        if !(robots.height_mm >= 0.0 && robots.height_mm < config.geometry.camera_mm[2]) {
            return Err(TrackerError::Value {
                key: "robots.height_mm",
                value: robots.height_mm,
                must: "at least 0 and below the camera",
            });
        }
        let patches = expected_patches(robots)?;
        let mut distances_mm = [[0.0; MAX_PATCHES]; MAX_PATCHES];
        for (row, a) in distances_mm.iter_mut().zip(&patches) {
            for (distance, b) in row.iter_mut().zip(&patches) {
                let ([ax, ay], [bx, by]) = (a.centroid_mm, b.centroid_mm);
                *distance = (ax - bx).hypot(ay - by);
            }
        }
        let team_patch = robots
            .patches
            .iter()
            .position(|patch| patch.role == PatchRole::Team)
            .ok_or(TrackerError::TeamPatches(0))?;

        let mut kinds = Vec::new();
        for team in Team::ALL {
            let class =
                class_of(config, config.teams.color(team), || format!("the {} team", team.name()))?;
            kinds.push(Kind { class, patch: team_patch, team: Some(team) });
        }
        let mut identities: Vec<Identity> = Vec::new();
        for identity in &robots.identities {
            let (team, id) = (identity.team, identity.id);
            if identities.iter().any(|known| (known.team, known.id) == (team, id)) {
                return Err(TrackerError::DuplicateIdentity { team, id });
            }
            if identity.colors.len() != patches.len() - 1 {
                return Err(TrackerError::ColorCount {
                    team,
                    id,
                    got: identity.colors.len(),
                    expected: patches.len() - 1,
                });
            }
            let mut colors = identity.colors.iter();
            let mut own_kinds = Vec::with_capacity(patches.len());
            for patch in 0..patches.len() {
                let kind = if patch == team_patch {
                    Kind { class: kinds[team as usize].class, patch, team: Some(team) }
                } else {
                    let color = colors.next().map_or("", String::as_str);
                    let class = class_of(config, color, || format!("{} {id}", team.name()))?;
                    Kind { class, patch, team: None }
                };
                let index = kinds.iter().position(|known| *known == kind).unwrap_or_else(|| {
                    kinds.push(kind);
                    kinds.len() - 1
                });
                own_kinds.push(index);
            }
            identities.push(Identity { team, id, kinds: own_kinds });
        }
        let wearers = Team::ALL.map(|team| {
            let mut wearers: Vec<usize> =
                (0..identities.len()).filter(|&index| identities[index].team == team).collect();
            wearers.sort_by(|&a, &b| identities[a].kinds.cmp(&identities[b].kinds));
            wearers
        });
        Ok(Self {
            patches,
            distances_mm,
            team_patch,
            kinds,
            identities,
            wearers,
            size_mm: robots.size_mm,
            body_turn: body_turn(robots),
            height_mm: robots.height_mm,
            footprints: Footprints::new(robots),
            shares: Shares::new(robots),
            limits,
        })
    }

    /// Distance between the visible centroids of two patches.
    pub fn distance_mm(&self, a: usize, b: usize) -> f64 {
        self.distances_mm[a][b]
    }

    /// The pose of the body of a robot whose layout has the pose given.
    pub fn body(&self, pose: &Pose) -> Pose {
        Pose { orientation: pose.orientation + self.body_turn, ..*pose }
    }

    /// d₁ of eq. (4): no two robots of a team can have their team patches nearer than ¾ of this.
    pub fn team_patch_size_mm(&self) -> f64 {
        self.patches[self.team_patch].size_mm()
    }

    /// Index of the identity that a message names by numbers.
    pub fn identity_of(&self, team: u32, id: u32) -> Option<usize> {
        let is_it = |identity: &Identity| (identity.team as u32, identity.id) == (team, id);
        self.identities.iter().position(is_it)
    }

    /// Indices of a team's identities, those that begin with the same kinds side by side.
    pub fn wearers(&self, team: Team) -> &[usize] {
        &self.wearers[team as usize]
    }

    /// Index of the kind of a team's team patch.
    pub fn team_kind(&self, team: Team) -> usize {
        team as usize
    }
}

impl ExpectedPatch {
    /// The patch size d₁ of eqs. (4) and (5): the side of a square. For any other shape it is the
    /// side of the square of the same area or of the same narrowness, whichever is smaller,
    /// because elongated patches can come close to each other side by side.
    pub fn size_mm(&self) -> f64 {
        self.area_mm2.sqrt().min(12f64.sqrt() * self.minor_mm)
    }

    /// Area in relation to spread: 1 for squares and all rectangles, 1.05 for discs, 0.87 for
    /// triangles, and small for rings and crooked strings.
    pub fn compactness(&self) -> f64 {
        self.area_mm2 / (12.0 * self.major_mm * self.minor_mm)
    }
}

impl Limits {
    fn new(config: &Config) -> Result<Self, TrackerError> {
        let tracker = &config.tracker;
        let &min_area_ratio = &tracker.min_area_ratio;
        if !(min_area_ratio > 0.0 && min_area_ratio < 1.0) {
            return Err(TrackerError::Value {
                key: "tracker.min_area_ratio",
                value: min_area_ratio,
                must: "between 0 and 1",
            });
        }
        if !(tracker.max_area_ratio > 1.0 && tracker.max_area_ratio.is_finite()) {
            return Err(TrackerError::Value {
                key: "tracker.max_area_ratio",
                value: tracker.max_area_ratio,
                must: "above 1",
            });
        }
        positive("tracker.patch_tolerance_mm", tracker.patch_tolerance_mm)?;
        Ok(Self {
            min_area_ratio,
            max_area_ratio: tracker.max_area_ratio,
            patch_tolerance_mm: tracker.patch_tolerance_mm,
        })
    }

    pub fn admit_area(&self, ratio: f64) -> bool {
        (self.min_area_ratio..=self.max_area_ratio).contains(&ratio)
    }

    /// How far an area is from the expected one: 0 when equal, 1 at either limit.
    pub fn area_misfit(&self, ratio: f64) -> f64 {
        let limit = if ratio < 1.0 { self.min_area_ratio } else { self.max_area_ratio };
        (ratio.ln() / limit.ln()).powi(2)
    }
}

/// The class of a colour by its name.
pub(crate) fn class_of(
    config: &Config,
    color: &str,
    user: impl FnOnce() -> String,
) -> Result<u32, TrackerError> {
    if config.colors.len() > 32 {
        return Err(TrackerError::TooManyColors(config.colors.len()));
    }
    match config.colors.iter().position(|known| known.name == color) {
        Some(class) => Ok(class as u32),
        None => Err(TrackerError::UnknownColor { user: user(), color: color.into() }),
    }
}

pub(crate) fn positive(key: &'static str, value: f64) -> Result<(), TrackerError> {
    if value > 0.0 && value.is_finite() {
        Ok(())
    } else {
        Err(TrackerError::Value { key, value, must: "positive" })
    }
}

fn expected_patches(robots: &RobotsConfig) -> Result<Vec<ExpectedPatch>, TrackerError> {
    let count = robots.patches.len();
    let team_patches = robots.patches.iter().filter(|patch| patch.role == PatchRole::Team).count();
    if team_patches != 1 {
        return Err(TrackerError::TeamPatches(team_patches));
    }
    if !(2..=MAX_PATCHES).contains(&count) {
        return Err(TrackerError::IdentificationPatches(count - 1));
    }
    for (index, patch) in robots.patches.iter().enumerate() {
        // Also keeps the sampling below within bounds.
        let is_absurd = |value: &f64| value.is_nan() || value.abs() > robots.size_mm;
        if patch.outline_mm.iter().flatten().any(is_absurd) {
            return Err(TrackerError::InvisiblePatch(index));
        }
    }
    let layout = Layout::new(robots);
    let patches: Vec<ExpectedPatch> = layout
        .patches
        .iter()
        .zip(spreads(robots, &layout))
        .map(|(visible, spread)| ExpectedPatch {
            area_mm2: visible.area_mm2,
            centroid_mm: visible.centroid_mm,
            ..spread
        })
        .collect();
    for (index, patch) in patches.iter().enumerate() {
        if !(patch.area_mm2 > 0.0 && patch.minor_mm > 0.0) {
            return Err(TrackerError::InvisiblePatch(index));
        }
    }
    for a in 0..count {
        for b in a + 1..count {
            let ([ax, ay], [bx, by]) = (patches[a].centroid_mm, patches[b].centroid_mm);
            if (ax - bx).hypot(ay - by) < 1.0 {
                return Err(TrackerError::ConcentricPatches(a, b));
            }
        }
    }
    Ok(patches)
}

/// How the visible part of each patch spreads around its centroid, measured on a grid; the other
/// fields stay zero.
fn spreads(robots: &RobotsConfig, layout: &Layout) -> Vec<ExpectedPatch> {
    #[derive(Clone, Copy, Default)]
    struct Sum {
        count: f64,
        covariance: [f64; 3],
        reach: f64,
    }
    const STEPS: i32 = 300;
    let step = robots.size_mm / f64::from(STEPS);
    let mut sums = vec![Sum::default(); layout.patches.len()];
    for row in -STEPS..STEPS {
        for column in -STEPS..STEPS {
            let x = (f64::from(column) + 0.5) * step;
            let y = (f64::from(row) + 0.5) * step;
            let Some(patch) = topmost_patch(robots, [x, y]) else { continue };
            let [cx, cy] = layout.patches[patch].centroid_mm;
            let (dx, dy) = (x - cx, y - cy);
            let sum = &mut sums[patch];
            sum.count += 1.0;
            // Each sample stands for a small square, which has a spread of its own.
            let cell = step * step / 12.0;
            let own = [dx * dx + cell, dx * dy, dy * dy + cell];
            sum.covariance.iter_mut().zip(own).for_each(|(sum, own)| *sum += own);
            sum.reach = sum.reach.max(dx.hypot(dy));
        }
    }
    sums.iter()
        .map(|sum| {
            let covariance = sum.covariance.map(|value| value / sum.count.max(1.0));
            let [major_mm, minor_mm] = principal_deviations(covariance);
            ExpectedPatch {
                area_mm2: 0.0,
                centroid_mm: [0.0; 2],
                covariance,
                major_mm,
                minor_mm,
                reach_mm: sum.reach,
            }
        })
        .collect()
}

/// Standard deviations along the longer and the shorter principal axis of a covariance
/// [xx, xy, yy].
pub(crate) fn principal_deviations([xx, xy, yy]: [f64; 3]) -> [f64; 2] {
    let mean = (xx + yy) / 2.0;
    let half_difference = (xx - yy) / 2.0;
    let offset = (half_difference * half_difference + xy * xy).sqrt();
    [(mean + offset).max(0.0).sqrt(), (mean - offset).max(0.0).sqrt()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use common::config::Preset;

    #[test]
    fn every_preset_can_be_tracked() {
        for preset in Preset::ALL {
            let pattern = Pattern::new(&preset.config()).unwrap();
            assert_eq!(pattern.identities.len(), preset.config().robots.identities.len());
        }
    }

    #[test]
    fn the_papers_layout_has_the_papers_sizes() {
        let pattern = Pattern::new(&Config::default()).unwrap();
        let [team, identification] = pattern.patches[..] else { panic!("two patches") };
        assert!((team.size_mm() - 34.0).abs() < 0.2, "{team:?}");
        assert!((team.compactness() - 1.0).abs() < 0.01, "{team:?}");
        assert!((team.reach_mm - 17.0 * 2f64.sqrt()).abs() < 0.5, "{team:?}");
        assert!((identification.size_mm() - 34.0).abs() < 0.2, "{identification:?}");
        assert!((pattern.distance_mm(0, 1) - 36.0 * 2f64.sqrt()).abs() < 1e-6);
        // Two team colours, five identification colours that both teams share.
        assert_eq!(pattern.kinds.len(), 7);
    }

    #[test]
    fn a_stripe_is_as_large_as_it_is_narrow() {
        let pattern = Pattern::new(&Preset::MirosotLarge.config()).unwrap();
        assert!((pattern.team_patch_size_mm() - 33.0).abs() < 0.3);
    }

    #[test]
    fn what_cannot_be_tracked_is_refused() {
        let refused = |change: &dyn Fn(&mut Config)| {
            let mut config = Config::default();
            change(&mut config);
            Pattern::new(&config).unwrap_err()
        };
        assert_eq!(
            refused(&|config| config.teams.blue = "navy".into()),
            TrackerError::UnknownColor { user: "the blue team".into(), color: "navy".into() }
        );
        assert_eq!(
            refused(&|config| config.robots.identities[1].colors[0] = "mauve".into()),
            TrackerError::UnknownColor { user: "yellow 1".into(), color: "mauve".into() }
        );
        assert_eq!(
            refused(&|config| config.robots.patches[1].role = PatchRole::Team),
            TrackerError::TeamPatches(2)
        );
        assert_eq!(
            refused(&|config| config.robots.patches.truncate(1)),
            TrackerError::IdentificationPatches(0)
        );
        assert_eq!(
            refused(&|config| config.robots.patches[1].outline_mm[0][0] = 1e9),
            TrackerError::InvisiblePatch(1)
        );
        assert_eq!(
            refused(&|config| {
                config.robots.patches[0].outline_mm = config.robots.patches[1].outline_mm.clone();
            }),
            TrackerError::InvisiblePatch(0)
        );
        assert_eq!(
            refused(&|config| config.robots.identities[2].colors.clear()),
            TrackerError::ColorCount { team: Team::Yellow, id: 2, got: 0, expected: 1 }
        );
        assert_eq!(
            refused(&|config| config.robots.identities[2].id = 1),
            TrackerError::DuplicateIdentity { team: Team::Yellow, id: 1 }
        );
        assert!(matches!(
            refused(&|config| config.tracker.min_area_ratio = f64::NAN),
            TrackerError::Value { key: "tracker.min_area_ratio", .. }
        ));
        assert!(matches!(
            refused(&|config| config.robots.height_mm = 1e4),
            TrackerError::Value { key: "robots.height_mm", .. }
        ));
    }
}
