//! `touchline learn`: colours out of pictures.

mod auto;
mod unevenness;

use super::{CommandError, load_config, output};
use crate::cli::LearnArgs;
use classifier::lamp::{Gains, Lamp, NO_GAINS, PitchProbe, corrections};
use classifier::lattice::Lattice;
use classifier::shading::ShadedTables;
use classifier::{BayerImage, ClassTables, Picture as Frame, demosaic};
use common::config::{ColorConfig, Config, LightConfig, commented_toml};
use grabber::pictures::{list_pictures, load_bayer};
use learning::confusion::Confusion;
use learning::labels::{ImageLabels, Labels};
use learning::picture::Picture;
use learning::samples::{Gatherer, Samples};
use learning::separate::{self, Wishes};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// A labelled picture.
struct Lesson {
    labels: ImageLabels,
    bayer: Vec<u8>,
}

/// Learns, prints how well colours can be told apart, and writes the configuration.
pub fn learn(args: LearnArgs) -> Result<ExitCode, CommandError> {
    let mut config = load_config(args.config.as_deref())?;
    output::check_free(args.output.as_deref(), args.force)?;
    let mut lessons = match &args.samples {
        Some(samples) => labelled(&Labels::load(samples)?, &args.pictures, &config)?,
        None => unlabelled(&args.pictures, &config)?,
    };
    config.light.pitch_rgb = match args.fixed_light || !config.light.follow {
        true => None,
        false => pitch_color(&config, &lessons)?,
    };
    let known_by = |config: &Config, lessons: &mut [Lesson]| match args.auto {
        true => Ok(Some(auto::learn(config, lessons)?)),
        false => Ok::<_, CommandError>(None),
    };
    // Robots tell how uneven the light is, and are found better once that is known.
    let mut found = known_by(&config, &mut lessons)?;
    if config.light.pitch_rgb.is_some()
        && let Some(unevenness) = unevenness::measure(&config, &lessons)?
        && unevenness != config.light.unevenness
    {
        config.light.unevenness = unevenness;
        found = known_by(&config, &mut lessons)?;
    }
    let learned = match found {
        Some(found) => found,
        None => learn_from(&config, &lessons, true)?,
    };
    common::tell!("{}", summary(&config, &learned, &gather(&config, &lessons)?)?);
    config.colors = learned;
    match &args.output {
        None => _ = say!("{}", fragment(&config))?,
        Some(path) => {
            output::write(path, &commented_toml(&config), args.force)?;
            say_line!("{path}: written", path = path.display())?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Bounds for the colours that the lessons show. One that is worn and not shown is an error, or else
/// stays as it is, behind the others.
fn learn_from(
    config: &Config,
    lessons: &[Lesson],
    is_strict: bool,
) -> Result<Vec<ColorConfig>, CommandError> {
    let samples = gather(config, lessons)?;
    let is_needed = |color: &ColorConfig| is_strict && is_worn(config, &color.name);
    let mut learned = separate::learn(&config.colors, is_needed, &samples, &Wishes::default())?;
    for color in &config.colors {
        let is_known = learned.iter().any(|known| known.name == color.name);
        if !is_known && is_worn(config, &color.name) {
            learned.push(color.clone());
        }
    }
    Ok(learned)
}

/// Pictures of which nothing is known yet.
fn unlabelled(arguments: &[PathBuf], config: &Config) -> Result<Vec<Lesson>, CommandError> {
    let mut lessons = Vec::new();
    for argument in arguments {
        for file in list_pictures(argument)? {
            let bayer = load_bayer(&file, &config.camera)?;
            let labels = ImageLabels { file, robots: None, ball: None, samples: Vec::new() };
            lessons.push(Lesson { labels, bayer });
        }
    }
    Ok(lessons)
}

/// The labelled pictures, or those of them that are named.
fn labelled(
    labels: &Labels,
    pictures: &[PathBuf],
    config: &Config,
) -> Result<Vec<Lesson>, CommandError> {
    let mut chosen: Vec<&ImageLabels> = Vec::new();
    for argument in pictures {
        for path in list_pictures(argument)? {
            let is_it = |image: &&ImageLabels| is_same_file(&image.file, &path);
            let image = labels.images.iter().find(is_it);
            chosen.push(image.ok_or_else(|| {
                format!("{}: nothing is labelled in this picture", path.display())
            })?);
        }
    }
    if pictures.is_empty() {
        chosen.extend(&labels.images);
    }
    if chosen.is_empty() {
        return Err("there is no labelled picture to learn from".into());
    }
    let lesson = |labels: &ImageLabels| -> Result<Lesson, CommandError> {
        Ok(Lesson { labels: labels.clone(), bayer: load_bayer(&labels.file, &config.camera)? })
    };
    chosen.into_iter().map(lesson).collect()
}

fn is_same_file(a: &Path, b: &Path) -> bool {
    match (a.canonicalize(), b.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => a == b,
    }
}

fn bayer_image<'a>(config: &Config, bayer: &'a [u8]) -> Result<BayerImage<'a>, CommandError> {
    let camera = &config.camera;
    BayerImage::new(bayer, camera.width, camera.height, camera.width, camera.bayer_order)
        .ok_or_else(|| "the pictures are too small to learn from".into())
}

/// The middle of the pitch's colours in all pictures; `None` when it cannot be seen in one of them.
fn pitch_color(config: &Config, lessons: &[Lesson]) -> Result<Option<[f64; 3]>, CommandError> {
    let probe = PitchProbe::new(config)?;
    let mut lattice = Lattice::new(&config.camera);
    let mut logs = [0.0; 3];
    for lesson in lessons {
        lattice.look_at(&Frame::Bayer(bayer_image(config, &lesson.bayer)?));
        let Some(rgb) = probe.measure(&lattice) else {
            common::tell!(
                "touchline: {}: the pitch is too dark to tell the light from it; the colours will \
                 not follow the lamps",
                lesson.labels.file.display()
            );
            return Ok(None);
        };
        logs.iter_mut().zip(rgb).for_each(|(sum, value)| *sum += value.ln());
    }
    let mean = |sum: f64| ((sum / lessons.len() as f64).exp() * 10.0).round() / 10.0;
    Ok(Some(logs.map(mean)))
}

/// Samples of all pictures, as they look under the light the colours are learned for.
fn gather(config: &Config, lessons: &[Lesson]) -> Result<Samples, CommandError> {
    let lamp = Lamp::new(config)?;
    let mut shaded = ShadedTables::new(config, &ClassTables::new(&[])?)?;
    let mut lattice = Lattice::new(&config.camera);
    let mut gatherer = Gatherer::new(config)?;
    let mut rgb = Vec::new();
    for lesson in lessons {
        let image = bayer_image(config, &lesson.bayer)?;
        demosaic(&image, &mut rgb);
        let picture = Picture::new(image.width(), &rgb);
        lattice.look_at(&Frame::Bayer(image));
        let gains: Gains = lamp.as_ref().and_then(|lamp| lamp.gains(&lattice)).unwrap_or(NO_GAINS);
        let picture = match &mut shaded {
            Some(shaded) => {
                shaded.look_at(&lattice);
                let (zones, tables) = (shaded.zones(), ShadedTables::corrections(gains));
                picture.corrected(|column, row| &tables[zones.at(column, row)])
            }
            None => {
                let tables = corrections(gains);
                picture.corrected(|_, _| &tables)
            }
        };
        gatherer.add(&lesson.labels, &picture)?;
    }
    Ok(gatherer.finish())
}

/// Whether somebody on the pitch wears a colour.
fn is_worn(config: &Config, name: &str) -> bool {
    config.teams.yellow.color == name
        || config.teams.blue.color == name
        || config.ball.color == name
        || config.robots.identities.iter().any(|identity| identity.colors.iter().any(|c| c == name))
}

/// What the colours learned take the samples for.
fn summary(
    config: &Config,
    learned: &[ColorConfig],
    samples: &Samples,
) -> Result<String, CommandError> {
    let tables = ClassTables::new(learned)?;
    // Samples have the numbers of the colours as configured.
    let number_of = |color: &ColorConfig| {
        config.colors.iter().position(|known| known.name == color.name).unwrap_or(usize::MAX)
    };
    let numbers: Vec<usize> = learned.iter().map(number_of).collect();
    let classify = |rgb| {
        let class = usize::from(tables.classify(rgb));
        numbers.get(class).map_or(classifier::BACKGROUND, |&number| number as u8)
    };
    let names = config.colors.iter().map(|color| color.name.clone()).collect();
    let confusion = Confusion::new(names, samples, classify);
    let mut text = format!(
        "{} pictures, {} patches; what pixels are taken for, from left to right (false pixels: of the \
         background, in a picture):\n{}",
        samples.pictures,
        samples.patches,
        confusion.text()
    );
    for warning in confusion.warnings() {
        text += &format!("warning: {warning}\n");
    }
    Ok(text)
}

/// The part of a configuration that was learned.
fn fragment(config: &Config) -> String {
    let mut text = String::new();
    if let Some(rgb) = config.light.pitch_rgb {
        let LightConfig { brightness, unevenness, glare, .. } = config.light;
        text += &format!(
            "[light]\npitch_rgb = {rgb:?}\nbrightness = {brightness}\nunevenness = {unevenness}\n\
             glare = {glare}\n\n"
        );
    }
    for color in &config.colors {
        let ColorConfig { name, red, green, blue, looks, .. } = color;
        text += &format!("[[colors]]\nname = {name:?}\nred = {red:?}\ngreen = {green:?}\n");
        text += &format!("blue = {blue:?}\n");
        if let Some(hue_deg) = color.hue_deg {
            text += &format!("hue_deg = {hue_deg:?}\n");
        }
        if let Some(saturation) = color.saturation {
            text += &format!("saturation = {saturation:?}\n");
        }
        text += &format!("looks = {looks:?}\n\n");
    }
    text
}
