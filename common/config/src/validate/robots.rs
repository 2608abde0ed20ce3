//! Checks of robots: patches must be visible, and identities distinguishable.

use super::super::problem::Problem;
use super::super::{Config, IdentityConfig, Pair, PatchConfig, PatchRole};
use geometry::layout::Layout;

impl Config {
    pub(super) fn check_robots(&self, problems: &mut Vec<Problem>) {
        let robots = &self.robots;
        if robots.wheel_base_mm > robots.size_mm * std::f64::consts::SQRT_2 {
            let message = format!("the wheels stand outside a robot of {} mm", robots.size_mm);
            problems.push(Problem::new("robots.wheel_base_mm", message).related("robots.size_mm"));
        }
        self.check_patches(&robots.patches, "robots.patches", problems);
        for (index, identity) in robots.identities.iter().enumerate() {
            if let Some(patches) = &identity.patches {
                let path = format!("robots.identities[{index}].patches");
                self.check_patches(patches, &path, problems);
            }
        }
    }

    fn check_patches(&self, patches: &[PatchConfig], path: &str, problems: &mut Vec<Problem>) {
        let team_patches = patches.iter().filter(|patch| patch.role == PatchRole::Team).count();
        if team_patches != 1 {
            let message =
                format!("exactly one patch must have the role \"team\", {team_patches} have it");
            problems.push(Problem::new(path, message));
        }
        // Patches may overhang, but coordinates much larger than that are measured from a corner.
        let size_mm = self.robots.size_mm;
        let reach = 0.75 * size_mm;
        for (index, patch) in patches.iter().enumerate() {
            if patch.outline_mm.iter().flatten().any(|value| value.abs() > reach) {
                let message = format!("lies outside a robot of {size_mm} mm");
                let path = format!("{path}[{index}].outline_mm");
                let help = "corners count from the robot's centre, x forward, y left";
                problems.push(Problem::new(path, message).help(help).related("robots.size_mm"));
            }
        }
    }

    pub(super) fn check_identities(&self, problems: &mut Vec<Problem>) {
        let identities = &self.robots.identities;
        for (index, identity) in identities.iter().enumerate() {
            let path = format!("robots.identities[{index}]");
            let same =
                |other: &IdentityConfig| (other.team, other.id) == (identity.team, identity.id);
            if let Some(first) = identities[..index].iter().position(same) {
                let message = format!("{} is already listed in", robot_name(identity));
                let message = format!("{message} robots.identities[{first}]");
                problems.push(Problem::new(format!("{path}.id"), message));
            }
            let patches = identification_patches(self.top_of(identity).patches);
            if identity.colors.len() != patches {
                let message = format!(
                    "needs one colour for each identification patch, that is {patches}, has {}",
                    identity.colors.len()
                );
                let problem = Problem::new(format!("{path}.colors"), message);
                problems.push(problem.related("robots.patches"));
            }
            for (place, color) in identity.colors.iter().enumerate() {
                problems.extend(self.check_color(format!("{path}.colors[{place}]"), color));
            }
        }
    }

    /// Every patch must be visible, and every robot must look different from every other at any
    /// rotation.
    pub(super) fn check_layout(&self, problems: &mut Vec<Problem>) {
        let common = Layout::new(&self.robots);
        check_visible(&common, "robots.patches", problems);
        let own: Vec<Option<Layout>> = self
            .robots
            .identities
            .iter()
            .map(|identity| identity.patches.as_deref().map(Layout::new))
            .collect();
        for (index, layout) in own.iter().enumerate() {
            if let Some(layout) = layout {
                let path = format!("robots.identities[{index}].patches");
                check_visible(layout, &path, problems);
            }
        }
        if problems.iter().any(|problem| problem.path.contains("patches")) {
            return;
        }
        let layouts: Vec<&Layout> = own.iter().map(|own| own.as_ref().unwrap_or(&common)).collect();
        self.check_looks(&layouts, problems);
    }

    fn check_looks(&self, layouts: &[&Layout], problems: &mut Vec<Problem>) {
        let robots = &self.robots.identities;
        let robots_and_layouts = robots.iter().zip(layouts);
        let tops: Vec<Top> =
            robots_and_layouts.map(|(robot, layout)| Top::new(layout, &robot.colors)).collect();
        let complete =
            |index: usize| robots[index].colors.len() + 1 == layouts[index].patches.len();
        for (index, robot) in robots.iter().enumerate().filter(|&(index, _)| complete(index)) {
            let path = format!("robots.identities[{index}].colors");
            let alike = (0..index)
                .filter(|&other| complete(other))
                .filter(|&other| robots[other].team == robot.team && robots[other].id != robot.id)
                .find_map(|other| Some((other, tops[index].turned_onto(&tops[other], 0.0)?)));
            if let Some((other, degrees)) = alike {
                let other = robot_name(&robots[other]);
                let turned = if degrees < 1.0 {
                    String::new()
                } else {
                    format!(" turned by {degrees:.0}°")
                };
                let message = format!("looks exactly like {other}{turned}");
                problems.push(Problem::new(path, message).related("robots.patches"));
            } else if let Some(degrees) = tops[index].turned_onto(&tops[index], MIN_TURN_DEG) {
                let message =
                    format!("looks the same turned by {degrees:.0}°: its heading cannot be told");
                problems.push(Problem::new(path, message).related("robots.patches"));
            }
        }
    }

    pub(super) fn warn_of_shared_colors(&self, warnings: &mut Vec<Problem>) {
        for (index, identity) in self.robots.identities.iter().enumerate() {
            // Robots distinguished by shapes may well have several patches in the team's colour.
            if identity.patches.is_some() {
                continue;
            }
            for (place, color) in identity.colors.iter().enumerate() {
                let taken = match self.team_wearing(color) {
                    Some(team) => format!("the {} team's patches", team.name()),
                    None if *color == self.ball.color => "the ball".to_string(),
                    None => continue,
                };
                let path = format!("robots.identities[{index}].colors[{place}]");
                warnings.push(Problem::new(path, format!("is also the colour of {taken}")));
            }
        }
    }

    pub(super) fn warn_of_blind_robots(&self, warnings: &mut Vec<Problem>) {
        if self.robots.identities.is_empty() {
            let message = "no robot is listed: none will be found";
            warnings.push(Problem::new("robots.identities", message));
        }
        if identification_patches(&self.robots.patches) == 0 {
            let message = "without an identification patch no heading can be told";
            warnings.push(Problem::new("robots.patches", message));
        }
    }
}

fn identification_patches(patches: &[PatchConfig]) -> usize {
    patches.iter().filter(|patch| patch.role == PatchRole::Identification).count()
}

fn check_visible(layout: &Layout, path: &str, problems: &mut Vec<Problem>) {
    for (index, patch) in layout.patches.iter().enumerate() {
        // A hundredth of the smallest useful patch.
        if patch.area_mm2 < 1.0 {
            let message = "nothing of this patch shows: it has no area, or others cover it";
            problems.push(Problem::new(format!("{path}[{index}].outline_mm"), message));
        }
    }
}

/// A robot's top as the tracker compares it: coloured centroids relative to the team patch, and patch
/// sizes.
struct Top<'a> {
    team_mm2: f64,
    dots: Vec<Dot<'a>>,
}

/// An identification patch.
#[derive(Clone, Copy)]
struct Dot<'a> {
    place: Pair,
    area_mm2: f64,
    color: &'a str,
}

/// Centroids closer than this count as equal.
const SAME_PLACE_MM: f64 = 2.0;
/// Patches whose areas differ by a smaller factor count as equal.
const SAME_AREA: f64 = 1.25;
/// Smaller rotations count as none.
const MIN_TURN_DEG: f64 = 5.0;

impl<'a> Top<'a> {
    fn new(layout: &Layout, colors: &'a [String]) -> Self {
        let team = layout.patches.iter().find(|patch| patch.role == PatchRole::Team);
        let [team_x, team_y] = team.map_or([0.0; 2], |patch| patch.centroid_mm);
        let dots = layout
            .patches
            .iter()
            .filter(|patch| patch.role == PatchRole::Identification)
            .zip(colors)
            .map(|(patch, color)| Dot {
                place: [patch.centroid_mm[0] - team_x, patch.centroid_mm[1] - team_y],
                area_mm2: patch.area_mm2,
                color,
            })
            .collect();
        Self { team_mm2: team.map_or(0.0, |patch| patch.area_mm2), dots }
    }

    /// The angle, at least `min_deg` degrees, by which this top must be turned to look like `other`.
    fn turned_onto(&self, other: &Top, min_deg: f64) -> Option<f64> {
        if self.dots.len() != other.dots.len() || !is_same_area(self.team_mm2, other.team_mm2) {
            return None;
        }
        // The farthest dot determines the angle best.
        let furthest = |dots: &[Dot<'a>]| {
            let radius = |dot: &Dot| f64::hypot(dot.place[0], dot.place[1]);
            dots.iter().copied().max_by(|a, b| radius(a).total_cmp(&radius(b)))
        };
        let Some(Dot { place: [x, y], .. }) = furthest(&self.dots) else {
            // Only a team patch: all robots look alike, and no rotation is visible.
            return (min_deg == 0.0).then_some(0.0);
        };
        let angle = |[x, y]: Pair| y.atan2(x).to_degrees();
        // All dots are in the middle of the team patch: any rotation looks the same.
        let turns: Vec<f64> = if x.hypot(y) < SAME_PLACE_MM {
            vec![min_deg]
        } else {
            let onto = |dot: &Dot| (angle(dot.place) - angle([x, y])).rem_euclid(360.0);
            other.dots.iter().map(onto).collect()
        };
        turns
            .into_iter()
            .filter(|turn| turn.min(360.0 - turn) >= min_deg)
            .find(|turn| self.dots.iter().all(|&dot| other.shows(turned(dot, *turn))))
    }

    fn shows(&self, dot: Dot) -> bool {
        self.dots.iter().any(|other| {
            let [dx, dy] = [0, 1].map(|axis| dot.place[axis] - other.place[axis]);
            dx.hypot(dy) < SAME_PLACE_MM
                && is_same_area(dot.area_mm2, other.area_mm2)
                && dot.color == other.color
        })
    }
}

fn is_same_area(a: f64, b: f64) -> bool {
    a.max(b) < SAME_AREA * a.min(b)
}

fn turned(dot: Dot, degrees: f64) -> Dot {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let [x, y] = dot.place;
    Dot { place: [cos * x - sin * y, sin * x + cos * y], ..dot }
}

fn robot_name(robot: &IdentityConfig) -> String {
    format!("{} {}", robot.team.name(), robot.id)
}

#[cfg(test)]
mod tests {
    use super::super::super::ColorConfig;
    use super::super::tests::{accepted, refused};
    use super::*;
    use messages::{MAX_PATCHES, MAX_ROBOTS, Team};

    fn square(center: Pair, half: f64) -> Vec<Pair> {
        let [x, y] = center;
        vec![[x + half, y + half], [x - half, y + half], [x - half, y - half], [x + half, y - half]]
    }

    fn identification(center: Pair) -> PatchConfig {
        PatchConfig { role: PatchRole::Identification, outline_mm: square(center, 8.0) }
    }

    fn wear(config: &mut Config, colors: &[&[&str]]) {
        let robots = colors.iter().enumerate().map(|(id, colors)| {
            let colors = colors.iter().map(|&color| color.into()).collect();
            IdentityConfig::new(Team::Blue, id as u32, colors)
        });
        config.robots.identities = robots.collect();
    }

    #[test]
    fn robots_must_be_told_apart() {
        refused("robots.identities[1].id", "yellow 0 is already listed", |config| {
            config.robots.identities[1].id = 0;
        });
        refused("robots.identities[1].colors", "looks exactly like yellow 0", |config| {
            config.robots.identities[1].colors = vec!["green".into()];
        });
        refused("robots.identities[1].colors", "that is 1, has 2", |config| {
            config.robots.identities[1].colors.push("red".into());
        });
        refused("robots.identities[1].id", "between 0 and 31", |config| {
            config.robots.identities[1].id = 32;
        });
        refused("robots.identities", "at most 32", |config| {
            config.colors.truncate(1);
            let colors = (0..=MAX_ROBOTS)
                .map(|index| ColorConfig { name: format!("c{index}"), ..config.colors[0].clone() });
            config.colors = colors.take(32).collect();
            config.ball.color = "c0".into();
            config.teams.yellow = "c1".into();
            config.teams.blue = "c2".into();
            config.robots.identities = (0..=MAX_ROBOTS as u32)
                .map(|number| {
                    let team = Team::ALL[number as usize % 2];
                    IdentityConfig::new(team, number / 2, vec![format!("c{}", 3 + number / 2)])
                })
                .collect();
        });
    }

    #[test]
    fn a_turned_robot_must_not_look_like_another() {
        // Two dots on opposite sides of a team patch in the middle.
        let opposite = |config: &mut Config| {
            config.robots.patches = vec![
                PatchConfig { role: PatchRole::Team, outline_mm: square([0.0, 0.0], 15.0) },
                identification([25.0, 0.0]),
                identification([-25.0, 0.0]),
            ];
        };
        accepted(|config| {
            opposite(config);
            wear(config, &[&["green", "red"], &["green", "cyan"], &["red", "cyan"]]);
        });
        refused("robots.identities[1].colors", "exactly like blue 0 turned by 180°", |config| {
            opposite(config);
            wear(config, &[&["green", "red"], &["red", "green"]]);
        });
        refused("robots.identities[0].colors", "the same turned by 180°", |config| {
            opposite(config);
            wear(config, &[&["red", "red"]]);
        });
        refused("robots.identities[0].colors", "heading cannot be told", |config| {
            opposite(config);
            config.robots.patches.pop();
            config.robots.patches[1] = identification([0.0, 0.0]);
            wear(config, &[&["red"]]);
        });
    }

    #[test]
    fn patches_must_show() {
        refused("robots.patches", "exactly one patch", |config| {
            config.robots.patches[1].role = PatchRole::Team;
            config.robots.identities.clear();
        });
        refused("robots.patches[0].outline_mm", "at least 3", |config| {
            config.robots.patches[0].outline_mm.truncate(2);
        });
        refused("robots.patches[0].outline_mm", "nothing of this patch shows", |config| {
            config.robots.patches[1].outline_mm = square([0.0, 0.0], 37.0);
        });
        refused("robots.patches[1].outline_mm", "nothing of this patch shows", |config| {
            config.robots.patches[1].outline_mm = vec![[0.0, 0.0], [-10.0, 0.0], [-20.0, 0.0]];
        });
        refused("robots.patches[0].outline_mm", "outside a robot of 75 mm", |config| {
            config.robots.patches[0].outline_mm = square([50.0, 50.0], 17.0);
        });
        refused("robots.patches", "at most 6", |config| {
            config.robots.identities.clear();
            while config.robots.patches.len() <= MAX_PATCHES {
                config.robots.patches.push(identification([0.0, 0.0]));
            }
        });
    }
}
