//! The pinhole camera that comes closest to a camera model, for programs that know no other.
//!
//! The leagues describe a camera by its rotation R and translation t from the field, its focal length f,
//! its principal point c and one radial term k:
//!
//! ```text
//! p = R·q + t        q on the field, mm; p in the camera's axes: right, down, forward
//! u = (p.x, p.y) / p.z
//! |u| = |d|·(1 + k·|d|²)      d in the direction of u
//! pixel = f·d + c
//! ```
//!
//! Our model has a free homography of the floor, two terms, or a fisheye lens. So the pinhole is fitted: by
//! least squares over a grid of points on the floor and at the height of the robots, both of which our model
//! places in the picture. The rest of the distances is the error that a receiver makes who uses it.

use super::least_squares::minimise;
use geometry::{CameraModel, FieldPoint, ImagePoint};
use nalgebra::{DVector, Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};

/// A pinhole camera with one radial term.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole {
    /// Pixels.
    pub focal_px: f64,
    /// Column and row.
    pub principal_point_px: [f64; 2],
    /// k.
    pub distortion: f64,
    /// R as a unit quaternion: x, y, z, w.
    pub camera_from_field: [f64; 4],
    /// t.
    pub translation_mm: [f64; 3],
    /// Position of the camera on the field.
    pub position_mm: [f64; 3],
    /// Root mean square of the distances to our model, over the field.
    pub rms_px: f64,
    /// The largest of them.
    pub worst_px: f64,
}

/// Reason why there is no such pinhole.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PinholeError {
    /// A mirrored picture is no rotation of the field.
    #[error("the picture is mirrored, which a pinhole camera cannot describe")]
    Mirrored,
    /// The fit has failed.
    #[error("no pinhole camera comes close to the calibration")]
    NoFit,
}

/// Points along each side of the grid.
const GRID: usize = 9;

/// A point of the field with its height, and its pixel.
type Sample = (Vector3<f64>, Vector2<f64>);

/// A pinhole camera during the fit.
#[derive(Clone, Copy)]
struct Camera {
    turn: Rotation3<f64>,
    position: Vector3<f64>,
    focal_px: f64,
    center: Vector2<f64>,
    distortion: f64,
}

impl Pinhole {
    /// The pinhole closest to a model on a field of `[length, width]`, between the floor and `height_mm`, for
    /// pictures of `picture_px` pixels across and down.
    pub fn closest_to(
        model: &CameraModel,
        field_mm: [f64; 2],
        height_mm: f64,
        picture_px: [u32; 2],
    ) -> Result<Self, PinholeError> {
        let samples = samples(model, field_mm, height_mm);
        let start = start(model, picture_px)?;
        // Parameters of order one: angles, lengths in camera heights, and focal lengths.
        let unit_mm = start.position.z;
        let with = |values: &DVector<f64>| Camera {
            turn: Rotation3::new(Vector3::new(values[0], values[1], values[2])) * start.turn,
            position: start.position + Vector3::new(values[3], values[4], values[5]) * unit_mm,
            focal_px: start.focal_px * values[6].exp(),
            center: start.center + Vector2::new(values[7], values[8]) * start.focal_px,
            distortion: values[9],
        };
        let residuals = |values: &DVector<f64>| {
            let camera = with(values);
            let errors = samples.iter().flat_map(|(point, pixel)| {
                let offset = camera.pixel(point) - pixel;
                [offset.x, offset.y]
            });
            DVector::from_iterator(2 * samples.len(), errors)
        };
        let minimum = minimise(DVector::zeros(10), residuals).ok_or(PinholeError::NoFit)?;
        let camera = with(&minimum.parameters);
        let distances = samples.iter().map(|(point, pixel)| (camera.pixel(point) - pixel).norm());
        let worst_px = distances.fold(0.0, f64::max);
        let rms_px = (minimum.sum_of_squares / samples.len() as f64).sqrt();
        let is_usable = camera.position.z > 0.0 && rms_px.is_finite();
        is_usable.then(|| camera.described(rms_px, worst_px)).ok_or(PinholeError::NoFit)
    }

    /// The pixel of a point of the field with its height.
    pub fn pixel(&self, point_mm: [f64; 3]) -> [f64; 2] {
        let [x, y, z, w] = self.camera_from_field;
        let turn = UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z));
        let seen = turn * Vector3::from(point_mm) + Vector3::from(self.translation_mm);
        let center = Vector2::from(self.principal_point_px);
        (center + distort(seen.xy() / seen.z, self.distortion) * self.focal_px).into()
    }
}

impl Camera {
    fn pixel(&self, point: &Vector3<f64>) -> Vector2<f64> {
        let seen = self.turn * (point - self.position);
        self.center + distort(seen.xy() / seen.z, self.distortion) * self.focal_px
    }

    fn described(&self, rms_px: f64, worst_px: f64) -> Pinhole {
        let turn = UnitQuaternion::from_rotation_matrix(&self.turn);
        // Of the two quaternions of a rotation, the one with w ≥ 0.
        let turn = if turn.w < 0.0 { -turn.into_inner() } else { turn.into_inner() };
        Pinhole {
            focal_px: self.focal_px,
            principal_point_px: self.center.into(),
            distortion: self.distortion,
            camera_from_field: [turn.i, turn.j, turn.k, turn.w],
            translation_mm: (-(self.turn * self.position)).into(),
            position_mm: self.position.into(),
            rms_px,
            worst_px,
        }
    }
}

/// The distorted point d of an undistorted u: the root of r·(1 + k·r²) = |u|, by Newton's method from |u|.
fn distort(undistorted: Vector2<f64>, k: f64) -> Vector2<f64> {
    let wanted = undistorted.norm();
    if wanted < 1e-12 {
        return undistorted;
    }
    let mut radius = wanted;
    for _ in 0..20 {
        let slope = (1.0 + 3.0 * k * radius * radius).max(0.05);
        let step = (radius * (1.0 + k * radius * radius) - wanted) / slope;
        radius -= step;
        if step.abs() < 1e-12 {
            break;
        }
    }
    undistorted * (radius / wanted)
}

fn samples(model: &CameraModel, [length, width]: [f64; 2], height_mm: f64) -> Vec<Sample> {
    let steps = || (0..GRID).map(|step| step as f64 / (GRID - 1) as f64 - 0.5);
    let points = [0.0, height_mm].into_iter().flat_map(|height| {
        steps().flat_map(move |x| steps().map(move |y| Vector3::new(x * length, y * width, height)))
    });
    points
        .map(|point| {
            let seen = model.image_from_field(FieldPoint::new(point.x, point.y), point.z);
            (point, Vector2::new(seen.x_px, seen.y_px))
        })
        .collect()
}

/// The camera without distortion, from where three pixels near the middle of the picture lie on the floor:
/// the first is on the axis, the others tell where right and down are, and how long the lens is.
fn start(model: &CameraModel, picture_px: [u32; 2]) -> Result<Camera, PinholeError> {
    let [width, height] = picture_px.map(f64::from);
    let center = Vector2::new((width - 1.0) / 2.0, (height - 1.0) / 2.0);
    let [x, y, z] = model.position_mm();
    let position = Vector3::new(x, y, z);
    let step_px = width.min(height) / 8.0;
    let direction = |dx: f64, dy: f64| {
        let floor = model.field_from_image(ImagePoint::new(center.x + dx, center.y + dy), 0.0);
        (Vector3::new(floor.x_mm, floor.y_mm, 0.0) - position).normalize()
    };
    let (forward, beside, below) =
        (direction(0.0, 0.0), direction(step_px, 0.0), direction(0.0, step_px));
    let right = (beside - forward * beside.dot(&forward)).normalize();
    let down = forward.cross(&right);
    if down.dot(&below) < 0.0 {
        return Err(PinholeError::Mirrored);
    }
    let slope = beside.cross(&forward).norm() / beside.dot(&forward);
    let rows = Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()]);
    let is_usable = rows.iter().all(|value| value.is_finite()) && slope > 0.0;
    is_usable
        .then(|| Camera {
            turn: Rotation3::from_matrix_unchecked(rows),
            position,
            focal_px: step_px / slope,
            center,
            distortion: 0.0,
        })
        .ok_or(PinholeError::NoFit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use config::{Config, DistortionModel, GeometryConfig, PointPair, Preset};

    fn model(config: &Config) -> CameraModel {
        let camera = &config.camera;
        CameraModel::new(&config.geometry, camera.width, camera.height).unwrap()
    }

    fn closest(config: &Config) -> Result<Pinhole, PinholeError> {
        let (field, camera) = (&config.field, &config.camera);
        Pinhole::closest_to(
            &model(config),
            [field.length_mm, field.width_mm],
            config.robots.height_mm,
            [camera.width, camera.height],
        )
    }

    /// A configuration whose camera is this pinhole, marked at points all over the field.
    fn config_of(pinhole: &Pinhole) -> Config {
        let mut config = Preset::Vsss3v3.config();
        let reach = [-1.0, -0.5, 0.0, 0.5, 1.0];
        config.geometry = GeometryConfig {
            camera_mm: pinhole.position_mm,
            points: reach
                .iter()
                .flat_map(|x| reach.iter().map(move |y| [x * 750.0, y * 650.0]))
                .map(|[x, y]| PointPair { field_mm: [x, y], image_px: pinhole.pixel([x, y, 0.0]) })
                .collect(),
            distortion: config.geometry.distortion,
        };
        config.geometry.distortion.k1 = 0.0;
        config
    }

    #[test]
    fn a_pinhole_is_found_again() {
        let turn = Rotation3::from_euler_angles(3.05, 0.08, 0.3);
        let turn = UnitQuaternion::from_rotation_matrix(&turn).into_inner();
        let position = Vector3::new(120.0, -80.0, 2100.0);
        let rotation = UnitQuaternion::new_normalize(turn);
        let camera = Pinhole {
            focal_px: 700.0,
            principal_point_px: [331.0, 228.0],
            distortion: 0.0,
            camera_from_field: [turn.i, turn.j, turn.k, turn.w],
            translation_mm: (-(rotation * position)).into(),
            position_mm: position.into(),
            rms_px: 0.0,
            worst_px: 0.0,
        };
        let found = closest(&config_of(&camera)).unwrap();
        assert!(found.worst_px < 1e-3, "{found:?}");
        assert!((found.focal_px - 700.0).abs() < 0.1, "{found:?}");
        for axis in 0..3 {
            assert!((found.position_mm[axis] - position[axis]).abs() < 1.0, "{found:?}");
        }
        // Any point in between is at the same pixel.
        for point in [[333.0, -222.0, 40.0], [-700.0, 600.0, 0.0]] {
            let (a, b) = (camera.pixel(point), found.pixel(point));
            assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 0.01, "{a:?} {b:?}");
        }
    }

    #[test]
    fn presets_have_a_pinhole_close_to_their_camera() {
        for preset in Preset::ALL {
            let config = preset.config();
            let found = closest(&config).unwrap();
            // The presets' keystone is no pinhole's.
            assert!(found.rms_px < 3.0, "{}: {found:?}", preset.name());
            let [x, y, z] = config.geometry.camera_mm;
            let [found_x, found_y, found_z] = found.position_mm;
            let apart = (found_x - x).hypot(found_y - y).hypot(found_z - z);
            assert!(apart < 0.1 * z, "{}: {found:?}", preset.name());
            let length: f64 = found.camera_from_field.iter().map(|it| it * it).sum();
            assert!((length - 1.0).abs() < 1e-9, "{found:?}");
        }
    }

    #[test]
    fn the_error_of_a_fisheye_is_said() {
        let mut config = Preset::Vsss3v3.config();
        config.geometry.distortion.model = DistortionModel::Fisheye;
        config.geometry.distortion.k1 = 0.0;
        let found = closest(&config).unwrap();
        assert!(found.rms_px > 0.01 && found.worst_px >= found.rms_px, "{found:?}");
        let seen = model(&config).image_from_field(FieldPoint::new(750.0, 650.0), 0.0);
        let [x, y] = found.pixel([750.0, 650.0, 0.0]);
        assert!((x - seen.x_px).hypot(y - seen.y_px) <= found.worst_px + 1e-9);
    }

    #[test]
    fn a_mirrored_picture_has_none() {
        let mut config = Preset::Vsss3v3.config();
        for pair in &mut config.geometry.points {
            pair.image_px[0] = f64::from(config.camera.width) - 1.0 - pair.image_px[0];
        }
        config.camera.mirrored = true;
        assert_eq!(closest(&config), Err(PinholeError::Mirrored));
    }
}
