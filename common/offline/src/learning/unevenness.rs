//! The share of the pitch's unevenness that patches have: the regression slope of the brightness of
//! patches of one colour in one picture on the brightness of the floor at their place, in octaves.

use super::LearnError;
use super::lessons::Lessons;
use crate::learning::labels::ImageLabels;
use crate::learning::picture::Picture;
use crate::learning::samples::{Gatherer, Samples};
use classifier::Picture as Frame;
use classifier::lattice::Lattice;
use classifier::shading::Shading;
use config::Config;
use std::collections::BTreeMap;

/// Fewest patches, and smallest standard deviation of the floor's brightness in octaves, for a
/// measurement.
const FEWEST_PATCHES: usize = 20;
const LEAST_DEVIATION: f64 = 0.15;
/// From this level in one channel on, a patch is at least partly clipped.
const CLIPPED: f64 = 245.0;
/// Grey levels that encode an octave, around the middle grey.
const LEVELS_PER_OCTAVE: f64 = 16.0;
const MIDDLE_LEVEL: f64 = 128.0;

/// A patch: the floor's brightness at its place, and its own brightness, in octaves.
type Pair = [f64; 2];

/// The share, from 0 to 1 in hundredths; `None` if the pictures do not determine it.
pub fn measure(
    config: &Config,
    lessons: &Lessons,
    labels: &[ImageLabels],
) -> Result<Option<f64>, LearnError> {
    let Some(mut shading) = Shading::new(config)? else { return Ok(None) };
    let mut lattice = Lattice::new(&config.camera);
    // Per colour and picture, relative to their mean.
    let mut apart: Vec<Pair> = Vec::new();
    for (lesson, labels) in lessons.list.iter().zip(labels) {
        let picture = &lesson.picture;
        lattice.sample(&Frame::Bayer(lesson.image(config)?));
        shading.measure(&lattice);
        // The picture of the floor's brightness has its samples at the same places as the picture.
        let mut floor = picture.clone();
        for (index, level) in floor.rgb.iter_mut().enumerate() {
            let octaves = shading.octaves_at(index % picture.width, index / picture.width);
            *level = [(octaves * LEVELS_PER_OCTAVE + MIDDLE_LEVEL).clamp(0.0, 255.0) as u8; 3];
        }
        let gather = |picture: &Picture| -> Result<Samples, LearnError> {
            let mut gatherer = Gatherer::new(config, &lessons.scene);
            gatherer.add(labels, picture)?;
            Ok(gatherer.finish())
        };
        for patches in by_class(&gather(&floor)?, &gather(picture)?).values() {
            let count = patches.len() as f64;
            let mean =
                [0, 1].map(|axis| patches.iter().map(|pair| pair[axis]).sum::<f64>() / count);
            apart.extend(patches.iter().map(|pair| [pair[0] - mean[0], pair[1] - mean[1]]));
        }
    }
    let count = apart.len();
    let floor2: f64 = apart.iter().map(|[floor, _]| floor * floor).sum();
    if count < FEWEST_PATCHES || floor2 < count as f64 * LEAST_DEVIATION.powi(2) {
        return Ok(None);
    }
    let share = apart.iter().map(|[floor, patch]| floor * patch).sum::<f64>() / floor2;
    let share = (share.clamp(0.0, 1.0) * 100.0).round() / 100.0;
    runtime::tell!(
        "{count} patches share {:.0} % of the unevenness of the pitch's brightness",
        100.0 * share
    );
    Ok(Some(share))
}

/// The patches of each colour.
fn by_class(floor: &Samples, picture: &Samples) -> BTreeMap<u8, Vec<Pair>> {
    // By colour and patch: sums of the floor's level, red, green and blue, and the number of samples.
    let mut sums: BTreeMap<(u8, u32), [f64; 5]> = BTreeMap::new();
    for (floor, sample) in floor.pixels.iter().zip(&picture.pixels) {
        let [red, green, blue] = sample.rgb.map(f64::from);
        let terms = [floor.rgb[0].into(), red, green, blue, 1.0];
        let sums = sums.entry((sample.class, sample.patch)).or_default();
        sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
    }
    let mut classes: BTreeMap<u8, Vec<Pair>> = BTreeMap::new();
    for ((class, _), [level, red, green, blue, count]) in sums {
        let rgb = [red, green, blue].map(|sum| sum / count);
        let brightness: f64 = rgb.iter().sum();
        if brightness >= 1.0 && rgb.iter().all(|&value| value <= CLIPPED) {
            let octaves = (level / count - MIDDLE_LEVEL) / LEVELS_PER_OCTAVE;
            classes.entry(class).or_default().push([octaves, brightness.log2()]);
        }
    }
    classes.retain(|_, patches| patches.len() > 1);
    classes
}

#[cfg(test)]
mod tests {
    use super::super::lessons::Lesson;
    use super::*;
    use crate::chain::Chain;
    use crate::learning::labels::{Quality, RobotLabel};
    use crate::learning::scene::Scene;
    use config::painted_light::painted;
    use grabber::synthetic::SyntheticMatch;
    use messages::Team;

    /// Pictures of a match under a lamp, with their detections as labels.
    fn lessons(config: &Config) -> (Lessons, Vec<ImageLabels>) {
        let mut game = SyntheticMatch::new(config).unwrap();
        let light = painted(config.preset.config().light);
        let mut chain = Chain::new(&Config { light, ..config.clone() }).unwrap();
        let mut lesson = || {
            (0..60).for_each(|_| game.advance());
            let mut bayer = vec![0; config.camera.frame_bytes()];
            game.render(&mut bayer, config.camera.width as usize);
            let seen = chain.look_at(&bayer).unwrap();
            let robots = seen.robots().iter().map(|robot| RobotLabel {
                team: Team::from_number(robot.team).unwrap(),
                id: robot.robot_id.number().unwrap(),
                x_px: robot.x_px.into(),
                y_px: robot.y_px.into(),
                heading_deg: f64::from(robot.orientation_image).to_degrees(),
                quality: Quality::Clear,
            });
            let robots = Some(robots.collect());
            let labels =
                ImageLabels { file: "match".into(), robots, ball: None, samples: Vec::new() };
            (Lesson::new(config, "match".into(), bayer).unwrap(), labels)
        };
        let (list, labels) = (0..8).map(|_| lesson()).unzip();
        (Lessons { scene: Scene::new(config).unwrap(), list }, labels)
    }

    #[test]
    fn painted_patches_have_all_of_the_unevenness() {
        let mut config = Config::default();
        (config.synthetic.vignette, config.synthetic.gradient) = (0.4, 0.4);
        let (lessons, labels) = lessons(&config);
        let share = measure(&config, &lessons, &labels).unwrap().unwrap();
        assert!((0.8..=1.0).contains(&share), "{share}");
    }

    #[test]
    fn even_light_determines_no_share() {
        let mut config = Config::default();
        (config.synthetic.vignette, config.synthetic.gradient) = (0.0, 0.0);
        let (lessons, labels) = lessons(&config);
        assert_eq!(measure(&config, &lessons, &labels).unwrap(), None);
    }
}
