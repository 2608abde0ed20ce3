//! Checks beyond the schema: references between keys, contradictions, and robots that look alike.

mod console;
mod geometry;
mod publish;
mod robots;

use super::problem::{Problem, listed, nearest, quoted};
use super::schema::Schema;
use super::{ColorConfig, Config, Pair, TeamsAccess};
use messages::Team;

impl Config {
    /// All problems that make this configuration unusable; empty for a usable one.
    pub fn problems(&self) -> Vec<Problem> {
        let mut problems = self.out_of_bounds();
        self.check_field(&mut problems);
        self.check_opponents(&mut problems);
        self.check_colors(&mut problems);
        self.check_roles(&mut problems);
        self.check_robots(&mut problems);
        self.check_identities(&mut problems);
        self.check_rest(&mut problems);
        publish::check(self, &mut problems);
        console::check(self, &mut problems);
        // With absurd sizes a check of the geometry would only repeat the problem.
        if none_in(&problems, &["field", "camera", "geometry", "robots.height_mm"]) {
            geometry::check(self, &mut problems);
        }
        // Measuring visible areas takes time proportional to the robot's area, so its size must be
        // sane.
        let is_of_patches = |problem: &Problem| problem.path.contains("patches");
        if none_in(&problems, &["robots.size_mm"]) && !problems.iter().any(is_of_patches) {
            self.check_layout(&mut problems);
        }
        problems
    }

    /// Settings that are possible but probably not intended.
    pub fn warnings(&self) -> Vec<Problem> {
        let mut warnings = Vec::new();
        self.warn_of_hidden_colors(&mut warnings);
        self.warn_of_shared_colors(&mut warnings);
        self.warn_of_blind_robots(&mut warnings);
        if f64::from(self.camera.exposure_us) * self.camera.fps > 1e6 {
            let message = format!("is longer than a frame at {} fps", self.camera.fps);
            warnings.push(Problem::new("camera.exposure_us", message).related("camera.fps"));
        }
        if self.access.group().is_none() && self.access.teams != TeamsAccess::default() {
            let message =
                "counts only for users of a group that may attach; access.group names none";
            warnings.push(Problem::new("access.teams", message).related("access.group"));
        }
        publish::warn(self, &mut warnings);
        geometry::warn(self, &mut warnings);
        warnings
    }

    /// Violations of the schema.
    fn out_of_bounds(&self) -> Vec<Problem> {
        // TOML's integers end at i64::MAX; a larger seed could not be checked at all.
        let mut written = self.clone();
        written.synthetic.seed = self.synthetic.seed.min(i64::MAX as u64);
        let mut problems = match toml::Value::try_from(&written) {
            Ok(value) => Schema::new().problems(&value),
            Err(error) => vec![Problem::new("", format!("cannot be written as TOML: {error}"))],
        };
        if written.synthetic.seed != self.synthetic.seed {
            let message = format!("must be at most {}, but is {}", i64::MAX, self.synthetic.seed);
            problems.push(Problem::new("synthetic.seed", message));
        }
        problems
    }

    fn check_opponents(&self, problems: &mut Vec<Problem>) {
        let lists = |team| self.robots.identities.iter().any(|robot| robot.team == team);
        if self.synthetic.unknown_opponents > 0
            && Team::ALL.into_iter().filter(|&team| lists(team)).count() != 1
        {
            let message = "unknown opponents need a list with robots of one team only";
            let problem = Problem::new("synthetic.unknown_opponents", message);
            problems.push(problem.related("robots.identities"));
        }
    }

    fn check_field(&self, problems: &mut Vec<Problem>) {
        let field = &self.field;
        if field.goal_width_mm > field.width_mm {
            let message = format!("the goal is wider than the field ({} mm)", field.width_mm);
            let problem = Problem::new("field.goal_width_mm", message);
            problems.push(problem.related("field.width_mm"));
        }
        if 2.0 * field.center_circle_radius_mm > field.width_mm.min(field.length_mm) {
            let message = "the centre circle does not fit on the field";
            let problem = Problem::new("field.center_circle_radius_mm", message);
            problems.push(problem.related("field.width_mm"));
        }
    }

    fn check_colors(&self, problems: &mut Vec<Problem>) {
        for (index, color) in self.colors.iter().enumerate() {
            let at = |key: &str| format!("colors[{index}].{key}");
            if !color.name.is_empty() && color.name.trim().is_empty() {
                problems.push(Problem::new(at("name"), "must not be blank"));
            }
            let namesake = self.colors[..index].iter().position(|other| other.name == color.name);
            if let Some(first) = namesake {
                let message = format!("{} is already the name of", quoted(&color.name));
                problems.push(Problem::new(at("name"), format!("{message} colors[{first}]")));
            }
            let bounds = [("red", color.red), ("green", color.green), ("blue", color.blue)];
            for (key, bounds) in bounds {
                problems.extend(check_order(at(key), bounds.map(f64::from)));
            }
            let yuv = [("y", color.y), ("u", color.u), ("v", color.v)];
            for (key, bounds) in yuv.into_iter().filter_map(|(key, bounds)| Some((key, bounds?))) {
                problems.extend(check_order(at(key), bounds.map(f64::from)));
            }
            if let Some(bounds) = color.saturation {
                problems.extend(check_order(at("saturation"), bounds));
            }
        }
    }

    /// Colours of teams, ball and robots must exist, and differ where required.
    fn check_roles(&self, problems: &mut Vec<Problem>) {
        for team in Team::ALL {
            let path = format!("teams.{}", team.name());
            problems.extend(self.check_color(path, self.teams.color(team)));
        }
        problems.extend(self.check_color("ball.color".into(), &self.ball.color));
        if self.teams.yellow.color == self.teams.blue.color {
            let message = format!("both teams wear {}", quoted(&self.teams.blue.color));
            problems.push(Problem::new("teams.blue", message).related("teams.yellow"));
        }
        if let Some(team) = self.team_wearing(&self.ball.color) {
            let message =
                format!("{} is the colour of team {}", quoted(&self.ball.color), team.name());
            let problem = Problem::new("ball.color", message);
            problems.push(problem.related(format!("teams.{}", team.name())));
        }
    }

    fn check_rest(&self, problems: &mut Vec<Problem>) {
        let supervisor = &self.supervisor;
        if supervisor.backoff_ms > supervisor.backoff_max_ms {
            let message = format!(
                "the longest pause is shorter than the first ({} ms)",
                supervisor.backoff_ms
            );
            let problem = Problem::new("supervisor.backoff_max_ms", message);
            problems.push(problem.related("supervisor.backoff_ms"));
        }
    }

    fn check_color(&self, path: String, name: &str) -> Option<Problem> {
        let names = || self.colors.iter().map(|color| color.name.as_str());
        if names().any(|known| known == name) {
            return None;
        }
        let help = match nearest(name, names()) {
            Some(meant) => format!("did you mean {}?", quoted(meant)),
            None => format!("the colours are {}", listed(names())),
        };
        let message = format!("there is no colour {}", quoted(name));
        Some(Problem::new(path, message).help(help).related("colors"))
    }

    fn team_wearing(&self, color: &str) -> Option<Team> {
        Team::ALL.into_iter().find(|&team| self.teams.color(team) == color)
    }

    fn warn_of_hidden_colors(&self, warnings: &mut Vec<Problem>) {
        for (index, color) in self.colors.iter().enumerate() {
            let cover = self.colors[..index].iter().find(|earlier| hides(earlier, color));
            if let Some(cover) = cover {
                let message = format!(
                    "never seen: its box lies within that of {}, which comes first",
                    quoted(&cover.name)
                );
                warnings.push(Problem::new(format!("colors[{index}].name"), message));
            }
        }
    }
}

fn check_order(path: String, [low, high]: Pair) -> Option<Problem> {
    let message = format!("from {low} to {high} is empty: the lowest value comes first");
    (low > high).then(|| Problem::new(path, message).help(format!("write [{high}, {low}]")))
}

/// Whether the `earlier` colour takes every pixel in `color`'s box. YUV boxes are ignored: a colour may
/// be meant for one kind of camera only.
fn hides(earlier: &ColorConfig, color: &ColorConfig) -> bool {
    let holds = |outer: [u8; 2], inner: [u8; 2]| outer[0] <= inner[0] && inner[1] <= outer[1];
    let is_of_yuv = earlier.yuv_box().is_some() || color.yuv_box().is_some();
    !is_of_yuv
        && earlier.hue_deg.is_none()
        && earlier.saturation.is_none()
        && holds(earlier.red, color.red)
        && holds(earlier.green, color.green)
        && holds(earlier.blue, color.blue)
}

/// Whether there is no problem at these keys and below.
fn none_in(problems: &[Problem], keys: &[&str]) -> bool {
    !problems.iter().any(|problem| {
        keys.iter().any(|&key| {
            problem
                .path
                .strip_prefix(key)
                .is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
        })
    })
}

#[cfg(test)]
mod tests {
    use super::super::Preset;
    use super::*;

    /// Problems of the default configuration after a change: paths and messages.
    pub(super) fn problems_after(change: impl FnOnce(&mut Config)) -> Vec<(String, String)> {
        let mut config = Config::default();
        change(&mut config);
        let problems = config.problems().into_iter();
        problems.map(|problem| (problem.path.clone(), problem.to_string())).collect()
    }

    /// Asserts that the change causes exactly one problem, at `path`, with `part` in its text.
    #[track_caller]
    pub(super) fn refused(path: &str, part: &str, change: impl FnOnce(&mut Config)) {
        let problems = problems_after(change);
        assert_eq!(problems.len(), 1, "{problems:#?}");
        assert_eq!(problems[0].0, path, "{problems:#?}");
        assert!(problems[0].1.contains(part), "{part:?} not in {problems:#?}");
    }

    #[track_caller]
    pub(super) fn accepted(change: impl FnOnce(&mut Config)) {
        assert_eq!(problems_after(change), []);
    }

    #[test]
    fn presets_are_sound() {
        for preset in Preset::ALL {
            assert_eq!(preset.config().problems(), [], "{}", preset.name());
            assert_eq!(preset.config().warnings(), [], "{}", preset.name());
        }
    }

    #[test]
    fn colors_must_be_usable() {
        refused("colors[1].name", "already the name of colors[0]", |config| {
            config.colors[1] = config.colors[0].clone();
            config.teams.yellow = "red".into();
        });
        refused("colors[3].red", "[7, 200]", |config| config.colors[3].red = [200, 7]);
        refused("colors[3].saturation", "empty", |config| {
            config.colors[3].saturation = Some([0.7, 0.2]);
        });
        refused("colors[3].saturation[1]", "between 0 and 1", |config| {
            config.colors[3].saturation = Some([0.7, 20.0]);
        });
        refused("colors[3].u", "[7, 200]", |config| config.colors[3].u = Some([200, 7]));
        refused("colors[3].hue_deg[0]", "between 0 and 360", |config| {
            config.colors[3].hue_deg = Some([-20.0, 20.0]);
        });
        accepted(|config| config.colors[3].hue_deg = Some([350.0, 20.0]));
        let more_colors = |config: &mut Config, count| {
            for index in config.colors.len()..count {
                let name = format!("spare {index}");
                config.colors.push(ColorConfig { name, ..config.colors[0].clone() });
            }
        };
        accepted(|config| more_colors(config, 32));
        refused("colors", "at most 32", |config| more_colors(config, 33));
        refused("colors[8].name", "must not be empty", |config| {
            more_colors(config, 9);
            config.colors[8].name.clear();
        });
        refused("colors[8].name", "must not be blank", |config| {
            more_colors(config, 9);
            config.colors[8].name = " ".into();
        });
    }

    #[test]
    fn references_must_lead_somewhere() {
        refused("teams.yellow", "did you mean \"yellow\"?", |config| {
            config.teams.yellow = "Yelow".into();
        });
        refused("ball.color", "the colours are orange, yellow", |config| {
            config.ball.color = "turquoise".into();
        });
        refused("ball.color", "colour of team blue", |config| config.ball.color = "blue".into());
        refused("teams.blue", "both teams", |config| config.teams.blue = "yellow".into());
        refused("robots.identities[4].colors[0]", "did you mean \"red\"?", |config| {
            config.robots.identities[4].colors[0] = "rad".into();
        });
    }

    #[test]
    fn numbers_must_be_possible() {
        refused("camera.fps", "between 1 and 10000, but is 0", |config| config.camera.fps = 0.0);
        refused("camera.fps", "finite", |config| config.camera.fps = f64::NAN);
        refused("camera.width", "16384", |config| config.camera.width = 20_000);
        refused("field.length_mm", "finite", |config| config.field.length_mm = f64::INFINITY);
        refused("filter.ball_noise_mm", "but is -1", |config| config.filter.ball_noise_mm = -1.0);
        refused("filter.heading_noise_deg", "0.001", |config| {
            config.filter.heading_noise_deg = 0.0
        });
        refused("geometry.points[2].image_px[1]", "finite", |config| {
            config.geometry.points[2].image_px[1] = f64::NEG_INFINITY;
        });
        refused("robots.patches[0].outline_mm[3][0]", "finite", |config| {
            config.robots.patches[0].outline_mm[3][0] = f64::NAN;
        });
        refused("synthetic.seed", "at most", |config| config.synthetic.seed = u64::MAX);
        refused("field.goal_width_mm", "wider", |config| config.field.goal_width_mm = 1900.0);
        refused("field.center_circle_radius_mm", "fit", |config| {
            config.field.center_circle_radius_mm = 950.0;
        });
        refused("robots.wheel_base_mm", "75 mm", |config| config.robots.wheel_base_mm = 110.0);
        refused("synthetic.unknown_opponents", "one team only", |config| {
            config.synthetic.unknown_opponents = 5;
        });
        refused("supervisor.backoff_max_ms", "100 ms", |config| {
            config.supervisor.backoff_max_ms = 50.0;
        });
    }

    #[test]
    fn absurd_sizes_do_not_keep_anybody_waiting() {
        let problems = problems_after(|config| {
            config.robots.size_mm = 1e300;
            config.robots.patches[0].outline_mm = vec![[1e300; 2], [-1e300, 0.0], [0.0; 2]];
            config.camera.width = u32::MAX;
        });
        assert!(problems.iter().any(|(path, _)| path == "robots.size_mm"), "{problems:#?}");
        assert!(problems.iter().any(|(path, _)| path == "camera.width"), "{problems:#?}");
    }

    #[test]
    fn odd_but_possible_is_a_warning() {
        let warned = |path: &str, change: &dyn Fn(&mut Config)| {
            let mut config = Config::default();
            change(&mut config);
            assert_eq!(config.problems(), [], "{path}");
            let warnings = config.warnings();
            assert!(warnings.iter().any(|warning| warning.path == path), "{path}: {warnings:#?}");
        };
        warned("camera.exposure_us", &|config| config.camera.exposure_us = 12_501);
        warned("access.teams", &|config| config.access.teams.blue = vec!["1000".into()]);
        warned("robots.identities", &|config| config.robots.identities.clear());
        warned("robots.identities[0].colors[0]", &|config| {
            config.robots.identities[0].colors[0] = "blue".into();
        });
        warned("robots.patches", &|config| {
            config.robots.patches.pop();
            config.robots.identities.clear();
        });
        warned("colors[8].name", &|config| {
            let name = "dark orange".to_string();
            config.colors.push(ColorConfig { name, red: [140, 170], ..config.colors[0].clone() });
        });
    }
}
