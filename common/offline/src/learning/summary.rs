//! The report about learned colours: how well they are separated, how much floor they take, and what
//! they cost the classifier.

use super::LearnError;
use super::floor::{Taken, covered_px};
use super::lessons::Lessons;
use super::passing::Passing;
use crate::chain::Chain;
use crate::learning::confusion::Confusion;
use crate::learning::labels::ImageLabels;
use classifier::ClassTables;
use config::Config;

/// The whole report as text.
pub fn text(
    config: &Config,
    lessons: &Lessons,
    labels: &[ImageLabels],
) -> Result<String, LearnError> {
    let lit = lessons.under_light(config)?;
    let samples = lessons.gather(config, &lit, labels)?;
    let tables = ClassTables::new(&config.colors)?;
    let names = config.colors.iter().map(|color| color.name.clone()).collect();
    let confusion = Confusion::new(names, &samples, |rgb| tables.classify(rgb));
    let mut text = format!(
        "{} pictures, {} patches; what pixels are taken for, from left to right (false pixels: of the \
         background, in a picture):\n{}",
        samples.pictures,
        samples.patches,
        confusion.text()
    );
    let mut passing = Passing::none(config)?;
    for picture in &lit {
        passing.add(picture, &lessons.scene.is_on_pitch);
    }
    text += &format!("{}\n", passing.text("the pitch"));
    for warning in confusion.warnings().into_iter().chain(swallowed(config, lessons, labels)?) {
        text += &format!("warning: {warning}\n");
    }
    Ok(text)
}

/// Warnings about colours that take more of the floor than their patches cover, each with its worst
/// picture.
fn swallowed(
    config: &Config,
    lessons: &Lessons,
    labels: &[ImageLabels],
) -> Result<Vec<String>, LearnError> {
    let mut chain = Chain::new(config)?;
    // Per colour: the most pixels taken in a picture, and that picture's number.
    let mut worst = vec![(0.0, 0); config.colors.len()];
    for (number, (lesson, labels)) in lessons.list.iter().zip(labels).enumerate() {
        // If only places are marked, floor and robots cannot be distinguished.
        if labels.robots.is_none() {
            continue;
        }
        chain
            .look_at(&lesson.bayer)
            .map_err(|fault| LearnError::Frame { file: lesson.file.clone(), fault })?;
        let mut taken = Taken::none(config.colors.len());
        taken.add(config, &lessons.scene, chain.runs(), labels);
        for (worst, &pixels) in worst.iter_mut().zip(&taken.pixels) {
            if pixels > worst.0 {
                *worst = (pixels, number);
            }
        }
    }
    let pitch = lessons.scene.is_on_pitch.iter().filter(|&&is_on_pitch| is_on_pitch).count().max(1);
    let covered = covered_px(config, &lessons.scene);
    let warnings = config.colors.iter().zip(worst).zip(covered);
    let warnings = warnings.filter(|((_, (pixels, _)), covered)| pixels > covered);
    Ok(warnings
        .map(|((color, (pixels, number)), covered)| {
            format!(
                "{} takes {pixels:.0} pixels of the floor in {} ({:.1} % of the pitch), and its \
                 patches cover only {covered:.0}: something there has this colour; cover it, or use \
                 another paint",
                color.name,
                lessons.list[number].file.display(),
                100.0 * pixels / pitch as f64
            )
        })
        .collect())
}
