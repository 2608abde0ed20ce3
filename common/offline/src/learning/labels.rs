//! Labels: contents of pictures, as a person has marked them.
//!
//! One JSON file describes any number of pictures; `docs/labels.md` explains it for people. Unknown keys are
//! ignored, so a file may carry notes for other programs.

use config::input;
use messages::Team;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// A file of labels cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LabelsError {
    /// The file cannot be read.
    #[error("cannot read the labels {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The text does not have the format.
    #[error("{}: {source}; docs/labels.md describes the format", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// Position and reason.
        source: serde_json::Error,
    },
    /// A coordinate that no picture has.
    #[error("{}: image {image}: {what} = {value} lies outside any picture", path.display())]
    Number {
        /// The file.
        path: PathBuf,
        /// The picture's name.
        image: String,
        /// The coordinate's name.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A robot is labelled twice in a picture.
    #[error("{}: image {image}: {team} {id} is labelled twice", path.display(), team = team.name())]
    Twice {
        /// The file.
        path: PathBuf,
        /// The picture's name.
        image: String,
        /// The robot's team.
        team: Team,
        /// The robot's number.
        id: u32,
    },
}

/// The labels of a set of pictures.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Labels {
    /// One entry for each picture.
    pub images: Vec<ImageLabels>,
}

/// The labels of one picture. Pixels: the centre of the top-left pixel is (0, 0), x right, y down.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct ImageLabels {
    /// The picture, relative to the folder of the labels; after [`Labels::load`], to the working directory.
    pub file: PathBuf,
    /// All robots in the picture; absent if robots were not labelled.
    #[serde(default)]
    pub robots: Option<Vec<RobotLabel>>,
    /// The ball: absent if it was not labelled, `null` if there is none.
    #[serde(default, deserialize_with = "present")]
    pub ball: Option<Option<BallLabel>>,
    /// Areas of a known colour.
    #[serde(default)]
    pub samples: Vec<SampleLabel>,
}

/// A robot.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct RobotLabel {
    /// Its team.
    pub team: Team,
    /// Its number in the team.
    pub id: u32,
    /// Centre of its top, column.
    pub x_px: f64,
    /// Centre of its top, row.
    pub y_px: f64,
    /// Heading as it appears in the picture: 0 right, 90 up on the screen.
    pub heading_deg: f64,
    /// Visibility.
    #[serde(default)]
    pub quality: Quality,
}

/// The ball.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct BallLabel {
    /// Centre, column.
    pub x_px: f64,
    /// Centre, row.
    pub y_px: f64,
    /// Visibility.
    #[serde(default)]
    pub quality: Quality,
}

/// An area of the picture that shows a colour, or the background.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct SampleLabel {
    /// Name of the colour, or "background".
    pub color: String,
    /// The area.
    #[serde(flatten)]
    pub area: SampleArea,
}

/// A part of a picture.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(untagged)]
pub enum SampleArea {
    /// A rectangle: left, top, right and bottom, all four included.
    Rectangle {
        /// Left, top, right and bottom.
        rect_px: [f64; 4],
    },
    /// A disc.
    Disc {
        /// Centre, column.
        x_px: f64,
        /// Centre, row.
        y_px: f64,
        /// Its radius.
        #[serde(default = "default_radius")]
        radius_px: f64,
    },
}

/// Visibility of a labelled object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Quality {
    /// Visible without doubt.
    #[default]
    Clear,
    /// Hidden, blurred or otherwise not required to be found.
    Hard,
}

/// Name of the background in labels.
pub const BACKGROUND: &str = "background";

fn default_radius() -> f64 {
    2.0
}

/// Distinguishes `null` from an absent key.
fn present<'de, D: serde::Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<Option<BallLabel>>, D::Error> {
    Option::deserialize(deserializer).map(Some)
}

impl Labels {
    /// Reads a file; the pictures' names are prefixed by its folder.
    pub fn load(path: &Path) -> Result<Self, LabelsError> {
        let text = input::read_text(path, input::LABELS)
            .map_err(|source| LabelsError::Read { path: path.into(), source })?;
        let mut labels = Self::parse(&text, path)?;
        if let Some(folder) = path.parent() {
            for image in &mut labels.images {
                image.file = folder.join(&image.file);
            }
        }
        Ok(labels)
    }

    /// Checks a text; error messages refer to it as `path`.
    pub fn parse(text: &str, path: &Path) -> Result<Self, LabelsError> {
        let labels: Self = serde_json::from_str(text)
            .map_err(|source| LabelsError::Format { path: path.into(), source })?;
        for image in &labels.images {
            image.check(path)?;
        }
        Ok(labels)
    }
}

impl ImageLabels {
    fn check(&self, path: &Path) -> Result<(), LabelsError> {
        /// Limit of coordinates, px.
        const MAX_COORDINATE_PX: f64 = 100_000.0;
        let number = |what: &'static str, value: f64| {
            if value.abs() <= MAX_COORDINATE_PX {
                return Ok(());
            }
            let image = self.file.display().to_string();
            Err(LabelsError::Number { path: path.into(), image, what, value })
        };
        let robots = self.robots.iter().flatten();
        for (index, robot) in robots.clone().enumerate() {
            number("x_px", robot.x_px)?;
            number("y_px", robot.y_px)?;
            number("heading_deg", robot.heading_deg)?;
            let before = robots.clone().take(index);
            if before.clone().any(|other| (other.team, other.id) == (robot.team, robot.id)) {
                return Err(LabelsError::Twice {
                    path: path.into(),
                    image: self.file.display().to_string(),
                    team: robot.team,
                    id: robot.id,
                });
            }
        }
        if let Some(Some(ball)) = &self.ball {
            number("x_px", ball.x_px)?;
            number("y_px", ball.y_px)?;
        }
        for sample in &self.samples {
            match sample.area {
                SampleArea::Rectangle { rect_px } => {
                    rect_px.iter().try_for_each(|&value| number("rect_px", value))?;
                }
                SampleArea::Disc { x_px, y_px, radius_px } => {
                    number("x_px", x_px)?;
                    number("y_px", y_px)?;
                    number("radius_px", radius_px)?;
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Labels, LabelsError> {
        Labels::parse(text, Path::new("labels.json"))
    }

    #[test]
    fn absent_differs_from_null() {
        let ball = |text: &str| {
            let image = parse(&format!(r#"{{"images": [{{"file": "a.png"{text}}}]}}"#)).unwrap();
            image.images[0].ball.clone()
        };
        assert_eq!(ball(""), None);
        assert_eq!(ball(r#", "ball": null"#), Some(None));
        let there = ball(r#", "ball": {"x_px": 1, "y_px": 2.5}, "note": 3"#).flatten().unwrap();
        assert_eq!(there, BallLabel { x_px: 1.0, y_px: 2.5, quality: Quality::Clear });
    }

    #[test]
    fn samples_are_discs_and_rectangles() {
        let labels = parse(
            r#"{"images": [{"file": "a.png", "samples": [
                {"color": "red", "x_px": 5, "y_px": 6},
                {"color": "background", "rect_px": [0, 1, 2, 3]}
            ]}]}"#,
        )
        .unwrap();
        let [disc, rectangle] = &labels.images[0].samples[..] else { panic!("{labels:?}") };
        assert_eq!(disc.area, SampleArea::Disc { x_px: 5.0, y_px: 6.0, radius_px: 2.0 });
        assert_eq!(rectangle.area, SampleArea::Rectangle { rect_px: [0.0, 1.0, 2.0, 3.0] });
    }

    #[test]
    fn errors_name_the_offending_entry() {
        let complaint = |robots: &str| {
            let text = format!(r#"{{"images": [{{"file": "a.png", "robots": [{robots}]}}]}}"#);
            parse(&text).unwrap_err().to_string()
        };
        let robot = r#"{"team": "blue", "id": 3, "x_px": 1, "y_px": 2, "heading_deg": 3}"#;
        let twice = complaint(&format!("{robot}, {robot}"));
        assert!(twice.contains("a.png: blue 3 is labelled twice"), "{twice}");
        let far = complaint(&robot.replace(r#""x_px": 1"#, r#""x_px": 1e9"#));
        assert!(far.contains("x_px = 1000000000"), "{far}");
        let unknown = complaint(&robot.replace("blue", "green"));
        assert!(unknown.contains("labels.json") && unknown.contains("green"), "{unknown}");
    }
}
