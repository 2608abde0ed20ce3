//! Samples: pixels of known colour, from labelled pictures.
//!
//! For a labelled robot, the layout tells which of its pixels show which patch. Pixels near the edge of a
//! patch are mixtures and are left out, like everything else on a robot, whose sides and rims may have any
//! colour. Everything on the pitch and on no robot is background.

use crate::learning::labels::{BACKGROUND, ImageLabels, Quality, RobotLabel, SampleArea};
use crate::learning::picture::Picture;
use crate::learning::scene::Scene;
use config::{Config, PatchRole};
use geometry::{CameraModel, FieldPoint, ImagePoint, Pose};

/// Labels cannot be used for samples.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SamplesError {
    /// A label names a colour that is not configured.
    #[error("{image}: the colour \"{color}\" is not one of the configured ones: {known}")]
    UnknownColor {
        /// The picture.
        image: String,
        /// Name in the label.
        color: String,
        /// The configured names.
        known: String,
    },
    /// A label names a robot that is not configured.
    #[error(
        "{image}: {team} {id} is labelled, but not in robots.identities; add it there or remove the label"
    )]
    UnknownRobot {
        /// The picture.
        image: String,
        /// The robot's team.
        team: &'static str,
        /// The robot's number.
        id: u32,
    },
}

/// A pixel inside a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sample {
    /// Its colour in the picture.
    pub rgb: [u8; 3],
    /// Index of the configured colour.
    pub class: u8,
    /// Number of its patch; never decreases.
    pub patch: u32,
}

/// A pixel at the rim of patches, which is a mixture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rim {
    /// Its colour in the picture.
    pub rgb: [u8; 3],
    /// Bit i is set if it lies beside a patch of class i: classifying it as such is no error.
    pub beside: u32,
}

/// Samples of a set of pictures.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Samples {
    /// Pixels inside patches.
    pub pixels: Vec<Sample>,
    /// Pixels at the rims of patches.
    pub rims: Vec<Rim>,
    /// Colours of the background, with the number of pixels per picture. Colours are quantised: a value
    /// stands for [`BACKGROUND_STEP`] neighbouring ones.
    pub background: Vec<([u8; 3], f64)>,
    /// Number of patches.
    pub patches: u32,
    /// Number of pictures.
    pub pictures: u32,
}

/// Quantisation of background colours, grey levels.
pub const BACKGROUND_STEP: u8 = 8;

/// Width of the mixture at a patch's edge, px: demosaicing reaches one pixel to each side.
const RIM_PX: f64 = 0.75;
/// Reach of a rim around a patch, px.
const RIM_REACH_PX: f64 = 2.0;
/// Radius around a robot that is no background, in half sizes of the robot: covers its corners, and its sides
/// as the camera sees them.
const ROBOT_REACH: f64 = 2.0;
/// Radius around the ball that is no background, in radii of the ball.
const BALL_REACH: f64 = 2.2;
/// Part of the ball's radius within which it shows its colour.
const BALL_CORE: f64 = 0.7;

/// Gathers samples picture by picture.
pub struct Gatherer<'a> {
    config: &'a Config,
    scene: &'a Scene,
    samples: Samples,
    background: Background,
}

/// Histogram of background colours.
pub(crate) struct Background {
    /// Counts, indexed by quantised red, green and blue.
    counts: Vec<u64>,
}

/// Quantised values of a channel.
const COARSE: usize = 256 / BACKGROUND_STEP as usize;

impl Default for Background {
    fn default() -> Self {
        Self { counts: vec![0; COARSE * COARSE * COARSE] }
    }
}

impl Background {
    pub fn add(&mut self, rgb: [u8; 3]) {
        let coarse = rgb.map(|value| usize::from(value / BACKGROUND_STEP));
        self.counts[coarse.iter().fold(0, |index, value| index * COARSE + value)] += 1;
    }

    /// The colours, each at the middle of its quantisation step, with their pixels per picture.
    pub fn finish(&self, pictures: usize) -> Vec<([u8; 3], f64)> {
        let color = |index: usize| {
            [COARSE * COARSE, COARSE, 1]
                .map(|unit| (index / unit % COARSE) as u8 * BACKGROUND_STEP + BACKGROUND_STEP / 2)
        };
        let counted = self.counts.iter().enumerate().filter(|&(_, &count)| count > 0);
        counted.map(|(index, &count)| (color(index), count as f64 / pictures as f64)).collect()
    }
}

/// Known content of a pixel.
#[derive(Clone, Copy, PartialEq)]
enum Content {
    Nothing,
    /// Content that must not be learned.
    Mixture,
    Color(u8),
}

impl<'a> Gatherer<'a> {
    /// For the configured colours; `scene` must be made for the same layout, geometry and camera.
    pub fn new(config: &'a Config, scene: &'a Scene) -> Self {
        Self { config, scene, samples: Samples::default(), background: Background::default() }
    }

    /// Adds a labelled picture.
    pub fn add(&mut self, labels: &ImageLabels, picture: &Picture) -> Result<(), SamplesError> {
        let image = labels.file.display().to_string();
        let mut map = vec![Content::Nothing; picture.rgb.len()];
        self.samples.pictures += 1;
        for robot in labels.robots.iter().flatten() {
            self.add_robot(&image, robot, picture, &mut map)?;
        }
        if let Some(Some(ball)) = &labels.ball {
            let radius_mm = self.config.ball.diameter_mm / 2.0;
            let center = ImagePoint::new(ball.x_px, ball.y_px);
            let radius_px = radius_mm / self.scene.camera.pixel_area_mm2(center, radius_mm).sqrt();
            let class = self.class(&image, &self.config.ball.color)?;
            self.samples.patches += u32::from(ball.quality == Quality::Clear);
            for (index, point) in picture.around(center, BALL_REACH * radius_px) {
                let distance = (point.x_px - center.x_px).hypot(point.y_px - center.y_px);
                let is_core = distance <= BALL_CORE * radius_px;
                if is_core && ball.quality == Quality::Clear && map[index] == Content::Nothing {
                    self.push(picture.rgb[index], class);
                }
                map[index] = if is_core { Content::Color(class) } else { Content::Mixture };
            }
        }
        for sample in &labels.samples {
            let class = match sample.color.as_str() {
                BACKGROUND => None,
                color => Some(self.class(&image, color)?),
            };
            self.samples.patches += u32::from(class.is_some());
            for index in area(picture, &sample.area) {
                match class {
                    Some(class) => {
                        self.push(picture.rgb[index], class);
                        map[index] = Content::Color(class);
                    }
                    None => self.background.add(picture.rgb[index]),
                }
            }
        }
        if labels.robots.is_some() {
            self.add_background(picture, &map);
        }
        Ok(())
    }

    /// All samples.
    pub fn finish(mut self) -> Samples {
        self.samples.background = self.background.finish(self.samples.pictures.max(1) as usize);
        self.samples
    }

    fn add_robot(
        &mut self,
        image: &str,
        label: &RobotLabel,
        picture: &Picture,
        map: &mut [Content],
    ) -> Result<(), SamplesError> {
        let robots = &self.config.robots;
        let identity = robots
            .identities
            .iter()
            .find(|identity| (identity.team, identity.id) == (label.team, label.id));
        let identity = identity.ok_or_else(|| SamplesError::UnknownRobot {
            image: image.to_string(),
            team: label.team.name(),
            id: label.id,
        })?;
        let top = self.config.top_of(identity);
        let mut names = identity.colors.iter();
        let mut classes = Vec::with_capacity(top.patches.len());
        for patch in top.patches {
            let name = match patch.role {
                PatchRole::Team => Some(self.config.teams.color(label.team)),
                PatchRole::Identification => names.next().map(String::as_str),
            };
            classes.push(name.map(|name| self.class(image, name)).transpose()?);
        }

        let center = ImagePoint::new(label.x_px, label.y_px);
        let (camera, map_of_top) = (&self.scene.camera, self.scene.top_map(top.patches));
        let pose = pose_of(camera, label, top.height_mm);
        let px_per_mm = 1.0 / camera.pixel_area_mm2(center, top.height_mm).sqrt();
        let ring = |reach_mm: f64| {
            std::array::from_fn::<_, 8, _>(|step| {
                let (sin, cos) = (step as f64 * std::f64::consts::FRAC_PI_4).sin_cos();
                [reach_mm * cos, reach_mm * sin]
            })
        };
        let inner = ring(RIM_PX / px_per_mm);
        let outer = [0.5, 1.0].map(|part| ring(part * RIM_REACH_PX / px_per_mm));
        let first = self.samples.patches;
        self.samples.patches += classes.len() as u32;
        let reach_px = ROBOT_REACH * robots.size_mm / 2.0 * px_per_mm;
        for (index, point) in picture.around(center, reach_px) {
            let [x, y] = robot_point(&pose, camera.field_from_image(point, top.height_mm));
            let here = map_of_top.patch_at([x, y]);
            let is_inside =
                inner.iter().all(|[dx, dy]| map_of_top.patch_at([x + dx, y + dy]) == here);
            let class = here.filter(|_| is_inside).and_then(|patch| classes[patch]);
            if let (Some(class), Some(patch)) = (class, here)
                && label.quality == Quality::Clear
                && !matches!(map[index], Content::Color(_))
            {
                let patch = first + patch as u32;
                self.samples.pixels.push(Sample { rgb: picture.rgb[index], class, patch });
            }
            if class.is_none() && label.quality == Quality::Clear {
                let mut beside = 0u32;
                for [dx, dy] in outer.as_flattened() {
                    let patch = map_of_top.patch_at([x + dx, y + dy]);
                    if let Some(class) = patch.and_then(|patch| classes[patch]) {
                        beside |= 1u32.checked_shl(class.into()).unwrap_or(0);
                    }
                }
                if beside != 0 && map[index] == Content::Nothing {
                    self.samples.rims.push(Rim { rgb: picture.rgb[index], beside });
                }
            }
            if here.is_some() || map[index] == Content::Nothing {
                map[index] = class.map_or(Content::Mixture, Content::Color);
            }
        }
        Ok(())
    }

    fn add_background(&mut self, picture: &Picture, map: &[Content]) {
        let pixels = picture.rgb.iter().zip(map).zip(&self.scene.is_on_pitch);
        for ((&rgb, &shows), &is_on_pitch) in pixels {
            if is_on_pitch && shows == Content::Nothing {
                self.background.add(rgb);
            }
        }
    }

    fn push(&mut self, rgb: [u8; 3], class: u8) {
        self.samples.pixels.push(Sample { rgb, class, patch: self.samples.patches - 1 });
    }

    fn class(&self, image: &str, name: &str) -> Result<u8, SamplesError> {
        let colors = &self.config.colors;
        match colors.iter().position(|color| color.name == name) {
            Some(class) => Ok(class as u8),
            None => {
                let known: Vec<&str> = colors.iter().map(|color| color.name.as_str()).collect();
                Err(SamplesError::UnknownColor {
                    image: image.to_string(),
                    color: name.to_string(),
                    known: known.join(", "),
                })
            }
        }
    }
}

/// Pose on the field of a robot whose top is labelled in the picture.
pub fn pose_of(camera: &CameraModel, label: &RobotLabel, height_mm: f64) -> Pose {
    const AHEAD_PX: f64 = 4.0;
    let (sin, cos) = label.heading_deg.to_radians().sin_cos();
    let at = |ahead: f64| {
        let point = ImagePoint::new(label.x_px + ahead * cos, label.y_px - ahead * sin);
        camera.field_from_image(point, height_mm)
    };
    let (behind, ahead) = (at(-AHEAD_PX), at(AHEAD_PX));
    let orientation = (ahead.y_mm - behind.y_mm).atan2(ahead.x_mm - behind.x_mm);
    Pose { position: at(0.0), orientation }
}

/// A point of the field in the robot's frame: x forward, y left.
pub fn robot_point(pose: &Pose, place: FieldPoint) -> [f64; 2] {
    let (sin, cos) = pose.orientation.sin_cos();
    let (dx, dy) = (place.x_mm - pose.position.x_mm, place.y_mm - pose.position.y_mm);
    [cos * dx + sin * dy, cos * dy - sin * dx]
}

/// Pixels of a labelled area.
fn area(picture: &Picture, area: &SampleArea) -> Vec<usize> {
    match *area {
        SampleArea::Rectangle { rect_px: [left, top, right, bottom] } => (0..picture.rgb.len())
            .filter(|&index| {
                let point = picture.point(index);
                (left..=right).contains(&point.x_px) && (top..=bottom).contains(&point.y_px)
            })
            .collect(),
        SampleArea::Disc { x_px, y_px, radius_px } => {
            picture.around(ImagePoint::new(x_px, y_px), radius_px).map(|(index, _)| index).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learning::labels::Labels;
    use geometry::layout::topmost_patch;
    use std::path::Path;

    fn labels(text: &str) -> ImageLabels {
        let text = format!(r#"{{"images": [{{"file": "a.png", {text}}}]}}"#);
        Labels::parse(&text, Path::new("labels.json")).unwrap().images.remove(0)
    }

    /// A picture of the default pitch in which every pixel has the display colour of its content.
    fn painted(config: &Config, robot: &Pose, classes: &[usize]) -> Picture {
        let camera = CameraModel::new(&config.geometry, 640, 480).unwrap();
        let mut picture = Picture { width: 640, rgb: vec![[10; 3]; 640 * 480] };
        for index in 0..picture.rgb.len() {
            let place = camera.field_from_image(picture.point(index), config.robots.height_mm);
            if let Some(patch) = topmost_patch(&config.robots, robot_point(robot, place)) {
                picture.rgb[index] = config.colors[classes[patch]].looks;
            }
        }
        picture
    }

    #[test]
    fn a_labelled_robot_shows_its_colors_and_nothing_else() {
        let config = Config::default();
        let camera = CameraModel::new(&config.geometry, 640, 480).unwrap();
        let class = |name: &str| config.colors.iter().position(|c| c.name == name).unwrap();
        let pose = Pose { position: FieldPoint::new(500.0, -300.0), orientation: 0.7 };
        let identity = config.robots.identities.iter().find(|i| i.team.name() == "blue").unwrap();
        let classes = [class("blue"), class(&identity.colors[0])];
        let picture = painted(&config, &pose, &classes);
        let at = |x: f64| camera.image_from_field(pose.field_from_robot([x, 0.0]), 75.0);
        let (center, ahead) = (at(0.0), at(30.0));
        let heading = (center.y_px - ahead.y_px).atan2(ahead.x_px - center.x_px).to_degrees();
        let labels = labels(&format!(
            r#""robots": [{{"team": "blue", "id": {}, "x_px": {}, "y_px": {}, "heading_deg": {heading}}}]"#,
            identity.id, center.x_px, center.y_px
        ));
        let scene = Scene::new(&config).unwrap();
        let mut gatherer = Gatherer::new(&config, &scene);
        gatherer.add(&labels, &picture).unwrap();
        let samples = gatherer.finish();
        for class in classes {
            let own = samples.pixels.iter().filter(|sample| usize::from(sample.class) == class);
            assert!(own.clone().count() > 20, "{}", config.colors[class].name);
            assert!(own.clone().all(|sample| sample.rgb == config.colors[class].looks));
        }
        assert_eq!(samples.patches, 2);
        // No pixel of the robot is background.
        assert_eq!(samples.background.len(), 1, "{:?}", samples.background);
    }

    #[test]
    fn marked_places_are_samples() {
        let config = Config::default();
        let picture = Picture { width: 640, rgb: vec![[10, 90, 10]; 640 * 480] };
        let scene = Scene::new(&config).unwrap();
        let mut gatherer = Gatherer::new(&config, &scene);
        let marks = r#""samples": [
            {"color": "green", "x_px": 50, "y_px": 60, "radius_px": 1},
            {"color": "background", "rect_px": [0, 0, 9, 4]},
            {"color": "green", "x_px": -500, "y_px": 1e5}
        ]"#;
        gatherer.add(&labels(marks), &picture).unwrap();
        let samples = gatherer.finish();
        assert_eq!(samples.pixels.len(), 5);
        assert_eq!(samples.background, [([12, 92, 12], 50.0)]);
    }

    #[test]
    fn unknown_names_are_refused() {
        let config = Config::default();
        let picture = Picture { width: 640, rgb: vec![[10; 3]; 640 * 480] };
        let complaint = |text: &str| {
            let scene = Scene::new(&config).unwrap();
            let mut gatherer = Gatherer::new(&config, &scene);
            gatherer.add(&labels(text), &picture).unwrap_err().to_string()
        };
        let mauve = complaint(r#""samples": [{"color": "mauve", "x_px": 1, "y_px": 1}]"#);
        assert!(mauve.contains("mauve") && mauve.contains("orange"), "{mauve}");
        let robot =
            r#""robots": [{"team": "blue", "id": 9, "x_px": 1, "y_px": 2, "heading_deg": 3}]"#;
        assert!(complaint(robot).contains("blue 9"), "{}", complaint(robot));
    }
}
