//! Names for the points of a pitch, so that users need not type coordinates.

use config::{FieldConfig, Pair};

/// A named point of the pitch; directions as seen in an upright picture, x to the right and y up.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmark {
    /// Canonical spelling: "corner top left".
    pub name: String,
    /// Position: x and y.
    pub field_mm: Pair,
}

/// Reason why a name is not accepted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LandmarkError {
    /// The pitch has no point with this name.
    #[error("{name:?} is not a point of the pitch; the points are {}", known.join(", "))]
    Unknown {
        /// The unknown name.
        name: String,
        /// All names.
        known: Vec<String>,
    },
    /// A point on top of the wall was named, but the wall's height is unknown.
    #[error("{0:?}: how high is the wall? Give `wall_height_mm`")]
    WallHeight(String),
}

/// All names with their positions.
pub fn landmark_names(field: &FieldConfig) -> Vec<Landmark> {
    let (x, y) = (field.length_mm / 2.0, field.width_mm / 2.0);
    let (goal, depth) = (field.goal_width_mm / 2.0, field.goal_depth_mm);
    let radius = field.center_circle_radius_mm;
    let mut all = vec![
        ("centre".to_string(), [0.0, 0.0]),
        ("centre line top".into(), [0.0, y]),
        ("centre line bottom".into(), [0.0, -y]),
        ("circle top".into(), [0.0, radius]),
        ("circle bottom".into(), [0.0, -radius]),
        ("circle left".into(), [-radius, 0.0]),
        ("circle right".into(), [radius, 0.0]),
    ];
    for (side, sign) in [("left", -1.0), ("right", 1.0)] {
        all.push((format!("corner top {side}"), [sign * x, y]));
        all.push((format!("corner bottom {side}"), [sign * x, -y]));
        all.push((format!("goal {side} middle"), [sign * x, 0.0]));
        all.push((format!("goal {side} top post"), [sign * x, goal]));
        all.push((format!("goal {side} bottom post"), [sign * x, -goal]));
        all.push((format!("goal {side} top back"), [sign * (x + depth), goal]));
        all.push((format!("goal {side} bottom back"), [sign * (x + depth), -goal]));
    }
    all.into_iter().map(|(name, field_mm)| Landmark { name, field_mm }).collect()
}

/// Position of a named point: x, y and height. Words may come in any order, joined by spaces or
/// hyphens; upper, lower, tl, br and the like are accepted. "wall …" is the inner upper edge of the
/// wall above the point, by default above a corner.
pub fn resolve_landmark(
    name: &str,
    field: &FieldConfig,
    wall_height_mm: Option<f64>,
) -> Result<[f64; 3], LandmarkError> {
    let mut words = words(name);
    let is_on_wall = words.iter().any(|word| word == "wall");
    words.retain(|word| word != "wall");
    let names = landmark_names(field);
    let find =
        |wanted: &[String]| names.iter().find(|landmark| self::words(&landmark.name) == wanted);
    let with = |more: &str| {
        let mut wanted = words.clone();
        wanted.push(more.to_string());
        wanted.sort();
        wanted
    };
    // "wall top left" means the corner; "goal left upper" can only mean the post.
    let landmark = find(&words)
        .or_else(|| is_on_wall.then(|| find(&with("corner"))).flatten())
        .or_else(|| find(&with("post")))
        .or_else(|| find(&with("middle")));
    let Some(landmark) = landmark else {
        let known = names.into_iter().map(|landmark| landmark.name).collect();
        return Err(LandmarkError::Unknown { name: name.into(), known });
    };
    let height = match (is_on_wall, wall_height_mm) {
        (false, _) => 0.0,
        (true, Some(height)) => height,
        (true, None) => return Err(LandmarkError::WallHeight(name.into())),
    };
    let [x, y] = landmark.field_mm;
    Ok([x, y, height])
}

/// The words of a name in canonical spelling and order.
fn words(name: &str) -> Vec<String> {
    let parts = name.split(|letter: char| !letter.is_alphanumeric());
    let mut words: Vec<String> = parts
        .filter(|part| !part.is_empty())
        .flat_map(|part| -> Vec<String> {
            let word = part.to_lowercase();
            let spelled: &[&str] = match word.as_str() {
                "tl" => &["top", "left"],
                "tr" => &["top", "right"],
                "bl" => &["bottom", "left"],
                "br" => &["bottom", "right"],
                "upper" => &["top"],
                "lower" => &["bottom"],
                "center" | "centre" | "middle" if name.to_lowercase().contains("goal") => {
                    &["middle"]
                }
                "center" | "middle" => &["centre"],
                "halfway" => &["centre"],
                "the" | "of" | "point" | "spot" => &[],
                _ => return vec![word],
            };
            spelled.iter().map(|word| word.to_string()).collect()
        })
        .collect();
    // "centre circle" and "circle" are the same.
    if words.iter().any(|word| word == "circle") {
        words.retain(|word| word != "centre");
    }
    words.sort();
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(name: &str) -> Result<[f64; 3], LandmarkError> {
        resolve_landmark(name, &FieldConfig::default(), Some(50.0))
    }

    #[test]
    fn every_name_leads_to_its_place_and_no_other() {
        let names = landmark_names(&FieldConfig::default());
        for landmark in &names {
            let [x, y] = landmark.field_mm;
            assert_eq!(place(&landmark.name), Ok([x, y, 0.0]), "{}", landmark.name);
            let spelled_alike =
                names.iter().filter(|other| words(&other.name) == words(&landmark.name));
            assert_eq!(spelled_alike.count(), 1, "{}", landmark.name);
        }
    }

    #[test]
    fn people_may_write_them_as_they_like() {
        for name in ["corner top-left", "corner-tl", "Top Left Corner", "upper_left corner"] {
            assert_eq!(place(name), Ok([-1100.0, 900.0, 0.0]), "{name}");
        }
        for name in ["wall tl", "wall-corner-tl", "top left wall"] {
            assert_eq!(place(name), Ok([-1100.0, 900.0, 50.0]), "{name}");
        }
        assert_eq!(place("goal left upper post"), Ok([-1100.0, 200.0, 0.0]));
        assert_eq!(place("goal right lower"), Ok([1100.0, -200.0, 0.0]));
        assert_eq!(place("goal left centre"), Ok([-1100.0, 0.0, 0.0]));
        assert_eq!(place("centre circle left"), Ok([-200.0, 0.0, 0.0]));
        assert_eq!(place("Center"), Ok([0.0; 3]));
        assert_eq!(place("wall centre line top"), Ok([0.0, 900.0, 50.0]));
    }

    #[test]
    fn unknown_names_are_refused() {
        for name in ["", "corner", "penalty", "corner top left top", "wall"] {
            assert!(matches!(place(name), Err(LandmarkError::Unknown { .. })), "{name:?}");
        }
        let error = resolve_landmark("wall tl", &FieldConfig::default(), None).unwrap_err();
        assert!(error.to_string().contains("wall_height_mm"), "{error}");
    }
}
