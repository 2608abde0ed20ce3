//! Points marked by a person: from a file and from the command line.

use crate::calibration::{LandmarkError, Mark, resolve_landmark};
use config::input;
use config::{FieldConfig, Pair};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// A file of points.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PointsFile {
    /// Height of the wall, for points named "wall …".
    pub wall_height_mm: Option<f64>,
    /// Height of the lens above the floor, if it was measured.
    pub camera_height_mm: Option<f64>,
    /// Position of the lens, [x, y, height], if it was measured.
    pub camera_mm: Option<[f64; 3]>,
    /// The points.
    points: Vec<Point>,
}

/// A point as written in the file: by name or by millimetres.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Point {
    at: Option<String>,
    field_mm: Option<Vec<f64>>,
    image_px: Pair,
}

/// A marked point with its name for messages.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedMark {
    /// Its name, or its millimetres.
    pub name: String,
    /// Its position on the pitch and in the picture.
    pub mark: Mark,
}

impl NamedMark {
    /// A mark that the program has found.
    pub fn found(mark: &Mark) -> Self {
        let [x, y, _] = mark.field_mm;
        Self { name: format!("({x}, {y}) as found"), mark: *mark }
    }
}

/// Reason why points cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PointsError {
    /// The file cannot be read.
    #[error("cannot read the points {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file is not a file of points.
    #[error("{}: {problem}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// The error and its place in the file.
        problem: toml::de::Error,
    },
    /// The name is unknown.
    #[error("point {number}: {source}")]
    Landmark {
        /// Number of the point, from 1.
        number: usize,
        /// The error.
        source: LandmarkError,
    },
    /// Neither name nor millimetres, or both.
    #[error(
        "point {0}: say where it is, by name (`at = \"corner top left\"`) or by `field_mm = [x, y]` or \
         `[x, y, height]`, one of them"
    )]
    Place(usize),
    /// The argument is malformed.
    #[error("--at {0}: write PLACE=X,Y, as in corner-tl=12,40, or -1100,900,50=12,40")]
    Argument(String),
}

impl PointsFile {
    /// Reads a file.
    pub fn load(path: &Path) -> Result<Self, PointsError> {
        let text = input::read_text(path, input::POINTS)
            .map_err(|source| PointsError::Read { path: path.into(), source })?;
        toml::from_str(&text).map_err(|problem| PointsError::Format { path: path.into(), problem })
    }

    /// Adds a point given as PLACE=X,Y.
    pub fn add_argument(&mut self, argument: &str) -> Result<(), PointsError> {
        let wrong = || PointsError::Argument(argument.into());
        let (place, pixel) = argument.rsplit_once('=').ok_or_else(wrong)?;
        let image_px = numbers(pixel).and_then(|px| px.try_into().ok()).ok_or_else(wrong)?;
        let field_mm = numbers(place);
        if field_mm.is_none() && place.trim().is_empty() {
            return Err(wrong());
        }
        let at = field_mm.is_none().then(|| place.to_string());
        self.points.push(Point { at, field_mm, image_px });
        Ok(())
    }

    /// All points with their positions.
    pub fn marks(&self, field: &FieldConfig) -> Result<Vec<NamedMark>, PointsError> {
        let points = self.points.iter().enumerate();
        points.map(|(index, point)| self.mark(index + 1, point, field)).collect()
    }

    fn mark(
        &self,
        number: usize,
        point: &Point,
        field: &FieldConfig,
    ) -> Result<NamedMark, PointsError> {
        let (name, field_mm) = match (&point.at, point.field_mm.as_deref()) {
            (Some(name), None) => {
                let place = resolve_landmark(name, field, self.wall_height_mm)
                    .map_err(|source| PointsError::Landmark { number, source })?;
                (name.clone(), place)
            }
            (None, Some(&[x, y])) => (format!("({x}, {y})"), [x, y, 0.0]),
            (None, Some(&[x, y, height])) => (format!("({x}, {y}, {height})"), [x, y, height]),
            _ => return Err(PointsError::Place(number)),
        };
        Ok(NamedMark { name, mark: Mark { field_mm, image_px: point.image_px } })
    }
}

/// Parses numbers separated by commas; `None` if anything else is among them.
fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split(',').map(|number| number.trim().parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_as_documented() {
        // The example of docs/calibration.md.
        let text = include_str!("../../../../../docs/calibration.md");
        let (_, rest) = text.split_once("```toml\n").unwrap();
        let (example, _) = rest.split_once("```").unwrap();
        let file: PointsFile = toml::from_str(example).unwrap();
        let marks = file.marks(&FieldConfig::default()).unwrap();
        assert_eq!(marks[0].mark.field_mm, [-1100.0, 900.0, 0.0]);
        assert!(marks.iter().any(|point| point.mark.field_mm == [-1100.0, 900.0, 50.0]));
        assert!(marks.iter().any(|point| point.name.starts_with('(')));
    }

    #[test]
    fn arguments_are_names_or_numbers() {
        let mut file = PointsFile { wall_height_mm: Some(50.0), ..PointsFile::default() };
        for argument in ["corner-tl=12,40.5", "-1100,900=1,2", "10, 20, 30 = 3 , 4", "wall br=5,6"]
        {
            file.add_argument(argument).unwrap();
        }
        let marks = file.marks(&FieldConfig::default()).unwrap();
        let places: Vec<[f64; 3]> = marks.iter().map(|point| point.mark.field_mm).collect();
        let expected = [[-1100.0, 900.0, 0.0], [-1100.0, 900.0, 0.0], [10.0, 20.0, 30.0]];
        assert_eq!(places[..3], expected);
        assert_eq!(places[3], [1100.0, -900.0, 50.0]);
        assert_eq!(marks[0].mark.image_px, [12.0, 40.5]);
        for argument in ["", "corner-tl", "corner-tl=12", "corner-tl=a,b", "=1,2", "x=1,2,3"] {
            assert!(PointsFile::default().add_argument(argument).is_err(), "{argument}");
        }
    }

    #[test]
    fn faulty_points_are_named() {
        let wrong = |text: &str| {
            let file: PointsFile = toml::from_str(text).unwrap();
            file.marks(&FieldConfig::default()).unwrap_err().to_string()
        };
        let text = wrong("points = [{ at = \"penalty\", image_px = [1, 2] }]");
        assert!(
            text.contains("point 1: \"penalty\"") && text.contains("corner top left"),
            "{text}"
        );
        assert!(wrong("points = [{ image_px = [1, 2] }]").contains("field_mm"));
        assert!(wrong("points = [{ field_mm = [1], image_px = [1, 2] }]").contains("height"));
        assert!(toml::from_str::<PointsFile>("points = [{ at = \"x\", px = [1, 2] }]").is_err());
    }
}
