//! The pattern: the tops of robots as they appear, and the colours that each robot wears.
//!
//! Everything that follows from the configuration alone is computed here, once, and an unusable configuration
//! is refused here. A *top* ([`Top`]) is a combination of patches and height. A *kind* ([`Kind`]) is a patch
//! of a top in a colour. An *identity* ([`Identity`]) is a robot of a team and number, with a kind for each
//! patch of its top.

pub(crate) mod cell_grid;
pub(crate) mod footprint;
pub(crate) mod shares;
mod top;

use crate::error::TrackerError;
use config::Config;
use messages::Team;
use top::Tops;
pub(crate) use top::{ExpectedPatch, Top, principal_deviations};

/// The robots to look for.
#[derive(Debug, Clone)]
pub(crate) struct Pattern {
    /// Every combination of patches and height that robots have.
    pub tops: Vec<Top>,
    /// Every combination of colour and patch that some robot wears; kinds of team patches first.
    pub kinds: Vec<Kind>,
    /// For each kind, an earlier one with the same candidates: same colour, same height, and a patch of the
    /// same size and form.
    pub alike: Vec<Option<usize>>,
    /// The configured robots.
    pub identities: Vec<Identity>,
    /// Heights of tops, each once.
    pub heights_mm: Vec<f64>,
    teams: [TeamPattern; 2],
    /// Side or diameter of a robot.
    pub size_mm: f64,
    pub limits: Limits,
}

/// Properties shared by the robots of a team.
#[derive(Debug, Clone)]
struct TeamPattern {
    /// Colour class.
    class: u32,
    /// Kinds of the team patches, one for each top that robots of the team have.
    kinds: Vec<usize>,
    /// Index of the top of robots without a top of their own.
    usual_top: usize,
    /// For each of `kinds`, the identities that wear it, sorted by their kinds.
    wearers: Vec<Vec<usize>>,
}

/// A patch of a top in a colour.
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

/// A robot by team and number, and the kinds that it wears.
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
            // Unidentified robots are found by the usual top.
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

    /// The top of a kind.
    pub fn top_of_kind(&self, kind: &Kind) -> &Top {
        &self.tops[kind.top]
    }

    /// The patch of a kind.
    pub fn patch_of_kind(&self, kind: &Kind) -> &ExpectedPatch {
        &self.tops[kind.top].patches[kind.patch]
    }

    /// The top of a team's robots without a top of their own.
    pub fn usual_top(&self, team: Team) -> &Top {
        &self.tops[self.teams[team as usize].usual_top]
    }

    /// Index of [`Pattern::usual_top`].
    pub fn usual_top_index(&self, team: Team) -> usize {
        self.teams[team as usize].usual_top
    }

    /// Index of the identity of a team and number as in a message.
    pub fn identity_of(&self, team: u32, id: u32) -> Option<usize> {
        let is_it = |identity: &Identity| (identity.team as u32, identity.id) == (team, id);
        self.identities.iter().position(is_it)
    }

    /// The top of a robot of a team and number as in a message.
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

    /// Indices of the identities that wear a kind of team patch, sorted by their kinds.
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

    /// Whether an area may be that of a patch, as a ratio to the expected area.
    pub fn admit_area(&self, ratio: f64) -> bool {
        (self.min_area_ratio..=self.max_area_ratio).contains(&ratio)
    }

    /// (ln ratio / ln limit)²: 0 for the expected area, 1 at either limit.
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

#[cfg(test)]
mod tests {
    use super::*;
    use config::{PatchRole, Preset};

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
