//! The parts of the configuration that describe shapes and places: pitch, camera geometry, lens, patches.
//!
//! They are defined here, below the configuration, because a camera model is computed from them and the
//! configuration is checked with a camera model.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A point or vector: `[x, y]`.
pub type Pair = [f64; 2];

/// The pitch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FieldConfig {
    /// Inner length, along x, between the goal lines.
    #[schemars(range(min = 100, max = 100_000))]
    pub length_mm: f64,
    /// Inner width, along y, between the side walls.
    #[schemars(range(min = 100, max = 100_000))]
    pub width_mm: f64,
    /// Width of the goal mouths.
    #[schemars(range(min = 0, max = 100_000))]
    pub goal_width_mm: f64,
    /// Depth of the goals behind the goal lines.
    #[schemars(range(min = 0, max = 10_000))]
    pub goal_depth_mm: f64,
    /// Radius of the centre circle.
    #[schemars(range(min = 0, max = 50_000))]
    pub center_circle_radius_mm: f64,
    /// Robots and balls found up to this far outside the field still count.
    #[schemars(range(min = 0, max = 10_000))]
    pub margin_mm: f64,
    /// Process only the part of the picture that shows the field, goals and margin, and the areas
    /// below: spectators' shirts then cost no time and are not taken for balls. false: the whole
    /// picture.
    pub mask: bool,
    /// Further areas to process, for example where robots wait, each a polygon of at least three
    /// corners [x, y] in field millimetres. Regions there are listed in the detections, but robots and
    /// balls count only within the margin.
    #[schemars(length(max = 64), inner(length(min = 3, max = 64)))]
    #[schemars(inner(inner(inner(range(min = -1_000_000, max = 1_000_000)))))]
    pub also_look_at_mm: Vec<Vec<Pair>>,
}

impl FieldConfig {
    /// The corners of the pitch.
    pub fn corners(&self) -> [Pair; 4] {
        let (x, y) = (self.length_mm / 2.0, self.width_mm / 2.0);
        [[-x, y], [x, y], [x, -y], [-x, -y]]
    }

    /// Points around the pitch: its corners and points on its sides.
    pub fn outline(&self) -> impl Iterator<Item = Pair> + use<> {
        const STEPS: u32 = 8;
        let corners = self.corners();
        (0..4).flat_map(move |side| {
            let (from, to) = (corners[side], corners[(side + 1) % 4]);
            (0..STEPS).map(move |step| {
                let part = f64::from(step) / f64::from(STEPS);
                [0, 1].map(|axis: usize| from[axis] + part * (to[axis] - from[axis]))
            })
        })
    }

    /// The unit in which these points would be on the pitch and spread over a good part of it, if it is not
    /// millimetres; with its length in millimetres.
    pub fn likely_unit(&self, points: impl Iterator<Item = Pair>) -> Option<(&'static str, f64)> {
        let half = (self.length_mm / 2.0).hypot(self.width_mm / 2.0);
        let reach = points.fold(0.0f64, |most, [x, y]| most.max(x.hypot(y)));
        let is_likely =
            |&(_, factor): &(_, f64)| (0.4 * half..1.3 * half).contains(&(reach * factor));
        [("metres", 1000.0), ("centimetres", 10.0)].into_iter().find(is_likely)
    }
}

impl Default for FieldConfig {
    fn default() -> Self {
        Self {
            length_mm: 2200.0,
            width_mm: 1800.0,
            goal_width_mm: 400.0,
            goal_depth_mm: 150.0,
            center_circle_radius_mm: 200.0,
            margin_mm: 40.0,
            mask: true,
            also_look_at_mm: Vec::new(),
        }
    }
}

/// A floor point and its position in the picture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PointPair {
    /// Position on the floor: origin at the centre of the pitch, x towards the right goal, y to the
    /// left of x, that is towards the top of an upright picture.
    #[schemars(inner(range(min = -1_000_000, max = 1_000_000)))]
    pub field_mm: Pair,
    /// Position in the picture; the centre of the top-left pixel is [0, 0].
    #[schemars(inner(range(min = -100_000, max = 100_000)))]
    pub image_px: Pair,
}

/// Lens distortion, which moves points towards or away from `center_px`. With `model` "polynomial", a
/// point at distance r in the undistorted picture, in half diagonals of the picture, appears at r·(1 +
/// k1·r² + k2·r⁴). With "fisheye", a ray at angle θ (radians) from the lens axis appears focal_px·(θ +
/// k1·θ³ + k2·θ⁵ + k3·θ⁷ + k4·θ⁹) pixels from it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DistortionConfig {
    /// "polynomial" for ordinary lenses; "fisheye" for wide ones (as in OpenCV's fisheye module, with
    /// fx = fy). `touchline calibrate` chooses the better fit.
    pub model: DistortionModel,
    /// Focal length of a fisheye, in pixels; unused by "polynomial".
    #[schemars(range(min = 1, max = 100_000))]
    pub focal_px: f64,
    /// First term; negative for barrel distortion. 0 for an equidistant fisheye, 1/12 for a stereographic
    /// one.
    #[schemars(range(min = -10, max = 10))]
    pub k1: f64,
    /// Second term.
    #[schemars(range(min = -10, max = 10))]
    pub k2: f64,
    /// Third term; "fisheye" only.
    #[schemars(range(min = -10, max = 10))]
    pub k3: f64,
    /// Fourth term; "fisheye" only.
    #[schemars(range(min = -10, max = 10))]
    pub k4: f64,
    /// Optical centre in the picture.
    #[schemars(inner(range(min = -100_000, max = 100_000)))]
    pub center_px: Pair,
}

/// Lens models.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum DistortionModel {
    /// The lens shows straight lines about straight.
    #[default]
    Polynomial,
    /// The lens shows equal angles at about equal distances.
    Fisheye,
}

/// Position of the camera and mapping from picture to field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GeometryConfig {
    /// Position of the lens in field coordinates, [x, y, height above the floor]; used to correct for
    /// the height of robots and ball.
    #[schemars(inner(range(min = -1_000_000, max = 1_000_000)))]
    pub camera_mm: [f64; 3],
    /// At least four floor points with their positions in the picture, no three on a line; more than
    /// four are fitted by least squares.
    #[schemars(length(min = 4, max = 1000))]
    pub points: Vec<PointPair>,
    /// Lens distortion.
    pub distortion: DistortionConfig,
}

impl Default for DistortionConfig {
    fn default() -> Self {
        Self {
            model: DistortionModel::Polynomial,
            focal_px: 400.0,
            k1: -0.03,
            k2: 0.0,
            k3: 0.0,
            k4: 0.0,
            center_px: [319.5, 239.5],
        }
    }
}

impl Default for GeometryConfig {
    fn default() -> Self {
        Self::above(&FieldConfig::default(), [640, 480], 2200.0)
    }
}

impl GeometryConfig {
    /// A camera `height_mm` above the field, slightly off its centre and slightly tilted, such that the
    /// whole field fills a picture of this width and height with a small border.
    pub fn above(field: &FieldConfig, picture_px: [u32; 2], height_mm: f64) -> Self {
        Self::with_border(field, picture_px, height_mm, 60.0)
    }

    /// Like [`above`](Self::above), with a border in millimetres: objects at the edge of the field lean
    /// outwards, the more the wider the camera looks.
    pub fn with_border(
        field: &FieldConfig,
        picture_px: [u32; 2],
        height_mm: f64,
        border_mm: f64,
    ) -> Self {
        let center_px = picture_px.map(|size| (f64::from(size) - 1.0) / 2.0);
        let reach_x = field.length_mm / 2.0 + field.goal_depth_mm + border_mm;
        let reach_y = field.width_mm / 2.0 + border_mm;
        let px_per_mm = (center_px[0] / reach_x).min(center_px[1] / reach_y);
        // A tilt about the x axis makes the far side of the field a little smaller.
        let keystone = 0.02;
        let corner = |x_sign: f64, y_sign: f64| {
            let field_mm = [x_sign * field.length_mm / 2.0, y_sign * field.width_mm / 2.0];
            let scale = px_per_mm * (1.0 - keystone * y_sign);
            let image_px =
                [center_px[0] + field_mm[0] * scale, center_px[1] - field_mm[1] * px_per_mm];
            PointPair { field_mm, image_px: image_px.map(|value| (value * 100.0).round() / 100.0) }
        };
        Self {
            camera_mm: [30.0, -20.0, height_mm],
            points: vec![
                corner(-1.0, 1.0),
                corner(1.0, 1.0),
                corner(1.0, -1.0),
                corner(-1.0, -1.0),
            ],
            distortion: DistortionConfig { center_px, ..DistortionConfig::default() },
        }
    }
}

/// Role of a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum PatchRole {
    /// Has the team's colour.
    Team,
    /// Has an identification colour.
    Identification,
}

/// One colour patch on a robot's top.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PatchConfig {
    /// "team" or "identification".
    pub role: PatchRole,
    /// Corners in the robot's frame: origin at the centre, x forward, y left. A patch covers those
    /// listed before it.
    #[schemars(length(min = 3, max = 64), inner(inner(range(min = -1000, max = 1000))))]
    pub outline_mm: Vec<Pair>,
}

/// The outline of a robot's body from above.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum RobotShape {
    /// A square.
    #[default]
    Square,
    /// A disc, with an optional straight front.
    Round,
}
