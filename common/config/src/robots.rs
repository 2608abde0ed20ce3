//! Robot configuration: teams, bodies, the patches on their tops, and each robot's colours.

use super::{Config, PatchConfig, RobotShape};
use geometry::body::Body;
use messages::{MAX_PATCHES, MAX_ROBOTS, Team};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The two teams.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TeamsConfig {
    /// The yellow team; `yellow = "orange"` is short for its colour.
    pub yellow: TeamConfig,
    /// The blue team; `blue = "cyan"` is short for its colour.
    pub blue: TeamConfig,
}

/// A team.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend("type" = ["object", "string"]))]
pub struct TeamConfig {
    /// Colour of its patches; the default is the preset's.
    #[serde(default)]
    #[schemars(length(min = 1))]
    pub color: String,
    /// Height of its robots' tops above the floor, if it differs from `robots.height_mm`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 1000), extend("examples" = [150]))]
    pub height_mm: Option<f64>,
}

impl TeamsConfig {
    /// A team.
    pub fn of(&self, team: Team) -> &TeamConfig {
        match team {
            Team::Yellow => &self.yellow,
            Team::Blue => &self.blue,
        }
    }

    /// The colour a team wears.
    pub fn color(&self, team: Team) -> &str {
        &self.of(team).color
    }
}

impl From<&str> for TeamConfig {
    fn from(color: &str) -> Self {
        Self { color: color.into(), height_mm: None }
    }
}

/// Identification colours of one robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct IdentityConfig {
    /// "yellow" or "blue".
    pub team: Team,
    /// Number in the team.
    #[schemars(range(max = 31))]
    pub id: u32,
    /// One colour for each identification patch, in the order of the patches.
    #[schemars(length(max = 5))]
    pub colors: Vec<String>,
    /// Patches of this robot, if they differ from `robots.patches`: robots may be distinguished by
    /// shapes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(length(min = 1, max = MAX_PATCHES), extend("examples" = [[
        {"role": "team", "outline_mm": [[35, 35], [2, 35], [2, -35], [35, -35]]},
        {"role": "identification", "outline_mm": [[-2, 35], [-35, 35], [-35, -35], [-2, -35]]},
    ]]))]
    pub patches: Option<Vec<PatchConfig>>,
    /// Height of its top above the floor, if it differs from its team's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 1000), extend("examples" = [140]))]
    pub height_mm: Option<f64>,
}

impl IdentityConfig {
    /// A robot with the common patches and height.
    pub fn new(team: Team, id: u32, colors: Vec<String>) -> Self {
        Self { team, id, colors, patches: None, height_mm: None }
    }
}

/// The robots and the colour patches on their tops.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RobotsConfig {
    /// "square" or "round".
    pub shape: RobotShape,
    /// Side of a square robot, diameter of a round one.
    #[schemars(range(min = 10, max = 500))]
    pub size_mm: f64,
    /// Distance from the centre to the front, for a round robot with a flat front. Default, and if as
    /// large as the radius: fully round.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = 250), extend("examples" = [75]))]
    pub front_mm: Option<f64>,
    /// Height of the robots' tops above the floor; teams and robots may have heights of their own.
    #[schemars(range(min = 0, max = 1000))]
    pub height_mm: f64,
    /// Distance along the axle between the centres of the drive wheels (b in eq. 7).
    #[schemars(range(min = 1, max = 500))]
    pub wheel_base_mm: f64,
    /// The patches: exactly one team patch, and up to five identification patches.
    #[schemars(length(min = 1, max = MAX_PATCHES))]
    pub patches: Vec<PatchConfig>,
    /// Report robots of which only the team's colour is recognised, without number and heading:
    /// opponents whose patches are not configured, robots that have lost a patch. They appear in
    /// `detections`, and are followed in `world`, in a list of their own.
    pub report_unknown: bool,
    /// The robots that may be on the pitch.
    #[schemars(length(max = MAX_ROBOTS))]
    pub identities: Vec<IdentityConfig>,
}

impl RobotsConfig {
    /// The body of a robot that has these patches on its top.
    pub fn body(&self, patches: &[PatchConfig]) -> Body {
        Body::new(self.shape, self.size_mm, self.front_mm, patches)
    }
}

impl AsRef<[PatchConfig]> for RobotsConfig {
    /// The patches of robots without patches of their own.
    fn as_ref(&self) -> &[PatchConfig] {
        &self.patches
    }
}

/// A robot's top: patches and height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Top<'a> {
    /// The patches, bottom first.
    pub patches: &'a [PatchConfig],
    /// Height above the floor.
    pub height_mm: f64,
}

impl Config {
    /// The top of a listed robot.
    pub fn top_of<'a>(&'a self, identity: &'a IdentityConfig) -> Top<'a> {
        let of_team = self.top_of_team(identity.team);
        Top {
            patches: identity.patches.as_deref().unwrap_or(of_team.patches),
            height_mm: identity.height_mm.unwrap_or(of_team.height_mm),
        }
    }

    /// The top of a robot of which only the team is known.
    pub fn top_of_team(&self, team: Team) -> Top<'_> {
        let robots = &self.robots;
        let height_mm = self.teams.of(team).height_mm.unwrap_or(robots.height_mm);
        Top { patches: &robots.patches, height_mm }
    }

    /// The top of a robot given by the numbers in messages; its id may be unknown.
    pub fn top(&self, team: u32, id: Option<u32>) -> Top<'_> {
        let is_it =
            |identity: &&IdentityConfig| (identity.team as u32, Some(identity.id)) == (team, id);
        match (self.robots.identities.iter().find(is_it), Team::from_number(team)) {
            (Some(identity), _) => self.top_of(identity),
            (None, Some(team)) => self.top_of_team(team),
            (None, None) => Top { patches: &self.robots.patches, height_mm: self.robots.height_mm },
        }
    }

    /// Height of the tallest possible robot.
    pub fn tallest_robot_mm(&self) -> f64 {
        let listed = self.robots.identities.iter().map(|identity| self.top_of(identity));
        let teams = Team::ALL.map(|team| self.top_of_team(team));
        listed.chain(teams).map(|top| top.height_mm).fold(0.0, f64::max)
    }
}
