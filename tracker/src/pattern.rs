//! What to look for: the patches of a robot as they show, and which robot wears which colours.
//!
//! Everything that can be computed from the configuration alone is computed here, once, and
//! everything that is wrong with it is refused here.

use crate::error::TrackerError;
use crate::footprint::Footprints;
use crate::shares::Shares;
use common::body::Body;
use common::config::{self, Config, Pair, PatchConfig, PatchRole};
use common::layout::{Layout, topmost_patch};
use common::messages::{MAX_PATCHES, Team};

/// The robots to look for.
#[derive(Debug, Clone)]
pub(crate) struct Pattern {
    /// Every combination of patches and height that robots have.
    pub tops: Vec<Top>,
    /// Every combination of colour and patch that some robot wears; kinds of team patches first.
    pub kinds: Vec<Kind>,
    /// For each kind, an earlier one that has the same candidates: same colour, same height, and a patch
    /// of the same size and form.
    pub alike: Vec<Option<usize>>,
    /// The robots that may be on the pitch.
    pub identities: Vec<Identity>,
    /// Heights of tops, each once.
    pub heights_mm: Vec<f64>,
    teams: [TeamPattern; 2],
    /// Side or diameter of a robot.
    pub size_mm: f64,
    /// Tolerances.
    pub limits: Limits,
}

/// What a robot's top shows, and how high it is.
#[derive(Debug, Clone)]
pub(crate) struct Top {
    /// In the configured order.
    pub patches: Vec<ExpectedPatch>,
    /// Between the visible centroids of any two patches.
    distances_mm: [[f64; MAX_PATCHES]; MAX_PATCHES],
    /// Which of them is the team patch.
    pub team_patch: usize,
    /// Above the floor.
    pub height_mm: f64,
    /// Index into [`Pattern::heights_mm`].
    pub height: usize,
    /// The body below it.
    pub body: Body,
    /// The same somewhat smaller: such bodies never overlap, however badly poses are measured.
    pub core: Body,
    /// The parts of the top that may belong to each patch.
    pub footprints: Footprints,
    /// How much of each patch there is at every point of it.
    pub shares: Shares,
}

/// Properties shared by the robots of a team.
#[derive(Debug, Clone)]
struct TeamPattern {
    /// Colour class.
    class: u32,
    /// The kinds of its team patches, one for each top that its robots have.
    kinds: Vec<usize>,
    /// Index of the top of its robots that have none of their own.
    usual_top: usize,
    /// For each of `kinds`, the identities that wear it, those that begin with the same kinds side by
    /// side.
    wearers: Vec<Vec<usize>>,
}

/// Bodies shrunk to this fraction of their size must not overlap.
const BODY_FRACTION: f64 = 0.8;

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
    /// Index into [`Pattern::tops`].
    pub top: usize,
    /// Index into the patches of the top.
    pub patch: usize,
    /// For the team patch, the team that wears the colour.
    pub team: Option<Team>,
}

/// A robot by name, and what it wears.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Identity {
    pub team: Team,
    pub id: u32,
    /// Index into [`Pattern::tops`].
    pub top: usize,
    /// For each patch of its top, the index of its kind.
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
        let mut tops = Tops::default();
        let of_identities = robots
            .identities
            .iter()
            .map(|identity| tops.index_of(config, config.top_of(identity)))
            .collect::<Result<Vec<usize>, _>>()?;

        let mut kinds = Vec::new();
        let mut teams = Vec::new();
        for team in Team::ALL {
            let class =
                class_of(config, config.teams.color(team), || format!("the {} team", team.name()))?;
            let usual_top = tops.index_of(config, config.top_of_team(team))?;
            let of_team = robots.identities.iter().zip(&of_identities);
            let of_team = of_team.filter(|(identity, _)| identity.team == team);
            let mut its_tops: Vec<usize> = of_team.map(|(_, &top)| top).collect();
            // Robots of which nothing else is known are looked for by the usual one.
            if its_tops.is_empty() || robots.report_unknown {
                its_tops.push(usual_top);
            }
            its_tops.sort_unstable();
            its_tops.dedup();
            let first = kinds.len();
            kinds.extend(its_tops.iter().map(|&top| Kind {
                class,
                top,
                patch: tops.list[top].team_patch,
                team: Some(team),
            }));
            let wearers = vec![Vec::new(); its_tops.len()];
            teams.push(TeamPattern {
                class,
                kinds: (first..kinds.len()).collect(),
                usual_top,
                wearers,
            });
        }
        let mut identities: Vec<Identity> = Vec::new();
        for (identity, top) in robots.identities.iter().zip(of_identities) {
            let (team, id) = (identity.team, identity.id);
            if identities.iter().any(|known| (known.team, known.id) == (team, id)) {
                return Err(TrackerError::DuplicateIdentity { team, id });
            }
            let (patches, team_patch) = (tops.list[top].patches.len(), tops.list[top].team_patch);
            if identity.colors.len() != patches - 1 {
                return Err(TrackerError::ColorCount {
                    team,
                    id,
                    got: identity.colors.len(),
                    expected: patches - 1,
                });
            }
            let mut colors = identity.colors.iter();
            let mut own_kinds = Vec::with_capacity(patches);
            for patch in 0..patches {
                let kind = if patch == team_patch {
                    Kind { class: teams[team as usize].class, top, patch, team: Some(team) }
                } else {
                    let color = colors.next().map_or("", String::as_str);
                    let class = class_of(config, color, || format!("{} {id}", team.name()))?;
                    Kind { class, top, patch, team: None }
                };
                let index = kinds.iter().position(|known| *known == kind).unwrap_or_else(|| {
                    kinds.push(kind);
                    kinds.len() - 1
                });
                own_kinds.push(index);
            }
            identities.push(Identity { team, id, top, kinds: own_kinds });
        }
        for TeamPattern { kinds: of_team, wearers, .. } in &mut teams {
            for (&kind, wearers) in of_team.iter().zip(wearers) {
                let wears = |&index: &usize| {
                    let Identity { top, kinds, .. } = &identities[index];
                    kinds[tops.list[*top].team_patch] == kind
                };
                wearers.extend((0..identities.len()).filter(wears));
                wearers.sort_by(|&a, &b| identities[a].kinds.cmp(&identities[b].kinds));
            }
        }
        let alike = (0..kinds.len())
            .map(|index| (0..index).find(|&other| tops.are_alike(&kinds[index], &kinds[other])))
            .collect();
        let [yellow, blue] = <[TeamPattern; 2]>::try_from(teams).expect("there are two teams");
        Ok(Self {
            tops: tops.list,
            kinds,
            alike,
            identities,
            heights_mm: tops.heights_mm,
            teams: [yellow, blue],
            size_mm: robots.size_mm,
            limits,
        })
    }

    /// The top of a robot.
    pub fn top_of(&self, identity: usize) -> &Top {
        &self.tops[self.identities[identity].top]
    }

    /// The top that a kind belongs to.
    pub fn top_of_kind(&self, kind: &Kind) -> &Top {
        &self.tops[kind.top]
    }

    /// Expected appearance of a kind's patch.
    pub fn patch_of_kind(&self, kind: &Kind) -> &ExpectedPatch {
        &self.tops[kind.top].patches[kind.patch]
    }

    /// The top of a team's robots that have none of their own.
    pub fn usual_top(&self, team: Team) -> &Top {
        &self.tops[self.teams[team as usize].usual_top]
    }

    /// Its index.
    pub fn usual_top_index(&self, team: Team) -> usize {
        self.teams[team as usize].usual_top
    }

    /// Index of the identity that a message names by numbers.
    pub fn identity_of(&self, team: u32, id: u32) -> Option<usize> {
        let is_it = |identity: &Identity| (identity.team as u32, identity.id) == (team, id);
        self.identities.iter().position(is_it)
    }

    /// The top of a robot that a message names by numbers.
    pub fn top_by_numbers(&self, team: u32, id: Option<u32>) -> &Top {
        let identity = id.and_then(|id| self.identity_of(team, id));
        match (identity, Team::from_number(team)) {
            (Some(identity), _) => self.top_of(identity),
            (None, team) => self.usual_top(team.unwrap_or(Team::Yellow)),
        }
    }

    /// Indices of the kinds of a team's team patches, at least one.
    pub fn team_kinds(&self, team: Team) -> &[usize] {
        &self.teams[team as usize].kinds
    }

    /// Indices of the identities whose team patch is of a kind, those that begin with the same kinds side
    /// by side.
    pub fn wearers(&self, team_kind: usize) -> &[usize] {
        let of = |team: &TeamPattern| team.kinds.iter().position(|&kind| kind == team_kind);
        let found = self.teams.iter().find_map(|team| Some(&team.wearers[of(team)?]));
        found.map_or(&[], Vec::as_slice)
    }

    /// Class of a team's colour.
    pub fn team_class(&self, team: Team) -> u32 {
        self.teams[team as usize].class
    }
}

impl Top {
    fn new(config: &Config, top: config::Top, height: usize) -> Result<Self, TrackerError> {
        let size_mm = config.robots.size_mm;
        let patches = expected_patches(size_mm, top.patches)?;
        let mut distances_mm = [[0.0; MAX_PATCHES]; MAX_PATCHES];
        for (row, a) in distances_mm.iter_mut().zip(&patches) {
            for (distance, b) in row.iter_mut().zip(&patches) {
                let ([ax, ay], [bx, by]) = (a.centroid_mm, b.centroid_mm);
                *distance = (ax - bx).hypot(ay - by);
            }
        }
        let is_team = |patch: &PatchConfig| patch.role == PatchRole::Team;
        let team_patch =
            top.patches.iter().position(is_team).ok_or(TrackerError::TeamPatches(0))?;
        let body = Body::new(&config.robots, top.patches);
        Ok(Self {
            patches,
            distances_mm,
            team_patch,
            height_mm: top.height_mm,
            height,
            body,
            core: body.scaled(BODY_FRACTION),
            footprints: Footprints::new(top.patches),
            shares: Shares::new(top.patches),
        })
    }

    /// Distance between the visible centroids of two patches.
    pub fn distance_mm(&self, a: usize, b: usize) -> f64 {
        self.distances_mm[a][b]
    }

    /// d₁ of eq. (4): no two robots of a team can have their team patches nearer than ¾ of this.
    pub fn team_patch_size_mm(&self) -> f64 {
        self.patches[self.team_patch].size_mm()
    }
}

/// Collects tops, each once.
#[derive(Default)]
struct Tops<'a> {
    list: Vec<Top>,
    configured: Vec<config::Top<'a>>,
    heights_mm: Vec<f64>,
}

impl<'a> Tops<'a> {
    fn index_of(&mut self, config: &Config, top: config::Top<'a>) -> Result<usize, TrackerError> {
        if let Some(known) = self.configured.iter().position(|known| *known == top) {
            return Ok(known);
        }
        if !(top.height_mm >= 0.0 && top.height_mm < config.geometry.camera_mm[2]) {
            return Err(TrackerError::Value {
                key: "robots.height_mm",
                value: top.height_mm,
                must: "at least 0 and below the camera",
            });
        }
        let height = self.heights_mm.iter().position(|&height_mm| height_mm == top.height_mm);
        let height = height.unwrap_or_else(|| {
            self.heights_mm.push(top.height_mm);
            self.heights_mm.len() - 1
        });
        self.list.push(Top::new(config, top, height)?);
        self.configured.push(top);
        Ok(self.list.len() - 1)
    }

    /// Whether whatever may be a patch of one kind may be one of the other.
    fn are_alike(&self, a: &Kind, b: &Kind) -> bool {
        let (top_a, top_b) = (&self.list[a.top], &self.list[b.top]);
        a.class == b.class
            && top_a.height == top_b.height
            && top_a.patches[a.patch].is_congruent(&top_b.patches[b.patch])
    }
}

impl ExpectedPatch {
    /// The patch size d₁ of eqs. (4) and (5): the side of a square. For any other shape it is the
    /// side of the square of the same area or of the same narrowness, whichever is smaller,
    /// because elongated patches can come close to each other side by side.
    pub fn size_mm(&self) -> f64 {
        self.area_mm2.sqrt().min(12f64.sqrt() * self.minor_mm)
    }

    /// Whether another patch has the same size and form, as exactly as these are measured.
    fn is_congruent(&self, other: &Self) -> bool {
        const SAME: f64 = 0.02;
        let is_same = |a: f64, b: f64| (a - b).abs() <= SAME * a.max(b);
        is_same(self.area_mm2, other.area_mm2)
            && is_same(self.major_mm, other.major_mm)
            && is_same(self.minor_mm, other.minor_mm)
            && is_same(self.reach_mm, other.reach_mm)
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

fn expected_patches(
    size_mm: f64,
    configured: &[PatchConfig],
) -> Result<Vec<ExpectedPatch>, TrackerError> {
    let count = configured.len();
    let team_patches = configured.iter().filter(|patch| patch.role == PatchRole::Team).count();
    if team_patches != 1 {
        return Err(TrackerError::TeamPatches(team_patches));
    }
    if !(2..=MAX_PATCHES).contains(&count) {
        return Err(TrackerError::IdentificationPatches(count - 1));
    }
    for (index, patch) in configured.iter().enumerate() {
        // Also keeps the sampling below within bounds.
        let is_absurd = |value: &f64| value.is_nan() || value.abs() > size_mm;
        if patch.outline_mm.iter().flatten().any(is_absurd) {
            return Err(TrackerError::InvisiblePatch(index));
        }
    }
    let layout = Layout::new(configured);
    let patches: Vec<ExpectedPatch> = layout
        .patches
        .iter()
        .zip(spreads(size_mm, configured, &layout))
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
fn spreads(size_mm: f64, configured: &[PatchConfig], layout: &Layout) -> Vec<ExpectedPatch> {
    #[derive(Clone, Copy, Default)]
    struct Sum {
        count: f64,
        covariance: [f64; 3],
        reach: f64,
    }
    const STEPS: i32 = 300;
    let step = size_mm / f64::from(STEPS);
    let mut sums = vec![Sum::default(); layout.patches.len()];
    for row in -STEPS..STEPS {
        for column in -STEPS..STEPS {
            let x = (f64::from(column) + 0.5) * step;
            let y = (f64::from(row) + 0.5) * step;
            let Some(patch) = topmost_patch(configured, [x, y]) else { continue };
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
        let top = &pattern.tops[0];
        let [team, identification] = top.patches[..] else { panic!("two patches") };
        assert!((team.size_mm() - 34.0).abs() < 0.2, "{team:?}");
        assert!((team.compactness() - 1.0).abs() < 0.01, "{team:?}");
        assert!((team.reach_mm - 17.0 * 2f64.sqrt()).abs() < 0.5, "{team:?}");
        assert!((identification.size_mm() - 34.0).abs() < 0.2, "{identification:?}");
        assert!((top.distance_mm(0, 1) - 36.0 * 2f64.sqrt()).abs() < 1e-6);
        // Two team colours, five identification colours that both teams share.
        assert_eq!(pattern.kinds.len(), 7);
    }

    #[test]
    fn a_stripe_is_as_large_as_it_is_narrow() {
        let pattern = Pattern::new(&Preset::MirosotLarge.config()).unwrap();
        assert!((pattern.tops[0].team_patch_size_mm() - 33.0).abs() < 0.3);
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
