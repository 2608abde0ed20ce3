//! `touchline config`: writes a commented configuration file, checks one, prints the schema.

use super::CommandError;
use crate::cli::ConfigCommand;
use config::change::{changes, values};
use config::edit::with_value;
use config::{
    self, Config, ConfigError, Diagnostics, GeometryConfig, PatchRole, Preset, RobotShape,
};
use geometry::{CameraModel, FieldPoint};
use grabber::pictures::list_pictures;
use messages::Team;
use offline::learning::lessons::Lessons;
use offline::learning::passing::Passing;
use runtime::output::{OutputError, Rule};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Carries out a `touchline config` command; prints to the standard output.
pub fn execute(command: ConfigCommand) -> Result<ExitCode, CommandError> {
    let text = match command {
        ConfigCommand::Init { output, preset, force } => init(preset, output.as_deref(), force)?,
        ConfigCommand::Check { file, pictures } => check(&file, &pictures)?,
        ConfigCommand::Diff { old, new } => diff(&Config::load(&old)?, &Config::load(&new)?),
        ConfigCommand::Get { file, key } => get(&Config::load(&file)?, &key)?,
        ConfigCommand::Set { file, key, value } => set(&file, &key, &value)?,
        ConfigCommand::Schema => schema(),
    };
    runtime::say!("{text}")?;
    Ok(ExitCode::SUCCESS)
}

/// The keys in which two configurations differ, a line each.
fn diff(old: &Config, new: &Config) -> String {
    changes(old, new).iter().map(|change| format!("{change}\n")).collect()
}

/// The value of a key; of a section, all its keys.
fn get(config: &Config, key: &str) -> Result<String, CommandError> {
    let below = format!("{key}.");
    let values = values(config);
    let mut found = values.iter().filter(|(name, _)| *name == key || name.starts_with(&below));
    match (values.get(key), found.next()) {
        (Some(value), _) => Ok(format!("{value}\n")),
        (None, Some(first)) => {
            let all = std::iter::once(first).chain(found);
            Ok(all.map(|(name, value)| format!("{name} = {value}\n")).collect())
        }
        (None, None) => Err(format!(
            "{key} is not set, or there is no such key; `touchline config init` lists all keys"
        )
        .into()),
    }
}

/// Sets a key in a file. Returns what has changed.
fn set(file: &Path, key: &str, value: &str) -> Result<String, CommandError> {
    let before = Config::load(file)?;
    let text = std::fs::read_to_string(file)?;
    let text = with_value(&text, key, value)?;
    let after = Config::parse(&text, &format!("{} with {key} = {value}", file.display()))?;
    Rule { inputs: &[], force: true }.write(file, text.as_bytes())?;
    let changed = diff(&before, &after);
    Ok(if changed.is_empty() { format!("{key} has this value already\n") } else { changed })
}

/// Error of a `touchline config` command; its text is for the user.
#[derive(Debug, thiserror::Error)]
pub enum ConfigCommandError {
    /// The configuration is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The file cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// Writes the preset's configuration, every key commented, to `path`; without a path, returns the text
/// for the standard output. An existing file is overwritten only with `force`.
pub fn init(
    preset: Preset,
    path: Option<&Path>,
    force: bool,
) -> Result<String, ConfigCommandError> {
    let text = config::commented_toml(&preset.config());
    let Some(path) = path else { return Ok(text) };
    Rule { inputs: &[], force }.write(path, text.as_bytes())?;
    let (path, name) = (path.display(), preset.name());
    Ok(format!("{path}: written ({name}); `touchline config check {path}` checks it\n"))
}

/// Checks a file; returns, for a usable one, a summary and warnings about settings that look unintended.
/// The cost of its colours is estimated with the pictures, or with the colour of the pitch.
pub fn check(path: &Path, pictures: &[PathBuf]) -> Result<String, CommandError> {
    let (config, warnings) = config::check_file(path)?;
    Ok(report(path, &config, &cost(&config, pictures)?, &warnings))
}

/// The share of a pitch that passes to the second look; empty if no colour has one.
fn cost(config: &Config, pictures: &[PathBuf]) -> Result<String, CommandError> {
    let mut passing = Passing::none(config)?;
    if !config.colors.iter().any(|color| color.hue_deg.is_some() || color.saturation.is_some()) {
        return Ok("no colour has bounds in hue or saturation: a pixel costs three look-ups".into());
    }
    if !pictures.is_empty() {
        let mut files = Vec::new();
        for argument in pictures {
            files.extend(list_pictures(argument)?);
        }
        let lessons = Lessons::load(config, files)?;
        for picture in &lessons.under_light(config)? {
            passing.add(picture, &lessons.scene.is_on_pitch);
        }
        return Ok(passing.text("the pitch in these pictures"));
    }
    if let Some(pitch_rgb) = config.light.pitch_rgb {
        passing.add_floor(pitch_rgb);
        return Ok(passing.text("a floor like light.pitch_rgb"));
    }
    passing.add_everything();
    Ok(passing.text("all colours there are"))
}

/// The JSON schema of the configuration.
pub fn schema() -> String {
    config::schema_json()
}

fn report(path: &Path, config: &Config, cost: &str, warnings: &Diagnostics) -> String {
    let count = match warnings.list.len() {
        0 => String::new(),
        1 => ", with a warning".to_string(),
        count => format!(", with {count} warnings"),
    };
    let mut text = format!("{}: OK{count}\n{}", path.display(), summary(config, cost));
    if !warnings.list.is_empty() {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "\n{warnings}");
    }
    text
}

fn summary(config: &Config, cost: &str) -> String {
    let (field, camera, robots) = (&config.field, &config.camera, &config.robots);
    let mut lines = vec![
        ("preset", config.preset.name().to_string()),
        ("field", format!("{} × {} mm", field.length_mm, field.width_mm)),
        (
            "camera",
            format!(
                "{} × {} pixels, {}, {} fps",
                camera.width,
                camera.height,
                format!("{:?}", camera.bayer_order).to_uppercase(),
                camera.fps
            ),
        ),
        ("geometry", geometry(config)),
        ("colours", colors(config)),
        ("cost", cost.to_string()),
        (
            "robots",
            format!(
                "{}; {} mm {}, {} high, {} identification {}",
                roster(config),
                robots.size_mm,
                match robots.shape {
                    RobotShape::Square => "square",
                    RobotShape::Round => "round",
                },
                heights(config),
                identification_patches(config),
                if identification_patches(config) == 1 { "patch" } else { "patches" }
            ),
        ),
    ];
    if config.publish.is_used() {
        lines.push(("publishes", publishes(config)));
    }
    lines.iter().map(|(name, value)| format!("  {name:<9} {value}\n")).collect()
}

/// "ssl to 224.5.23.2:10006; commands of 127.0.0.1 at port 20011".
fn publishes(config: &Config) -> String {
    let outputs = config.publish.outputs().into_iter().filter(|output| output.enabled);
    let mut parts: Vec<String> =
        outputs.map(|output| format!("{} to {}", output.name, output.to.join(", "))).collect();
    let commands = &config.publish.commands;
    if commands.enabled {
        let allowed = commands.allow.join(", ");
        parts.push(format!("takes commands of {allowed} at port {}", commands.port));
    }
    parts.join("; ")
}

fn geometry(config: &Config) -> String {
    let (geometry, camera) = (&config.geometry, &config.camera);
    let mut text = format!("{} points", geometry.points.len());
    if let Ok(model) = CameraModel::new(geometry, camera.width, camera.height) {
        let middle = model.image_from_field(FieldPoint::new(0.0, 0.0), 0.0);
        let mm_per_px = model.pixel_area_mm2(middle, 0.0).sqrt();
        let _ = write!(text, ", {mm_per_px:.2} mm a pixel in the middle");
    }
    let derived = GeometryConfig::above(&config.field, camera.picture_px(), geometry.camera_mm[2]);
    if derived.points == geometry.points {
        text += " (ideal; a real camera needs its own points)";
    }
    text
}

fn colors(config: &Config) -> String {
    let role = |name: &str| {
        if name == config.ball.color {
            return " (ball)".to_string();
        }
        let team = Team::ALL.into_iter().find(|&team| config.teams.color(team) == name);
        team.map_or_else(String::new, |team| format!(" (team {})", team.name()))
    };
    let names: Vec<String> =
        config.colors.iter().map(|color| format!("{}{}", color.name, role(&color.name))).collect();
    names.join(", ")
}

/// "75 mm", or "50–150 mm" if robots differ.
fn heights(config: &Config) -> String {
    let heights: Vec<f64> =
        config.robots.identities.iter().map(|robot| config.top_of(robot).height_mm).collect();
    let lowest = heights.iter().copied().fold(f64::INFINITY, f64::min);
    let highest = heights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    match heights[..] {
        [] => format!("{} mm", config.robots.height_mm),
        _ if lowest == highest => format!("{lowest} mm"),
        _ => format!("{lowest}–{highest} mm"),
    }
}

/// "yellow 0–4, blue 0–2 and 7".
fn roster(config: &Config) -> String {
    let teams: Vec<String> = Team::ALL
        .into_iter()
        .filter_map(|team| {
            let robots = config.robots.identities.iter().filter(|robot| robot.team == team);
            let mut ids: Vec<u32> = robots.map(|robot| robot.id).collect();
            ids.sort_unstable();
            (!ids.is_empty()).then(|| format!("{} {}", team.name(), ranges(&ids)))
        })
        .collect();
    if teams.is_empty() { "none".into() } else { teams.join(", ") }
}

/// "0–4 7" for ascending numbers.
fn ranges(numbers: &[u32]) -> String {
    let chunks = numbers.chunk_by(|a, b| a + 1 == *b).filter_map(|chunk| match chunk {
        [only] => Some(only.to_string()),
        [first, .., last] => Some(format!("{first}–{last}")),
        [] => None,
    });
    chunks.collect::<Vec<_>>().join(" ")
}

fn identification_patches(config: &Config) -> usize {
    let patches = &config.robots.patches;
    patches.iter().filter(|patch| patch.role == PatchRole::Identification).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A separate directory for each test, removed at the end.
    struct Scratch(PathBuf);

    impl Scratch {
        fn new(name: &str) -> Self {
            let name = format!("touchline-config-{}-{name}", std::process::id());
            let path = std::env::temp_dir().join(name);
            std::fs::create_dir_all(&path).unwrap();
            Self(path)
        }

        fn file(&self, name: &str) -> PathBuf {
            self.0.join(name)
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    #[test]
    fn check_accepts_the_output_of_init() {
        let scratch = Scratch::new("init");
        for preset in Preset::ALL {
            let file = scratch.file(&format!("{}.toml", preset.name()));
            let said = init(preset, Some(&file), false).unwrap();
            assert!(said.contains(preset.name()), "{said}");
            assert_eq!(Config::load(&file).unwrap(), preset.config());
            let report = check(&file, &[]).unwrap();
            assert!(report.contains(": OK\n"), "{report}");
        }
    }

    #[test]
    fn init_without_a_file_returns_the_text() {
        let text = init(Preset::Vsss3v3, None, false).unwrap();
        assert_eq!(Config::parse(&text, "text").unwrap(), Preset::Vsss3v3.config());
    }

    #[test]
    fn init_leaves_an_existing_file_alone_unless_forced() {
        let scratch = Scratch::new("force");
        let file = scratch.file("match.toml");
        let filler = "# mine, and longer than nothing\n".repeat(2000);
        std::fs::write(&file, &filler).unwrap();
        let error = init(Preset::default(), Some(&file), false).unwrap_err();
        assert!(matches!(error, ConfigCommandError::Output(OutputError::Exists(_))), "{error}");
        assert_eq!(std::fs::read_to_string(&file).unwrap(), filler);
        init(Preset::default(), Some(&file), true).unwrap();
        assert_eq!(Config::load(&file).unwrap(), Config::default());
    }

    #[test]
    fn check_sums_up_field_camera_colours_and_robots() {
        let scratch = Scratch::new("check");
        let file = scratch.file("match.toml");
        let text = "preset = \"vsss-3v3\"\n[camera]\nfps = 60\nexposure_us = 20_000\n";
        std::fs::write(&file, text).unwrap();
        let report = check(&file, &[]).unwrap();
        for part in [
            "OK, with a warning",
            "1500 × 1300 mm",
            "640 × 480 pixels, RGGB, 60 fps",
            "orange (ball), yellow (team yellow), blue (team blue), green",
            "cost      no colour has bounds in hue or saturation",
            "yellow 0–2, blue 0–2; 75 mm square, 75 mm high, 1 identification patch",
            "match.toml:4:15: camera.exposure_us: is longer than a frame at 60 fps",
        ] {
            assert!(report.contains(part), "{part:?} is missing in\n{report}");
        }
    }

    #[test]
    fn check_says_what_is_published() {
        let mut config = Preset::Vsss3v3.config();
        assert!(!summary(&config, "").contains("publishes"));
        for name in ["firasim", "json", "commands"] {
            config.publish.enable(name);
        }
        let text = summary(&config, "");
        let expected = "  publishes firasim to 224.0.0.1:10002; json to 127.0.0.1:10030; takes commands of \
                        127.0.0.1 at port 20011\n";
        assert!(text.ends_with(expected), "{text}");
    }

    #[test]
    fn check_shows_errors() {
        let scratch = Scratch::new("wrong");
        let file = scratch.file("match.toml");
        std::fs::write(&file, "[camera]\nfsp = 80\n").unwrap();
        let error = check(&file, &[]).unwrap_err().to_string();
        assert!(error.contains("match.toml:2:1") && error.contains("`fps`"), "{error}");
        let error = check(&scratch.file("absent.toml"), &[]).unwrap_err().to_string();
        assert!(error.contains("absent.toml"), "{error}");
    }

    #[test]
    fn numbers_are_summed_up_as_ranges() {
        assert_eq!(ranges(&[0, 1, 2, 5, 7, 8]), "0–2 5 7–8");
        assert_eq!(ranges(&[]), "");
    }
}
