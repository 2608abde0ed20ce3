//! Reads a file into a checked configuration, or into diagnostics that show the faulty lines.
//!
//! The preset's configuration is the base; the file's keys replace its values one by one, lists as a
//! whole. All problems are reported at once.

use super::diagnostic::{Diagnostic, Diagnostics, Place};
use super::problem::{Problem, element_path, key_path};
use super::schema::Schema;
use super::{ColorConfig, Config, GeometryConfig, Preset};
use crate::input;
use serde::Deserialize;
use std::ops::Range;
use std::path::{Path, PathBuf};
use toml::de::{DeTable, DeValue};

/// Reason why there is no configuration. The text shows each faulty line.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
    /// The file was read, but its content is invalid.
    #[error("{0}")]
    Invalid(Diagnostics),
}

impl Config {
    /// Reads and checks a configuration file.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        Self::parse(&read(path)?, &path.display().to_string())
    }

    /// Parses and checks the text of a configuration; `origin` is its name in diagnostics.
    pub fn parse(text: &str, origin: &str) -> Result<Self, ConfigError> {
        let document = Document::parse(text, origin).map_err(ConfigError::Invalid)?;
        document.config().map_err(ConfigError::Invalid)
    }

    /// Parses a text that was checked before, in a fraction of the time; `None` if it is not even TOML with
    /// these keys.
    pub(crate) fn parse_unchecked(text: &str) -> Option<Self> {
        merged(&values(text).ok()?).ok()
    }
}

/// Like [`Config::load`], and also returns warnings about settings that are probably not intended.
pub fn check_file(path: &Path) -> Result<(Config, Diagnostics), ConfigError> {
    check(&read(path)?, &path.display().to_string())
}

fn read(path: &Path) -> Result<String, ConfigError> {
    input::read_text(path, input::CONFIG)
        .map_err(|source| ConfigError::Read { path: path.into(), source })
}

/// Like [`Config::parse`], and also returns warnings about settings that are probably not intended.
pub fn check(text: &str, origin: &str) -> Result<(Config, Diagnostics), ConfigError> {
    let document = Document::parse(text, origin).map_err(ConfigError::Invalid)?;
    let config = document.config().map_err(ConfigError::Invalid)?;
    let warnings = document.diagnostics(config.warnings());
    Ok((config, warnings))
}

/// A parsed text with the positions of its keys.
struct Document<'a> {
    text: &'a str,
    origin: &'a str,
    spans: DeTable<'a>,
    values: toml::Table,
}

impl<'a> Document<'a> {
    fn parse(text: &'a str, origin: &'a str) -> Result<Self, Diagnostics> {
        // Not every text is a file of its own: recordings contain one.
        input::check(text.len() as u64, input::CONFIG).map_err(|error| Diagnostics {
            list: vec![Diagnostic {
                origin: origin.to_string(),
                problem: Problem::new("", error.to_string()),
                place: None,
            }],
        })?;
        let syntax = |error: toml::de::Error| Diagnostics {
            list: vec![Diagnostic {
                origin: origin.to_string(),
                problem: Problem::new("", error.message().trim().replace('\n', ", ")),
                place: error.span().map(|span| Place::new(text, span)),
            }],
        };
        let spans = DeTable::parse(text).map_err(syntax)?.into_inner();
        let values = values(text).map_err(syntax)?;
        Ok(Self { text, origin, spans, values })
    }

    fn config(&self) -> Result<Config, Diagnostics> {
        // Violations of the schema first: they may prevent the rest from becoming a configuration at
        // all.
        let mut problems = Schema::new().problems(&toml::Value::Table(self.values.clone()));
        match merged(&self.values) {
            Ok(config) => {
                let known = |problem: &Problem| problems.iter().any(|p| p.path == problem.path);
                let further: Vec<_> =
                    config.problems().into_iter().filter(|problem| !known(problem)).collect();
                problems.extend(further);
                if problems.is_empty() {
                    return Ok(config);
                }
            }
            Err(error) if problems.is_empty() => {
                problems.push(Problem::new("", error.message().to_string()));
            }
            Err(_) => {}
        }
        Err(self.diagnostics(problems))
    }

    /// Finds the positions of problems, and sorts by them.
    fn diagnostics(&self, problems: Vec<Problem>) -> Diagnostics {
        let mut list: Vec<(usize, Diagnostic)> = Vec::new();
        let mut more_of_preset = Vec::<(String, usize)>::new();
        for mut problem in problems {
            let mut found = self.find(&problem.path, problem.at_key);
            if !found.exact {
                // One diagnostic for a list of the preset, not one for each of its elements.
                let list_path = problem.path.split('[').next().unwrap_or_default().to_string();
                if let Some((_, more)) = more_of_preset.iter_mut().find(|(p, _)| *p == list_path) {
                    *more += 1;
                    continue;
                }
                let note = format!("{list_path} is not in the file and has the preset's value");
                more_of_preset.push((list_path, 0));
                problem.help = Some(match problem.help {
                    Some(help) => format!("{help} ({note})"),
                    None => note,
                });
                if let Some(related) = &problem.related {
                    let related = self.find(related, false);
                    if related.exact {
                        found = related;
                    }
                }
            }
            let place = found.span.clone().map(|span| Place::new(self.text, span));
            let origin = self.origin.to_string();
            let start = found.span.map_or(usize::MAX, |span| span.start);
            list.push((start, Diagnostic { origin, problem, place }));
        }
        for (path, more) in more_of_preset.into_iter().filter(|&(_, more)| more > 0) {
            let of_this = |diagnostic: &Diagnostic| {
                diagnostic.problem.path.split('[').next() == Some(path.as_str())
            };
            if let Some((_, diagnostic)) = list.iter_mut().find(|(_, c)| of_this(c)) {
                diagnostic.problem.message += &format!(" (and {more} more in {path})");
            }
        }
        list.sort_by_key(|&(start, _)| start);
        Diagnostics { list: list.into_iter().map(|(_, diagnostic)| diagnostic).collect() }
    }

    /// Position of a key or of its value, or else of the nearest enclosing table.
    fn find(&self, path: &str, at_key: bool) -> Found {
        let mut found = Found { span: None, exact: path.is_empty() };
        found.search_table(&self.spans, "", path, at_key);
        found
    }
}

/// The keys and values of a text, all in their long form.
fn values(text: &str) -> Result<toml::Table, toml::de::Error> {
    let mut values = text.parse::<toml::Table>()?;
    write_out_short_forms(&mut values);
    Ok(values)
}

/// The preset's configuration, overridden by the text.
fn merged(values: &toml::Table) -> Result<Config, toml::de::Error> {
    let preset = match values.get("preset") {
        Some(name) => Preset::deserialize(name.clone())?,
        None => Preset::default(),
    };
    let mut base = preset.config();
    if values.contains_key("colors") {
        // The preset's pitch colour belongs to the preset's colours.
        base.light.pitch_rgb = None;
    }
    let mut values = values.clone();
    values.get_mut("colors").into_iter().for_each(complete_colors);
    let geometry = values.remove("geometry");
    let mut config = merge(&base, values)?;
    // The preset's camera fits the preset's field and picture size only.
    if (&config.field, config.camera.width, config.camera.height)
        != (&base.field, base.camera.width, base.camera.height)
    {
        config.geometry = GeometryConfig::above(
            &config.field,
            config.camera.picture_px(),
            base.geometry.camera_mm[2],
        );
    }
    match geometry {
        None => Ok(config),
        Some(geometry) => merge(&config, toml::Table::from_iter([("geometry".into(), geometry)])),
    }
}

struct Found {
    span: Option<Range<usize>>,
    /// Exactly this key, not only an enclosing table.
    exact: bool,
}

impl Found {
    fn search_table(&mut self, table: &DeTable, path: &str, target: &str, at_key: bool) {
        for (key, value) in table {
            let here = key_path(path, key.get_ref());
            if leads_to(&here, target) {
                self.exact = here == target;
                let key_itself = self.exact && at_key;
                self.span = Some(if key_itself { key.span() } else { value.span() });
                self.search_value(value.get_ref(), &here, target, at_key);
            }
        }
    }

    fn search_value(&mut self, value: &DeValue, path: &str, target: &str, at_key: bool) {
        match value {
            DeValue::Table(table) => self.search_table(table, path, target, at_key),
            DeValue::Array(array) => {
                for (index, element) in array.iter().enumerate() {
                    let here = element_path(path, index);
                    if leads_to(&here, target) {
                        self.exact = here == target;
                        self.span = Some(element.span());
                        self.search_value(element.get_ref(), &here, target, at_key);
                    }
                }
            }
            _ => {}
        }
    }
}

/// Expands `teams.yellow = "orange"` to `teams.yellow = { color = "orange" }`.
fn write_out_short_forms(values: &mut toml::Table) {
    let Some(toml::Value::Table(teams)) = values.get_mut("teams") else { return };
    for (_, team) in teams.iter_mut().filter(|(_, team)| team.is_str()) {
        let color = std::mem::replace(team, toml::Value::Boolean(false));
        *team = toml::Value::Table(toml::Table::from_iter([("color".into(), color)]));
    }
}

/// Whether `path` is the target or encloses it.
fn leads_to(path: &str, target: &str) -> bool {
    target.strip_prefix(path).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
}

/// Adds a box to colours with nothing but `looks`. Other faults of the list are reported elsewhere.
fn complete_colors(colors: &mut toml::Value) {
    let tables = colors.as_array_mut().into_iter().flatten().filter_map(toml::Value::as_table_mut);
    for color in tables {
        let is_bounded = color.keys().any(|key| key != "name" && key != "looks");
        let looks = color.get("looks").cloned().map(<[u8; 3]>::deserialize);
        if !is_bounded && let Some(Ok(looks)) = looks {
            for (channel, range) in
                ["red", "green", "blue"].into_iter().zip(ColorConfig::box_around(looks))
            {
                color.insert(channel.into(), range.map(i64::from).to_vec().into());
            }
        }
    }
}

/// The configuration with some of its values replaced.
fn merge(base: &Config, overrides: toml::Table) -> Result<Config, toml::de::Error> {
    let mut values =
        toml::Table::try_from(base).map_err(|error| serde::de::Error::custom(error.to_string()))?;
    merge_tables(&mut values, overrides);
    Config::deserialize(values)
}

fn merge_tables(base: &mut toml::Table, overrides: toml::Table) {
    for (key, value) in overrides {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(base)), toml::Value::Table(value)) => {
                merge_tables(base, value);
            }
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FieldConfig, commented_toml};
    use messages::Team;
    use proptest::prelude::*;

    fn parse(text: &str) -> Config {
        Config::parse(text, "match.toml").unwrap_or_else(|error| panic!("{error}"))
    }

    fn message(text: &str) -> String {
        match Config::parse(text, "match.toml") {
            Ok(_) => panic!("accepted:\n{text}"),
            Err(error) => error.to_string(),
        }
    }

    /// The first lines of the diagnostics.
    fn headlines(text: &str) -> Vec<String> {
        let message = message(text);
        let lines = message.lines().filter(|line| line.starts_with("match.toml"));
        lines.map(str::to_string).collect()
    }

    #[test]
    fn an_unknown_key_is_shown_with_what_was_meant() {
        assert_eq!(
            message("# My pitch\n[camera]\nwidth = 640\n\tfsp = 80 # fast\n"),
            "match.toml:4:2: camera.fsp: there is no such key\n   \
                4 |  fsp = 80 # fast\n     \
                  |  ^^^ did you mean `fps`?"
        );
        assert_eq!(
            message("fps = 80\n"),
            "match.toml:1:1: fps: there is no such key\n   \
                1 | fps = 80\n     \
                  | ^^^ `fps` belongs in [camera]"
        );
        assert_eq!(
            message("[ball]\nmass = 46\n"),
            "match.toml:2:1: ball.mass: there is no such key\n   \
                2 | mass = 46\n     \
                  | ^^^^ the keys here are color and diameter_mm"
        );
    }

    #[test]
    fn looks_alone_make_a_color() {
        let looks =
            |name: &str, rgb: [u8; 3]| format!("[[colors]]\nname = {name:?}\nlooks = {rgb:?}\n");
        let names = Config::default().colors.into_iter().map(|color| color.name);
        let all: String = names.zip(0..).map(|(name, i)| looks(&name, [200, 10 * i, 0])).collect();
        let colors = parse(&all).colors;
        assert_eq!(
            (colors[1].red, colors[1].green, colors[1].blue),
            ([105, 255], [0, 39], [0, 25])
        );
        // With any other bound given, missing ones stay unbounded.
        let bounded = all.replacen("looks", "hue_deg = [350, 20]\nlooks", 1);
        assert_eq!(parse(&bounded).colors[0].red, [0, 255]);
        let missing = headlines("[[colors]]\nname = \"red\"\n");
        assert!(missing[0].contains("looks"), "{missing:?}");
    }

    #[test]
    fn a_wrong_type_is_shown_with_the_right_one() {
        assert_eq!(
            message("[camera]\nwidth = \"640\"\n"),
            "match.toml:2:9: camera.width: must be a whole number, not the text \"640\"\n   \
                2 | width = \"640\"\n     \
                  |         ^^^^^ write it without the quotes"
        );
        assert_eq!(
            message("[camera]\r\nbayer_order = \"rgbg\"\r\n"),
            "match.toml:2:15: camera.bayer_order: \"rgbg\" is unknown\n   \
                2 | bayer_order = \"rgbg\"\n     \
                  |               ^^^^^^ did you mean \"rggb\"? \
                  Possible are \"rggb\", \"grbg\", \"gbrg\" and \"bggr\""
        );
        assert_eq!(headlines("camera = 3"), ["match.toml:1:10: camera: must be a table, not 3"]);
    }

    #[test]
    fn a_team_is_a_colour_or_a_table() {
        let config = parse(
            "[teams]\nyellow = \"orange\"\n[teams.blue]\nheight_mm = 150\n[ball]\ncolor = \"red\"\n",
        );
        assert_eq!(
            (config.teams.yellow.color.as_str(), config.teams.yellow.height_mm),
            ("orange", None)
        );
        assert_eq!(
            (config.teams.blue.color.as_str(), config.teams.blue.height_mm),
            ("blue", Some(150.0))
        );
        assert_eq!(config.tallest_robot_mm(), 150.0);
        assert_eq!(
            headlines("[teams.blue]\nheight = 150\n"),
            ["match.toml:2:1: teams.blue.height: there is no such key"]
        );
        assert_eq!(
            headlines("[teams]\nblue = 3\n"),
            ["match.toml:2:8: teams.blue: must be a table, not 3"]
        );
    }

    #[test]
    fn a_robot_may_bring_its_own_top() {
        let robot = |more: &str| {
            format!(
                "[[robots.identities]]\nteam = \"blue\"\nid = 4\ncolors = [\"red\", \"blue\"]\n{more}\n"
            )
        };
        let patches = "patches = [\n  \
             { role = \"team\", outline_mm = [[30, 30], [0, 30], [0, -30], [30, -30]] },\n  \
             { role = \"identification\", outline_mm = [[-5, 30], [-30, 30], [-30, -30], [-5, -30]] },\n  \
             { role = \"identification\", outline_mm = [[-20, 5], [-30, 5], [-30, -5], [-20, -5]] },\n]";
        let config = parse(&robot(&format!("height_mm = 120\n{patches}")));
        let top = config.top(Team::Blue as u32, Some(4));
        assert_eq!((top.patches.len(), top.height_mm), (3, 120.0));
        // Two colours are one too many for the preset's patches.
        let refused = headlines(&robot(""));
        assert!(refused[0].contains("that is 1, has 2"), "{refused:?}");
        let hidden = patches.replace("[-20, 5]", "[-29.9, 5]").replace("[-20, -5]", "[-29.9, -5]");
        let refused = headlines(&robot(&hidden.replace("[-30, 5], [-30, -5], ", "[-29.9, -5], ")));
        assert!(
            refused[0].contains("identities[0].patches[2].outline_mm: nothing of"),
            "{refused:?}"
        );
    }

    #[test]
    fn problems_inside_lists_have_their_own_lines() {
        let colors = commented_toml(&Config::default());
        let start = colors.find("[[colors]]").unwrap();
        let end = colors.find("# The two teams").unwrap();
        let colors = colors[start..end].replace("red = [59, 140]", "red = [140, 59]");
        let line = 1 + colors.lines().position(|line| line == "red = [140, 59]").unwrap();
        assert_eq!(
            headlines(&colors),
            [format!(
                "match.toml:{line}:7: colors[6].red: from 140 to 59 is empty: \
                 the lowest value comes first"
            )]
        );
        let robots = "[robots]\nidentities = [\n  { team = \"blue\", id = 1, colors = [\"red\"] },\n  \
                      { team = \"blue\", id = 2, colors = [\"pnik\"] },\n]\n";
        assert_eq!(
            message(robots),
            "match.toml:4:38: robots.identities[1].colors[0]: there is no colour \"pnik\"\n   \
                4 |   { team = \"blue\", id = 2, colors = [\"pnik\"] },\n     \
                  |                                      ^^^^^^ did you mean \"pink\"?"
        );
    }

    #[test]
    fn a_missing_key_is_shown_at_its_table() {
        let text = "[[robots.identities]]\nteam = \"blue\"\nid = 1\ncolors = [\"red\"]\n\n\
                    [[robots.identities]]\nteam = \"blue\"\ncolour = [\"green\"]\n";
        assert_eq!(
            headlines(text),
            [
                "match.toml:6:1: robots.identities[1]: the key `id` is missing",
                // The missing `colors` is not reported separately.
                "match.toml:8:1: robots.identities[1].colour: there is no such key",
            ]
        );
    }

    #[test]
    fn everything_wrong_is_told_at_once_in_order() {
        let text = "[filter]\nposition_noise_mm = 0\n[camera]\nfps = inf\n\
                    [teams]\nyellow = \"lemon\"\n";
        assert_eq!(
            headlines(text),
            [
                "match.toml:2:21: filter.position_noise_mm: \
                 must lie between 0.001 and 1000, but is 0",
                "match.toml:4:7: camera.fps: must be a finite number, not inf",
                "match.toml:6:10: teams.yellow: there is no colour \"lemon\"",
            ]
        );
    }

    #[test]
    fn preset_values_are_blamed_on_the_line_that_does_not_fit_them() {
        let text = "[[colors]]\nname = \"orange\"\nred = [115, 255]\ngreen = [30, 110]\n\
                    blue = [0, 40]\nlooks = [235, 110, 25]\n";
        let message = message(text);
        let lines: Vec<&str> = message.lines().collect();
        assert!(lines[0].starts_with("match.toml:1:1: teams.yellow: there is no colour"));
        assert!(lines[2].contains("teams.yellow is not in the file"), "{message}");
        // Ten robots wear colours that no longer exist: one diagnostic.
        let robots: Vec<_> = lines.iter().filter(|line| line.contains("identities[")).collect();
        assert_eq!(robots.len(), 1, "{message}");
        assert!(robots[0].ends_with("(and 9 more in robots.identities)"), "{message}");
    }

    #[test]
    fn syntax_errors_have_a_place_too() {
        assert_eq!(
            message("# no\n[camera\nfps = 3\n"),
            "match.toml:2:8: unclosed table, expected `]`\n   \
                2 | [camera\n     \
                  |        ^"
        );
        assert_eq!(headlines("[camera]\nfps = 1\nfps = 2\n")[0], "match.toml:3:1: duplicate key");
    }

    #[test]
    fn an_empty_file_is_the_default() {
        assert_eq!(parse(""), Config::default());
        assert_eq!(parse("preset = \"vsss-3v3\""), Preset::Vsss3v3.config());
    }

    #[test]
    fn keys_override_the_preset_one_by_one_and_lists_as_a_whole() {
        let config = parse(
            "preset = \"mirosot-large\"\n[filter]\ngate_chi2 = 20\n[geometry.distortion]\nk1 = 0.01\n\
             [robots]\nidentities = [{ team = \"blue\", id = 7, colors = [\"red\", \"green\"] }]",
        );
        let mut expected = Preset::MirosotLarge.config();
        expected.filter.gate_chi2 = 20.0;
        expected.geometry.distortion.k1 = 0.01;
        expected.robots.identities.truncate(1);
        let robot = &mut expected.robots.identities[0];
        (robot.team, robot.id) = (messages::Team::Blue, 7);
        robot.colors = vec!["red".into(), "green".into()];
        assert_eq!(config, expected);
    }

    #[test]
    fn the_presets_pitch_belongs_to_the_presets_colors() {
        let preset = Config::default();
        assert!(preset.light.pitch_rgb.is_some());
        assert_eq!(parse("[light]\nbrightness = 1").light.pitch_rgb, preset.light.pitch_rgb);
        let text = commented_toml(&preset);
        assert_eq!(parse(&text), preset);
        // Colours of one's own are set for an unknown pitch, unless it is given.
        let is_pitch = |line: &&str| line.starts_with("pitch_rgb");
        let without: Vec<&str> = text.lines().filter(|line| !is_pitch(line)).collect();
        let config = parse(&without.join("\n"));
        assert_eq!(config.light.pitch_rgb, None);
        assert_eq!(parse(&commented_toml(&config)), config);
    }

    #[test]
    fn the_presets_camera_follows_field_and_picture() {
        let config = parse("[camera]\nwidth = 1280\nheight = 960\n[field]\nlength_mm = 2000\n");
        let field = FieldConfig { length_mm: 2000.0, ..FieldConfig::default() };
        assert_eq!(
            config.geometry,
            GeometryConfig::above(&field, config.camera.picture_px(), 2200.0)
        );
        assert_eq!(config.warnings(), []);
        // Given values stay.
        let config =
            parse("[camera]\nwidth = 1280\nheight = 960\n[geometry]\ncamera_mm = [1, 2, 3000]");
        assert_eq!(config.geometry.camera_mm, [1.0, 2.0, 3000.0]);
        assert_eq!(config.geometry.distortion.center_px, [639.5, 479.5]);
        // Other changes leave the preset's camera as it is.
        assert_eq!(parse("[camera]\nfps = 200").geometry, Config::default().geometry);
    }

    #[test]
    fn a_file_that_cannot_be_read_is_named() {
        let error = Config::load(Path::new("/nowhere/match.toml")).unwrap_err().to_string();
        assert!(error.contains("/nowhere/match.toml"), "{error}");
    }

    /// Whether the text is accepted does not matter, as long as there is an answer.
    fn survives(text: &str) {
        match check(text, "any") {
            Ok((config, warnings)) => {
                assert_eq!(config.problems(), []);
                let _ = warnings.to_string();
            }
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }

    #[test]
    fn any_value_for_any_key_gets_an_answer() {
        let text = commented_toml(&Config::default());
        let lines: Vec<&str> = text.lines().collect();
        for (index, line) in lines.iter().enumerate() {
            let Some((key, _)) = line.split_once(" = ").filter(|_| !line.starts_with('#')) else {
                continue;
            };
            let list = if line.ends_with('[') { "[ # " } else { "" };
            for value in ["-1", "1e308", "nan", "99999999999999", "\"\"", "[]", "{}", "true"] {
                let mut changed = lines.clone();
                let line = format!("{key} = {list}{value}");
                changed[index] = &line;
                survives(&changed.join("\n"));
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn any_text_gets_an_answer(text in any::<String>()) {
            survives(&text);
        }

        #[test]
        fn a_mutilated_file_gets_an_answer(
            cuts in prop::collection::vec((any::<prop::sample::Index>(), 0usize..40, ".{0,3}"), 1..4),
        ) {
            let mut text = commented_toml(&Config::default());
            for (place, length, insert) in cuts {
                let mut chars: Vec<char> = text.chars().collect();
                let start = place.index(chars.len());
                let end = (start + length).min(chars.len());
                chars.splice(start..end, insert.chars());
                text = chars.into_iter().collect();
            }
            survives(&text);
        }
    }
}
