//! The pictures to learn from, as the classifier sees them.

use super::LearnError;
use crate::learning::labels::ImageLabels;
use crate::learning::picture::Picture;
use crate::learning::samples::{Gatherer, Samples};
use crate::learning::scene::Scene;
use classifier::lattice::Lattice;
use classifier::shading::ShadedTables;
use classifier::white_balance::{Gains, NO_GAINS, PitchProbe, WhiteBalance};
use classifier::{BayerImage, ClassTables, Correction, Picture as Frame, demosaic};
use config::Config;
use grabber::pictures::load_bayer;
use std::path::{Path, PathBuf};

/// Pictures, and the data common to all of them.
pub struct Lessons {
    /// What the configuration says of all pictures.
    pub scene: Scene,
    /// The pictures.
    pub list: Vec<Lesson>,
}

/// A picture.
pub struct Lesson {
    /// Its file, or another name for messages.
    pub file: PathBuf,
    /// Rows of the configured camera, without padding.
    pub bayer: Vec<u8>,
    /// In full colour, as the camera gave it.
    pub picture: Picture,
}

impl Lessons {
    /// Reads the files.
    pub fn load(
        config: &Config,
        files: impl IntoIterator<Item = PathBuf>,
    ) -> Result<Self, LearnError> {
        let lesson = |file: PathBuf| -> Result<Lesson, LearnError> {
            let bayer = load_bayer(&file, &config.camera)?;
            Lesson::new(config, file, bayer)
        };
        let list = files.into_iter().map(lesson).collect::<Result<Vec<_>, _>>()?;
        Ok(Self { scene: Scene::new(config)?, list })
    }

    /// Bayer frames of the configured camera, each with a name for messages.
    pub fn from_frames(
        config: &Config,
        frames: impl IntoIterator<Item = (PathBuf, Vec<u8>)>,
    ) -> Result<Self, LearnError> {
        let lesson = |(name, bayer)| Lesson::new(config, name, bayer);
        let list = frames.into_iter().map(lesson).collect::<Result<Vec<_>, _>>()?;
        Ok(Self { scene: Scene::new(config)?, list })
    }

    /// The pictures in the light to which `config` corrects them.
    pub fn under_light(&self, config: &Config) -> Result<Vec<Picture>, LearnError> {
        let white_balance = WhiteBalance::new(config)?;
        let mut shaded = ShadedTables::new(config, &ClassTables::new(&[])?)?;
        let mut lattice = Lattice::new(&config.camera);
        let mut lit = Vec::with_capacity(self.list.len());
        for lesson in &self.list {
            lattice.sample(&Frame::Bayer(lesson.image(config)?));
            let gains: Gains = white_balance
                .as_ref()
                .and_then(|white_balance| white_balance.gains(&lattice))
                .unwrap_or(NO_GAINS);
            lit.push(match &mut shaded {
                Some(shaded) => {
                    shaded.measure(&lattice);
                    let (zones, tables) = (shaded.zones(), ShadedTables::corrections(gains));
                    lesson.picture.corrected(|column, row| &tables[zones.at(column, row)])
                }
                None => {
                    let tables = Correction::new(gains, 0).tables();
                    lesson.picture.corrected(|_, _| &tables)
                }
            });
        }
        Ok(lit)
    }

    /// Geometric mean of the pitch's colour over all pictures; `None` if the pitch cannot be seen in one of
    /// them.
    pub fn pitch_color(&self, config: &Config) -> Result<Option<[f64; 3]>, LearnError> {
        let probe = PitchProbe::new(config)?;
        let mut lattice = Lattice::new(&config.camera);
        let mut logs = [0.0; 3];
        for lesson in &self.list {
            lattice.sample(&Frame::Bayer(lesson.image(config)?));
            let Some(rgb) = probe.measure(&lattice) else {
                runtime::tell!(
                    "touchline: {}: the pitch is too dark to tell the light from it; the colours \
                     will not follow the lamps",
                    lesson.file.display()
                );
                return Ok(None);
            };
            logs.iter_mut().zip(rgb).for_each(|(sum, value)| *sum += value.ln());
        }
        let mean = |sum: f64| ((sum / self.list.len() as f64).exp() * 10.0).round() / 10.0;
        Ok(Some(logs.map(mean)))
    }

    /// Gathers samples from all pictures; `lit` has the pictures in the light to learn for, `labels`
    /// their labels.
    pub fn gather(
        &self,
        config: &Config,
        lit: &[Picture],
        labels: &[ImageLabels],
    ) -> Result<Samples, LearnError> {
        let mut gatherer = Gatherer::new(config, &self.scene);
        for (picture, labels) in lit.iter().zip(labels) {
            gatherer.add(labels, picture)?;
        }
        Ok(gatherer.finish())
    }
}

impl Lesson {
    /// A picture of the configured camera.
    pub fn new(config: &Config, file: PathBuf, bayer: Vec<u8>) -> Result<Self, LearnError> {
        let mut rgb = Vec::new();
        let image = bayer_image(config, &bayer, &file)?;
        demosaic(&image, &mut rgb);
        let picture = Picture::new(image.width(), &rgb);
        Ok(Self { file, bayer, picture })
    }

    /// The picture as the camera delivered it.
    pub fn image(&self, config: &Config) -> Result<BayerImage<'_>, LearnError> {
        bayer_image(config, &self.bayer, &self.file)
    }
}

fn bayer_image<'a>(
    config: &Config,
    bayer: &'a [u8],
    file: &Path,
) -> Result<BayerImage<'a>, LearnError> {
    let camera = &config.camera;
    BayerImage::new(bayer, camera.width, camera.height, camera.width, camera.bayer_order)
        .ok_or_else(|| LearnError::TooSmall(file.to_path_buf()))
}
