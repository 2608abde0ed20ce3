//! Patches guessed from pictures without labels: blobs with roughly the right colour and the size of a patch.
//!
//! `looks` gives a colour's hue or, for white, grey and black, its brightness relative to the pitch. The
//! minimum saturation or the boundaries in brightness are unknown: on a green pitch under a yellow lamp they
//! differ from those on a black one. So the pictures are segmented at each of several levels of that bound,
//! as in a search for maximally stable regions. If too much passes, floor and patches merge into one large
//! blob; if too little passes, patches fall to pieces; at the right level most blobs have the size of a
//! patch. For each colour, the middle of the levels with the most blobs of that size is chosen, where blobs
//! beyond the expected number count negatively. The blobs at that level are samples of the colour nearly as
//! good as labelled ones, and everything else on the pitch is background.

use crate::learning::blobs::{Blob, NOTHING, blobs};
use crate::learning::palette::{self, Tone};
use crate::learning::picture::Picture;
use crate::learning::samples::{Background, Sample, Samples};
use crate::learning::scene::Scene;
use config::{Config, PatchRole};
use geometry::ImagePoint;
use geometry::layout::Layout;

/// Levels: the minimum saturation of colours with a hue, and the factor on the boundaries in brightness of
/// white, grey and black.
const LEVELS: [(f64, f64); 12] = [
    (0.06, 0.45),
    (0.09, 0.55),
    (0.13, 0.65),
    (0.18, 0.75),
    (0.24, 0.87),
    (0.30, 1.0),
    (0.37, 1.15),
    (0.44, 1.3),
    (0.51, 1.5),
    (0.58, 1.75),
    (0.66, 2.0),
    (0.75, 2.4),
];
/// Maximum saturation of white, grey and black.
const MAX_GREY_SATURATION: f64 = 0.2;
/// Maximum of the channels below which a pixel has no reliable hue.
const DARKEST: u8 = 16;
/// Accepted sizes of a blob, relative to the smallest and the largest patch.
const SIZES: [f64; 2] = [0.35, 1.8];
/// Minimum part of its bounding box that a blob fills.
const MIN_FILL: f64 = 0.3;
/// Margin around a blob that is not sampled as background, px.
const RIM_PX: i64 = 2;

/// The patches of a colour according to the layout.
#[derive(Debug, Clone, PartialEq)]
pub struct ExpectedPatches {
    /// Index of the configured colour.
    pub class: u8,
    /// Area of the smallest and of the largest patch.
    pub area_mm2: [f64; 2],
    /// Total area of its patches, if all robots are in the picture.
    pub total_mm2: f64,
    /// Height of the patches above the floor.
    pub height_mm: f64,
    /// Number of its patches, if all robots are in the picture.
    pub count: f64,
}

/// The features of a pixel that decide its class.
struct Feature {
    hue: u8,
    saturation: u8,
    /// Mean of the channels.
    grey: u8,
    has_hue: bool,
}

/// Guesses which pixels of the pictures show which configured colour. The pictures must be in the light that
/// colours are learned for.
pub fn guess(config: &Config, scene: &Scene, pictures: &[Picture]) -> Samples {
    let expected = expected_patches(config);
    let tones = palette::tones(&config.colors, config.light.pitch_rgb);
    let features: Vec<Vec<Feature>> = pictures.iter().map(features).collect();
    let map = |picture: usize, level: usize| {
        let classes = Classes::new(&tones, &expected, level);
        let pixels = features[picture].iter().zip(&scene.is_on_pitch);
        let class = |(feature, &is_on_pitch): (&Feature, &bool)| match is_on_pitch {
            true => classes.of(feature),
            false => NOTHING,
        };
        pixels.map(class).collect::<Vec<u8>>()
    };
    // Patches found, indexed by level and colour.
    let mut found = vec![vec![0.0; expected.len()]; LEVELS.len()];
    for (picture, image) in pictures.iter().enumerate() {
        for (level, found) in found.iter_mut().enumerate() {
            for blob in &blobs(&map(picture, level), image.width).0 {
                if let Some(index) =
                    expected.iter().position(|expected| expected.class == blob.class)
                {
                    found[index] += f64::from(u8::from(expected[index].is_met(scene, blob)));
                }
            }
        }
    }
    let chosen: Vec<usize> = (0..expected.len())
        .map(|index| {
            let count = expected[index].count * pictures.len() as f64;
            best_level(found.iter().map(|found| found[index]), count)
        })
        .collect();
    let mut samples = SampleBuilder::default();
    for (picture, image) in pictures.iter().enumerate() {
        samples.begin(image);
        for (expected, &level) in expected.iter().zip(&chosen) {
            let (blobs, numbers) = blobs(&map(picture, level), image.width);
            for (number, blob) in (0..).zip(&blobs) {
                if blob.class == expected.class && expected.is_met(scene, blob) {
                    samples.add(image, blob, |index| numbers[index] == number);
                }
            }
        }
        samples.end(image, scene);
    }
    samples.finish(pictures.len())
}

/// The middle of the levels at which most patches are found; patches beyond the expected number count
/// negatively.
fn best_level(found: impl Iterator<Item = f64>, count: f64) -> usize {
    let worth: Vec<f64> = found.map(|found| found.min(2.0 * count - found)).collect();
    let most = worth.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let is_best = |level: &usize| worth[*level] >= 0.9 * most;
    let first = (0..worth.len()).find(|&level| worth[level] >= most).unwrap_or(0);
    let last = (first..worth.len()).take_while(is_best).last().unwrap_or(first);
    (first + last) / 2
}

/// The colours on robots and ball.
pub fn expected_patches(config: &Config) -> Vec<ExpectedPatches> {
    let layout = Layout::new(&config.robots);
    let own = |patches: &Vec<_>| Layout::new(patches);
    let mut all: Vec<ExpectedPatches> = Vec::new();
    let mut add = |name: &str, area_mm2: f64, height_mm: f64| {
        let Some(class) = config.colors.iter().position(|color| color.name == name) else { return };
        match all.iter_mut().find(|expected| usize::from(expected.class) == class) {
            Some(expected) => {
                let [least, most] = expected.area_mm2;
                expected.area_mm2 = [least.min(area_mm2), most.max(area_mm2)];
                expected.total_mm2 += area_mm2;
                expected.count += 1.0;
            }
            None => all.push(ExpectedPatches {
                class: class as u8,
                area_mm2: [area_mm2; 2],
                total_mm2: area_mm2,
                height_mm,
                count: 1.0,
            }),
        }
    };
    for identity in &config.robots.identities {
        let mut names = identity.colors.iter();
        let own = identity.patches.as_ref().map(own);
        let height_mm = config.top_of(identity).height_mm;
        for patch in &own.as_ref().unwrap_or(&layout).patches {
            let name = match patch.role {
                PatchRole::Team => Some(config.teams.color(identity.team)),
                PatchRole::Identification => names.next().map(String::as_str),
            };
            if let Some(name) = name {
                add(name, patch.area_mm2, height_mm);
            }
        }
    }
    let radius_mm = config.ball.diameter_mm / 2.0;
    add(&config.ball.color, std::f64::consts::PI * radius_mm.powi(2), radius_mm);
    all
}

impl ExpectedPatches {
    /// Whether a blob can be one of the colour's patches.
    fn is_met(&self, scene: &Scene, blob: &Blob) -> bool {
        let [across, down] =
            [blob.columns, blob.rows].map(|[first, last]| f64::from(last - first + 1));
        let center = ImagePoint::new(blob.center[0], blob.center[1]);
        let pixels = f64::from(blob.pixels);
        let area_mm2 = || pixels * scene.camera.pixel_area_mm2(center, self.height_mm);
        pixels >= MIN_FILL * across * down
            && pixels >= 4.0
            && (SIZES[0] * self.area_mm2[0]..=SIZES[1] * self.area_mm2[1]).contains(&area_mm2())
    }
}

fn features(picture: &Picture) -> Vec<Feature> {
    let feature = |&[red, green, blue]: &[u8; 3]| {
        let (least, most) = (red.min(green).min(blue), red.max(green).max(blue));
        let sum = u32::from(red) + u32::from(green) + u32::from(blue);
        let saturation = (sum - 3 * u32::from(least)) * 255 / sum.max(1);
        let hue = palette::hue_deg([red, green, blue]).unwrap_or(0.0);
        Feature {
            hue: (hue * 256.0 / 360.0) as u8,
            saturation: saturation as u8,
            grey: (sum / 3) as u8,
            has_hue: most > least && most >= DARKEST,
        }
    };
    picture.rgb.iter().map(feature).collect()
}

/// Assignment of features to classes at one level.
struct Classes {
    of_hue: [u8; 256],
    least_saturation: u8,
    of_grey: [u8; 256],
    most_grey_saturation: u8,
}

impl Classes {
    fn new(tones: &[Option<Tone>], expected: &[ExpectedPatches], level: usize) -> Self {
        let (saturation, factor) = LEVELS[level];
        let mut classes = Self {
            of_hue: [NOTHING; 256],
            least_saturation: (saturation * 255.0) as u8,
            of_grey: [NOTHING; 256],
            most_grey_saturation: (MAX_GREY_SATURATION * 255.0) as u8,
        };
        for expected in expected {
            match tones[usize::from(expected.class)] {
                Some(Tone::Hue([from, to])) => {
                    for (bin, class) in classes.of_hue.iter_mut().enumerate() {
                        let hue = (bin as f64 + 0.5) * 360.0 / 256.0;
                        if (hue - from).rem_euclid(360.0) <= (to - from).rem_euclid(360.0) {
                            *class = expected.class;
                        }
                    }
                }
                Some(Tone::Grey([from, to])) => {
                    for (grey, class) in classes.of_grey.iter_mut().enumerate() {
                        if (from * factor..to * factor).contains(&(grey as f64)) {
                            *class = expected.class;
                        }
                    }
                }
                None => {}
            }
        }
        classes
    }

    fn of(&self, feature: &Feature) -> u8 {
        if feature.has_hue && feature.saturation >= self.least_saturation {
            let class = self.of_hue[usize::from(feature.hue)];
            if class != NOTHING {
                return class;
            }
        }
        match feature.saturation <= self.most_grey_saturation {
            true => self.of_grey[usize::from(feature.grey)],
            false => NOTHING,
        }
    }
}

/// Samples under construction.
#[derive(Default)]
struct SampleBuilder {
    samples: Samples,
    background: Background,
    /// Pixels of the current picture that belong to a patch or its margin.
    is_patch: Vec<bool>,
}

impl SampleBuilder {
    fn begin(&mut self, picture: &Picture) {
        self.is_patch.clear();
        self.is_patch.resize(picture.rgb.len(), false);
    }

    /// Adds the inner pixels of a blob as samples, and excludes its surroundings from the background.
    fn add(&mut self, picture: &Picture, blob: &Blob, is_in: impl Fn(usize) -> bool) {
        let (width, height) = (picture.width as i64, picture.height() as i64);
        let in_blob = |column: i64, row: i64| {
            (0..width).contains(&column)
                && (0..height).contains(&row)
                && is_in((row * width + column) as usize)
        };
        let patch = self.samples.patches;
        self.samples.patches += 1;
        let range = |[first, last]: [u32; 2]| i64::from(first)..=i64::from(last);
        let mut all = Vec::new();
        let mut inside = Vec::new();
        for row in range(blob.rows) {
            for column in range(blob.columns).filter(|&column| in_blob(column, row)) {
                let beside = [(-1, 0), (1, 0), (0, -1), (0, 1)];
                let index = (row * width + column) as usize;
                all.push(index);
                if beside.iter().all(|(dx, dy)| in_blob(column + dx, row + dy)) {
                    inside.push(index);
                }
                for y in (row - RIM_PX).max(0)..=(row + RIM_PX).min(height - 1) {
                    for x in (column - RIM_PX).max(0)..=(column + RIM_PX).min(width - 1) {
                        self.is_patch[(y * width + x) as usize] = true;
                    }
                }
            }
        }
        // A very small patch consists of edge pixels only.
        let own = if 4 * inside.len() >= all.len() { inside } else { all };
        let sample = |index: usize| Sample { rgb: picture.rgb[index], class: blob.class, patch };
        self.samples.pixels.extend(own.into_iter().map(sample));
    }

    /// Adds everything else on the pitch as background.
    fn end(&mut self, picture: &Picture, scene: &Scene) {
        let pixels = picture.rgb.iter().zip(&self.is_patch).zip(&scene.is_on_pitch);
        for ((&rgb, &is_patch), &is_on_pitch) in pixels {
            if is_on_pitch && !is_patch {
                self.background.add(rgb);
            }
        }
    }

    fn finish(self, pictures: usize) -> Samples {
        let background = self.background.finish(pictures);
        Samples { background, pictures: pictures as u32, rims: Vec::new(), ..self.samples }
    }
}
